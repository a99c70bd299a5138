"""The band of an excitation, such as a sweep, and of its recording, read off the response that was measured with it."""

from typing import Any

import numpy as np
from scipy.fft import next_fast_len

from roomeq.acoustics.band_energy import energy_per_bin
from roomeq.acoustics.decibels import FLOOR_POWER, power_db
from roomeq.core.arrays import BoolArray, FloatArray
from roomeq.core.constants import FS_HZ, bands_hz

CLIFF_DB = 15.0
_MODES_HZ, _MODES_DB = 63.0, 10.0  # below this frequency, the modes of a room may rise by so much within a third octave
_LOW_HZ, _N_LOW = 20.0, 28  # sixth octaves from 20 to 450 Hz
_TOP_CLIFF_DB = 24.0
"""Three times as steep as loudspeakers. Of 213 measured responses, the steepest falls by 14 dB in a third octave;
resampling filters fall by 40 dB or more."""
_HIGH_HZ = 500.0  # up to half the sample rate
NO_END_HZ = 0.5 * FS_HZ
"""Upper end of a band that reaches half the sample rate, at 16 kHz."""


def excited_from_hz(rir: FloatArray, fs_hz: float = FS_HZ) -> float:
    """Return the frequency below which the excitation, such as a sweep from 100 Hz, had no energy; 0 if there is none.

    It is the highest frequency at which the response rises by `CLIFF_DB` in a third octave, above everything below.
    Loudspeakers fall by at most 24 dB per octave, 8 dB per third octave (vented box; Small, J. Audio Eng. Soc. 21
    (1973) 363). At low frequencies the lowest modes of the room add to that.
    """
    level_db = _levels_db(rir, fs_hz, _LOW_HZ * 2.0 ** (np.arange(-0.5, _N_LOW) / 6.0))
    below_db = np.maximum.accumulate(level_db)
    at_hz = _LOW_HZ * 2.0 ** ((np.arange(len(level_db) - 2) + 1) / 6.0)
    cliffs = np.flatnonzero(level_db[2:] - below_db[:-2] > CLIFF_DB + np.where(at_hz < _MODES_HZ, _MODES_DB, 0.0))
    return float(at_hz[cliffs[-1]]) if len(cliffs) else 0.0


def excited_to_hz(rir: FloatArray, fs_hz: float = FS_HZ) -> float:
    """Return the frequency above which nothing was played or recorded, as by a device at 8 kHz; else ``fs_hz / 2``.

    It is the lowest frequency at which the response falls by `_TOP_CLIFF_DB` in a third octave, and everything above is
    as low. An anti-alias filter just below half the sample rate is no such end.
    """
    n_bands = round(6.0 * np.log2(0.5 * fs_hz / _HIGH_HZ))
    edges_hz = 0.5 * fs_hz * 2.0 ** (np.arange(-n_bands, 1) / 6.0)
    level_db = _levels_db(rir, fs_hz, edges_hz)
    above_db = np.maximum.accumulate(level_db[::-1])[::-1]
    cliffs = np.flatnonzero(level_db[:-2] - above_db[2:] > _TOP_CLIFF_DB)
    return float(np.sqrt(edges_hz[cliffs[0] + 1] * edges_hz[cliffs[0] + 2])) if len(cliffs) else 0.5 * fs_hz


def eq_to_hz(to_hz: float, fs_hz: float = FS_HZ) -> float:
    """Return the frequency up to which a recording that ends at `to_hz` holds a whole EQ.

    It ends in the middle of a third octave.
    """
    return to_hz * 2.0 ** (-1.0 / 6.0) if to_hz < 0.5 * fs_hz else to_hz


def is_excited(mid_hz: FloatArray, width_octaves: FloatArray | float, from_hz: float, to_hz: float,
               fs_hz: float = FS_HZ) -> BoolArray:
    """Tell which bands an excitation between two frequencies reaches, shape of `mid_hz`.

    Four fifths of a band, in octaves, must be excited; at the upper end, of what lies below half the sample rate.
    """
    low, high = np.log2(mid_hz) - 0.5 * width_octaves, np.log2(mid_hz) + 0.5 * width_octaves
    above_lower_end = high - np.log2(max(from_hz, 1e-3)) > 0.8 * width_octaves
    below_upper_end = np.log2(to_hz) - low > 0.8 * (np.minimum(high, np.log2(0.5 * fs_hz)) - low)
    return np.asarray(above_lower_end & below_upper_end)


def limit_to_excitation(parameters: dict[str, Any], from_hz: float, to_hz: float, fs_hz: float = FS_HZ) -> None:
    """Make those EQ points, decay times and C50 of acoustic parameters invalid that lie outside an excitation's band.

    Parameters
    ----------
    parameters
        As of `roomeq.acoustics.parameters.measure`, with the EQ.
    from_hz, to_hz
        See `excited_from_hz` and `excited_to_hz`.
    fs_hz
        Sample rate.
    """
    mid_hz = np.array(bands_hz(fs_hz))
    excited = dict.fromkeys(("edt_valid", "t20_valid", "t30_valid", "c50_valid"),
                            is_excited(mid_hz, 1.0, from_hz, to_hz, fs_hz))
    excited["eq_valid"] = (from_hz <= mid_hz) & (mid_hz <= eq_to_hz(to_hz, fs_hz))
    for key, is_measured in excited.items():
        parameters[key] = [bool(valid and measured) for valid, measured in zip(parameters[key], is_measured,
                                                                               strict=True)]


def _levels_db(rir: FloatArray, fs_hz: float, edges_hz: FloatArray) -> FloatArray:
    """Return the level of a response in the bands between some frequencies [dB per bin]."""
    power = energy_per_bin(rir, next_fast_len(max(len(rir), round(fs_hz)), real=True))
    edges = np.rint(edges_hz / (0.5 * fs_hz / (len(power) - 1))).astype(int)
    return power_db(np.add.reduceat(power[:edges[-1]], edges[:-1]) / np.diff(edges), floor=FLOOR_POWER)
