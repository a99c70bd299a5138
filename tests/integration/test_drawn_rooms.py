"""RIR directories of drawn rooms: same bytes for any jobs, parts and number of rooms; rates; arrays; wrong options."""

import hashlib
import subprocess
from pathlib import Path

import numpy as np
import pytest
import soundfile
from commands import call
from scipy.signal import butter, sosfilt

from roomeq.core.constants import BANDS_HZ
from roomeq.core.files import write_json, write_jsonl
from roomeq.effects.coupled_volume import CoupledVolume
from roomeq.effects.model import Extension, Model, write_model
from roomeq.eq.steps import compensate
from roomeq.records.rir_dir import load_channels, load_rir, read_rirs, validate_rirs
from roomeq.simulate_rirs import simulate

ROOT = Path(__file__).resolve().parents[2]
RAYS = 2000  # so many that chance does not bend a decay, and materials need not be drawn again
TYPES = """
[plain]
floor_area_m2 = [10, 16]
aspect = [1, 1.5]
height_m = [2.4, 2.8]
t60_s = [0.3, 0.5]
[[plain.sources]]
directivity = "talker"
height_m = [1.1, 1.7]
[[plain.microphones]]
height_m = [0.8, 1.2]

[furnished]
floor_area_m2 = [12, 20]
aspect = [1, 1.5]
height_m = [2.4, 2.8]
l_shaped = 0.5
furnished = 1
t60_s = [0.3, 0.5]
[[furnished.furniture]]
kind = "table"
length_m = 1.2
width_m = 0.8
height_m = 0.75
materials = ["parquet"]
[[furnished.sources]]
height_m = [1.1, 1.7]
[[furnished.microphones]]
on = "table"
height_m = 0.05
"""
ARRAYS = """
[studio]
floor_area_m2 = 14
aspect = 1.2
height_m = 2.5
t60_s = "materials"
num_sources = 2
num_mics = 2
[[studio.sources]]
height_m = 1.2
[[studio.microphones]]
height_m = 1.0
array_m = [[0, 0, 0], [0.05, 0, 0], [0, 0.05, 0]]
"""


@pytest.fixture(scope="module")
def types(tmp_path_factory):
    path = tmp_path_factory.mktemp("types") / "types.toml"
    path.write_text(TYPES)
    return path


def draw(types, out, rooms=4, **options):
    simulate(None, out, **(dict(rooms=rooms, room_types=types, num_rays=RAYS, seed=3) | options))
    return {row["id"]: row for row in read_rirs(out)}


def hashes(directory):
    return {str(path.relative_to(directory)): hashlib.sha256(path.read_bytes()).hexdigest()
            for path in sorted(directory.rglob("*")) if path.is_file() and path.name not in (".done", "rir_list")}


def test_whole_rate_may_be_a_float(types, tmp_path):
    draw(types, tmp_path / "rirs", rooms=1, fs_hz=8000.0, noise_rirs=0)
    assert validate_rirs(tmp_path / "rirs") == 1


@pytest.fixture(scope="module")
def four(types, tmp_path_factory):
    out = tmp_path_factory.mktemp("four") / "rirs"
    draw(types, out)
    return out


def test_each_room_gives_an_rir_at_its_target_and_one_of_a_noise(four):
    rows = {row["id"]: row for row in read_rirs(four)}
    assert validate_rirs(four) == 8
    assert set(rows) == {f"room{n:05d}-s1-m1{noise}" for n in range(1, 5) for noise in ("", "-noise1")}
    assert {row["room_type"] for row in rows.values()} == {"plain", "furnished"}
    for row in rows.values():
        if row["noise_for"]:
            assert row["materials"] == rows[row["noise_for"]]["materials"] and row["source_directivity"] is None
            continue
        assert 0.3 <= row["target_t60_s"] <= 0.5 and row["t30_s"] == pytest.approx(row["target_t60_s"], rel=0.05)
        assert (row["room_type"] == "furnished") == ("mesh" in row) and row["measured_id"] is None
        assert ("furniture1" in row["materials"]) == ("mesh" in row)
        assert (row["room_type"] == "plain") == (row["source_directivity"] is not None)
        if "mesh" in row:
            assert (four / row["mesh"]).is_file()


