"""BUT ReverbDB as released: one test for each irregularity of the release."""

import pytest
from corpora_examples import (
    make_reverbdb,
    put,
    put_reverbdb_mic,
    put_reverbdb_room,
    put_reverbdb_session,
    put_text,
)

from roomeq.corpora import read_measured
from roomeq.corpora.reverbdb import list_reverbdb, read_meta
from roomeq.records.rir_dir import read_noises, read_rirs


def rows_of(root):
    return {recording.id: recording.row for recording in list_reverbdb(root).rirs}


def test_geometry_is_depth_width_height(tmp_path):
    row = rows_of(make_reverbdb(tmp_path))["VUT_FIT_Q301-MicID01-SpkID01_20190503_S-01-v00"]
    assert row["room_dims_m"] == [10.776, 6.94, 2.598]
    assert row["source_pos_m"] == [0.988, 4.527, 1.459] and row["mic_pos_m"] == [1.747, 4.123, 1.229]
    assert row["distance_m"] == 0.89 and row["geometry_problem"] is None
    assert (row["source_id"], row["mic_id"], row["session"]) == ("SpkID01", "MicID01-01", "S")
    assert row["documented_t60_s"] == 0.61 and row["temperature_c"] == 22.5 and row["excitation"] == "sweep"


def test_meta_files_with_banners_and_bad_bytes_are_read(tmp_path):
    path = tmp_path / "meta.txt"
    path.write_bytes(b"\xef\xbb\xbf####\r\n# $NotAKey value\r\n$EnvDepth\t4.5\r\n"
                     b"$EnvDescription\tpokoj \xe8. 1\tx\r\n$EnvTemp\t\r\n")
    meta = read_meta(path)
    assert meta["EnvDepth"] == "4.5" and meta["EnvTemp"] == "" and "NotAKey" not in meta
    assert read_meta(tmp_path / "absent.txt") == {}


def test_env_full_meta_is_read_too(tmp_path):
    session = put_reverbdb_session(put_reverbdb_room(tmp_path, env="env_full_meta.txt"))
    put_reverbdb_mic(session, 3)
    assert next(iter(rows_of(tmp_path).values()))["room_dims_m"] == [10.776, 6.94, 2.598]


def test_missing_keys_are_null_and_counted(tmp_path):
    session = put_reverbdb_session(put_reverbdb_room(tmp_path, EnvTemp="warm", EnvWidth=None))
    put_reverbdb_mic(session, 1, EnvMic1Height=None, EnvMic1RelRT60="?")
    corpus = list_reverbdb(tmp_path)
    row = corpus.rirs[0].row
    assert row["room_dims_m"] == [10.776, None, 2.598] and row["mic_pos_m"] == [1.747, 4.123, None]
    assert row["temperature_c"] is None and row["documented_t60_s"] is None and row["distance_m"] is None
    assert corpus.notes["$EnvTemp absent or no number"] == 1
    assert corpus.notes["$EnvMic{n}RelDistance absent or no number"] == 1


def test_rirs_without_meta_files_are_read(tmp_path):
    put(tmp_path / "R" / "MicID01" / "SpkID01_20190503_S" / "01" / "RIR" / "IR_x.v00.wav")
    corpus = list_reverbdb(tmp_path)
    assert corpus.rirs[0].id == "R-MicID01-SpkID01_20190503_S-01-IR_x.v00"
    assert corpus.rirs[0].row["room_dims_m"] is None and corpus.notes["rooms without env_meta.txt"] == 1


def test_microphone_meta_overrides_the_session(tmp_path):
    session = put_reverbdb_session(put_reverbdb_room(tmp_path), speaker_m=(1, 1, 1))
    put_reverbdb_mic(session, 7, EnvSpk1Depth=2.5)
    row = next(iter(rows_of(tmp_path).values()))
    assert row["mic_pos_m"] == [1.747, 4.123, 1.229] and row["source_pos_m"] == [2.5, 1, 1]


def test_microphone_number_may_differ_from_its_folder(tmp_path):
    session = put_reverbdb_session(put_reverbdb_room(tmp_path))
    folder = put_reverbdb_mic(session, 4)
    folder.rename(folder.with_name("05"))
    corpus = list_reverbdb(tmp_path)
    assert corpus.rirs[0].row["mic_pos_m"] == [1.747, 4.123, 1.229]
    assert any("EnvMicID" in note for note in corpus.notes)


