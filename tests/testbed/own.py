"""How the testbed's own base sounds: sinc pulses, noise, and air that wears both off."""

import numba
import numpy as np

from testbed.air import through_air
from testbed.bands import band_gains
from testbed.draws import C0, FS_HZ, N_FFT, N_SAMPLES, generator
from testbed.trace import BIN_M

HALF_TAPS = 32


@numba.njit(cache=True)
def add_pulses(out, at, amplitudes):
    """Add band-limited pulses at fractional samples: sinc under a Hann window."""
    n_bands, n = out.shape
    for k in range(len(at)):
        first = int(np.floor(at[k]))
        part = at[k] - first
        if part < 1e-9:
            if 0 <= first < n:
                for b in range(n_bands):
                    out[b, first] += amplitudes[b, k]
            continue
        for i in range(max(0, first - HALF_TAPS + 1), min(n, first + HALF_TAPS + 1)):
            x = np.pi * (i - at[k])
            tap = np.sin(x) / x * np.cos(x / (2 * HALF_TAPS + 1)) ** 2
            for b in range(n_bands):
                out[b, i] += tap * amplitudes[b, k]


def pulses(length_m, pressure, speed, air):
    """Spectrum of paths that each have a pressure per octave, shape (8, n)."""
    at = length_m / speed * FS_HZ
    if len(at) == 1:
        pulse = np.zeros((1, N_SAMPLES))
        add_pulses(pulse, at, np.ones((1, 1)))
        return np.fft.rfft(pulse[0], N_FFT) * (pressure[:, 0] @ band_gains(N_FFT))
    return _spectrum(at, pressure)


def late(field, energy, speed, air):
    """Spectrum of noise with the energy that was traced; nothing comes ahead of the direct sound."""
    per_bin = round(BIN_M / C0 * FS_HZ)
    first = int(np.ceil(field.images.length_m[0] / C0 * FS_HZ))
    carrier = generator(field.room.seed, "late", field.rir.rir_id).standard_normal(N_SAMPLES)
    carrier[:first] = 0.0
    amplitudes = np.sqrt(np.repeat(energy / per_bin, per_bin, axis=-1)[:, :N_SAMPLES]) * carrier
    return _spectrum(np.arange(N_SAMPLES) * (C0 / speed), amplitudes)


def finished(rir, speed, air):
    """Let the response have come through the air."""
    return through_air(rir, *air, speed)


def _spectrum(at, amplitudes):
    """Spectrum of pulses that each have a pressure per octave."""
    out = np.zeros((len(amplitudes), N_SAMPLES))
    add_pulses(out, at, amplitudes)
    return np.sum(band_gains(N_FFT) * np.fft.rfft(out, N_FFT), axis=0)
