"""Air: speed of sound and absorption (ISO 9613-1:1993)."""

from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from roomeq.core.arrays import FloatArray
from roomeq.core.constants import FS_HZ, exact_bands_hz, require_air

PRESSURE_KPA = 101.325
_KELVIN = 273.15
_REFERENCE_K = 293.15
_TRIPLE_POINT_K = 273.16
_DB_PER_NEPER = 10.0 / np.log(10.0)


def speed_of_sound_m_s(temperature_c: float) -> float:
    """Return the speed of sound in air [m/s], ``343.2 sqrt(T / 293.15 K)`` (ISO 9613-1, eq. 3.1 and annex A).

    Parameters
    ----------
    temperature_c
        Temperature [degrees Celsius].
    """
    return 343.2 * float(np.sqrt((temperature_c + _KELVIN) / _REFERENCE_K))


def air_absorption_db_m(frequencies_hz: ArrayLike, temperature_c: float = 20.0, humidity_pct: float = 50.0,
                        pressure_kpa: float = PRESSURE_KPA) -> FloatArray:
    """Return the attenuation of pure tones in air (ISO 9613-1, eq. 3 to 5 and B.1 to B.3).

    Parameters
    ----------
    frequencies_hz
        Any shape.
    temperature_c
        -20 to 50 degrees Celsius.
    humidity_pct
        Relative humidity, 0 to 100 %.
    pressure_kpa
        Atmospheric pressure, 10 to 200 kPa.

    Returns
    -------
    ndarray, shape of `frequencies_hz`
        Attenuation [dB/m].

    Raises
    ------
    ValueError
        Temperature, humidity or pressure is out of range.
    """
    require_air(temperature_c, humidity_pct)
    if not 10.0 <= pressure_kpa <= 200.0:
        raise ValueError(f"pressure_kpa={pressure_kpa:g} must lie in [10, 200]: give kilopascals")
    frequency = np.asarray(frequencies_hz, dtype=np.float64)
    kelvin = temperature_c + _KELVIN
    pressure = pressure_kpa / PRESSURE_KPA
    relative = kelvin / _REFERENCE_K
    saturation = 10.0 ** (-6.8346 * (_TRIPLE_POINT_K / kelvin) ** 1.261 + 4.6151)
    vapour_pct = humidity_pct * saturation / pressure
    oxygen_hz = pressure * (24.0 + 4.04e4 * vapour_pct * (0.02 + vapour_pct) / (0.391 + vapour_pct))
    nitrogen_hz = pressure * relative ** -0.5 * (
        9.0 + 280.0 * vapour_pct * np.exp(-4.170 * (relative ** (-1.0 / 3.0) - 1.0)))
    classical = 1.84e-11 / pressure * np.sqrt(relative)
    oxygen = 0.01275 * np.exp(-2239.1 / kelvin) / (oxygen_hz + frequency ** 2 / oxygen_hz)
    nitrogen = 0.1068 * np.exp(-3352.0 / kelvin) / (nitrogen_hz + frequency ** 2 / nitrogen_hz)
    return 8.686 * frequency ** 2 * (classical + relative ** -2.5 * (oxygen + nitrogen))


@cache
def band_attenuation_per_m(temperature_c: float = 20.0, humidity_pct: float = 50.0,
                           fs_hz: float = FS_HZ) -> tuple[float, ...]:
    """Return the energy attenuation of the octave bands below half a sample rate, in the middle of what is recorded.

    That is the exact mid-band frequency, but for an octave that reaches beyond half the sample rate: of the octave at
    8 kHz, only 5.6 to 8 kHz are recorded at 16 kHz.

    Returns
    -------
    tuple of floats
        The m [1/m] in ``p^2 ~ exp(-m d)`` over a distance d.

    Raises
    ------
    ValueError
        See `air_absorption_db_m`.
    """
    bands_hz = np.array(exact_bands_hz(fs_hz))
    middle_hz = bands_hz * np.sqrt(np.minimum(1.0, 0.5 * fs_hz / (bands_hz * np.sqrt(2.0))))
    attenuation = air_absorption_db_m(middle_hz, temperature_c, humidity_pct) / _DB_PER_NEPER
    return tuple(float(value) for value in attenuation)
