"""Rows that their recordings contradict: each labelling error is found, and right rows are kept."""

import logging

import numpy as np
import pytest
from echoes import echo_room
from rirmaker import coloured_rir, row, write_rir_dir

from roomeq.acoustics.same_recordings import cut_parts
from roomeq.core.constants import EXACT_BANDS_HZ, FS_HZ
from roomeq.loop.arrivals import measure_arrivals
from roomeq.loop.doubtful_geometry import (
    OTHER_UNIT,
    TOO_EARLY,
    TOO_LATE,
    direct_limits,
    find_other_unit,
    find_wrong_distance,
)
from roomeq.loop.doubtful_recordings import COPY, COPY_IN_ROOM, OTHER_DECAY, find_copies, find_other_decays
from roomeq.loop.misnamed_devices import (
    BANDS_HZ,
    EXCHANGED,
    FEWEST_RIRS,
    OTHER_DEVICE,
    find_misnamed_devices,
    reverberation_levels,
)
from roomeq.loop.usable import LeftOut, usable_rirs
from roomeq.records.geometry import OUTSIDE

POSITIONS = ("source_pos_m", "mic_pos_m")
LENGTHS = (*POSITIONS, "room_dims_m")
FEET, CM = 1.0 / 0.3048, 100.0


def multiplied(item, keys, factor):
    return item | {key: [None if x is None else x * factor for x in item[key]] for key in keys}


@pytest.fixture(scope="module")
def rooms():
    """Return rows and RIRs of two rooms, the second without heights and time of flight."""
    return [echo_room(3, known=POSITIONS, tof_removed=False)[:2], echo_room(4)[:2]]


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("keys, factor, said", [
    ((), 1.0, None), (LENGTHS[2:], FEET, "fit room_dims_m in feet"), (LENGTHS, FEET, "fit all lengths in feet"),
    (LENGTHS[2:], CM, "fit room_dims_m in centimetres"), (LENGTHS, CM, "fit all lengths in centimetres")])
def test_lengths_in_another_unit_are_found_by_their_reflections(rooms, number, keys, factor, said):
    rows, rirs = rooms[number]
    doubt = find_other_unit([multiplied(item, keys, factor) for item in rows], [measure_arrivals(rir) for rir in rirs])
    if said is None:
        assert doubt is None
    else:
        assert doubt.phrase == OTHER_UNIT and said in doubt.detail and f"room {rows[0]['room_id']}" in doubt.detail


def impulse(sample, *, noise=1e-4, hidden=0.0, at=0):
    """Return a decaying recording whose direct sound is at a sample, and perhaps a weak one before it."""
    rir = coloured_rir(1, snr_db=None)
    rir = np.concatenate([np.zeros(sample), rir[320:]]) + noise * np.random.default_rng(2).standard_normal(
        sample + len(rir) - 320)
    rir[at] += hidden
    return rir


@pytest.mark.parametrize("apart_m, found_m, more, phrase", [
    (3.0, 3.0, {}, None), (3.0, 3.8, {}, None), (9.8, 3.0, {}, TOO_EARLY), (3.0, 7.0, {}, TOO_LATE),
    (3.0, 7.0, dict(tof_removed=True), None), (3.0, 7.0, dict(tof_removed=None), None), (20.0, 21.8, {}, None)])
def test_direct_sound_that_contradicts_the_positions(apart_m, found_m, more, phrase):
    item = row("r", source_pos_m=[0.0, 0.0, 1.0], mic_pos_m=[apart_m, 0.0, 1.0], tof_removed=False) | more
    doubt = find_wrong_distance(item, direct_limits(impulse(round(found_m / 343.2 * FS_HZ))))
    assert (doubt and doubt.phrase) == phrase
    if doubt:
        assert "RIR r of room hall" in doubt.detail and f"{apart_m:.2f} m apart" in doubt.detail


@pytest.mark.parametrize("apart_m, found_m, phrase", [(9.8, 3.0, TOO_EARLY), (3.0, 7.0, None), (3.0, 3.2, None)])
def test_sound_that_is_too_early_for_the_plan_contradicts_positions_without_heights(apart_m, found_m, phrase):
    item = row("r", source_pos_m=[0.0, 0.0, None], mic_pos_m=[apart_m, 0.0, 1.0], tof_removed=False)
    doubt = find_wrong_distance(item, direct_limits(impulse(round(found_m / 343.2 * FS_HZ))))
    assert (doubt and doubt.phrase) == phrase
    assert not doubt or "are at least 9.80 m apart" in doubt.detail


