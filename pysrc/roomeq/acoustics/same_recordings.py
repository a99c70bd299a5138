"""Find pairs of recordings that are one, whatever their level, polarity, format or time of flight.

Neither the reflections nor the noise of two recordings are the same. What a high-pass or a resampler does lies outside
the band that is compared. The time of the direct sound, by which recordings are aligned, depends on both; the best lag
is therefore searched.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from roomeq.acoustics.iso3382 import DIRECT_S
from roomeq.core.arrays import Array, FloatArray, IntArray
from roomeq.core.constants import FS_HZ

SAME = 0.95
"""Correlation of each part of two recordings from which on they are one.

In 620 measured RIRs, those of neighbouring microphones reach 0.51 (4 cm apart), and those of one position in two states
of a room 0.47. In a diffuse field with the spectra of these RIRs, those of microphones 2 cm apart would reach 0.81, and
1 cm apart 0.947. All copies of 120 of them by way of another sampling rate or a high-pass at 20 Hz are found, and 105
of those in 16 bits with a peak of -40 dB: in the others, the last part is lost in the rounding.
"""
PARTS_S = (DIRECT_S, 0.01, 0.03, 0.08, 0.2)
"""Limits of the parts, after the direct sound, which is alike in all rooms."""
BAND_HZ = (200.0, 6000.0)
"""Limits of the frequencies that are compared, with a weight in proportion to the frequency: at low frequencies,
neighbouring microphones hear the same."""
MOST_LAG_S = 5e-4
"""Largest difference between the times at which the direct sound is found."""
SHORTEST_LAST_S = 0.02
"""Least length of the last part, up to the end of the shorter recording."""

_EDGES = np.rint((np.array(PARTS_S) - PARTS_S[0]) * FS_HZ).astype(int)
_MARGIN = round(MOST_LAG_S * FS_HZ)
_N_CUT = int(_EDGES[-1]) + 2 * _MARGIN
_N_FFT = 4096
_COARSE_HZ, _COARSE_STEP, _COARSE_SAME = 1500.0, 2, 0.8
"""Upper limit of the frequencies, step of the lags [samples] and correlation by which pairs are chosen."""
_BLOCK = 1000  # recordings whose correlations with all others are in memory at a time
_FINE_LAGS = np.arange(-_COARSE_STEP, _COARSE_STEP + 0.1, 0.25)  # [samples]


class SamePair(NamedTuple):
    """Numbers of two recordings that are one, and the least correlation of their parts."""

    first: int
    second: int
    correlation: float


def cut_parts(rir: FloatArray, direct_sample: float) -> FloatArray:
    """Return the part of a recording that is compared with others, band-limited and weighted, shape (n_samples,).

    What lies beyond the end of the recording is zero.
    """
    begin = round(direct_sample) + round(PARTS_S[0] * FS_HZ) - _MARGIN
    cut = np.trim_zeros(rir, "b")[begin:begin + _N_CUT]
    spectrum = _in_band(np.fft.rfft(cut, _N_FFT), BAND_HZ[1])
    limited = np.fft.irfft(spectrum * np.arange(len(spectrum)))[:_N_CUT]
    limited[len(cut):] = 0.0
    return np.asarray(limited, dtype=np.float32)


def find_same(one: FloatArray, other: FloatArray | None = None) -> Iterator[SamePair]:
    """Yield the pairs of a recording of the one and one of the other set that are the same, by their numbers.

    Pairs are first chosen by the correlation of the whole cut at low frequencies, which is fast.

    Parameters
    ----------
    one : ndarray, shape (n, n_samples)
        See `cut_parts`.
    other : ndarray, shape (m, n_samples), optional
        If not given, recordings of `one` are compared with later ones of it.
    """
    others = one if other is None else other
    for begin in range(0, len(one), _BLOCK):
        block = one[begin:begin + _BLOCK]
        best, lag = _coarse_correlation(block, others)
        for n, m in np.argwhere(best > _COARSE_SAME).tolist():
            if other is None and m <= begin + n:
                continue
            if (correlation := _least_correlation(block[n], others[m], int(lag[n, m]))) > SAME:
                yield SamePair(begin + n, m, correlation)


def _in_band(spectrum: Array, high_hz: float) -> Array:
    frequency_hz = np.fft.rfftfreq(_N_FFT, 1.0 / FS_HZ)[:spectrum.shape[-1]]
    return spectrum * ((frequency_hz >= BAND_HZ[0]) & (frequency_hz <= high_hz))


def _coarse_correlation(one: FloatArray, other: FloatArray) -> tuple[Array, IntArray]:
    """Return the correlation of all pairs at low frequencies and the lag of the other [samples], shape (n, m) each."""
    n_bins = _N_FFT // 8 + 1  # a quarter of the sampling rate
    (first, second) = (_in_band(np.fft.rfft(parts, _N_FFT)[:, :n_bins], _COARSE_HZ) for parts in (one, other))
    fixed = _normalised(np.fft.irfft(first))
    best = np.full((len(one), len(other)), -1.0, dtype=np.float32)
    lag: IntArray = np.zeros(best.shape, dtype=np.int8)
    for samples in range(-_MARGIN, _MARGIN + 1, _COARSE_STEP):
        moved = _normalised(np.fft.irfft(second * _advance(np.array(samples), n_bins)))
        correlation = np.abs(fixed @ moved.T)
        lag[correlation > best] = samples
        best = np.maximum(best, correlation)
    return best, lag


def _normalised(signals: FloatArray) -> FloatArray:
    return np.asarray(signals / np.maximum(np.linalg.norm(signals, axis=-1, keepdims=True), 1e-20), dtype=np.float32)


def _advance(samples: FloatArray, n_bins: int) -> Array:
    """Return the spectrum of an advance by some samples, shape (*samples.shape, n_bins)."""
    return np.exp(2j * np.pi * np.multiply.outer(samples, np.arange(n_bins) / _N_FFT))


def _least_correlation(one: FloatArray, other: FloatArray, lag: int) -> float:
    """Return the least correlation of the parts of two recordings, at the best lag near to a given one."""
    lags = lag + _FINE_LAGS
    moved = np.fft.irfft(np.fft.rfft(other, _N_FFT) * _advance(lags, _N_FFT // 2 + 1))
    end = min(_held(one), _held(other) - lag) - _MARGIN
    if end < _EDGES[-2] + SHORTEST_LAST_S * FS_HZ:
        return 0.0
    edges = _MARGIN + np.minimum(_EDGES, end)
    correlations = [np.abs(_normalised(moved[:, first:last]) @ _normalised(one[first:last]))
                    for first, last in zip(edges[:-1], edges[1:], strict=True)]
    return float(np.min(correlations, axis=0).max())


def _held(parts: FloatArray) -> int:
    """Return the number of samples that a recording holds."""
    return len(np.trim_zeros(parts, "b"))
