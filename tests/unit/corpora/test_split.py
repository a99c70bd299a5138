"""Splits are disjoint and complete, have the sizes asked for, and depend on the seed only."""

from unittest.mock import Mock

import numpy as np
import pytest
import soundfile
import soxr
from rirmaker import coloured_rir, row, write_rir_dir

from roomeq.corpora import read_measured
from roomeq.corpora.split import SPLITS, split_rirs
from roomeq.records.rir_dir import read_noises, read_rirs, validate_rirs

RIR = np.eye(1, 600, 10).ravel() + 1e-3


def recordings(name):
    """Yield RIRs, each of which is a recording of its own."""
    rng = np.random.default_rng(list(name.encode()))
    while True:
        yield RIR + 0.01 * rng.normal(size=len(RIR))


def make(directory, rooms, noises=()):
    """Write an RIR directory of {room: number of RIRs}, whose recordings are in no directory of another name."""
    rirs = recordings(directory.name)
    return write_rir_dir(directory, [(row(f"{room}-{n}", room), next(rirs))
                                     for room, count in rooms.items() for n in range(count)], noises)


def split(tmp_path, rir_dir, name="out", **options):
    """Split; return the ids, and the noises' ids, of each split."""
    split_rirs(rir_dir, tmp_path / name, **{"seed": 0} | options)
    for part in SPLITS:
        validate_rirs(tmp_path / f"{name}.{part}")
    return tuple({part: [row["id"] for row in read(tmp_path / f"{name}.{part}")] for part in SPLITS}
                 for read in (read_rirs, read_noises))


def sizes_of(ids):
    return [len(ids[part]) for part in SPLITS]


