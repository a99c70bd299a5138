"""Effects of the chain: loudspeakers, microphones, recorders."""

import numpy as np
from scipy.signal import sosfilt

from testbed.draws import FREQUENCY_HZ, FS_HZ, N_FFT, N_SAMPLES, generator
from testbed.render import Extra


def _section(b, a):
    return [*(np.array(b) / a[0]), *(np.array(a) / a[0])]


def peak(frequency_hz, gain_db, q):
    """Second-order resonance (Bristow-Johnson's audio EQ cookbook)."""
    w, a = 2.0 * np.pi * frequency_hz / FS_HZ, 10.0 ** (gain_db / 40.0)
    alpha = np.sin(w) / (2.0 * q)
    return _section([1 + alpha * a, -2 * np.cos(w), 1 - alpha * a], [1 + alpha / a, -2 * np.cos(w), 1 - alpha / a])


def shelf(frequency_hz, gain_db, high):
    """Second-order shelf, slope 1 (Bristow-Johnson's audio EQ cookbook)."""
    w, a = 2.0 * np.pi * frequency_hz / FS_HZ, 10.0 ** (gain_db / 40.0)
    sign = 1.0 if high else -1.0  # a high shelf is the low one with the sign of the cosine turned
    cosine, root = sign * np.cos(w), np.sqrt(2.0 * a) * np.sin(w)
    return _section([a * (a + 1 + (a - 1) * cosine + root), -2 * sign * a * (a - 1 + (a + 1) * cosine),
                     a * (a + 1 + (a - 1) * cosine - root)],
                    [a + 1 - (a - 1) * cosine + root, 2 * sign * (a - 1 - (a + 1) * cosine),
                     a + 1 - (a - 1) * cosine - root])


SHAPES = dict(peak=peak, high_shelf=lambda f, g: shelf(f, g, True), low_shelf=lambda f, g: shelf(f, g, False))


def draw_loudspeakers(seed, rooms):
    """Two resonances and a roll-off for each loudspeaker; gains [dB] at scale 1."""
    def one(rng):
        low, high = np.exp(rng.uniform(np.log([150.0, 1500.0]), np.log([900.0, 5000.0])))
        signs = rng.permutation([1.0, -1.0]) if rng.random() < 0.6 else np.ones(2)
        return [["peak", low, signs[0] * rng.uniform(0.6, 1.2), rng.uniform(0.8, 2.5)],
                ["peak", high, signs[1] * rng.uniform(0.6, 1.2), rng.uniform(0.8, 2.5)],
                ["high_shelf", rng.uniform(3000.0, 6000.0), -rng.uniform(0.8, 1.6)],
                ["low_shelf", rng.uniform(80.0, 160.0), -rng.uniform(0.8, 1.6)]]
    return {name: one(generator(seed, "loudspeaker", name)) for name in ("spk1", "spk2")}


def draw_microphones(seed, rooms):
    """Proximity rise in the bass and a peak at high frequency for each microphone; gains [dB] at scale 1."""
    def one(rng):
        return [["low_shelf", rng.uniform(120.0, 300.0), rng.uniform(0.5, 1.3)],
                ["peak", rng.uniform(3500.0, 6500.0), rng.uniform(0.5, 1.3), rng.uniform(0.8, 2.0)]]
    return {name: one(generator(seed, "microphone", name)) for name in ("mic1", "mic2")}


def filtered_by(key):
    """Return the function that makes the effect of filters that belong to a loudspeaker or a microphone."""
    def extra(parameters, scale):
        filters = {name: np.array([SHAPES[shape](hz, scale * gain_db, *more) for shape, hz, gain_db, *more in sections])
                   for name, sections in parameters.items()}
        return Extra(response=lambda field, rir: sosfilt(filters[getattr(field.rir, key)], rir))
    return extra