@pytest.mark.parametrize("options", [dict(hidden=0.008, at=140), dict(noise=0.01)])
def test_late_sound_may_be_a_reflection_behind_an_obstacle_or_noise(options):
    item = row("r", source_pos_m=[0.0, 0.0, 1.0], mic_pos_m=[3.0, 0.0, 1.0], tof_removed=False)
    assert find_wrong_distance(item, direct_limits(impulse(326, **options))) is None


def test_distortion_ahead_of_the_direct_sound_is_not_the_direct_sound():
    item = row("r", source_pos_m=[0.0, 0.0, 1.0], mic_pos_m=[6.0, 0.0, 1.0], tof_removed=False)
    assert find_wrong_distance(item, direct_limits(impulse(round(6.0 / 343.2 * FS_HZ), hidden=0.1, at=60))) is None


def test_recordings_without_reflections_tell_no_unit(rooms):
    rows, rirs = rooms[0]
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((len(rows), 4000)) * np.exp(-np.arange(4000) / 1000.0)
    noise[:, 100] = 10.0
    assert find_other_unit(rows, [measure_arrivals(rir) for rir in noise]) is None


def decays(rng, time_s, n_rirs, factor=1.0):
    """Return log T20 per octave of RIRs of a room, with the scatter of ISO 3382-2 in diffuse ones, or a multiple."""
    sd = factor * 0.88 * np.sqrt(1.19 / (0.7071 * np.array(EXACT_BANDS_HZ) * time_s))
    return np.log(time_s) + sd * rng.standard_normal((n_rirs, 8))


@pytest.mark.parametrize("n_rirs", [5, 8, 30])
def test_decays_of_diffuse_rooms_raise_no_alarm(n_rirs):
    rng = np.random.default_rng(n_rirs)
    rows = [row(f"r{n}", f"room{n // n_rirs}") for n in range(100 * n_rirs)]
    log_t20 = np.concatenate([decays(rng, rng.uniform(0.2, 2.0), n_rirs) for _ in range(100)])
    assert find_other_decays(rows, log_t20) == [None] * len(rows)


