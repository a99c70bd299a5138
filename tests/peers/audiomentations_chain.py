"""A chain of audiomentations with roomeq's `Reverberate` in it.

Needs roomeq and audiomentations. It exits with status 1 where the far-field speech is not aligned with the clean one.
"""

import sys

import audiomentations
import numpy as np

import roomeq

FS = 16000


def utterance(seed):
    """Return two seconds that are syllables to an analysis: bursts of noise."""
    rng = np.random.default_rng(seed)
    envelope = np.clip(np.sin(2 * np.pi * 4 * np.arange(2 * FS) / FS), 0, None)
    return (0.1 * envelope * rng.standard_normal(2 * FS)).astype(np.float32)


def main():
    room = roomeq.Room((5, 4, 3), materials={"floor": "carpet_thin", "default": "brick_plastered"}, t60_s=0.4)
    rirs = roomeq.simulate_rir(room, (1, 1, 1.5), np.random.default_rng(0).uniform((2, 1, 1), (4.5, 3.5, 1.5), (20, 3)))
    chain = audiomentations.Compose([
        audiomentations.Gain(min_gain_db=-6, max_gain_db=6, p=1.0),
        roomeq.Reverberate(rirs, noises=[np.random.default_rng(1).standard_normal(5 * FS)], snr="uniform 15 25"),
        audiomentations.LowPassFilter(min_cutoff_freq=6000, max_cutoff_freq=7500, p=0.5)])
    lags = []
    for seed in range(10):
        clean = utterance(seed)
        far_field = chain(samples=clean, sample_rate=FS)
        correlation = np.fft.irfft(np.fft.rfft(far_field, 4 * FS) * np.conj(np.fft.rfft(clean, 4 * FS)))
        lag = int(np.argmax(np.abs(correlation)))
        lags.append(lag if lag < 2 * FS else lag - 4 * FS)
    print(f"10 utterances through {len(chain.transforms)} transforms; the strongest correlation with the clean is "
          f"{min(lags)} to {max(lags)} samples after it")
    return int(max(abs(lag) for lag in lags) > 10 * FS // 1000)  # a reflection may be stronger than the direct sound


if __name__ == "__main__":
    sys.exit(main())