def draw_noise(seed, rooms):
    """Per room: hum (levels of 50 Hz and its harmonics) and pink noise, relative to one another."""
    result = {}
    for room in rooms:
        rng = generator(seed, "noise", room.room_id)
        harmonics = rng.uniform(0.2, 1.0, 8) / np.arange(1, 9) ** 0.5
        result[room.room_id] = dict(level=float(np.exp(rng.normal(0.0, 0.2))), hum=float(rng.uniform(0.3, 1.0)),
                                    harmonics=harmonics.tolist())
    return result


def noise(parameters, scale):
    """Hum and pink noise; the pink part's standard deviation is `scale` times the direct sound's peak at 2 m."""
    f = np.fft.rfftfreq(N_SAMPLES, 1.0 / FS_HZ)

    def make(field, rir):
        room = parameters[field.room.room_id]
        rng = generator(field.room.seed, "noise", field.rir.rir_id)
        white = np.fft.rfft(rng.standard_normal(N_SAMPLES))
        pink = np.fft.irfft(white / np.sqrt(np.maximum(f, 20.0)), N_SAMPLES)
        t = np.arange(N_SAMPLES) / FS_HZ
        start = rng.uniform(0.0, 2.0 * np.pi)
        hum = sum(a * np.sin(2.0 * np.pi * 50.0 * k * t + k * start) for k, a in enumerate(room["harmonics"], start=1))
        level = scale * room["level"] / (8.0 * np.pi)
        return level * (pink / pink.std() + room["hum"] * hum / hum.std())
    return Extra(noise=make)


def draw_drift(seed, rooms):
    """Which of the two clocks is the faster, and where the sweep begins [Hz]."""
    rng = generator(seed, "drift")
    return dict(sign=float(rng.choice([-1.0, 1.0])), from_hz=float(rng.uniform(20.0, 60.0)))


def drift(parameters, scale):
    """Player and recorder disagree: what the sweep reached later comes `scale` seconds later at 8 kHz.

    An exponential sweep passes f at L ln(f / f1); clocks off by e shift that by e L ln(f / f1), which is a group delay.
    """
    low = parameters["from_hz"]
    f = np.maximum(FREQUENCY_HZ, low)
    slope = parameters["sign"] * scale / np.log(8000.0 / low)
    phase = 2.0 * np.pi * slope * (f * np.log(f / low) - f + low)
    # a real response ends with phase 0 or pi at half the sample rate: else a long sinc would ring ahead
    ends = np.pi * np.round(phase[-1] / np.pi) - phase[-1]
    phase += ends * np.sin(0.5 * np.pi * np.clip(f / 1000.0 - 7.0, 0.0, 1.0)) ** 2
    turn = np.exp(-1j * phase)
    return Extra(response=lambda field, rir: _through(rir, turn))


def draw_distortion(seed, rooms):
    """Length constant L of a short sweep [s], and what second and third harmonic have of the distortion."""
    rng = generator(seed, "distortion")
    second = float(rng.uniform(0.4, 0.8))
    return dict(rate_s=float(rng.uniform(0.003, 0.005) / np.log(2.0)), shares=[second, 1.0 - second],
                from_hz=float(rng.uniform(30.0, 60.0)))


def distortion(parameters, scale):
    """Harmonics of the loudspeaker: the k-th arrives L ln k ahead (Farina, AES 108 (2000), preprint 5093)."""
    gain = np.ones(N_FFT // 2 + 1, dtype=complex)
    for k, share in enumerate(parameters["shares"], start=2):
        high = 1.0 / (1.0 - 1j * k * parameters["from_hz"] / np.maximum(FREQUENCY_HZ, 1e-3))
        gain += scale * share * high * np.exp(2j * np.pi * FREQUENCY_HZ * parameters["rate_s"] * np.log(k))
    return Extra(response=lambda field, rir: _through(rir, gain))


def _through(rir, transfer):
    """Filter by a transfer function; what would come before the emission is lost."""
    return np.fft.irfft(np.fft.rfft(rir, N_FFT) * transfer, N_FFT)[:N_SAMPLES]
