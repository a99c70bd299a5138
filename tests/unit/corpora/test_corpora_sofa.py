"""SOFA files of measured rooms."""

import os

import numpy as np
import pytest
from corpora_examples import put, put_sofa, put_text, rir
from netCDF4 import Dataset

from roomeq.corpora import read_measured
from roomeq.corpora.listing import list_sofa
from roomeq.corpora.record import Recording
from roomeq.corpora.sofa_file import sofa_signals
from roomeq.records.rir_dir import load_rir, read_rirs


def signals(path):
    return list(sofa_signals(list_sofa(path).rirs[0]))


def test_measurements_and_receivers_become_rows(tmp_path):
    path = put_sofa(tmp_path / "lab.sofa", 2, 2, SourcePosition=[[1, 1, 1.2], [2, 1, 1.2]],
                    GLOBAL_RoomShortName="Lab 3", GLOBAL_SourceShortName="Genelec", RoomTemperature=295.15)
    rows = [row for row, _, _ in signals(path)]
    assert [row["id"] for row in rows] == ["lab_m0_ch0", "lab_m0_ch1", "lab_m1_ch0", "lab_m1_ch1"]
    assert rows[2]["source_pos_m"] == [2, 1, 1.2] and rows[2]["mic_pos_m"] == [3, 2, 1.5]
    assert rows[0]["room_dims_m"] == [5, 4, 3] and rows[0]["room_id"] == "Lab-3"
    assert rows[0]["source_id"] == "Genelec" and rows[1]["mic_id"] == "unknown-ch1"
    assert rows[0]["temperature_c"] == 22.0 and rows[0]["binaural"] is False


def test_samples_are_resampled_to_16_khz(tmp_path):
    out = read_measured(put_sofa(tmp_path / "a.sofa", fs_hz=16000), tmp_path / "out")
    assert load_rir(out, read_rirs(out)[0]) == pytest.approx(rir("0-0", 2400), abs=1e-7)
    out = read_measured(put_sofa(tmp_path / "b.sofa", fs_hz=48000), tmp_path / "out48")
    assert read_rirs(out)[0]["n_samples"] == 800


def test_positions_are_relative_to_the_lowest_corner(tmp_path):
    path = put_sofa(tmp_path / "a.sofa", RoomCornerA=[[2, 3, 0]], RoomCornerB=[[-3, -1, 3]],
                    SourcePosition=[[-2, 0, 1]], ListenerPosition=[[0, 1, 1]])
    row = signals(path)[0][0]
    assert row["room_dims_m"] == [5, 4, 3]
    assert row["source_pos_m"] == [1, 1, 1] and row["mic_pos_m"] == [3, 2, 1]


def test_receivers_turn_with_the_listener(tmp_path):
    # a microphone 10 cm to the left of a listener that looks along +y stands 10 cm towards -x
    path = put_sofa(tmp_path / "a.sofa", ReceiverPosition=[[90, 0, 0.1]], ListenerView=[[0, 1, 0]])
    assert signals(path)[0][0]["mic_pos_m"] == [2.9, 2.0, 1.5]


def test_a_view_that_changes_is_where_the_source_faces(tmp_path):
    path = put_sofa(tmp_path / "a.sofa", 2, SourceView=[[1, 0, 0], [0, 2, 0]], ListenerView=[[1, 0, 0]])
    first, second = (row for row, _, _ in signals(path))
    assert (first["source_dir"], second["source_dir"]) == ([1, 0, 0], [0, 1, 0])
    assert first["mic_dir"] is None  # one view for all may be that of the convention's example
    put_text(tmp_path / "t.csv", "file,mic_dir\na.sofa,0 1 0\n")
    out = read_measured(tmp_path / "t.csv", tmp_path / "out")
    assert [(row["source_dir"], row["mic_dir"]) for row in read_rirs(out)] == [
        ([1, 0, 0], [0, 1, 0]), ([0, 1, 0], [0, 1, 0])]


@pytest.mark.parametrize("unit, right_angle", [("degree", 90.0), ("radian", 0.5 * np.pi)])
def test_spherical_source_positions(tmp_path, unit, right_angle):
    path = put_sofa(tmp_path / "a.sofa", SourcePosition=[[right_angle, right_angle / 3, 2]],
                    SourcePosition_Type="spherical", SourcePosition_Units="degree, degree, metre")
    with Dataset(path, "a") as file:
        file["SourcePosition"].Units = f"{unit}, {unit}, metre"
    assert signals(path)[0][0]["source_pos_m"] == pytest.approx([0, np.sqrt(3), 1], abs=1e-4)