def test_jobs_parts_and_more_rooms_change_no_byte(types, four, tmp_path):
    draw(types, tmp_path / "nj2", nj=2)
    assert hashes(tmp_path / "nj2") == hashes(four)
    for part in ("2/2", "1/2", None):
        simulate(None, tmp_path / "parts", rooms=4, room_types=types, num_rays=RAYS, seed=3, part=part)
    assert hashes(tmp_path / "parts") == hashes(four)
    draw(types, tmp_path / "six", rooms=6)
    draw(types, tmp_path / "last", rooms="5-6")
    audio = {name: value for name, value in hashes(tmp_path / "six").items() if name != "rirs.jsonl"}
    apart = {name: value for part in (four, tmp_path / "last") for name, value in hashes(part).items()}
    apart.pop("rirs.jsonl")
    assert audio == apart
    assert read_rirs(tmp_path / "six") == read_rirs(four) + read_rirs(tmp_path / "last")


def test_a_row_simulated_again_as_if_measured_is_in_the_same_room(four, tmp_path):
    simulate(four, tmp_path / "again", num_rays=500, noise_rirs=0)
    before, after = ({row["id"]: row for row in read_rirs(directory) if not row["noise_for"]}
                     for directory in (four, tmp_path / "again"))
    assert set(after) == set(before)
    for name, row in before.items():
        assert after[name]["source_pos_m"] == row["source_pos_m"] and after[name].get("mesh", "").endswith(
            row.get("mesh", ""))


@pytest.mark.parametrize("known, message", [
    (dict(source_directivity=dict(radius_m=0.1)), "source_directivity: key 'membrane_radius_m' is missing"),
    (dict(source_directivity=dict(radius_m=0.1, membrane_radius_m=0.2), source_dir=[1, 0, 0]),
     r"RIR hall: membrane_radius_m=0.2 must lie in \(0, radius_m=0.1\]"),
    (dict(source_directivity=dict(radius_m=0.1, membrane_radius_m=0.05)),
     "RIR hall: source_directivity needs .* add source_dir"),
    (dict(source_directivity=dict(radius_m=0.1, membrane_radius_m=0.05), source_dir=[1, 0, None]),
     "RIR hall: source_directivity needs .* add source_dir"),
    (dict(channel_pos_m=[[1, 2]]), "channel_pos_m=.* must be a list of two or more positions"),
    (dict(channel_pos_m=[[2.9, 2, 1], [3.1, 2, 1]]),  # mic_pos_m is their centre
     r"channel_pos_m\[0\]=\[2.9, 2, 1\] and mic_pos_m=\[3, 2, 1\] must be the same place"),
])
def test_a_wrong_directivity_or_array_in_a_row_is_refused(tmp_path, known, message):
    row = dict(id="hall", wav="hall.wav", room_id="hall", source_id="s", mic_id="m", fs_hz=16000, n_samples=9,
               room_dims_m=[5, 4, 3], source_pos_m=[1, 1, 1], mic_pos_m=[3, 2, 1])
    write_jsonl(tmp_path / "rirs.jsonl", [row | known])
    with pytest.raises(ValueError, match=message):
        simulate(tmp_path, tmp_path / "out", num_rays=500)


def test_rooms_at_48_khz_are_those_at_16_khz(types, four, tmp_path):
    rows = draw(types, tmp_path / "rirs", rooms=2, fs_hz=48000)
    assert validate_rirs(tmp_path / "rirs") == 4
    at_16_khz = {row["id"]: row for row in read_rirs(four)}
    for name, row in rows.items():
        info = soundfile.info(tmp_path / "rirs" / row["wav"])
        assert info.samplerate == row["fs_hz"] == 48000 and len(row["acoustic_parameters"]["t20_s"]) == 9
        same = at_16_khz[name]
        assert row["source_pos_m"] == same["source_pos_m"] and row["target_t60_s"] == same["target_t60_s"]
        assert row["direct_sample"] == pytest.approx(3 * same["direct_sample"])
        assert all(row["materials"][key]["material"] == same["materials"][key]["material"] for key in same["materials"])


