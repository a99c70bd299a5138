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
    # nearer than the critical distance of 0.7 m, the direct sound is stronger than any reflection
    source = np.array([2, 2, 1.5])
    rirs = roomeq.simulate_rir(room, source, source + np.random.default_rng(0).uniform((0.2, 0.2, -0.2), 0.35, (20, 3)))
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
    return int(max(abs(lag) for lag in lags) > FS // 1000)  # the low-pass filter's group delay is some samples


if __name__ == "__main__":
    sys.exit(main())