def test_without_corners_only_the_distance_is_kept(tmp_path):
    row = signals(put_sofa(tmp_path / "a.sofa", convention="GeneralFIR"))[0][0]
    assert row["room_dims_m"] is None and row["source_pos_m"] is None and row["room_id"] == "a"
    assert row["distance_m"] == pytest.approx(np.sqrt(4 + 1 + 0.09), abs=1e-4)


def test_default_corners_and_positions_are_unknown(tmp_path):
    path = put_sofa(tmp_path / "a.sofa", RoomCornerB=[[1, 2, 3]], SourcePosition=[[0, 0, 1]],
                    ListenerPosition=[[0, 0, 0]])
    row = signals(path)[0][0]
    assert row["room_dims_m"] is None and row["mic_pos_m"] is None and row["distance_m"] is None
    assert row["temperature_c"] is None
    assert row["geometry_problem"].startswith("SourcePosition and ListenerPosition are those of the convention's")


@pytest.mark.parametrize(("options", "message"), [
    (dict(RoomCornerB=[[1, 2, 3]]), "not used, only their distance: RoomCornerA and RoomCornerB"),
    (dict(SourcePosition=[[0, 0, 1]], ListenerPosition=[[0, 0, 0]]), "are those of the convention's example"),
    (dict(SourcePosition=[[np.nan, 0, 1]]), "SourcePosition is absent, or no finite vector")])
def test_log_says_why_positions_are_not_used(tmp_path, caplog, options, message):
    path = put_sofa(tmp_path / "a.sofa", **options)
    read_measured(path, tmp_path / "measured")
    assert "a: positions of 1 RIRs are not used" in caplog.text and message in caplog.text


def test_delay_precedes_the_response(tmp_path):
    _, samples, _ = signals(put_sofa(tmp_path / "a.sofa", Data_Delay=np.array([[7.0]])))[0]
    assert len(samples) == 2407 and not samples[:7].any() and samples[47] == 0.5


def test_dummy_head_is_binaural(tmp_path):
    path = put_sofa(tmp_path / "a.sofa", n_receivers=2, GLOBAL_ListenerShortName="KU100")
    assert all(row["binaural"] for row, _, _ in signals(path))


def test_rate_below_16_khz_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"a\.sofa: sample rate 8000 Hz must be at least 16000 Hz"):
        read_measured(put_sofa(tmp_path / "a.sofa", fs_hz=8000), tmp_path / "out")


@pytest.mark.parametrize("kind, shape, message", [
    (str, (3 * 10**8,), "variable 'Comment' must hold plain numbers or characters, no strings or records"),
    ("list", (3 * 10**8,), "variable 'Comment' must hold plain numbers or characters, no strings or records"),
    ("record", (10**6,), "variable 'Comment' must hold plain numbers or characters, no strings or records"),
    ("S1", (3 * 10**8,), "variable 'Comment' of 300000000 characters must hold at most 1000000"),
    ("f8", (10**9,), "values must be at most 345600000, see roomeq --max-audio-hours")])
def test_what_an_array_takes_is_known_before_it_is_read(tmp_path, kind, shape, message):
    path = put_sofa(tmp_path / "a.sofa")
    with Dataset(path, "a") as file:
        types = dict(list=lambda: file.createVLType(float, "list"),
                     record=lambda: file.createCompoundType(np.dtype([("a", float, (1000,))]), "record"))
        file.createDimension("Q", shape[0])
        file.createVariable("Comment", types[kind]() if kind in types else kind, ("Q",), zlib=kind in ("S1", "f8"))
    with pytest.raises(ValueError, match=message):
        signals(path)


def test_many_variables_are_refused(tmp_path):
    path = put_sofa(tmp_path / "a.sofa")
    with Dataset(path, "a") as file:
        for n in range(1000):
            file.setncattr(f"Comment{n}", "")
    with pytest.raises(ValueError, match=r"10\d\d variables and attributes must be at most 1000"):
        signals(path)


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir, lambda path: path.symlink_to("/dev/zero")])
def test_a_sofa_file_is_a_regular_file(tmp_path, make):
    put_sofa(tmp_path / "a.sofa")
    make(tmp_path / "b.sofa")
    with pytest.raises(ValueError, match=r"b\.sofa: a SOFA file must be a regular file: remove it"):
        list_sofa(tmp_path)


