"""From paths to a recorded response, with whatever an effect changes on the way."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from testbed.bases import base_named
from testbed.draws import C0, DECLARED_C, DECLARED_PCT, FS_HZ, N_FFT, N_SAMPLES, generator
from testbed.paths import COARSE
from testbed.trace import N_ANGLES

ONSET_S = 3e-3  # in which the wave field takes over from the direct sound, which it has too
NOISE_DB = (-70.0, -65.0)  # of the recorder, relative to the direct sound's peak
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
        field -> (low-frequency transfer function, its share of the pressure, filter of the late field), each shape
        (N_FFT // 2 + 1,).
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
    base = base_named(field.base)
    speed = (hooks(extras, "speed") or [C0])[-1]
    air = (hooks(extras, "air") or [(DECLARED_C, DECLARED_PCT)])[-1]
    for change in hooks(extras, "scene"):
        field = change(field)
    image_spectrum = _images(base, field, extras, speed, air)
    late_spectrum = base.late(field, _late_energy(base, field, extras, speed), speed, air)
    for wave in hooks(extras, "wave"):
        transfer, share, late = wave(field)
        # early pulses agree with the wave field in phase, the late field doesn't: pressures add up, or powers
        image_spectrum = image_spectrum + _after_arrival(share * (transfer - image_spectrum), field, speed)
        late_spectrum = late_spectrum * late
    rir = base.finished(np.fft.irfft(image_spectrum + late_spectrum, N_FFT)[:N_SAMPLES], speed, air)
    for change in hooks(extras, "response"):
        rir = change(field, rir)
    noise = sum((make(field, rir) for make in hooks(extras, "noise")), _recorder(field))
    return rir + noise


def _after_arrival(spectrum, field, speed):
    """Spectrum of what comes after the direct sound: a share without phase begins before its cause, and ahead of 0."""
    since_s = np.arange(N_FFT) / FS_HZ - field.images.length_m[0] / speed
    after = np.sin(0.5 * np.pi * np.clip(since_s / ONSET_S, 0.0, 1.0)) ** 2 * (np.arange(N_FFT) < N_SAMPLES)
    return np.fft.rfft(np.fft.irfft(spectrum, N_FFT) * after)


def _images(base, field, extras, speed, air):
    """Spectrum of the specular paths."""
    images, facing = field.images, field.rir.facing
    pressure = images.gain / (4.0 * np.pi * images.length_m)
    for departing in hooks(extras, "departing"):
        pressure = pressure * departing(field, images.departure @ facing)
    special = {}
    for blocking in hooks(extras, "blocking"):
        special.update(blocking(field))
    free = np.array([k not in special for k in range(len(images.length_m))])
    spectrum = base.pulses(images.length_m[free], pressure[:, free], speed, air)
    for k, transfer in special.items():
        spectrum = spectrum + transfer * base.pulses(images.length_m[k:k + 1], pressure[:, k:k + 1], speed, air)
    for pulses in hooks(extras, "pulses"):
        for length, departure, gain in pulses(field):
            one = np.full((len(pressure), 1), 1.0 / (4.0 * np.pi * length))
            for departing in hooks(extras, "departing"):
                one = one * departing(field, np.array([departure @ facing]))
            spectrum = spectrum + gain * base.pulses(np.array([length]), one, speed, air)
    return spectrum


def _late_energy(base, field, extras, speed):
    """Energy of everything else, shape (8, N_BINS)."""
    energy = field.energy
    for departing in hooks(extras, "departing"):
        power = departing(field, ANGLE_COSINES) ** 2
        energy = energy * np.repeat(np.einsum("ba,abk->bk", power, field.share), COARSE, axis=-1)
    energy = base.spread(energy)
    for decay in hooks(extras, "decay"):
        energy = decay(field, energy, speed)
    return energy


def direct_peak(field):
    """Peak of the unobstructed direct sound."""
    return 1.0 / (4.0 * np.pi * field.images.length_m[0])


def _recorder(field):
    """White noise of the recorder."""
    rng = generator(field.room.seed, "recorder", field.rir.rir_id)
    return direct_peak(field) * 10.0 ** (rng.uniform(*NOISE_DB) / 20.0) * rng.standard_normal(N_SAMPLES)
