"""Characterising RIRs: which are measured, dropped and screened, and why."""

import numpy as np
import pytest
import soxr
from rirmaker import DIRECT, coloured_rir, row, write_rir_dir
from scipy.signal import butter, firwin, resample_poly, sosfilt

from roomeq.acoustics.parameters import measure
from roomeq.core.audio import read_audio
from roomeq.core.files import read_json, read_jsonl
from roomeq.corpora.characterise import characterise
from roomeq.records.rir_dir import read_noises, read_rirs, rir_path, validate_rirs

PLACES = dict(source_pos_m=[1.0, 1.0, 1.0], mic_pos_m=[4.0, 3.0, 1.5])


def run(tmp_path, items, **options):
    """Characterise RIRs; return the kept rows by id and the screening report."""
    write_rir_dir(tmp_path / "in", items)
    characterise(tmp_path / "in", tmp_path / "out", **options)
    validate_rirs(tmp_path / "out")
    return {row["id"]: row for row in read_rirs(tmp_path / "out")}, read_json(tmp_path / "out" / "screening.json")


def test_acoustic_parameters_are_complete_json(tmp_path):
    rows, report = run(tmp_path, [(row("a"), coloured_rir(0, snr_db=60.0))])
    parameters = rows["a"]["acoustic_parameters"]
    assert parameters["direct_sample"] == pytest.approx(DIRECT, abs=0.5)
    for key in ("edt_s", "t20_s", "t30_s", "c50_db", "eq_db"):
        assert len(parameters[key]) == len(parameters[key.rsplit("_", 1)[0] + "_valid"]) == 8, key
    assert parameters["eq_db"][4] == 0.0
    assert parameters["t30_s"][5] == pytest.approx(0.4, rel=0.05)
    assert rows["a"]["screen"] is None and rows["a"]["geometry_ok"]
    assert report["n_given"] == report["n_kept"] == report["n_for_eq"] == 1


def test_output_refers_to_audio_and_noises_of_the_input(tmp_path):
    write_rir_dir(tmp_path / "in", [(row("a"), coloured_rir(0))], [dict(id="n", room_id="hall")])
    characterise(tmp_path / "in", tmp_path / "deep" / "out")
    out = tmp_path / "deep" / "out"
    assert not list(out.rglob("*.wav"))
    assert len(read_audio(rir_path(out, read_rirs(out)[0]))) == read_rirs(out)[0]["n_samples"]
    assert read_audio(out / read_noises(out)[0]["wav"]).size


@pytest.mark.parametrize("more, rir, reason", [
    (dict(binaural=True), coloured_rir(1), "binaural"),
    (dict(excitation="clap"), coloured_rir(1), "hand clap"),
    ({}, coloured_rir(1, snr_db=28.0), "too noisy"),
    ({}, coloured_rir(1, eq_db=(-60, -50, -40, 0, 0, 0, 0, 0), snr_db=45.0), "dead bands"),
], ids=["binaural", "clap", "noisy", "dead"])
def test_screened_rirs_are_kept_but_not_counted_for_eq(tmp_path, more, rir, reason):
    rows, report = run(tmp_path, [(row("a"), coloured_rir(0)), (row("b", **more), rir)])
    assert rows["a"]["screen"] is None
    assert rows["b"]["screen"].startswith(f"{reason}: ")
    assert report["screened_counts"] == {reason: 1}
    assert (report["n_kept"], report["n_for_eq"]) == (2, 1)


def test_anti_alias_roll_off_invalidates_8_khz_only(tmp_path):
    filtered = np.convolve(coloured_rir(0, length_s=0.8), firwin(401, 7500, fs=16000, window=("kaiser", 10)))
    rows, report = run(tmp_path, [(row("a"), filtered)])
    parameters = rows["a"]["acoustic_parameters"]
    assert rows["a"]["screen"] is None
    assert parameters["eq_valid"] == [True] * 7 + [False]
    assert parameters["eq_db"][7] < -40.0 and abs(parameters["eq_edge_db"]) < 4.0
    assert report["n_roll_off_at_8khz"] == 1


