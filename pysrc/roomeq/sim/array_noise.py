"""Noise of the late reverberation at the microphones of an array, coherent as in a diffuse field."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import irfft, next_fast_len, rfft
from threadpoolctl import threadpool_limits

from roomeq.core.arrays import Array, FloatArray, IntArray
from roomeq.core.constants import exact_bands_hz
from roomeq.sim.render import tail_noise
from roomeq.sim.trace import sphere_directions

_LOADING = 1e-6  # of the diagonal, for microphones in one place
_STEP_RAD = 0.1  # largest change of k d over frequencies that share a factor
_STEP_SHARE = 0.02  # or relative change of the frequency, if that is more, in arrays that are
_COMPACT_M = 0.5  # larger than this
_ELEMENTS = 2 ** 22  # of the coherence matrices that are in memory at once
_DIRECTIONS = 2000  # of plane waves that are a diffuse field to directive microphones
_LONGER_S = 1.0
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
    n_bins = spectra.shape[1]
    edges = _group_edges(n_fft, fs_hz, float(distance_m.max()), speed_m_s)
    frequency_hz = 0.5 * (edges[:-1] + edges[1:]) * fs_hz / n_fft
    padded = np.pad(spectra, ((0, 0), (0, edges[-1] - n_bins)))
    at_once = max(1, _ELEMENTS // distance_m.size)
    waves = _diffuse_field(positions_m, fs_hz, directivities) if any(directivities) else None
    with threadpool_limits(1):  # of small matrices; threads would take longer than one
        for first in range(0, len(frequency_hz), at_once):
            of_block = frequency_hz[first:first + at_once]
            coherence = (np.sinc(2.0 * of_block[:, None, None] * distance_m / speed_m_s) if waves is None else
                         _coherence(*waves, of_block, speed_m_s, fs_hz))
            factors = np.linalg.cholesky((1.0 - _LOADING) * coherence + _LOADING * np.eye(len(positions_m)))
            factors = factors.astype(np.complex64 if np.iscomplexobj(factors) else np.float32)
            for n, factor in enumerate(factors, first):
                group = slice(edges[n], edges[n + 1])
                padded[:, group] = factor @ padded[:, group]
    return list(irfft(padded[:, :n_bins], n_fft)[:, :n_samples])


class ArrayNoise:
    """Noise of the late reverberation at each microphone of an array, made when it is first asked for.

    Parameters
    ----------
    mics_m
        Shape (n_mics, 3).
    volume_m3, speed_m_s, fs_hz
        Of room and air, and the sample rate.
    rngs
        One per microphone.
    """

    def __init__(self, mics_m: ArrayLike, volume_m3: float, speed_m_s: float, fs_hz: float,
                 rngs: Sequence[np.random.Generator]) -> None:
        self._mics_m, self._rngs = np.asarray(mics_m, dtype=float), rngs
        self._air = speed_m_s, fs_hz
        self._volume_m3 = volume_m3
        self._noises: list[Array] = []

    def at_microphone(self, n: int, n_samples: int) -> Array:
        """Return the noise at microphone `n`, shape (n_samples,).

        No microphone may need more than `_LONGER_S` more than the first that asks.
        """
        speed_m_s, fs_hz = self._air
        if not self._noises:
            longest = n_samples + round(_LONGER_S * fs_hz)
            self._noises = make_coherent([tail_noise(longest, self._volume_m3, speed_m_s, rng, fs_hz)
                                          for rng in self._rngs], self._mics_m, speed_m_s, fs_hz)
        assert n_samples <= len(self._noises[n])
        return self._noises[n][:n_samples]


def _group_edges(n_fft: int, fs_hz: float, largest_m: float, speed_m_s: float) -> IntArray:
    """Return the bins at which groups of frequencies begin that share a factor, and where the last one ends.

    The coherence of omnidirectional microphones differs within a group from that at its middle by 0.22 `_STEP_RAD` at
    most, as the slope of ``sin(x) / x`` is 0.44 at most. Beyond `_COMPACT_M` the width of a group grows with frequency:
    the slope is also 1.07 / x at most, so that the difference is 0.54 `_STEP_SHARE` at most, whatever the distance.
    Between directive microphones it is up to three times as much, of figures of eight along their axis.
    """
    step_hz = _STEP_RAD * speed_m_s / (2.0 * np.pi * max(largest_m, 0.01))
    n_bins = n_fft // 2 + 1
    width = min(max(1, int(step_hz * n_fft / fs_hz)), n_bins)
    share = _STEP_SHARE if largest_m > _COMPACT_M else 0.0
    edges = [0]
    while edges[-1] < n_bins:
        edges.append(edges[-1] + max(width, int(share * edges[-1])))
    return np.array(edges)


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
    different = {id(directivity): directivity for directivity in directivities}
    heard = {key: np.ones((_DIRECTIONS, n_bands)) if directivity is None else directivity(directions)
             for key, directivity in different.items()}
    gains = np.array([heard[id(directivity)] for directivity in directivities])
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