@pytest.mark.parametrize(("n_rirs", "factor"), [(5, 1.5), (5, 3.0), (8, 2.0), (8, 3.0), (30, 2.0)])
def test_decays_that_scatter_more_than_in_a_diffuse_room_raise_no_alarm(n_rirs, factor):
    """By chance, 1e-4 of them may; few RIRs do not tell how much more theirs scatter."""
    rng, alarms = np.random.default_rng(n_rirs), 0
    rows = [row(f"r{n}", f"room{n // n_rirs}") for n in range(8 * n_rirs)]
    for _ in range(800 // n_rirs):
        log_t20 = np.concatenate([decays(rng, rng.uniform(0.2, 2.0), n_rirs, factor) for _ in range(8)])
        alarms += sum(doubt is not None for doubt in find_other_decays(rows, log_t20))
    assert alarms <= 2  # of 6,400


@pytest.mark.parametrize("n_rirs", [6, 8])
def test_swapped_recordings_are_found_in_rooms_that_scatter(n_rirs):
    rng, found = np.random.default_rng(n_rirs), 0
    rows = [row(f"r{n}", f"room{n // n_rirs}") for n in range(2 * n_rirs)]
    for _ in range(50):
        log_t20 = np.concatenate([decays(rng, time_s, n_rirs, 1.2) for time_s in (0.5, 0.8)])
        log_t20[[1, n_rirs + 2]] = log_t20[[n_rirs + 2, 1]]
        doubts = find_other_decays(rows, log_t20)
        found += (doubts[1] is not None) + (doubts[n_rirs + 2] is not None)
        assert sum(doubt is not None for doubt in doubts) <= 2
    assert found >= 85


def test_swapped_recordings_are_found_and_the_room_they_fit_is_named():
    rng = np.random.default_rng(1)
    rows = [row(f"r{n}", f"room{n // 6}") for n in range(12)]
    log_t20 = np.concatenate([decays(rng, time_s, 6) for time_s in (0.5, 0.8)])
    log_t20[[2, 9]] = log_t20[[9, 2]]
    log_t20[5, 3] = np.nan
    log_t20[4] += 0.7  # no other room has this decay
    found = find_other_decays(rows, log_t20)
    assert [n for n, doubt in enumerate(found) if doubt] == [2, 9] and found[2].phrase == OTHER_DECAY
    assert "RIR r2 of room room0: T20=0." in found[2].detail and "it fits room room1: " in found[2].detail


def test_decays_of_few_rirs_are_not_compared():
    rng = np.random.default_rng(1)
    log_t20 = np.concatenate([decays(rng, 0.5, 3), decays(rng, 1.0, 1), np.full((2, 8), np.nan)])
    assert find_other_decays([row(f"r{n}") for n in range(6)], log_t20) == [None] * 6


def test_copies_of_recordings_are_found_whatever_their_level():
    rirs = [coloured_rir(n, snr_db=60.0) for n in range(3)]
    rirs.append(0.3 * np.concatenate([np.zeros(50), rirs[1]]))
    repeated = coloured_rir(2, snr_db=55.0)  # under the name of another microphone at one place
    rows = [row("a", "x"), row("b", "x"), row("c", "x"), row("b2", "y"), row("c2", "x", mic_id="m2")]
    starts = [320, 320, 320, 370, 320]
    parts = np.array([cut_parts(rir, start) for rir, start in zip([*rirs, repeated], starts, strict=True)])
    found = find_copies(rows, parts)
    assert [doubt and doubt.phrase for doubt in found] == [None, None, None, COPY, COPY_IN_ROOM]
    assert "RIR b2 of room y is the recording of RIR b of room x" in found[3].detail
    assert "RIR c2 of room x is the recording of RIR c of room x" in found[4].detail
    assert found[4].detail.endswith(": give each recording once")
    elsewhere = [item | dict(mic_pos_m=[1.0, 1.0, float(n)]) for n, item in enumerate(rows)]
    assert [bool(doubt) for doubt in find_copies(elsewhere, parts)] == [False, True, True, True, True]
    assert find_copies([], np.zeros((0, 0))) == []


def devices(rng, n_rooms, differ_db, *, key="source_id", exchanged=(), rirs=8):
    """Return rows and levels of rooms with two devices, whose names are exchanged in some rooms."""
    rows, levels_db = [], []
    response_db = differ_db * rng.standard_normal((2, len(BANDS_HZ)))
    for room in range(n_rooms):
        room_db = 3.0 * rng.standard_normal(len(BANDS_HZ))
        for n in range(rirs):
            rows.append(row(f"r{room}-{n}", f"room{room}") | {key: "ab"[(n % 2) ^ (room in exchanged)]})
            levels_db.append(response_db[n % 2] + room_db + 1.5 * rng.standard_normal(len(BANDS_HZ)))
    return rows, np.array(levels_db)


@pytest.mark.parametrize("key, name", [("source_id", "loudspeakers"), ("mic_id", "microphones")])
def test_exchanged_names_are_found_in_the_room(key, name):
    rows, levels_db = devices(np.random.default_rng(1), 6, 2.0, key=key, exchanged=[2])
    found = find_misnamed_devices(rows, levels_db)
    assert {item["room_id"] for item, doubt in zip(rows, found, strict=True) if doubt} == {"room2"}
    assert sum(doubt is not None for doubt in found) == 8 and found[16].phrase == EXCHANGED
    assert f"room room2: the {name} a and b differ as in the other rooms" in found[16].detail
    assert f"correct {key}" in found[16].detail


@pytest.mark.parametrize("differ_db", [0.0, 0.5, 2.0, 6.0])
@pytest.mark.parametrize("n_rooms", [3, 8])
@pytest.mark.parametrize("rirs", [4, 8])
def test_right_names_raise_no_alarm(n_rooms, differ_db, rirs):
    for seed in range(40):
        rows, levels_db = devices(np.random.default_rng(seed), n_rooms, differ_db, rirs=rirs)
        assert find_misnamed_devices(rows, levels_db) == [None] * len(rows)


def test_rooms_with_more_scatter_raise_no_alarm():
    for seed in range(40):
        rng = np.random.default_rng(seed)
        rows, levels_db = devices(rng, 8, 2.0)
        levels_db[:8] += 4.0 * rng.standard_normal((8, len(BANDS_HZ)))  # a few strong reflections
        assert find_misnamed_devices(rows, levels_db) == [None] * len(rows)


def test_names_in_two_rooms_cannot_be_compared():
    rows, levels_db = devices(np.random.default_rng(1), 2, 6.0, exchanged=[1])
    assert find_misnamed_devices(rows, levels_db) == [None] * len(rows)


@pytest.mark.parametrize("key", ["source_id", "mic_id"])
@pytest.mark.parametrize("seed", range(5))
def test_rirs_under_another_devices_name_are_found(key, seed):
    rows, levels_db = devices(np.random.default_rng(seed), 6, 4.0, key=key)
    for n in (16, 20):
        rows[n][key] = "b"
    found = find_misnamed_devices(rows, levels_db)
    assert [n for n, doubt in enumerate(found) if doubt] == [16, 20] and found[16].phrase == OTHER_DEVICE
    assert found[16].detail.startswith("RIR r2-0 of room room2: ")
    assert f"by {key} a, not b" in found[16].detail and f"correct {key}" in found[16].detail


def test_few_rirs_of_two_devices_cannot_be_compared():
    rows, levels_db = devices(np.random.default_rng(1), 3, 6.0)
    rows[0]["source_id"] = "b"
    few = [n for n in range(len(rows)) if n % 8 < 6]
    assert len(few) < FEWEST_RIRS and not any(find_misnamed_devices([rows[n] for n in few], levels_db[few]))
    assert find_misnamed_devices(rows, levels_db)[0] is not None


def test_reverberation_levels_are_those_of_the_spectrum():
    octaves_db = np.array([0.0, 0.0, 6.0, 0.0, -6.0, 0.0, 0.0, 0.0])
    difference = np.mean([reverberation_levels(coloured_rir(n, eq_db=octaves_db), 320)
                          - reverberation_levels(coloured_rir(n), 320) for n in range(10)], axis=0)
    expected = np.interp(np.log(BANDS_HZ), np.log(EXACT_BANDS_HZ), octaves_db)
    assert difference == pytest.approx(expected - expected.mean(), abs=0.8)  # tips are averaged
    assert np.all(reverberation_levels(np.ones(100), 50) == 0.0)  # no reverberation


def test_levels_scatter_less_over_windows_than_in_all():
    rirs = [coloured_rir(n) for n in range(20)]
    levels_db = np.array([reverberation_levels(rir, 320) for rir in rirs])
    long = slice(320 + 320, 320 + 320 + 6400)
    power = np.abs(np.fft.rfft([rir[long] for rir in rirs], 16000)) ** 2
    of_all_db = 10.0 * np.log10(power[:, 891:1122].sum(axis=1))  # third octave at 1 kHz
    at_1khz = int(np.argmin(np.abs(BANDS_HZ - 1000.0)))
    assert levels_db[:, at_1khz].std() < 0.8 * of_all_db.std()


def test_windows_that_may_be_noise_have_no_part_in_the_levels():
    rng = np.random.default_rng(0)
    reverberation, noise = rng.standard_normal(800), 0.01 * np.cumsum(rng.standard_normal(4000)) / 40.0
    assert np.sum(noise[:800] ** 2) < 1e-3 * np.sum(reverberation ** 2)
    levels_db = [reverberation_levels(np.concatenate([np.zeros(320), reverberation, after]), 0)
                 for after in (np.zeros(4000), noise)]
    assert levels_db[0] == pytest.approx(levels_db[1], abs=1e-9)



def test_mislabelled_rirs_are_left_out_counted_and_named(rooms, tmp_path, caplog):
    (rows, rirs), (others, other_rirs) = rooms
    named = [[item | dict(id=f"{item['room_id']}-{item['id']}") for item in of_room] for of_room in (rows, others)]
    outside = multiplied(named[0][0], POSITIONS, CM)
    items = [outside, *named[0][1:], *(multiplied(item, LENGTHS, FEET) for item in named[1])]
    with caplog.at_level(logging.WARNING):
        usable = usable_rirs([write_rir_dir(tmp_path, zip(items, [*rirs, *other_rirs], strict=True))])
    assert [rir.row["room_id"] for rir in usable.rirs] == ["room3"] * 7
    assert usable.left_out == [LeftOut(OTHER_UNIT, 8, 1), LeftOut(OUTSIDE, 1, 1)]
    assert "room room4: room_dims_m=" in caplog.text and "state lengths in metres" in caplog.text
    assert f"source_pos_m[0]={outside['source_pos_m'][0]:g} lies outside the room" in caplog.text
    assert "RIR room3-s0_m0 of room room3: " in caplog.text