def test_arrays_have_a_row_each_with_all_positions(tmp_path):
    (tmp_path / "studio.toml").write_text(ARRAYS)
    rows = draw(tmp_path / "studio.toml", tmp_path / "rirs", rooms=1)
    assert validate_rirs(tmp_path / "rirs") == 8
    assert {name for name in rows if "noise" not in name} == {f"room00001-s{s}-m{m}" for s in (1, 2) for m in (1, 2)}
    assert len({str(row["materials"]) for row in rows.values()}) == 1
    for row in (row for row in rows.values() if not row["noise_for"]):
        assert row["mic_pos_m"] == row["channel_pos_m"][0] and len(row["channel_pos_m"]) == 3
        samples, fs_hz = soundfile.read(tmp_path / "rirs" / row["wav"], always_2d=True)
        assert samples.shape == (row["n_samples"], 3)
        assert np.array_equal(load_rir(tmp_path / "rirs", row), samples[:, 0])
        for channel, position in enumerate(row["channel_pos_m"]):
            direct = np.linalg.norm(np.subtract(position, row["source_pos_m"])) / 343.2 * fs_hz
            assert np.argmax(np.abs(samples[:round(direct) + 4, channel])) == pytest.approx(direct, abs=2.0)
        tails = sosfilt(butter(4, 500.0, fs=fs_hz, output="sos"), samples[round(0.08 * fs_hz):], axis=0)
        assert np.corrcoef(tails.T)[0, 1] > 0.9  # 5 cm apart, up to 500 Hz


def test_second_decay_is_coherent_at_the_microphones_of_an_array(tmp_path):
    (tmp_path / "studio.toml").write_text(ARRAYS)
    effect = CoupledVolume(level_db=-5.0, time_s=2.0, slope=0.0)
    write_model(tmp_path / "model.json", Model((Extension(CoupledVolume, {}, effect.vector(), np.zeros(3)),)))
    rows = draw(tmp_path / "studio.toml", tmp_path / "rirs", rooms=1, noise_rirs=0, model=tmp_path / "model.json")
    for row in rows.values():
        samples, fs_hz = soundfile.read(tmp_path / "rirs" / row["wav"])
        late = sosfilt(butter(4, 500.0, fs=fs_hz, output="sos"), samples[round(0.8 * fs_hz):], axis=0)
        assert np.corrcoef(late.T)[0, 1] > 0.9  # 5 cm apart, up to 500 Hz


def test_rows_of_arrays_are_simulated_with_all_microphones(tmp_path, caplog):
    array = [[3.0, 2.0, 1.0], [3.05, 2.0, 1.0], [3.0, 2.05, 1.0]]
    row = dict(wav="hall.wav", room_id="hall", source_id="s", mic_id="m", fs_hz=16000, n_samples=9,
               room_dims_m=[5, 4, 3], source_pos_m=[1, 1, 1], mic_pos_m=array[0])
    write_jsonl(tmp_path / "rirs.jsonl", [
        row | dict(id="a", channel_pos_m=array), row | dict(id="b"),
        row | dict(id="c", channel_pos_m=[[None, 2.0, 1.0], *array[1:]]),
        row | dict(id="d", channel_pos_m=array, mic_pos_m=None)])  # drawn, with the whole array
    with caplog.at_level("INFO"):
        simulate(tmp_path, tmp_path / "out", num_rays=500)
    assert "1 RIRs are of arrays with unknown coordinates in channel_pos_m" in caplog.text
    rows = {row["id"]: row for row in read_rirs(tmp_path / "out")}
    assert validate_rirs(tmp_path / "out") == 8
    assert rows["a"]["channel_pos_m"] == rows["a-noise1"]["channel_pos_m"] == array
    np.testing.assert_allclose(np.diff(rows["d"]["channel_pos_m"], axis=0), np.diff(array, axis=0), atol=1e-6)
    assert rows["d"]["channel_pos_m"][0] == rows["d"]["mic_pos_m"] != array[0]
    for name, n_channels in (("a", 3), ("a-noise1", 3), ("b", 1), ("c", 1), ("d", 3)):
        assert soundfile.info(tmp_path / "out" / rows[name]["wav"]).channels == n_channels
    write_jsonl(tmp_path / "rirs.jsonl", [row | dict(id="a", channel_pos_m=[array[0], [5.5, 2.0, 1.0]])])
    with pytest.raises(ValueError, match=r"RIR a: channel_pos_m\[1\]\[0\]=5.5 must lie in"):
        simulate(tmp_path, tmp_path / "outside", num_rays=500)