def test_eq_points_above_a_lower_sample_rate_are_not_measured(tmp_path):
    narrow = resample_poly(resample_poly(coloured_rir(1), 1, 2), 2, 1)
    rows, _ = run(tmp_path, [(row("a"), coloured_rir(0)), (row("b"), narrow)])
    valid = {name: kept["acoustic_parameters"]["eq_valid"] for name, kept in rows.items()}
    assert valid == dict(a=[True] * 8, b=[True] * 6 + [False] * 2)
    assert rows["b"]["screen"].startswith("dead bands: ")
    for key in ("edt_valid", "t20_valid", "t30_valid", "c50_valid"):
        flags = {name: kept["acoustic_parameters"][key] for name, kept in rows.items()}
        assert flags["b"][6:] == [False] * 2 and all(flags["a"][5:]) and flags["b"][5], key


@pytest.mark.parametrize("fs_hz", [12000, 14000])
def test_recording_of_a_lower_rate_has_no_level_below_a_roll_off_at_8_khz(tmp_path, fs_hz):
    narrow = soxr.resample(soxr.resample(coloured_rir(1), 16000, fs_hz, quality="VHQ"), fs_hz, 16000, quality="VHQ")
    rows, report = run(tmp_path, [(row("a"), narrow)])
    parameters = rows["a"]["acoustic_parameters"]
    assert parameters["eq_valid"] == [True] * 7 + [False] and parameters["eq_edge_db"] is None
    assert rows["a"]["screen"] is None and report["n_roll_off_at_8khz"] == 0


def test_eq_points_below_a_sweep_are_not_measured_for_all_rirs_of_a_source(tmp_path):
    sweep = butter(20, 90.0, "high", fs=16000, output="sos")
    items = [(row(f"a{n}"), sosfilt(sweep, coloured_rir(n))) for n in range(2)]
    items += [(row("a2"), coloured_rir(2)), (row("b", source_id="other"), coloured_rir(3))]
    rows, _ = run(tmp_path, items)
    valid = {name: kept["acoustic_parameters"]["eq_valid"] for name, kept in rows.items()}
    assert {name: points[0] for name, points in valid.items()} == dict(a0=False, a1=False, a2=False, b=True)
    assert all(all(points[1:]) for points in valid.values())
    lowest_c50 = {name: kept["acoustic_parameters"]["c50_valid"][0] for name, kept in rows.items()}
    assert lowest_c50 == dict(a0=False, a1=False, a2=False, b=True)
    assert all(kept["screen"] is None for kept in rows.values())


def test_sweep_that_one_of_two_recordings_shows_concerns_both_but_no_other_room(tmp_path):
    sweep = butter(20, 90.0, "high", fs=16000, output="sos")
    items = [(row("a0"), sosfilt(sweep, coloured_rir(0))), (row("a1"), coloured_rir(1))]
    items += [(row(f"b{n}", "other"), coloured_rir(2 + n)) for n in range(4)]
    rows, _ = run(tmp_path, items)
    lowest = {name: kept["acoustic_parameters"]["eq_valid"][0] for name, kept in rows.items()}
    assert lowest == dict(a0=False, a1=False, b0=True, b1=True, b2=True, b3=True)


def test_slope_of_24_db_per_octave_is_no_roll_off():
    parameters = measure(coloured_rir(0, eq_db=(0, 0, 0, 0, 0, 0, -2, -26)))
    assert parameters["eq_edge_db"] is None and parameters["eq_valid"][7]


def test_repeats_and_uncommon_spaces_are_dropped(tmp_path):
    first = coloured_rir(0)
    again = first + 0.01 * coloured_rir(5)
    rows, report = run(tmp_path, [
        (row("a", **PLACES), first), (row("b", **PLACES), again), (row("c"), 0.5 * first),
        (row("d", repeat_of="e"), coloured_rir(2)), (row("e"), coloured_rir(3)),
        (row("stairs", uncommon=True), coloured_rir(4))])
    assert sorted(rows) == ["a", "e"]
    assert report["dropped_counts"] == {"repeat": 3, "uncommon space": 1}
    assert report["dropped"]["b"] == "repeat: same positions as a"
    assert report["dropped"]["c"] == "repeat: same audio as a"
    assert report["dropped"]["d"] == "repeat: same positions as e"


