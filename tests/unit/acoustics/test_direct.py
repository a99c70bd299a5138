"""The direct sound is the first arrival, with its sign, to a fraction of a sample."""

import csv

import numpy as np
import pytest

from roomeq.acoustics.direct import find_direct
from roomeq.core.audio import read_audio
from roomeq.core.constants import FS_HZ


def arrival(sample, n_samples=4000):
    """A band-limited impulse, pre-ringing included."""
    return np.sinc(np.arange(n_samples) - sample)


@pytest.mark.parametrize("polarity", [1, -1])
@pytest.mark.parametrize("sample", [700.0, 700.25, 700.5, 700.9])
def test_arrival_is_found_between_samples(sample, polarity):
    found, sign = find_direct(polarity * arrival(sample), FS_HZ)
    assert found == pytest.approx(sample, abs=0.05)
    assert sign == polarity


@pytest.mark.parametrize("reflection", [2.0, -3.0, 8.0])
def test_stronger_first_reflection_is_not_direct_sound(reflection):
    rir = arrival(700.0) + reflection * arrival(725.0)
    found, sign = find_direct(rir, FS_HZ)
    assert found == pytest.approx(700.0, abs=0.3)
    assert sign == 1


def test_noise_before_direct_sound_is_ignored():
    noise = np.random.default_rng(0).standard_normal(8000)
    for level in (1e-3, 1e-2, 0.1):
        found, _ = find_direct(arrival(700.0, 8000) + level * noise, FS_HZ)
        assert found == pytest.approx(700.0, abs=0.5)


@pytest.mark.parametrize("lead", [0.0, 1e-4])
@pytest.mark.parametrize("length_s", [0.1, 0.125, 0.15])
def test_response_that_ends_in_its_decay_has_its_direct_sound(length_s, lead):
    """The quietest part of the file is reverberation then, not noise."""
    rng = np.random.default_rng(3)
    decay = 0.1 * rng.standard_normal(4000) * 10.0 ** (-3.0 * np.arange(4000) / FS_HZ / 1.8)
    rir = arrival(300.0) * (np.abs(np.arange(4000) - 300) < 16) + np.where(np.arange(4000) > 320, 4.0 * decay, 0.0)
    rir[:280] = lead * rng.standard_normal(280)
    assert np.abs(rir).max() < 2.0
    assert find_direct(rir[:round(length_s * FS_HZ)], FS_HZ)[0] == pytest.approx(300.0, abs=0.5)


def test_arrival_ignores_scale_and_leading_silence():
    rir = arrival(700.4)
    assert find_direct(1e-6 * rir, FS_HZ) == pytest.approx(find_direct(rir, FS_HZ))
    assert find_direct(np.pad(rir, (50, 0)), FS_HZ)[0] == pytest.approx(find_direct(rir, FS_HZ)[0] + 50)


def test_expected_sample_finds_obstructed_direct_sound():
    rir = 0.02 * arrival(700.0) - arrival(800.0)
    assert find_direct(rir, FS_HZ)[0] == pytest.approx(800.0, abs=0.1)
    found, sign = find_direct(rir, FS_HZ, expected_sample=703.0)
    assert found == pytest.approx(700.0, abs=0.5)
    assert sign == 1


@pytest.mark.parametrize("rir, message", [
    (np.zeros(1000), "is silent"),
    (np.zeros(0), "0 samples"),
    ("hall.wav", "impulse response 'hall.wav' is a path: must be samples: read the file"),
    (np.where(np.arange(1000) == 7, np.nan, 0.1), "nan at sample 7"),
    (np.ones((2, 100)), "must be mono"),
    (np.random.default_rng(1).standard_normal(20000), "no direct sound"),
], ids=["silence", "empty", "path", "nan", "stereo", "noise"])
def test_response_without_direct_sound_is_rejected(rir, message):
    with pytest.raises(ValueError, match=message):
        find_direct(rir, FS_HZ)


def test_expected_sample_beyond_response_is_rejected():
    with pytest.raises(ValueError, match="expected_sample=9000 must lie in"):
        find_direct(arrival(700.0), FS_HZ, expected_sample=9000.0)


def test_recordings_aligned_to_10_ms_are_found_there(shared_data):
    measured = shared_data / "measured"
    with open(measured / "manifest.csv", newline="") as stream:
        rows = [row for row in csv.DictReader(stream) if row["source_id"] == "r3_a"][::10]
    for row in rows:
        found, sign = find_direct(read_audio(measured / row["file"]), FS_HZ)
        assert found == pytest.approx(160.0, abs=2.0), row["file"]
        assert sign == 1, row["file"]