def test_compensation_filters_all_microphones_of_an_array(tmp_path):
    (tmp_path / "studio.toml").write_text(ARRAYS)
    rows = draw(tmp_path / "studio.toml", tmp_path / "rirs", rooms=1, noise_rirs=0)
    free = [hz for hz in BANDS_HZ if hz != 1000.0]
    write_json(tmp_path / "gmm.json", dict(weights=[1.0], means_db=[[0.0] * 7], covariances_db2=[np.eye(7).tolist()],
                                           points_hz=free, weights_of_room={}))
    compensate(tmp_path / "rirs", tmp_path / "gmm.json", tmp_path / "eq", seed=0)
    assert validate_rirs(tmp_path / "eq") == 4
    name = next(iter(rows))
    compensated = {row["id"]: row for row in read_rirs(tmp_path / "eq")}
    before, after = load_channels(tmp_path / "rirs", rows[name]), load_channels(tmp_path / "eq", compensated[name])
    gains = np.abs(np.fft.rfft(after, 65536, axis=0)) / np.maximum(np.abs(np.fft.rfft(before, 65536, axis=0)), 1e-12)
    inside = slice(1000, 20000)
    assert np.median(np.abs(gains[inside, 1] / gains[inside, 0] - 1.0)) < 0.02
    assert np.ptp(np.median(gains[inside].reshape(50, -1, 3), axis=1)) > 0.1
    assert "remix 1 " in (tmp_path / "rirs" / "rir_list").read_text()


@pytest.mark.parametrize("range_s", [(0.6, 0.65), np.array([0.6, 0.65])], ids=["tuple", "array"])
def test_a_stated_range_replaces_the_times_of_the_types(types, tmp_path, range_s):
    rows = draw(types, tmp_path / "rirs", rooms=2, t60_range_s=range_s, noise_rirs=0)
    assert all(0.6 <= row["target_t60_s"] <= 0.65 for row in rows.values())


@pytest.mark.parametrize("arguments, message", [
    (["out"], "give either MEASURED_DIR and OUT, or --rooms and OUT"),
    (["--rooms", "3", "measured", "out"], "give either MEASURED_DIR and OUT, or --rooms and OUT"),
    (["a", "b", "c"], "3 directories are given where MEASURED_DIR OUT are at most two"),
    (["--rooms", "0", "out"], "rooms='0' must be a number of rooms, such as 200"),
    (["--rooms", "7-3", "out"], "rooms='7-3' must be a number of rooms"),
    (["--rooms", "3", "--t60-range", "measured", "out"], "t60_range='measured' must be two times [s], where no room"),
    (["--rooms", "3", "--room-types", "car", "out"], "room_types: 'car' must be a TOML file or among meeting_room"),
    (["--rooms", "3", "--room-types", "absent.toml", "out"], "absent.toml: cannot be read as types of rooms"),
    (["--room-types", "meeting_room", "measured", "out"], "room_types=meeting_room is of drawn rooms: give --rooms"),
    (["--rooms", "3", "--fs", "7999", "out"], "fs=7999 must be a whole number of hertz from 8000 to 48000"),
    (["--rooms", "3", "--fs", "48000", "--model", "model.json", "out"], "fs=48000 must be 16000 with model=model.json"),
])
def test_wrong_options_end_in_one_line(tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "measured").mkdir()
    write_jsonl(tmp_path / "measured" / "rirs.jsonl", [])
    status, said = call(["simulate", *arguments])
    assert status and message in said and "Traceback" not in said


def test_an_unknown_material_is_refused_with_file_type_and_key(types, tmp_path):
    (tmp_path / "types.toml").write_text(TYPES.replace('["parquet"]', '["parkett"]'))
    with pytest.raises(ValueError, match=r"/types.toml: furnished: furniture\[0\]: materials: .*'parkett' is in"):
        draw(tmp_path / "types.toml", tmp_path / "rirs")


def test_the_step_splits_the_work_and_gives_the_same_bytes(types, four, tmp_path):
    arguments = ["--nj", "2", "--rooms", "4", "--room-types", str(types), "--num-rays", str(RAYS), "--seed", "3"]
    done = subprocess.run([ROOT / "steps" / "simulate_rirs.sh", *arguments, tmp_path / "rirs"], cwd=ROOT, text=True,
                          capture_output=True)
    assert done.returncode == 0, done.stderr
    assert hashes(tmp_path / "rirs") == hashes(four)
    assert (tmp_path / "log" / "rirs" / "simulate.log").is_file()
