"""Zero-phase octave filter bank whose gains add up to one: it merges the bands of a simulated response."""

from functools import lru_cache

import numpy as np

from roomeq.core.arrays import FloatArray
from roomeq.core.constants import exact_bands_hz

SPREAD_S = 0.06
"""Time by which the filters of the low bands spread a pulse, to either side [s]."""
MIN_CROSSOVER_OCTAVES = 1.0 / 3.0
MIN_CROSSOVER_HZ = 62.0  # a narrower crossover would spread a pulse over more than some 20 ms


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
    frequency = np.maximum(np.fft.rfftfreq(n_fft, 1.0 / fs_hz), 1e-3)
    bands = np.array(exact_bands_hz(fs_hz))
    edges = np.sqrt(bands[:-1] * bands[1:])
    octaves = np.clip(MIN_CROSSOVER_HZ / edges / np.log(2.0), MIN_CROSSOVER_OCTAVES, 1.0)
    position = np.clip(np.log2(frequency / edges[:, None]) / octaves[:, None], -0.5, 0.5)
    above = np.sin(0.5 * np.pi * (position + 0.5)) ** 2  # share of what lies above each edge
    gains = -np.diff(above, axis=0, prepend=1.0, append=0.0)
    gains.flags.writeable = False
    return gains
