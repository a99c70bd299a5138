"""Latency of recordings whose rows say that sample 0 is the emission."""

import numpy as np
import pytest
from echoes import echo_room
from rirmaker import row, write_rir_dir

from roomeq.core.constants import FS_HZ
from roomeq.loop.data import _measure, _Recording
from roomeq.loop.doubtful_geometry import TOO_EARLY
from roomeq.loop.features import METRIC, measure_features
from roomeq.loop.latency import find_latencies
from roomeq.loop.unknown_geometry import declared_speed_m_s
from roomeq.loop.usable import LeftOut, usable_rirs
from roomeq.sim.geometry import find_place

POSITIONS = ("source_pos_m", "mic_pos_m")
DISTANCES_M = np.array([1.0, 1.7, 2.5, 3.1, 4.2, 5.0])


def timed(distances_m=DISTANCES_M, rooms=("hall",), **more):
    """Return rows and arrivals of RIRs of a room, or in turn of several, with an error of 3 cm."""
    rng = np.random.default_rng(0)
    rows = [row(f"r{n}", rooms[n % len(rooms)], source_pos_m=[0.5, 1.0, 1.2], mic_pos_m=[0.5 + metres, 1.0, 1.2],
                tof_removed=False, **more) for n, metres in enumerate(distances_m)]
    return rows, (distances_m + 0.03 * rng.standard_normal(len(rows))) / 343.2


@pytest.mark.parametrize("ms", [-3.0, -1.0, 1.0, 3.0, 8.0])
def test_latency_of_a_room_is_found_and_said(ms, caplog):
    rows, direct_s = timed()
    assert find_latencies(rows, direct_s + 1e-3 * ms) == pytest.approx(np.full(6, 1e-3 * ms), abs=1e-4)
    assert "room hall: the direct sounds of 6 of 6 RIRs are " in caplog.text
    assert ("earlier" if ms < 0.0 else "later") in caplog.text and "set tof_removed to null" in caplog.text


@pytest.mark.parametrize("ms, hidden, more", [
    (0.0, 0, {}), (0.3, 0, {}), (0.0, 1, {}), (0.0, 4, {}), (3.0, 0, dict(tof_removed=None))])
def test_single_hidden_sounds_and_small_delays_are_no_latency(ms, hidden, more):
    rows, direct_s = timed()
    direct_s[:hidden] += np.array([1.5, 4.0, 2.4, 6.0])[:hidden] * 1e-3  # detours around obstacles
    assert not find_latencies([item | more for item in rows], direct_s + 1e-3 * ms).any()


def test_hidden_sound_does_not_conceal_the_latency_of_its_room():
    rows, direct_s = timed()
    direct_s[2] += 4e-3
    assert find_latencies(rows, direct_s + 3e-3) == pytest.approx(np.full(6, 3e-3), abs=1e-4)


def test_wrong_speed_of_sound_is_no_latency():
    rows, direct_s = timed()
    assert not find_latencies(rows, 1.05 * direct_s).any()


def test_unknown_heights_do_not_conceal_a_latency():
    rows, direct_s = timed()
    rows = [item | {key: [*item[key][:2], None] for key in POSITIONS} for item in rows]
    assert find_latencies(rows, direct_s + 3e-3) == pytest.approx(np.full(6, 3e-3), abs=1e-4)


def test_small_rooms_are_taken_together_by_source():
    rows, direct_s = timed(rooms=("a", "b", "c"))
    assert find_latencies(rows, direct_s + 3e-3) == pytest.approx(np.full(6, 3e-3), abs=1e-4)
    assert not find_latencies(rows[:2], direct_s[:2] + 3e-3).any()  # two RIRs do not tell it from detours


@pytest.fixture(scope="module")
def room():
    return echo_room(3, known=POSITIONS, tof_removed=False)[:2]


def late(rir, n_samples):
    return np.concatenate([1e-6 * np.random.default_rng(0).standard_normal(n_samples), rir])


@pytest.mark.parametrize("n_samples", [0, 24, 40, 56])
def test_features_do_not_depend_on_latency(room, n_samples, tmp_path):
    """By up to 3.5 ms, an error that an obstacle's detour may have as well."""
    rows, rirs = room
    usable = usable_rirs([write_rir_dir(tmp_path, zip(rows, (late(rir, n_samples) for rir in rirs), strict=True))])
    assert [rir.row["tof_removed"] for rir in usable.rirs] == [None if n_samples else False] * len(rows)
    at = np.isin(METRIC, ("direct", "early", "drr", "c50"))
    for rir, recording in zip(usable.rirs, rirs, strict=True):
        place = find_place(rir.row, [rir.row], rir.directory, 0)
        expected_s = np.linalg.norm(np.subtract(place.mic_pos_m, place.source_pos_m)) / declared_speed_m_s(rir.row)
        right = measure_features(recording, expected_s * FS_HZ)
        found = _measure(_Recording(rir.directory, rir.row, place))
        both = at & right.valid & found.valid
        assert both.sum() > 20 and (right.valid == found.valid)[at].all()
        assert np.abs(found.values - right.values)[both].max() < 0.1
        assert found.valid[METRIC == "arrival"].item() == (n_samples == 0)


def test_wrong_position_is_found_beside_a_latency(room, tmp_path):
    rows, rirs = room
    rirs = [late(rir, 0 if n == 2 else 400) for n, rir in enumerate(rirs)]  # 25 ms; one of them 8.6 m nearer
    usable = usable_rirs([write_rir_dir(tmp_path, zip(rows, rirs, strict=True))])
    assert usable.left_out == [LeftOut(TOO_EARLY, 1, 1)]
    assert rows[2]["id"] not in [rir.row["id"] for rir in usable.rirs]