def test_free_field_and_broken_files_are_refused(tmp_path):
    path = put_sofa(tmp_path / "hrir.sofa", n_receivers=2, convention="SimpleFreeFieldHRIR",
                    ReceiverPosition=[[0, 0.09, 0], [0, -0.09, 0]])
    with pytest.raises(ValueError, match="SimpleFreeFieldHRIR describes a free field, no room: leave the file"):
        signals(path)
    for broken in (put_text(tmp_path / "a.sofa", "junk"), put(tmp_path / "b.wav").rename(tmp_path / "b.sofa")):
        with pytest.raises(ValueError, match=rf"{broken.name}: cannot be read as SOFA .*: export it again"):
            list(sofa_signals(Recording(broken, "x", dict(corpus="x"))))
    with pytest.raises(ValueError, match=r"no \.sofa files below it"):
        list_sofa(tmp_path / "empty")


def put_fire(path, irs):
    """Write a file of the old data type FIRE, shape (n_measurements, n_receivers, n_emitters, n_samples)."""
    with Dataset(str(path), "w") as file:
        for name, text in dict(Conventions="SOFA", Version="1.0", SOFAConventions="MultiSpeakerBRIR",
                               SOFAConventionsVersion="0.3", DataType="FIRE", RoomType="reverberant").items():
            setattr(file, name, text)
        for name, size in zip("MRENCI", (*irs.shape, 3, 1), strict=True):
            file.createDimension(name, size)
        values = {"Data.IR": ("MREN", irs), "Data.SamplingRate": ("I", 16000), "Data.Delay": ("IRE", 0),
                  "ListenerPosition": ("IC", 0), "SourcePosition": ("IC", 0), "ReceiverPosition": ("RCI", 0),
                  "EmitterPosition": ("ECI", 1)}
        for name, (dimensions, value) in values.items():
            variable = file.createVariable(name, "f8", tuple(dimensions))
            variable[:] = value
            if name.endswith("Position"):
                variable.Type, variable.Units = "cartesian", "metre"
    return path


def test_emitters_of_data_type_fire_are_no_samples(tmp_path):
    irs = np.random.default_rng(0).normal(size=(1, 2, 3, 100))
    found = signals(put_fire(tmp_path / "a.sofa", irs))
    assert [row["id"] for row, _, _ in found] == [f"a_ch{r}_e{e}" for r in range(2) for e in range(3)]
    assert found[4][1] == pytest.approx(irs[0, 1, 1])


def test_rooms_without_a_name_are_named_by_their_files(tmp_path):
    for folder in ("office", "hall"):
        put_sofa(tmp_path / folder / "rirs.sofa")
    assert [next(sofa_signals(recording))[0]["room_id"] for recording in list_sofa(tmp_path).rirs] == [
        "hall-rirs", "office-rirs"]


def test_cells_of_a_table_come_before_what_the_file_states(tmp_path):
    put_sofa(tmp_path / "a.sofa", 2, GLOBAL_RoomShortName="Lab", GLOBAL_SourceShortName="Genelec")
    put_text(tmp_path / "t.csv", "file,room,mic_id,binaural,excitation\na.sofa,Hall 2,KU100,1,clap\n")
    rows = read_rirs(read_measured(tmp_path / "t.csv", tmp_path / "out"))
    assert {(row["room_id"], row["source_id"], row["mic_id"], row["binaural"], row["excitation"]) for row in rows} == {
        ("Hall-2", "Genelec", "KU100", True, "clap")}
    assert rows[0]["mic_pos_m"] == [3, 2, 1.5]
    put_sofa(tmp_path / "b.sofa")
    put_text(tmp_path / "t.csv", "file,room\na.sofa,Hall 2\nb.sofa,Hall-2\n")
    with pytest.raises(ValueError, match="'Hall-2' and 'Hall 2' would both have the id 'Hall-2'"):
        read_measured(tmp_path / "t.csv", tmp_path / "out")
    put_text(tmp_path / "t.csv", "file,mic_pos_m\na.sofa,1 2 1\n")
    with pytest.raises(ValueError, match=r"mic_pos_m='1 2 1' must be empty for a SOFA file"):
        read_measured(tmp_path / "t.csv", tmp_path / "out")


def test_sofa_files_are_not_overlooked(tmp_path):
    put_sofa(tmp_path / "a.sofa")
    put(tmp_path / "note.wav")
    with pytest.raises(ValueError, match="holds SOFA files .* and audio files"):
        read_measured(tmp_path, tmp_path.parent / "out")
    (tmp_path / "note.wav").unlink()
    put_sofa(tmp_path / "b.sofa").rename(tmp_path / "B.SOFA")
    with pytest.raises(ValueError, match=r"B\.SOFA: a SOFA file's name must end in \.sofa"):
        read_measured(tmp_path, tmp_path.parent / "out")
