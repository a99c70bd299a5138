"""Recordings that are no RIR are told from RIRs, generated ones and real ones."""

import csv

import numpy as np
import pytest
from rir_damage import SHAPES, SOMETIMES, room_rir

from roomeq.acoustics.plausibility import find_implausibility
from roomeq.core.audio import read_audio
from roomeq.core.constants import FS_HZ

CUT_BY_ITS_AUTHORS = {"rooms/gtu_11rooms_dims_only/gtu_z02.flac"}
"""Starts in mid-response: 0.4 of the maximum at sample 1, and a constant level for 50 ms."""
KINDS = {"time-reversed": "time-reversed", "time-reversed and padded": "time-reversed", "clipped by 12 dB": "clipped",
         "clipped by 26 dB": "clipped", "noise modulated at 30 Hz": "no decay", "direct sound silenced": "no onset"}


def examples():
    """Yield RIRs of dry and live rooms, near and far, each with its own random generator."""
    for seed in range(9):
        yield (room_rir(seed, time_s=(0.3, 0.6, 1.2)[seed // 3], drr_db=(-6.0, 0.0, 6.0)[seed % 3]),
               np.random.default_rng(seed))


@pytest.mark.parametrize("shape", sorted(SHAPES.keys() - SOMETIMES))
def test_damaged_rir_and_other_sounds_are_found(shape):
    found = [find_implausibility(SHAPES[shape](rir, rng), FS_HZ) for rir, rng in examples()]
    # from time to time, a Gaussian sample at the start is much larger than the others
    assert sum(reason is None for reason in found) <= (shape == "starts in mid-decay")
    if shape in KINDS:
        assert {reason.split(": ")[0] for reason in found} == {KINDS[shape]}


def test_direct_sound_cut_off_is_found_if_no_pause_follows_it():
    rirs = [room_rir(seed, pause=False) for seed in range(9)]
    found = [find_implausibility(SHAPES["direct sound cut off"](rir, None), FS_HZ) for rir in rirs]
    assert not any(find_implausibility(rir, FS_HZ) for rir in rirs)
    assert sum(reason is not None and reason.startswith("no onset: ") for reason in found) > 4


def test_clipping_of_a_weak_direct_sound_by_6_db_is_found():
    found = [find_implausibility(SHAPES["clipped by 6 dB"](room_rir(seed, drr_db=-10.0), None), FS_HZ)
             for seed in range(9)]
    assert sum(reason is not None for reason in found) > 4


@pytest.mark.parametrize("offset", [-0.05, 0.01, 0.1])
def test_constant_offset_is_found(offset):
    for rir, _ in examples():
        assert find_implausibility(rir + offset * np.abs(rir).max(), FS_HZ).startswith("offset: a constant holds")


@pytest.mark.parametrize("time_s", [0.15, 0.3, 1.0, 4.0])
@pytest.mark.parametrize("lead_s", [0.0, 0.0005, 0.002, 0.2])
@pytest.mark.parametrize("drr_db", [-6.0, 0.0, 12.0])
def test_rir_is_an_rir_however_long_noisy_or_cropped(time_s, lead_s, drr_db):
    for length_s in (0.25, 0.5, 2.0):
        for noise_db in (-30.0, -50.0, -90.0):
            rir = room_rir(5, time_s=time_s, length_s=length_s, drr_db=drr_db, lead_s=lead_s, noise_db=noise_db)
            assert find_implausibility(rir, FS_HZ) is None


@pytest.mark.parametrize("rir", [
    np.eye(1, 8000, 100)[0], np.eye(1, 8000)[0], 0.5 * np.sinc(np.arange(8000) - 200.5)],
    ids=["impulse", "impulse at the start", "impulse between two samples"])
def test_loop_back_is_plausible(rir):
    assert find_implausibility(rir, FS_HZ) is None


@pytest.mark.parametrize("bits", [8, 12, 16, 24])
def test_coarse_samples_are_not_taken_for_clipping(bits):
    for rir, _ in examples():
        assert find_implausibility(np.round(rir * 2.0 ** (bits - 1)) / 2.0 ** (bits - 1), FS_HZ) is None


def test_verdict_depends_neither_on_gain_nor_on_polarity_nor_on_padding():
    for name in ("clipped by 26 dB", "time-reversed", "starts in mid-decay"):
        bad = SHAPES[name](room_rir(1), np.random.default_rng(1))
        reason = find_implausibility(bad, FS_HZ)
        assert find_implausibility(-4.0 * bad, FS_HZ) == reason
        assert find_implausibility(np.pad(bad, 500), FS_HZ) == reason


@pytest.fixture(scope="module")
def recordings(shared_data):
    """Return the real RIRs by path."""
    found = {}
    for folder in (shared_data / "measured", *sorted((shared_data / "rooms").iterdir())):
        if not (folder / "manifest.csv").is_file():
            continue
        with (folder / "manifest.csv").open() as file:
            for line in csv.DictReader(file):
                path = folder / line["file"]
                found[str(path.relative_to(shared_data))] = read_audio(path, channel=0)
    return found


def test_no_real_recording_raises_a_false_alarm(recordings):
    assert len(recordings) > 500
    alarms = {path: reason for path, rir in recordings.items() if (reason := find_implausibility(rir, FS_HZ))}
    assert alarms.keys() <= CUT_BY_ITS_AUTHORS, alarms


@pytest.mark.parametrize("shape", ["time-reversed", "clipped by 26 dB", "starts in mid-decay",
                                   "noise modulated at 4 Hz", "direct sound silenced"])
def test_damage_of_real_recordings_is_found(recordings, shape):
    rirs = list(recordings.values())[::6]
    found = [find_implausibility(SHAPES[shape](rir, np.random.default_rng(n)), FS_HZ) for n, rir in enumerate(rirs)]
    assert sum(reason is not None for reason in found) >= 0.9 * len(rirs)