def test_repeats_with_an_unknown_height_are_dropped(tmp_path):
    places = PLACES | dict(mic_pos_m=[4.0, 3.0, None])
    first = coloured_rir(0)
    _, report = run(tmp_path, [(row("a", **places), first), (row("b", **places), first + 0.01 * coloured_rir(5))])
    assert report["dropped"] == dict(b="repeat: same positions as a")


@pytest.mark.parametrize("height_m", [1.5, None])
def test_array_channels_of_one_position_are_kept(tmp_path, height_m):
    places = PLACES | dict(mic_pos_m=[4.0, 3.0, height_m])
    rows, _ = run(tmp_path, [(row("ch0", **places), coloured_rir(0)), (row("ch1", **places), coloured_rir(1))])
    assert sorted(rows) == ["ch0", "ch1"]


def test_takes_of_each_channel_of_one_position_are_dropped(tmp_path):
    noise = 0.01 * coloured_rir(5)
    rows, report = run(tmp_path, [(row(f"take{take}-ch{channel}", **PLACES), coloured_rir(channel) + take * noise)
                                  for take in range(2) for channel in range(2)])
    assert sorted(rows) == ["take0-ch0", "take0-ch1"]
    assert report["dropped"] == {f"take1-ch{n}": f"repeat: same positions as take0-ch{n}" for n in range(2)}


def test_repeat_is_kept_if_its_first_take_is_dropped(tmp_path):
    rows, _ = run(tmp_path, [(row("a", uncommon=True), coloured_rir(0)), (row("b", repeat_of="a"), coloured_rir(1))])
    assert sorted(rows) == ["b"]


def test_unmeasurable_rir_is_an_error_or_skipped(tmp_path):
    items = [(row("a"), coloured_rir(0)), (row("bad"), 0.1 * np.random.default_rng(0).standard_normal(8000))]
    with pytest.raises(ValueError, match="bad.wav: .*no direct sound"):
        run(tmp_path, items, keep_suspicious=True)
    assert not (tmp_path / "out").exists()
    rows, report = run(tmp_path, items, keep_suspicious=True, skip_bad=True)
    assert sorted(rows) == ["a"] and report["dropped_counts"] == {"broken": 1}


def test_dropping_every_rir_is_an_error(tmp_path):
    with pytest.raises(ValueError, match="all 1 RIRs are dropped .1 uncommon space."):
        run(tmp_path, [(row("a", uncommon=True), coloured_rir(0))])


def test_parts_and_jobs_give_the_same_bytes(tmp_path):
    items = [(row(f"r{n}"), coloured_rir(n)) for n in range(4)]
    run(tmp_path, items)
    characterise(tmp_path / "in", tmp_path / "jobs", nj=2)
    for part in ("1/2", "2/2"):
        characterise(tmp_path / "in", tmp_path / "parts", part=part)
    assert not (tmp_path / "parts").exists()
    characterise(tmp_path / "in", tmp_path / "parts")
    whole = (tmp_path / "out" / "rirs.jsonl").read_bytes()
    assert (tmp_path / "jobs" / "rirs.jsonl").read_bytes() == whole
    assert (tmp_path / "parts" / "rirs.jsonl").read_bytes() == whole
    assert read_jsonl(tmp_path / "out" / "rirs.jsonl")


def test_row_that_is_edited_while_it_is_read_is_refused(tmp_path, monkeypatch):
    write_rir_dir(tmp_path / "in", [(row("a"), coloured_rir(0))])
    table = tmp_path / "in/rirs.jsonl"

    def read_and_edit(directory):
        rows = read_rirs(directory)
        table.write_text(table.read_text().replace('"hall"', '"kitchen"'))
        return rows

    monkeypatch.setattr("roomeq.corpora.characterise.read_rirs", read_and_edit)
    with pytest.raises(ValueError, match=r"in/rirs\.jsonl: was written to meanwhile; run this again"):
        characterise(tmp_path / "in", tmp_path / "out")
    monkeypatch.undo()
    characterise(tmp_path / "in", tmp_path / "out")
    assert read_rirs(tmp_path / "out")[0]["room_id"] == "kitchen"
