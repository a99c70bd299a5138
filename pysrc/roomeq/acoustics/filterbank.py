"""Zero-phase filter banks whose gains add up to one: they merge the bands of a simulated response."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from roomeq.core.arrays import Array, FloatArray
from roomeq.core.constants import exact_bands_hz

SPREAD_S = 0.06
"""Time by which the filters of the low bands spread a pulse, to either side [s]."""
MIN_CROSSOVER_OCTAVES = 1.0 / 3.0
MIN_CROSSOVER_HZ = 62.0  # a narrower crossover would spread a pulse over more than some 20 ms


def thirds_of_octaves(fs_hz: float) -> FloatArray:
    """Return the edges of the thirds of octaves, up to half the sample rate [Hz], shape (n_bands, 4)."""
    bands = np.array(exact_bands_hz(fs_hz))
    return np.minimum(bands[:, None] * (bands[1] / bands[0]) ** np.linspace(-0.5, 0.5, 4), 0.5 * fs_hz)


@lru_cache(maxsize=32)
def octave_filterbank(n_fft: int, fs_hz: float) -> FloatArray:
    """Return the amplitude responses of the complementary octave bands below half the sample rate.

    Neighbouring bands cross at the edge between them, where their gains are ``cos^2`` and ``sin^2`` of log
    frequency and add up to exactly one. The crossover is a third of an octave wide, at low frequencies more. The
    lowest band holds everything below, the highest everything above.

    Parameters
    ----------
    n_fft
        Length of the transform.
    fs_hz
        Sample rate.

    Returns
    -------
    ndarray, shape (n_bands, n_fft // 2 + 1)
        Read-only.
    """
    return _complementary(thirds_of_octaves(fs_hz)[1:, 0], MIN_CROSSOVER_OCTAVES, n_fft, fs_hz)


class Passband(NamedTuple):
    """The bins that a band passes, and its amplitude response there (float32)."""

    bins: slice
    gains: Array


@lru_cache(maxsize=32)
def third_octave_filterbank(n_fft: int, fs_hz: float) -> list[Passband]:
    """Return the responses of the thirds of the bands of `octave_filterbank`, which cross half as widely."""
    edges = thirds_of_octaves(fs_hz)[:, :3].ravel()[1:]
    bands = []
    for response in _complementary(edges[edges < 0.5 * fs_hz], 0.5 * MIN_CROSSOVER_OCTAVES, n_fft, fs_hz):
        passed = np.flatnonzero(response)
        bins = slice(passed[0], passed[-1] + 1)
        bands.append(Passband(bins, response[bins].astype(np.float32)))
    return bands


def _complementary(edges_hz: FloatArray, min_octaves: float, n_fft: int, fs_hz: float) -> FloatArray:
    """Return the amplitude responses of bands that cross at some edges; see `octave_filterbank`."""
    frequency = np.maximum(np.fft.rfftfreq(n_fft, 1.0 / fs_hz), 1e-3)
    octaves = np.clip(MIN_CROSSOVER_HZ / edges_hz / np.log(2.0), min_octaves, 1.0)
    position = np.clip(np.log2(frequency / edges_hz[:, None]) / octaves[:, None], -0.5, 0.5)
    above = np.sin(0.5 * np.pi * (position + 0.5)) ** 2  # share of what lies above each edge
    gains = -np.diff(above, axis=0, prepend=1.0, append=0.0)
    gains.flags.writeable = False
    return gains
