"""From paths to a recorded response, with whatever an effect changes on the way."""

from collections.abc import Callable
from dataclasses import dataclass

import numba
import numpy as np

from testbed.air import through_air
from testbed.bands import band_gains
from testbed.draws import C0, DECLARED_C, DECLARED_PCT, FS_HZ, N_SAMPLES, generator
from testbed.paths import COARSE, smoothed
from testbed.trace import BIN_M, N_ANGLES

N_FFT = 32768
HALF_TAPS = 32
NOISE_DB = (-70.0, -65.0)  # of the recorder, relative to the direct sound's peak
FREQUENCY_HZ = np.fft.rfftfreq(N_FFT, 1.0 / FS_HZ)
ANGLE_COSINES = -1.0 + (2.0 * np.arange(N_ANGLES) + 1.0) / N_ANGLES


@dataclass(frozen=True)
class Extra:
    """What an effect does, where it acts; None where it doesn't.

    Attributes
    ----------
    air : tuple of float
        True temperature [degrees C] and humidity [%] of the air that absorbs.
    speed : float
        True speed of sound [m/s].
    departing : callable
        (field, cosine of the angle to where the source faces, shape (n,)) -> pressure per octave, shape (8, n).
    scene : callable
        field -> field with other energy.
    blocking : callable
        field -> {number of an image: transfer function, shape (N_FFT // 2 + 1,)} of what replaces its pulse.
    decay : callable
        (field, energy, speed) -> energy, both shape (8, N_BINS).
    pulses : callable
        field -> list of (length [m], departure, gain, shape (N_FFT // 2 + 1,)).
    wave : callable
        field -> (low-frequency transfer function, its filter, that of the late field), each shape (N_FFT // 2 + 1,).
    response : callable
        (field, rir) -> rir.
    noise : callable
        (field, rir) -> noise to add, shape (N_SAMPLES,).
    """

    air: tuple | None = None
    speed: float | None = None
    departing: Callable | None = None
    scene: Callable | None = None
    blocking: Callable | None = None
    decay: Callable | None = None
    pulses: Callable | None = None
    wave: Callable | None = None
    response: Callable | None = None
    noise: Callable | None = None


@numba.njit(cache=True)
def _add_pulses(out, at, amplitudes):
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


def _spectrum(at, amplitudes):
    """Spectrum of pulses that each have a pressure per octave."""
    out = np.zeros((len(amplitudes), N_SAMPLES))
    _add_pulses(out, at, amplitudes)
    return np.sum(band_gains(N_FFT) * np.fft.rfft(out, N_FFT), axis=0)


def hooks(extras, name):
    """What the extras hold under one name."""
    return [getattr(extra, name) for extra in extras if getattr(extra, name) is not None]


def render(field, extras=()):
    """Render what a recorder would keep of one pair, sample 0 at the emission.

    Parameters
    ----------
    field : Field
    extras : sequence of Extra

    Returns
    -------
    rir : ndarray, shape (N_SAMPLES,)
    """
    speed = (hooks(extras, "speed") or [C0])[-1]
    for change in hooks(extras, "scene"):
        field = change(field)
    image_spectrum = _images(field, extras, speed)
    late_spectrum = _late(field, extras, speed)
    for wave in hooks(extras, "wave"):
        transfer, low, late = wave(field)
        # early pulses agree with the wave field in phase, the late field doesn't: pressures add up, or powers
        image_spectrum = image_spectrum * (1.0 - low) + low * transfer
        late_spectrum = late_spectrum * late
    rir = np.fft.irfft(image_spectrum + late_spectrum, N_FFT)[:N_SAMPLES]
    temperature, humidity = (hooks(extras, "air") or [(DECLARED_C, DECLARED_PCT)])[-1]
    rir = through_air(rir, temperature, humidity, speed)
    for change in hooks(extras, "response"):
        rir = change(field, rir)
    noise = sum((make(field, rir) for make in hooks(extras, "noise")), _recorder(field))
    return rir + noise


def _images(field, extras, speed):
    """Spectrum of the specular paths."""
    images, facing = field.images, field.rir.facing
    pressure = images.gain / (4.0 * np.pi * images.length_m)
    for departing in hooks(extras, "departing"):
        pressure = pressure * departing(field, images.departure @ facing)
    at = images.length_m / speed * FS_HZ
    special = {}
    for blocking in hooks(extras, "blocking"):
        special.update(blocking(field))
    free = np.array([k not in special for k in range(len(at))])
    spectrum = _spectrum(at[free], pressure[:, free])
    for k, transfer in special.items():
        pulse = np.zeros((1, N_SAMPLES))
        _add_pulses(pulse, at[k:k + 1], np.ones((1, 1)))
        spectrum = spectrum + transfer * np.fft.rfft(pulse[0], N_FFT) * (pressure[:, k] @ band_gains(N_FFT))
    for pulses in hooks(extras, "pulses"):
        for length, departure, gain in pulses(field):
            one = np.full((len(pressure), 1), 1.0 / (4.0 * np.pi * length))
            for departing in hooks(extras, "departing"):
                one = one * departing(field, np.array([departure @ facing]))
            spectrum = spectrum + gain * _spectrum(np.array([length / speed * FS_HZ]), one)
    return spectrum


def _late(field, extras, speed):
    """Spectrum of everything else: noise with the energy that was traced."""
    energy = field.energy
    for departing in hooks(extras, "departing"):
        power = departing(field, ANGLE_COSINES) ** 2
        energy = energy * np.repeat(np.einsum("ba,abk->bk", power, field.share), COARSE, axis=-1)
    energy = smoothed(energy)
    for decay in hooks(extras, "decay"):
        energy = decay(field, energy, speed)
    per_bin = round(BIN_M / C0 * FS_HZ)
    first = int(np.ceil(field.images.length_m[0] / C0 * FS_HZ))  # nothing comes ahead of the direct sound
    carrier = generator(field.room.seed, "late", field.rir.rir_id).standard_normal(N_SAMPLES)
    carrier[:first] = 0.0
    amplitudes = np.sqrt(np.repeat(energy / per_bin, per_bin, axis=-1)[:, :N_SAMPLES]) * carrier
    return _spectrum(np.arange(N_SAMPLES) * (C0 / speed), amplitudes)


def direct_peak(field):
    """Peak of the unobstructed direct sound."""
    return 1.0 / (4.0 * np.pi * field.images.length_m[0])


def _recorder(field):
    """White noise of the recorder."""
    rng = generator(field.room.seed, "recorder", field.rir.rir_id)
    return direct_peak(field) * 10.0 ** (rng.uniform(*NOISE_DB) / 20.0) * rng.standard_normal(N_SAMPLES)