@pytest.mark.parametrize("fs_hz", [16000, 48000])
def test_files_of_one_name_are_channels_also_where_they_were_converted(tmp_path, fs_hz):
    rirs = recordings("takes")
    for mic in range(3):
        for take in range(6):
            path = tmp_path / "corpus" / "lab" / f"mic{mic}" / f"take{take}.wav"
            path.parent.mkdir(parents=True, exist_ok=True)
            soundfile.write(path, np.repeat(next(rirs), fs_hz // 16000), fs_hz, subtype="FLOAT")
    read_measured(tmp_path / "corpus", tmp_path / "in", keep_suspicious=True)
    ids, _ = split(tmp_path, tmp_path / "in", sizes=(9, 6, 3))
    takes = [{name.rpartition("-")[2] for name in of_part} for of_part in ids.values()]
    assert sum(map(len, takes)) == 6 and sizes_of(ids) == [9, 6, 3]


@pytest.mark.parametrize("file", ["lab/position{}/mic{}.wav", "lab/position{}/mic{}/rir.wav"])
def test_folders_are_measurements_where_there_are_more_of_them_than_names(tmp_path, file):
    rirs = recordings("positions")
    items = [(row(f"lab-{n}-mic{mic}", "lab", recording=file.format(n, mic)), next(rirs))
             for n in range(12) for mic in range(2)]
    ids, _ = split(tmp_path, write_rir_dir(tmp_path / "in", items), sizes=(12, 8, 4))
    positions = [{name.split("-")[1] for name in of_part} for of_part in ids.values()]
    assert sum(map(len, positions)) == 12 and sizes_of(ids) == [12, 8, 4]


@pytest.mark.parametrize("file", ["lab/position{}/ch{}.wav", "lab/position{}/CH{:02d}.wav",
                                  "lab/ch{1}/position{0}.wav", "lab/ch{1}/position{0}/rir.wav"])
def test_channels_are_known_by_their_names_where_there_are_many(tmp_path, file):
    rirs = recordings("arrays")
    items = [(row(f"lab-{n}-{mic}", "lab", recording=file.format(n, mic)), next(rirs))
             for n in range(3) for mic in range(8)]
    ids, _ = split(tmp_path, write_rir_dir(tmp_path / "in", items), sizes=(8, 8, 8))
    assert sizes_of(ids) == [8, 8, 8]
    assert all(len({name.split("-")[1] for name in of_part}) == 1 for of_part in ids.values())


def test_recording_without_a_direct_sound_is_named(tmp_path):
    rir_dir = write_rir_dir(tmp_path / "in", [(row(f"a-{n}"), np.full(16000, 0.3) if n == 2 else coloured_rir(n))
                                              for n in range(4)])
    with pytest.raises(ValueError, match=r"a-2.wav: impulse response has no direct sound: .* roomeq characterise"):
        split(tmp_path, rir_dir, sizes=(2, 1, 1))


@pytest.mark.parametrize("count, sizes, expected", [
    (20, (12, 3, 5), [12, 3, 5]), (26, (12, 3, 5), [12, 3, 5]), (40, (773, 194, 242), [26, 6, 8]),
    (3, (773, 194, 242), [1, 1, 1]), (4, (773, 194, 242), [2, 1, 1])])
def test_sizes_are_exact_or_in_proportion(tmp_path, count, sizes, expected):
    ids, _ = split(tmp_path, make(tmp_path / "in", {"a": count}), sizes=sizes)
    assert sizes_of(ids) == expected


def test_splits_are_disjoint_and_complete(tmp_path):
    ids, _ = split(tmp_path, make(tmp_path / "in", {"a": 9, "b": 8, "c": 5}))
    everything = sorted(sum(ids.values(), []))
    assert everything == sorted(row["id"] for row in read_rirs(tmp_path / "in"))


@pytest.mark.parametrize("ending", ["_ch{}", "_ch{}_e0", "_ch0_e{}"])
def test_channels_of_a_measurement_stay_together_wherever_they_are(tmp_path, ending):
    rirs, rows = recordings("channels"), []
    for measurement in range(6):
        for n in range(4):
            rir_id = f"lab-{measurement}" + ending.format(n)
            rows.append((row(rir_id, "lab", mic_id=f"array-ch{n}", source_pos_m=[1.0 + measurement, 1.0, 1.0],
                             mic_pos_m=[2.0, 3.0 + 0.05 * n, 1.0]), next(rirs)))
    ids, _ = split(tmp_path, write_rir_dir(tmp_path / "in", rows), sizes=(12, 4, 8))
    part_of = {rir_id: part for part in SPLITS for rir_id in ids[part]}
    assert len({(rir_id.split("_")[0], part) for rir_id, part in part_of.items()}) == 6


def test_split_depends_on_the_seed_only(tmp_path):
    rir_dir = make(tmp_path / "in", {"a": 20})
    first, _ = split(tmp_path, rir_dir, "first")
    assert split(tmp_path, rir_dir, "again")[0] == first
    assert split(tmp_path, rir_dir, "other", seed=1)[0] != first


@pytest.mark.parametrize("seed", range(5))
def test_split_by_room_keeps_rooms_in_one_split(tmp_path, seed):
    rooms = {"a": 10, "b": 3, "c": 4, "d": 6, "e": 2}
    ids, _ = split(tmp_path, make(tmp_path / "in", rooms), split_by="room", seed=seed)
    homes = {part: {rir_id.split("-")[0] for rir_id in ids[part]} for part in SPLITS}
    assert sum(len(home) for home in homes.values()) == len(rooms)
    assert sizes_of(ids)[0] == max(sizes_of(ids)) and min(sizes_of(ids)) > 0


@pytest.mark.parametrize("seed", range(5))
def test_rooms_of_one_pattern_stay_together(tmp_path, seed):
    rooms = {"lab_open": 3, "lab_shut": 3, "house_hall": 2, "house_den": 2, "c": 4, "d": 6, "house": 2}
    ids, _ = split(tmp_path, make(tmp_path / "in", rooms), split_by="room", same_rooms=("lab_*", "house_*"), seed=seed)
    for name in ("lab_", "house_"):
        assert sum(any(rir_id.startswith(name) for rir_id in ids[part]) for part in SPLITS) == 1
    assert sum(sizes_of(ids)) == sum(rooms.values())


@pytest.mark.parametrize("seed", range(3))
def test_noises_go_with_the_rooms_of_their_pattern(tmp_path, seed):
    noises = [dict(id=f"{room}-noise{n}", room_id=room) for room in ("c", "d", "lab_hall") for n in range(6)]
    rir_dir = make(tmp_path / "in", {"lab_a": 3, "lab_b": 3, "c": 4, "d": 6}, noises)
    ids, dealt = split(tmp_path, rir_dir, split_by="room", same_rooms=("lab_*",), seed=seed)
    for part in SPLITS:  # of three groups, one each
        assert len(dealt[part]) == 6 and {name[:2] for name in dealt[part]} == {name[:2] for name in ids[part]}


@pytest.mark.parametrize("height_m", [1.0, None])
def test_takes_of_one_position_stay_together(tmp_path, height_m):
    rirs = recordings("takes")
    items = [(row(f"p{n}-{take}", source_pos_m=[1.0, 0.1 * n, 1.5], mic_pos_m=[2.0, 2.0, height_m]), next(rirs))
             for n in range(12) for take in range(2)]
    ids, _ = split(tmp_path, write_rir_dir(tmp_path / "in", items))
    assert sum(sizes_of(ids)) == 24
    for part in SPLITS:
        assert all(rir_id[:-1] + str(1 - int(rir_id[-1])) in ids[part] for rir_id in ids[part])


@pytest.mark.parametrize("position_m", [None, [2.0, 2.0, None]])
def test_channels_of_one_measurement_stay_together(tmp_path, position_m):
    rirs = recordings("channels")
    items = [(row(f"p{n}_ch{take}", mic_id=f"m{take}", source_pos_m=position_m and [1.0, 0.1 * n, 1.5],
                  mic_pos_m=position_m), next(rirs)) for n in range(12) for take in range(2)]
    ids, _ = split(tmp_path, write_rir_dir(tmp_path / "in", items))
    assert sum(sizes_of(ids)) == 24
    for part in SPLITS:
        assert all(rir_id[:-1] + str(1 - int(rir_id[-1])) in ids[part] for rir_id in ids[part])


def test_every_split_gets_noises_of_each_kind(tmp_path):
    noises = [dict(id=f"{kind}{n}", room_id=None, kind=kind) for kind in ("ambient", "point") for n in range(3)]
    _, dealt = split(tmp_path, make(tmp_path / "in", {"a": 9}, noises))
    assert all({noise_id[:-1] for noise_id in dealt[part]} == {"ambient", "point"} for part in SPLITS)


@pytest.mark.parametrize("split_by", ["rir", "room"])
def test_every_split_gets_noises_of_its_own(tmp_path, split_by):
    noises = [dict(id=f"n{n}{room}", room_id=room) for n in range(3) for room in ("a", "b", "c", None)]
    rir_dir = make(tmp_path / "in", {"a": 9, "b": 4, "c": 4}, noises)
    ids, dealt = split(tmp_path, rir_dir, split_by=split_by)
    assert sorted(sum(dealt.values(), [])) == sorted(noise["id"] for noise in noises)
    assert min(sizes_of(dealt)) > 0
    if split_by == "room":
        for part in SPLITS:
            homes = {rir_id.split("-")[0] for rir_id in ids[part]}
            assert {noise_id[2:] for noise_id in dealt[part]} <= homes | {"None"}


def test_single_noise_is_shared_with_a_warning(tmp_path, caplog):
    _, dealt = split(tmp_path, make(tmp_path / "in", {"a": 9}, [dict(id="n", room_id="a")]))
    assert all(dealt[part] == ["n"] for part in SPLITS)
    assert "no ambient noises of its own" in caplog.text


def test_rirs_per_room_are_logged(tmp_path, caplog):
    caplog.set_level("INFO")
    split(tmp_path, make(tmp_path / "in", {"a": 9, "kitchen": 5}))
    assert "kitchen" in caplog.text and "train" in caplog.text


@pytest.mark.parametrize("rooms, options, message", [
    ({"a": 2}, {}, "leave .* empty when split by rir"),
    ({"a": 5, "b": 5}, dict(split_by="room"), "empty when split by room"),
    ({"a1": 5, "a2": 5, "b": 2}, dict(split_by="room", same_rooms=("a*",)), "12 RIRs of 2 rooms leave"),
    ({"a": 5, "b": 5, "c": 2}, dict(split_by="room", same_rooms=("x*",)), "'x\\*' matches no room .* a, b, c"),
    ({"a": 5, "b": 5, "c": 2}, dict(same_rooms=("a*",)), "split by 'room'"),
    ({"a": 5}, dict(split_by="file"), "split_by='file' must be"),
    ({"a": 5}, dict(sizes=(3, 0, 1)), "must be three positive"),
])
def test_impossible_split_is_refused(tmp_path, rooms, options, message):
    with pytest.raises(ValueError, match=message):
        split(tmp_path, make(tmp_path / "in", rooms), **options)
    assert not list(tmp_path.glob("out.*"))


def test_other_directories_serve_development_and_test(tmp_path):
    noises = [dict(id=f"n{n}", room_id=None) for n in range(6)]
    rir_dir = make(tmp_path / "in", {"a": 10, "b": 10}, noises)
    other = make(tmp_path / "other", {"c": 4}, [dict(id="own", room_id="c")])
    ids, of_noises = split(tmp_path, rir_dir, sizes=(12, 3, 5), test_rirs=other)
    assert sizes_of(ids) == [12, 3, 4] and {name.split("-")[0] for name in ids["test"]} == {"c"}
    assert "own" in of_noises["test"] and len(of_noises["test"]) > 1
    third = make(tmp_path / "third", {"d": 2})
    ids, _ = split(tmp_path, rir_dir, "both", sizes=(12, 3, 5), test_rirs=other, dev_rirs=third)
    assert sizes_of(ids) == [12, 2, 4]


def test_recordings_of_another_set_are_no_test(tmp_path):
    rir_dir, other = make(tmp_path / "in", {"a": 6}), make(tmp_path / "other", {"c": 4})
    with pytest.raises(ValueError, match="in: RIR a-. is the recording of RIR a-. of .*in: give recordings for test "
                                         "that train does not have"):
        split_rirs(rir_dir, tmp_path / "out", seed=0, sizes=(4, 1, 1), test_rirs=rir_dir)
    with pytest.raises(ValueError, match="other: RIR c-. is the recording of RIR c-. of .*other: give recordings for "
                                         "test that dev does not have"):
        split_rirs(rir_dir, tmp_path / "out", seed=0, sizes=(4, 1, 1), dev_rirs=other, test_rirs=other)
    copy = write_rir_dir(tmp_path / "copy", [(row("renamed", "d"), soundfile.read(rir_dir / "audio/a-2.wav")[0])])
    with pytest.raises(ValueError, match="copy: RIR renamed is the recording of RIR a-2"):
        split_rirs(rir_dir, tmp_path / "out", seed=0, sizes=(4, 1, 1), test_rirs=copy)


def test_noises_of_the_same_id_are_refused(tmp_path):
    rir_dir = make(tmp_path / "in", {"a": 10}, [dict(id="n1", room_id=None)])
    other = make(tmp_path / "other", {"c": 4}, [dict(id="n1", room_id="c")])
    with pytest.raises(ValueError, match="other: noise n1 has the id of a noise of .*in, .* rename one"):
        split_rirs(rir_dir, tmp_path / "out", seed=0, sizes=(4, 1, 1), test_rirs=other)


@pytest.mark.parametrize("gain, subtype", [(1.0, "FLOAT"), (0.3, "PCM_24"), (0.3, "PCM_16"), (-0.1, "PCM_16")])
@pytest.mark.parametrize("kind, old", [("RIR", "a-2"), ("noise", "n1")])
def test_copies_in_other_formats_and_at_other_levels_are_no_test(tmp_path, kind, old, gain, subtype):
    rir_dir = make(tmp_path / "in", {"a": 6}, [dict(id=f"n{n}", room_id=None) for n in range(3)])
    copied, _ = soundfile.read(rir_dir / f"audio/{old}.wav")
    if kind == "RIR":
        other = write_rir_dir(tmp_path / "other", [(row("new", "d"), copied)])
    else:
        other = make(tmp_path / "other", {"d": 1}, [dict(id="new", room_id=None)])
    soundfile.write(other / "audio/new.wav", gain / np.abs(copied).max() * copied, 16000, subtype=subtype)
    with pytest.raises(ValueError, match=f"other: {kind} new is the recording of {kind} {old} of .*in: give "
                                         "recordings for test that train does not have"):
        split_rirs(rir_dir, tmp_path / "out", seed=0, sizes=(4, 1, 1), test_rirs=other)


def resampled(rir):
    """Return an RIR as a recorder of another sampling rate, on another clock, would hold it."""
    return soxr.resample(soxr.resample(rir, 16000, 44100), 44100, 16000)[3:]


def test_resampled_copies_are_no_test(tmp_path):
    rir_dir = write_rir_dir(tmp_path / "in", [(row(f"a-{n}", "a"), coloured_rir(n)) for n in range(6)])
    other = write_rir_dir(tmp_path / "other", [(row("other", "b"), coloured_rir(8)),
                                               (row("copy", "b"), 0.1 * resampled(coloured_rir(4)))])
    with pytest.raises(ValueError, match="other: RIR copy is the recording of RIR a-4 of .*in: give recordings for "):
        split_rirs(rir_dir, tmp_path / "out", seed=0, sizes=(4, 1, 1), test_rirs=other)


@pytest.mark.parametrize("split_by", ["rir", "room"])
@pytest.mark.parametrize("seed", range(3))
def test_copies_of_an_rir_stay_together(tmp_path, caplog, split_by, seed):
    caplog.set_level("INFO")
    rir_dir = write_rir_dir(tmp_path / "in", [
        *((row(f"{room}-{n}", room), coloured_rir(10 * k + n)) for k, room in enumerate("abcdef") for n in range(2)),
        (row("x-0", "x"), resampled(coloured_rir(20))), (row("x-1", "x"), coloured_rir(99))])
    ids, _ = split(tmp_path, rir_dir, split_by=split_by, seed=seed, sizes=(8, 3, 3))
    part_of = {rir_id: part for part in SPLITS for rir_id in ids[part]}
    assert part_of["c-0"] == part_of["x-0"] and len(part_of) == 14
    assert f"{rir_dir}: RIRs c-0, x-0 are one recording and stay together" in caplog.text


@pytest.mark.parametrize("seed", range(3))
def test_copies_of_a_noise_stay_together(tmp_path, seed):
    rir_dir = make(tmp_path / "in", {"a": 9}, [dict(id=f"n{n}-{copy}", room_id=None) for n in range(6)
                                               for copy in range(2)])
    for n in range(6):
        noise, _ = soundfile.read(rir_dir / f"audio/n{n}-0.wav")
        soundfile.write(rir_dir / f"audio/n{n}-1.wav", 0.5 * noise, 16000, subtype="PCM_16")
    _, dealt = split(tmp_path, rir_dir, seed=seed)
    assert sum(sizes_of(dealt)) == 12 and min(sizes_of(dealt)) > 0
    for part in SPLITS:
        assert all(noise_id[:-1] + str(1 - int(noise_id[-1])) in dealt[part] for noise_id in dealt[part])


def test_rooms_of_the_same_name_are_said(tmp_path, caplog):
    rir_dir = make(tmp_path / "in", {"a": 6})
    other = write_rir_dir(tmp_path / "other", [(row("a-new", "a"), 0.5 * RIR)])
    split_rirs(rir_dir, tmp_path / "out", seed=0, sizes=(4, 1, 1), test_rirs=other)
    assert "both have rooms named a: word error rates take them for the same rooms" in caplog.text


def test_run_that_is_killed_between_two_sets_leaves_no_set_of_an_earlier_split(tmp_path, monkeypatch):
    rir_dir = make(tmp_path / "in", {"a": 12})
    split(tmp_path, rir_dir, sizes=(6, 3, 3))
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr("roomeq.corpora.split.write_noises", Mock(side_effect=[None, KeyboardInterrupt]))
        split_rirs(rir_dir, tmp_path / "out", seed=1, sizes=(6, 3, 3))
    assert sorted(path.name for path in tmp_path.glob("out.*")) == ["out.train"]
    ids, _ = split(tmp_path, rir_dir, seed=1, sizes=(6, 3, 3))
    assert sizes_of(ids) == [6, 3, 3] and len(set().union(*ids.values())) == 12


def test_ids_in_both_directories_are_refused(tmp_path):
    rir_dir, other = make(tmp_path / "in", {"a": 6}), make(tmp_path / "other", {"a": 2})
    with pytest.raises(ValueError, match="other: RIR a-0 has the id of an RIR of .*in: .* rename one"):
        split_rirs(rir_dir, tmp_path / "out", seed=0, sizes=(4, 1, 1), test_rirs=other)


def test_row_that_is_edited_while_it_is_read_is_refused(tmp_path, monkeypatch):
    make(tmp_path / "in", dict(a=3, b=3))
    table = tmp_path / "in/rirs.jsonl"

    def read_and_edit(directory):
        rows = read_rirs(directory)
        table.write_text(table.read_text().replace('"room_id": "a"', '"room_id": "kitchen"'))
        return rows

    monkeypatch.setattr("roomeq.corpora.split.read_rirs", read_and_edit)
    with pytest.raises(ValueError, match=r"in/rirs\.jsonl: was written to meanwhile; run this again"):
        split(tmp_path, tmp_path / "in", sizes=(2, 2, 2))
    monkeypatch.undo()
    split(tmp_path, tmp_path / "in", sizes=(2, 2, 2))
    assert {row["room_id"] for part in SPLITS for row in read_rirs(tmp_path / f"out.{part}")} == {"b", "kitchen"}
