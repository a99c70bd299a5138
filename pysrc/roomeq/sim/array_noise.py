"""Noise of the late reverberation at the microphones of an array, coherent as in a diffuse field."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import irfft, next_fast_len, rfft

from roomeq.core.arrays import Array, FloatArray
from roomeq.core.constants import exact_bands_hz
from roomeq.sim.trace import sphere_directions

_LOADING = 1e-6  # of the diagonal, for microphones in one place
_STEP_RAD = 0.1  # largest change of k d over frequencies that share a factor
_ELEMENTS = 2 ** 22  # of the coherence matrices that are in memory at once
_DIRECTIONS = 2000  # of plane waves that are a diffuse field to directive microphones
_MARGIN_S = 0.02  # zeros behind the noise: the filters that mix it are short, and must not wrap around


def make_coherent(noises: Sequence[Array], mics_m: ArrayLike, speed_m_s: float, fs_hz: float,
                  directivities: Sequence[Callable[[FloatArray], FloatArray] | None] = ()) -> list[Array]:
    """Mix independent noises so that two microphones at a distance d have the coherence of a diffuse field.

    Of omnidirectional ones it is ``sin(k d) / (k d)`` (Cook et al., J. Acoust. Soc. Am. 27 (1955) 1072). With
    directivities D it is the mean of ``D_1 D_2 exp(i k x)`` over all directions, where x is the part of d along each,
    over the root of both mean squares (Elko, in Brandstein and Ward, Microphone Arrays, Springer 2001, ch. 4). The
    noises are mixed by the Cholesky factor of the coherence matrix at each frequency (Habets, Cohen and Gannot, J.
    Acoust. Soc. Am. 124 (2008) 2911).

    Parameters
    ----------
    noises
        One per microphone, of equal power, shape (n_samples,) each.
    mics_m
        Shape (n_mics, 3).
    speed_m_s
        Speed of sound.
    fs_hz
    directivities
        One per microphone, from unit vectors away from it, shape (n, 3), to gains of pressure, shape (n, n_bands); None
        is omnidirectional. By default all are.

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
    waves = _diffuse_field(positions_m, fs_hz, directivities) if any(directivities) else None
    for block in (slice(first, first + at_once) for first in range(0, n_groups, at_once)):
        coherence = (np.sinc(2.0 * frequency_hz[block, None, None] * distance_m / speed_m_s) if waves is None else
                     _coherence(*waves, frequency_hz[block], speed_m_s, fs_hz))
        factor = np.linalg.cholesky((1.0 - _LOADING) * coherence + _LOADING * np.eye(len(positions_m)))
        groups[block] = factor.astype(np.complex64 if np.iscomplexobj(factor) else np.float32) @ groups[block]
    return list(irfft(padded[:, :n_bins], n_fft)[:, :n_samples])


def _diffuse_field(positions_m: FloatArray, fs_hz: float, directivities: Sequence[
        Callable[[FloatArray], FloatArray] | None]) -> tuple[FloatArray, FloatArray]:
    """Return plane waves from everywhere as directive microphones hear them.

    Returns
    -------
    gains : ndarray, shape (n_mics, n_waves, n_bands)
        Of unit mean square over the waves.
    ahead_m : ndarray, shape (n_mics, n_waves)
        How far each microphone lies towards where a wave comes from.
    """
    directions, n_bands = sphere_directions(_DIRECTIONS, np.random.default_rng(0)), len(exact_bands_hz(fs_hz))
    gains = np.array([np.ones((_DIRECTIONS, n_bands)) if directivity is None else directivity(directions)
                      for directivity in directivities])
    gains = gains / np.sqrt(np.maximum(np.mean(gains ** 2, axis=1, keepdims=True), np.finfo(float).tiny))
    return gains, (positions_m - positions_m.mean(axis=0)) @ directions.T


def _coherence(gains: FloatArray, ahead_m: FloatArray, frequency_hz: FloatArray, speed_m_s: float,
               fs_hz: float) -> Array:
    """Return the coherence of microphones in the field of `_diffuse_field`, shape (n_frequencies, n_mics, n_mics)."""
    band = np.abs(np.log(frequency_hz[:, None] / exact_bands_hz(fs_hz))).argmin(axis=1)
    result = np.empty((len(frequency_hz), len(gains), len(gains)), complex)
    for n, (one_hz, of_band) in enumerate(zip(frequency_hz, band, strict=True)):
        heard = gains[:, :, of_band] * np.exp(2j * np.pi * one_hz / speed_m_s * ahead_m)
        result[n] = heard @ heard.conj().T / _DIRECTIONS
    return result
