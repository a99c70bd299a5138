"""Point noises of the synthetic speech corpus: hum, fan and clatter of sines, filtered noise and damped resonances."""

from collections.abc import Callable

import numpy as np

from roomeq.core.arrays import FloatArray

FS_HZ = 16000


def _shaped(rng: np.random.Generator, n_samples: int, gain: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Return noise with the magnitude spectrum ``gain(freqs_hz)`` and unit RMS."""
    freqs_hz = np.fft.rfftfreq(n_samples, 1 / FS_HZ).clip(5)
    noise = np.fft.irfft(np.fft.rfft(rng.standard_normal(n_samples)) * gain(freqs_hz), n_samples)
    return noise / noise.std()


def hum(rng: np.random.Generator, n_samples: int) -> FloatArray:
    """Return the hum of an appliance: harmonics of the mains with slow modulation, and some hiss."""
    time_s = np.arange(n_samples) / FS_HZ
    fundamental_hz = rng.choice([50, 100]) * rng.uniform(0.998, 1.002)
    harmonics = fundamental_hz * np.arange(1, 25)
    levels = 10 ** (-(rng.uniform(0, 12, 24) + np.linspace(0, rng.uniform(15, 30), 24)) / 20)
    tone = levels @ np.sin(2 * np.pi * (harmonics[:, None] * time_s + rng.random((24, 1))))
    swell = 1 + rng.uniform(0.05, 0.3) * np.sin(2 * np.pi * (rng.uniform(0.2, 1.5) * time_s + rng.random()))
    hiss = _shaped(rng, n_samples, lambda f: (f / 500) ** -0.5)
    return tone / tone.std() * swell + rng.uniform(0.1, 0.3) * hiss


def fan(rng: np.random.Generator, n_samples: int) -> FloatArray:
    """Return the noise of a fan: low-passed noise modulated by the blades, and the tone of the blades."""
    time_s = np.arange(n_samples) / FS_HZ
    corner_hz, blades_hz = rng.uniform(400, 1500), rng.uniform(60, 180)
    rush = _shaped(rng, n_samples, lambda f: 1 / (1 + (f / corner_hz) ** rng.uniform(1.2, 2)) * (f / (f + 60)))
    beat = np.sin(2 * np.pi * blades_hz * time_s)
    harmonic = np.sin(4 * np.pi * blades_hz * time_s + 1)
    return rush * (1 + 0.2 * beat) + rng.uniform(0.1, 0.4) * beat + rng.uniform(0.05, 0.2) * harmonic


def clatter(rng: np.random.Generator, n_samples: int) -> FloatArray:
    """Return the clatter of dishes: about 3 strokes per second, each of six resonances that ring for 20-200 ms."""
    out = 0.003 * rng.standard_normal(n_samples)
    starts = np.flatnonzero(rng.random(n_samples) < 3 / FS_HZ)
    for start in [int(rng.integers(n_samples // 4)), *starts]:
        time_s = np.arange(min(FS_HZ // 2, n_samples - start)) / FS_HZ
        freqs_hz = rng.uniform(500, 6500, 6)
        decays = rng.uniform(5, 50, 6)
        rings = np.exp(-decays[:, None] * time_s) * np.sin(2 * np.pi * freqs_hz[:, None] * time_s)
        out[start:start + len(time_s)] += rng.lognormal(0, 0.7) * (rng.dirichlet(np.ones(6)) @ rings)
    return out


def babble(rng: np.random.Generator, utterances: list[list[FloatArray]], n_samples: int) -> FloatArray:
    """Return several talkers who speak at the same time.

    Parameters
    ----------
    rng
    utterances
        Utterances of each talker, at least `n_samples` long in total.
    n_samples
    """
    out = np.zeros(n_samples)
    for spoken in utterances:
        stream = np.concatenate(spoken)
        stream = np.roll(stream, int(rng.integers(len(stream))))[:n_samples]
        out += stream / stream.std() * 10 ** (rng.normal(0, 2) / 20)
    return out


def point_noise(kind: str, rng: np.random.Generator, n_samples: int) -> FloatArray:
    """Return a noise of a kind (hum, fan, clatter) at the level of `levelled`."""
    return levelled({"hum": hum, "fan": fan, "clatter": clatter}[kind](rng, n_samples))


def levelled(noise: FloatArray) -> FloatArray:
    """Scale a noise to an RMS of -23 dB FS, or less where its peak would exceed -1 dB FS."""
    return noise * min(10 ** (-23 / 20) / noise.std(), 10 ** (-1 / 20) / np.abs(noise).max())
