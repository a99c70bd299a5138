"""Zero-phase octave filters, for analysis (IEC 61260-1); the bank for synthesis is `roomeq.acoustics.filterbank`."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import irfft, next_fast_len, rfft

from roomeq.core.arrays import Array, FloatArray, IntArray
from roomeq.core.constants import EXACT_BANDS_HZ, FS_HZ, exact_bands_hz

OCTAVE_WIDTH_HZ = (np.minimum(np.array(EXACT_BANDS_HZ) * np.sqrt(2.0), 0.5 * FS_HZ)
                   - np.array(EXACT_BANDS_HZ) / np.sqrt(2.0))
"""Width of the octaves below half the sample rate [Hz], shape (8,)."""
SPECTRUM_HZ = tuple(1000.0 * 10.0 ** (0.1 * k) for k in range(-16, 9))
"""Exact mid-band frequencies of third octaves, 25 Hz to 6.3 kHz: below the octaves, modes of rooms are far apart."""
THIRDS_HZ = SPECTRUM_HZ[3:]
"""Those that make up the octaves, from 50 Hz on."""
_PREFERRED = (1.0, 1.25, 1.6, 2.0, 2.5, 3.15, 4.0, 5.0, 6.3, 8.0)  # ISO 266
THIRD_WIDTH_HZ = np.array(THIRDS_HZ) * (10.0 ** 0.05 - 10.0 ** -0.05)
"""Width of the third octaves [Hz], shape (22,)."""


def nearest_octave(frequencies_hz: ArrayLike) -> IntArray:
    """Return the number of the octave about each frequency, shape (n,)."""
    return np.argmin(np.abs(np.log(np.asarray(frequencies_hz)[:, None] / np.array(EXACT_BANDS_HZ))), axis=1)


OCTAVE_OF_THIRD = nearest_octave(THIRDS_HZ)
"""Number of the octave of each third octave, shape (22,)."""
FILTER_ORDER = 4  # of the Butterworth prototype; IEC 61260-1 class 1 needs 3, strong neighbouring bands ask for more
LEAD_S = 0.05
"""Time by which an octave filter spreads energy, before and after [s]."""
_FFT_GRID = 4096  # few sizes of transform, so that their filters stay cached


def nominal_hz(third_hz: float) -> float:
    """Return the nominal mid-band frequency of a third octave, such as 1250 Hz for 1259 Hz (IEC 61260-1)."""
    decade, n = divmod(round(10.0 * np.log10(third_hz)), 10)
    return _PREFERRED[n] * 10.0 ** decade


def octave_width_hz(band_hz: float, fs_hz: float) -> float:
    """Return the width of an octave below half the sample rate."""
    return min(band_hz * np.sqrt(2.0), 0.5 * fs_hz) - band_hz / np.sqrt(2.0)


def octave_fft_size(n_samples: int, fs_hz: float) -> int:
    """Return a length of transform in which no octave filter wraps around a response."""
    return next_fast_len(-(-(n_samples + round(2 * LEAD_S * fs_hz)) // _FFT_GRID) * _FFT_GRID, real=True)


def octave_gains(n_fft: int, fs_hz: float, band_hz: float) -> FloatArray:
    """Return the amplitude response of a zero-phase octave filter.

    The magnitude is that of a Butterworth band-pass, ``1 / sqrt(1 + (Q (f/fm - fm/f))^2n)`` with Q = sqrt 2:
    3 dB down at the band's edges ``fm 2^(-1/2)`` and ``fm 2^(1/2)``.

    Parameters
    ----------
    n_fft
        Length of the transform.
    fs_hz
        Sample rate.
    band_hz
        Exact mid-band frequency [Hz].

    Returns
    -------
    ndarray, shape (n_fft // 2 + 1,)
    """
    ratio = np.maximum(np.fft.rfftfreq(n_fft, 1.0 / fs_hz), 1e-3) / band_hz
    return np.asarray(1.0 / np.sqrt(1.0 + (np.sqrt(2.0) * (ratio - 1.0 / ratio)) ** (2 * FILTER_ORDER)))


@lru_cache(maxsize=16)
def _gains(n_fft: int, fs_hz: float, bands_hz: tuple[float, ...]) -> Array:
    """Return the amplitude responses of some octave filters, shape (n_bands, n_fft // 2 + 1), read-only float32."""
    gains = np.array([octave_gains(n_fft, fs_hz, band_hz) for band_hz in bands_hz], np.float32)
    gains.flags.writeable = False
    return gains


def octave_bands(rir: FloatArray, fs_hz: float, bands_hz: Sequence[float] | None = None, *,
                 lead: int = 0) -> Array:
    """Split a response into octave bands with zero-phase filters.

    Single precision is enough: the rounding of each band lies 140 dB below its peak. scipy's FFT transforms four rows
    of it in the time of one.

    Parameters
    ----------
    rir
        Shape (n_samples,).
    fs_hz
        Sample rate.
    bands_hz
        Exact mid-band frequencies [Hz]; by default all octaves below half the sample rate.
    lead
        Number of samples before the response that are returned too, `LEAD_S` at most: the filters spread energy there.

    Returns
    -------
    ndarray of float32, shape (n_bands, lead + n_samples)
    """
    bands_hz = tuple(exact_bands_hz(fs_hz) if bands_hz is None else bands_hz)
    n_fft = octave_fft_size(len(rir), fs_hz)
    filtered = irfft(rfft(rir, n_fft).astype(np.complex64) * _gains(n_fft, fs_hz, bands_hz), n_fft)
    return np.concatenate([filtered[:, n_fft - lead:], filtered[:, :len(rir)]], axis=1)
