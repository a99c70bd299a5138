"""Recordings that are no RIR: damage done to an RIR, and sounds that were mistaken for one."""

import numpy as np

from roomeq.core.constants import FS_HZ


def room_rir(seed, *, time_s=0.5, length_s=1.0, drr_db=0.0, lead_s=0.02, noise_db=-60.0, pause=True):
    """Return a direct sound, eight early reflections, exponentially decaying noise, and noise all along.

    Without a pause, the decaying noise does not fade in over 20 ms.
    """
    rng = np.random.default_rng(seed)
    n, lead = round(length_s * FS_HZ), round(lead_s * FS_HZ)
    t = np.arange(n - lead) / FS_HZ
    late = rng.standard_normal(len(t)) * 10.0 ** (-3.0 * t / time_s) * (np.clip(t / 0.02, 0.0, 1.0) if pause else 1.0)
    for delay_s in rng.uniform(0.001, 0.03, 8):
        late[round(delay_s * FS_HZ)] += rng.choice([-1.0, 1.0]) * 4.0 * 10.0 ** (-3.0 * delay_s / time_s)
    rir = np.zeros(n)
    rir[lead:] = late
    rir[lead] += np.sqrt(np.sum(late ** 2) * 10.0 ** (drr_db / 10.0))
    taps = np.array([0.6, 1.0, -0.5, -0.3, 0.1])  # a loudspeaker's response
    rir = np.convolve(rir, taps)[:n] / np.abs(rir).max()
    rir += 10.0 ** (noise_db / 20.0) * np.abs(rir).max() * rng.standard_normal(n)
    return 0.8 * rir / np.abs(rir).max()


def direct_of(rir):
    """Return the first sample within 20 dB of the maximum."""
    return int(np.argmax(np.abs(rir) > 0.1 * np.abs(rir).max()))


def clip(gain_db):
    """Return what amplifies a recording beyond full scale."""
    return lambda rir, rng: np.clip(rir / np.abs(rir).max() * 10.0 ** (gain_db / 20.0), -1.0, 1.0)


def clip_16_bit(rir, rng):
    """Clip at the limits of 16-bit samples, which differ by a step, and normalise."""
    return np.clip(np.round(rir / np.abs(rir).max() * 20.0 * 32768.0), -32768, 32767) * (0.5 / 32768)


def start_after(seconds):
    """Return what cuts a recording some time after its direct sound."""
    return lambda rir, rng: rir[direct_of(rir) + round(seconds * FS_HZ):]


def silence_until(seconds):
    """Return what silences a recording until some time after its direct sound."""
    def damage(rir, rng):
        rir = rir.copy()
        rir[:direct_of(rir) + round(seconds * FS_HZ)] = 0.0
        return rir
    return damage


def modulated(rate_hz, depth):
    """Return noise of the recording's length with a modulated amplitude."""
    def damage(rir, rng):
        t = np.arange(len(rir)) / FS_HZ
        return 0.1 * rng.standard_normal(len(rir)) * (1.0 + depth * np.cos(2.0 * np.pi * rate_hz * t))
    return damage


def _time(rir):
    return np.arange(len(rir)) / FS_HZ


def sweep(rir, rng):
    """Return the excitation, followed by a pause, instead of the response."""
    t = _time(rir) * 1.25
    return np.where(t < 1.0, np.sin(2.0 * np.pi * 100.0 / np.log(70.0) * (70.0 ** t - 1.0)), 1e-4 * np.cos(900.0 * t))


def recorded_sweep(rir, rng):
    """Return the recording of a sweep in the room: it was not deconvolved."""
    n = 3 * len(rir)
    return np.fft.irfft(np.fft.rfft(sweep(rir, rng), n) * np.fft.rfft(rir, n), n)[:2 * len(rir)]


def syllables(rir, rng):
    """Return something like speech: bursts of a pulse train, with pauses."""
    t = _time(rir)
    return np.where((t * 120.0 % 1.0) < 0.05, 1.0, 0.02 * rng.standard_normal(len(t))) * np.maximum(
        0.01, np.sin(2.0 * np.pi * 2.5 * t + 1.0))


SHAPES = {
    "silent": lambda rir, rng: 0.0 * rir,
    "not a number": lambda rir, rng: np.where(np.arange(len(rir)) == 99, np.nan, rir),
    "infinite": lambda rir, rng: np.where(np.arange(len(rir)) == 99, np.inf, rir),
    "constant": lambda rir, rng: 0.0 * rir + 0.1,
    "hum": lambda rir, rng: 0.1 * np.sin(2.0 * np.pi * 50.0 * _time(rir)),
    "white noise": lambda rir, rng: 0.1 * rng.standard_normal(len(rir)),
    "noise modulated at 2 Hz": modulated(2.0, 1.0),
    "noise modulated at 4 Hz": modulated(4.0, 1.0),
    "noise modulated at 30 Hz": modulated(30.0, 1.0),
    "noise modulated by 80 percent": modulated(3.0, 0.8),
    "noise that swells": lambda rir, rng: rng.standard_normal(len(rir)) * 10.0 ** (2.0 * (_time(rir) - 1.0)),
    "noise that stops": lambda rir, rng: rng.standard_normal(len(rir)) * np.where(_time(rir) < 0.7, 0.2, 1e-4),
    "sweep": sweep,
    "recorded sweep": recorded_sweep,
    "syllables": syllables,
    "time-reversed": lambda rir, rng: rir[::-1],
    "time-reversed and padded": lambda rir, rng: np.concatenate([rir[::-1], np.zeros(8000)]),
    "clipped by 6 dB": clip(6.0),
    "clipped by 12 dB": clip(12.0),
    "clipped by 26 dB": clip(26.0),
    "clipped by 26 dB at 16 bits, then normalised": clip_16_bit,
    "direct sound cut off": start_after(0.0025),
    "direct sound silenced": silence_until(0.03),
    "starts in mid-decay": start_after(0.1),
}
"""Damage by name: each takes an RIR and a random generator, and returns what is no RIR."""

SOMETIMES = {"clipped by 6 dB", "direct sound cut off"}
"""Damage that is seen in some RIRs only: a single sample is flattened, or a pause follows the direct sound."""