def test_position_outside_the_room_is_marked(tmp_path):
    session = put_reverbdb_session(put_reverbdb_room(tmp_path))
    put_reverbdb_mic(session, 1, (1.0, -0.02, 1.0))
    put_reverbdb_mic(session, 2, (0.988, 4.527, 1.459))
    put_reverbdb_mic(session, 3, EnvMic3RelDistance=4.2)
    problems = [row["geometry_problem"] for row in rows_of(tmp_path).values()]
    assert problems[0] == "mic_pos_m[1]=-0.02 lies outside the room (0 to 6.94 m)"
    assert "0 m apart and must be at least 0.05 m" in problems[1] and "distance_m=4.2" in problems[2]
    assert all(row["unreliable_geometry"] for row in rows_of(tmp_path).values())


@pytest.mark.parametrize("name, unreliable, uncommon", [
    ("Hotel_SkalskyDvur_ConferenceRoom2", True, False), ("VUT_FIT_L227", True, True),
    ("Hotel_SkalskyDvur_Room112", False, False), ("VUT_FIT_L2270", False, False)])
def test_unreliable_and_uncommon_rooms_are_marked(tmp_path, name, unreliable, uncommon):
    put_reverbdb_mic(put_reverbdb_session(put_reverbdb_room(tmp_path, name)), 1)
    row = next(iter(rows_of(tmp_path).values()))
    assert (row["unreliable_geometry"], row["uncommon"]) == (unreliable, uncommon)


def test_stairs_are_uncommon_by_their_type(tmp_path):
    put_reverbdb_mic(put_reverbdb_session(put_reverbdb_room(tmp_path, "X", EnvType="Stairs")), 1)
    assert next(iter(rows_of(tmp_path).values()))["uncommon"]


def test_repeats_name_the_first_take_of_the_s_session(tmp_path):
    room = put_reverbdb_room(tmp_path)
    put_reverbdb_mic(put_reverbdb_session(room, "SpkID01_20170910_T"), 1)
    put_reverbdb_mic(put_reverbdb_session(room, "SpkID01_20190503_S"), 1, takes=("v00", "v01"))
    put_reverbdb_mic(put_reverbdb_session(room, "SpkID02_20190503_S", (2, 2, 1)), 1)
    of = {name.removeprefix("VUT_FIT_Q301-MicID01-"): row for name, row in rows_of(tmp_path).items()}
    first = "VUT_FIT_Q301-MicID01-SpkID01_20190503_S-01-v00"
    assert {name: row["repeat_of"] for name, row in of.items()} == {
        "SpkID01_20190503_S-01-v00": None, "SpkID01_20190503_S-01-v01": first, "SpkID02_20190503_S-01-v00": None,
        "SpkID01_20170910_T-01-v00": first}
    assert of["SpkID01_20170910_T-01-v00"]["session"] == "T"


def test_silences_are_noises_and_speech_is_ignored(tmp_path):
    session = put_reverbdb_session(put_reverbdb_room(tmp_path))
    folder = put_reverbdb_mic(session, 1, silences=("s.v00", "s.v01"))
    put(folder / "english" / "LibriSpeech" / "test-clean" / "1" / "2" / "1-2-0000.v00.wav")
    put_reverbdb_mic(session, 2, takes=(), silences=("s.v00",))
    out = read_measured(tmp_path, tmp_path / "out")
    assert len(read_rirs(out)) == 1
    noises = read_noises(out)
    assert len(noises) == 3 and {(n["kind"], n["room_id"]) for n in noises} == {("ambient", "VUT_FIT_Q301")}


def test_tree_may_be_nested_or_be_one_room(tmp_path):
    release = make_reverbdb(tmp_path / "BUT_ReverbDB_rel_19_06_RIR-Only")
    ids = set(rows_of(release))
    assert len(ids) == 2 and ids == set(rows_of(tmp_path)) == set(rows_of(release / "VUT_FIT_Q301"))


def test_tree_without_rirs_is_an_error(tmp_path):
    put_text(tmp_path / "Room" / "MicID01" / "SpkID01_1_S" / "spk_meta.txt", "")
    with pytest.raises(ValueError, match="no RIRs .*: check that the release was unpacked whole"):
        list_reverbdb(tmp_path)
