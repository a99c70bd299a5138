"""Random numbers and constants of the generated rooms."""

import zlib

import numpy as np

FS_HZ = 16000
OCTAVES_HZ = 62.5 * 2.0 ** np.arange(8)
N_BANDS = len(OCTAVES_HZ)
DECLARED_C, DECLARED_PCT = 20.0, 50.0  # the air that every row states
LENGTH_S = 1.6  # of a recorded response
N_SAMPLES = round(LENGTH_S * FS_HZ)
N_FFT = 32768
FREQUENCY_HZ = np.fft.rfftfreq(N_FFT, 1.0 / FS_HZ)


def generator(seed, *purpose):
    """Return the generator of one purpose; draws for one never move those for another."""
    return np.random.default_rng([int(seed), *(zlib.crc32(str(word).encode()) for word in purpose)])


def speed_of_sound(temperature_c):
    """Speed of sound in air [m/s]."""
    return 331.3 * np.sqrt(1.0 + temperature_c / 273.15)


C0 = speed_of_sound(DECLARED_C)
