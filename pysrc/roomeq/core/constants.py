"""Numbers that every package uses: the sample rate, and the octave bands that all values per band refer to."""

from functools import cache
from numbers import Integral, Real
from typing import Any

FS_HZ = 16000
"""Sample rate of all speech, RIRs and noises inside the toolkit [Hz] (the paper's; LibriSpeech's)."""

BANDS_HZ = (62.5, 125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0)
"""Nominal mid-band frequencies of the eight octave bands [Hz]; also the paper's eight EQ sample points."""

EXACT_BANDS_HZ = tuple(1000.0 * 10.0 ** (0.3 * k) for k in range(-4, 4))
"""Exact mid-band frequencies [Hz], base ten (IEC 61260-1): 63.1, 125.9, ... 7943."""

MIN_FS_HZ, MAX_FS_HZ = 8000, 48000
"""Sample rates that RIRs can be simulated, analysed and augmented with [Hz]."""


@cache
def exact_bands_hz(fs_hz: float) -> tuple[float, ...]:
    """Return the exact mid-band frequencies of the octave bands at a sample rate [Hz].

    They are those from 62.5 Hz to 16 kHz that lie below half the sample rate: seven at 8 kHz, the eight of
    `EXACT_BANDS_HZ` at 16 kHz, nine from 32 kHz on.
    """
    return tuple(band_hz for band_hz in (*EXACT_BANDS_HZ, 1000.0 * 10.0 ** 1.2) if band_hz < 0.5 * fs_hz)


@cache
def bands_hz(fs_hz: float) -> tuple[float, ...]:
    """Return the nominal mid-band frequencies of the octave bands at a sample rate [Hz]; see `exact_bands_hz`."""
    return (*BANDS_HZ, 16000.0)[:len(exact_bands_hz(fs_hz))]


def is_number(value: Any) -> bool:
    """Tell whether a value is a real number, of Python or NumPy; a truth value is not."""
    return isinstance(value, Real) and not isinstance(value, bool)


def is_whole(value: Any) -> bool:
    """Tell whether a value is an integer, of Python or NumPy; a truth value is not."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def require_fs(fs_hz: float) -> int:
    """Return a sample rate as an integer of Python: products of NumPy's small integers overflow.

    Raises
    ------
    ValueError
        It is no whole number of hertz from `MIN_FS_HZ` to `MAX_FS_HZ`.
    """
    if not (is_number(fs_hz) and MIN_FS_HZ <= fs_hz <= MAX_FS_HZ and fs_hz == int(fs_hz)):
        raise ValueError(f"fs={fs_hz!r} must be a whole number of hertz from {MIN_FS_HZ} to {MAX_FS_HZ}: "
                         "choose another sample rate")
    return int(fs_hz)


TEMPERATURE_RANGE_C = (-20.0, 50.0)
"""Of the tables in ISO 9613-1."""


def require_air(temperature_c: float = 20.0, humidity_pct: float = 50.0) -> None:
    """Raise ValueError unless temperature [°C] and relative humidity [%] can be those of the air in a room."""
    for name, value in (("temperature_c", temperature_c), ("humidity_pct", humidity_pct)):
        if not is_number(value):
            raise ValueError(f"{name}={value!r} must be a number: correct it")
    low, high = TEMPERATURE_RANGE_C
    if not low <= temperature_c <= high:
        raise ValueError(f"temperature_c={temperature_c:g} must lie in [{low:g}, {high:g}] (ISO 9613-1): "
                         "give degrees Celsius")
    if not 0.0 <= humidity_pct <= 100.0:
        raise ValueError(f"humidity_pct={humidity_pct:g} must lie in [0, 100]: give relative humidity in percent")


LARGEST_SEED = 2 ** 63 - 1
BAND_1KHZ = 4
"""Index of the 1 kHz band: the reference of every EQ, and the band of every T60 target."""
MIN_ROOM_M, MAX_ROOM_M = 0.1, 200.0
"""Shortest and longest dimension of a room; a value outside is in another unit than metres."""
