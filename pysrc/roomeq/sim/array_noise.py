"""Noise of the late reverberation at the microphones of an array, coherent as in a diffuse field."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import irfft, next_fast_len, rfft

from roomeq.core.arrays import Array

_LOADING = 1e-6  # of the diagonal, for microphones in one place
_STEP_RAD = 0.1  # largest change of k d over frequencies that share a factor
_ELEMENTS = 2 ** 22  # of the coherence matrices that are in memory at once
_MARGIN_S = 0.02  # zeros behind the noise: the filters that mix it are short, and must not wrap around


def make_coherent(noises: Sequence[Array], mics_m: ArrayLike, speed_m_s: float, fs_hz: float) -> list[Array]:
    """Mix independent noises so that two microphones at a distance d have the coherence of a diffuse field.

    It is ``sin(k d) / (k d)`` (Cook et al., J. Acoust. Soc. Am. 27 (1955) 1072). The noises are mixed by the Cholesky
    factor of the coherence matrix at each frequency (Habets, Cohen and Gannot, J. Acoust. Soc. Am. 124 (2008) 2911).

    Parameters
    ----------
    noises
        One per microphone, of equal power, shape (n_samples,) each.
    mics_m
        Shape (n_mics, 3).
    speed_m_s
        Speed of sound.
    fs_hz

    Returns
    -------
    list of ndarray of float32, shape (n_samples,)
        Of the same power; the first is unchanged but for rounding.
    """
    positions_m, n_samples = np.asarray(mics_m, dtype=float), len(noises[0])
    distance_m = np.linalg.norm(positions_m[:, None] - positions_m, axis=2)
    n_fft = next_fast_len(n_samples + round(_MARGIN_S * fs_hz), real=True)
    spectra = rfft(np.array(noises, np.float32), n_fft)
    step_hz = _STEP_RAD * speed_m_s / (2.0 * np.pi * max(float(distance_m.max()), 0.01))
    n_bins = spectra.shape[1]
    width = min(max(1, int(step_hz * n_fft / fs_hz)), n_bins)
    n_groups = -(-n_bins // width)
    frequency_hz = (np.arange(n_groups) + 0.5) * width * fs_hz / n_fft
    padded = np.pad(spectra, ((0, 0), (0, n_groups * width - n_bins)))
    groups = padded.reshape(len(padded), n_groups, width).transpose(1, 0, 2)
    at_once = max(1, _ELEMENTS // distance_m.size)
    for block in (slice(first, first + at_once) for first in range(0, n_groups, at_once)):
        coherence = np.sinc(2.0 * frequency_hz[block, None, None] * distance_m / speed_m_s)
        factor = np.linalg.cholesky((1.0 - _LOADING) * coherence + _LOADING * np.eye(len(positions_m)))
        groups[block] = factor.astype(np.float32) @ groups[block]
    return list(irfft(padded[:, :n_bins], n_fft)[:, :n_samples])
