"""Excerpts of noises, and a cache that threads share."""

import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from roomeq.augment import audio_cache
from roomeq.augment.audio_cache import AudioCache
from roomeq.augment.draw import Noise
from roomeq.augment.mix import without_rumble
from roomeq.core.constants import FS_HZ

LEAD, LENGTH = FS_HZ - 1, 3 * FS_HZ  # an RIR of 1 s, and an utterance of 2 s


def cache_of(*noises):
    return AudioCache(Path(), SimpleNamespace(ambient=[], point=noises, rows={}))


def noise_of(samples):
    return Noise("bark", Path("bark.wav"), None, "point", samples.astype(np.float32))


@pytest.mark.parametrize("before_s, after_s", [(0.0, 4.0), (2.0, 2.0), (4.0, 0.0), (0.0, 1.0), (0.0, 0.0)])
@pytest.mark.parametrize("offset", [0.0, -2.0 ** -15])
def test_excerpt_sounds_after_its_lead(before_s, after_s, offset):
    sound = 0.05 * np.random.default_rng(0).standard_normal(FS_HZ // 2)
    noise = noise_of(offset + np.concatenate([np.zeros(int(before_s * FS_HZ)), sound, np.zeros(int(after_s * FS_HZ))]))
    cache = cache_of(noise)
    for u in np.linspace(0.0, 0.999, 50):
        samples, start = cache.excerpt(noise, u, LENGTH, lead=LEAD)
        assert len(samples) == LENGTH and np.ptp(samples[LEAD:]) > 0 and 0 <= start < len(noise.samples)


def test_excerpt_that_sounds_is_the_drawn_one_without_rumble():
    noise = noise_of(0.1 + np.random.default_rng(0).standard_normal(10 * FS_HZ))
    samples, start = cache_of(noise).excerpt(noise, 0.5, LENGTH, lead=LEAD)
    np.testing.assert_array_equal(samples, without_rumble(noise.samples, FS_HZ)[start:start + LENGTH])


def test_excerpt_of_a_long_noise_is_the_same_but_for_its_ends(monkeypatch):
    """Of noises that are too long to be kept, the excerpt alone is filtered, whose filter is 0.1 s long."""
    noise = noise_of(0.1 + np.random.default_rng(0).standard_normal(10 * FS_HZ))
    kept, start = cache_of(noise).excerpt(noise, 0.5, LENGTH)
    monkeypatch.setattr(audio_cache, "CACHE_BYTES", 1 << 20)
    long, also_start = cache_of(noise).excerpt(noise, 0.5, LENGTH)
    inside = slice(FS_HZ // 10, -FS_HZ // 10)
    assert start == also_start and not np.array_equal(kept, long)
    np.testing.assert_allclose(kept[inside], long[inside], atol=1e-2)


def test_repeated_noise_has_no_pulses_of_its_offset():
    sound = 0.01 * np.random.default_rng(0).standard_normal(FS_HZ)
    noise = noise_of(0.1 + sound)
    samples, _ = cache_of(noise).excerpt(noise, 0.5, LENGTH)
    assert np.abs(samples - samples.mean()).max() < 1.5 * np.abs(sound).max()


@pytest.mark.parametrize("offset", [0.0, -2.0 ** -15])
def test_silent_noise_is_refused(offset):
    noise = noise_of(np.full(10 * FS_HZ, offset))
    with pytest.raises(ValueError, match="bark.wav: noise bark is silent"):
        cache_of(noise).excerpt(noise, 0.5, LENGTH, lead=LEAD)


def test_threads_may_share_a_cache(monkeypatch):
    monkeypatch.setattr(audio_cache, "CACHE_BYTES", 3)
    cache, interval_s = cache_of(), sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(8) as threads:
            found = list(threads.map(lambda n: cache._get(f"rir {n % 7}", lambda: (n % 7, 1)), range(4000)))
    finally:
        sys.setswitchinterval(interval_s)
    assert found == [n % 7 for n in range(4000)]
