"""`roomeq simulate --model`: each effect changes the RIRs that it concerns, by its physics, and no others."""

import json
from dataclasses import replace

import numpy as np
import pytest

from roomeq.acoustics.air import speed_of_sound_m_s
from roomeq.core.constants import BAND_1KHZ, FS_HZ
from roomeq.core.files import write_jsonl
from roomeq.effects.catalogue import CATALOGUE
from roomeq.effects.model import Extension, Model, read_model, write_model
from roomeq.effects.response import RESPONSE_HZ
from roomeq.records.rir_dir import load_rir, read_rirs, validate_rirs
from roomeq.simulate_rirs import simulate
from roomeq.simulate_rirs.directory import _drawn_facing

SOURCE_ONLY = {name for name, effect in CATALOGUE.items() if effect.SCOPE in ("source", "rir")}
VECTORS = dict(air_absorption=(1.0, np.log(20.0)), sound_speed=(3.5,),
               source_directivity=(*np.log([0.15, 0.5]), *[0.0] * 24),
               occlusion=(-3.0,), near_reflector=(np.log(0.5), 0.8), coupled_volume=(-1.0, np.log(2.0), 0.1),
               room_modes=(0.0,), source_response=np.linspace(-12.0, 6.0, len(RESPONSE_HZ)),
               mic_response=np.linspace(6.0, -12.0, len(RESPONSE_HZ)),
               room_eq=np.linspace(-6.0, 6.0, len(RESPONSE_HZ)), noise_floor=(3.0,) * 22)
OPTIONS = dict(num_rays=500, t60_range_s=(0.3, 0.6), seed=5)


def measured_row(row_id, **known):
    return dict(id=row_id, wav=f"{row_id}.wav", room_id="office", source_id="spk1", mic_id=row_id, fs_hz=FS_HZ,
                n_samples=FS_HZ, room_dims_m=[6.0, 4.2, 3.0], source_pos_m=[1.0, 2.0, 1.5],
                mic_pos_m=[4.0, 3.0, 1.2], source_dir=[1.0, 0.3, 0.0]) | known


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    directory = tmp_path_factory.mktemp("measured")
    write_jsonl(directory / "rirs.jsonl", [
        measured_row("a"), measured_row("b", source_id="spk2", mic_pos_m=[4.5, 1.0, 1.2], source_dir=None)])
    return directory


@pytest.fixture(scope="module")
def plain(measured, tmp_path_factory):
    return simulated(measured, tmp_path_factory.mktemp("plain") / "out", None)


def simulated(measured, out, model, **options):
    simulate(measured, out, model=model, **(OPTIONS | options))
    validate_rirs(out)
    return {row["id"]: (row, load_rir(out, row)) for row in read_rirs(out)}


def extension(name, vector=None, units=()):
    effect = CATALOGUE[name]
    vector = np.array(VECTORS[name] if vector is None else vector, dtype=float)
    return Extension(effect, {unit: effect.from_vector(vector) for unit in units}, vector, np.zeros(len(vector)))


def model_file(path, *extensions):
    write_model(path, Model(extensions))
    return path


def test_drawn_rooms_have_loudspeakers_and_microphones_of_their_own(tmp_path):
    simulate(None, tmp_path / "drawn", rooms=2, room_types="lecture_hall", num_rays=500, noise_rirs=0, fs_hz=8000)
    rows = read_rirs(tmp_path / "drawn")
    for name in ("source_response", "mic_response"):
        known = extension(name, units=("s1", "m1"))  # measured devices are others than the drawn ones
        for spread, alike in ((known.spread, True), (known.spread + 1.0, False)):
            first, second = (replace(known, spread=spread).for_row(row, 0) for row in rows)
            assert (first == second) is alike


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_effect_changes_exactly_the_rirs_it_concerns(name, measured, plain, tmp_path):
    simulated_rirs = simulated(measured, tmp_path / "out", model_file(tmp_path / "model.json", extension(name)))
    for row_id, (row, rir) in simulated_rirs.items():
        acts = CATALOGUE[name].IN_RESPONSE and not (name in SOURCE_ONLY and row["noise_for"])
        assert row["model"] == [name] * acts
        before = plain[row_id][1]
        same = len(rir) == len(before) and np.array_equal(rir, before)
        # a directivity changes the absorption that meets the target, and noise sources are in the same room
        assert same != acts or (name == "source_directivity" and row["noise_for"]), f"{name} on {row_id}"
        assert np.all(np.isfinite(rir)) and row["temperature_c"] == plain[row_id][0]["temperature_c"]


def test_noise_of_recordings_is_said_to_be_left_out(measured, plain, tmp_path, caplog):
    caplog.set_level("INFO")
    path = model_file(tmp_path / "model.json", extension("noise_floor", units=["office"]))
    assert simulated(measured, tmp_path / "out", path)["a"][0]["model"] == plain["a"][0]["model"]
    assert f"{path}: noise_floor is of the recordings and no part of a room impulse response" in caplog.text


def test_source_without_stated_facing_faces_as_in_the_model_or_the_microphone(measured, tmp_path):
    effect = extension("source_directivity")
    facing = {}
    for name, model in (("model", Model((effect,), {"b": [0.0, 1.0, 0.0], "a": [0.0, 0.0, 1.0]})),
                        ("microphone", Model((effect,)))):
        write_model(tmp_path / f"{name}.json", model)
        rows = simulated(measured, tmp_path / name, tmp_path / f"{name}.json")
        assert rows["a"][0]["source_dir"] == measured_row("a")["source_dir"]
        facing[name], facing[f"{name}, noise"] = rows["b"][0]["source_dir"], rows["b-noise1"][0]["source_dir"]
    assert facing["model"] == [0.0, 1.0, 0.0] and facing["model, noise"] is None
    np.testing.assert_allclose(facing["microphone"], np.array([3.5, -1.0, -0.3]) / np.linalg.norm([3.5, 1.0, 0.3]))


def test_facing_that_no_row_states_is_drawn_for_each_rir(measured, tmp_path):
    write_model(tmp_path / "model.json", Model((extension("source_directivity"),), {"b": [0.0, 1.0, 0.0]}))
    azimuths = []
    for seed in (5, 6):
        rows = simulated(measured, tmp_path / f"seed{seed}", tmp_path / "model.json", draw_devices=True, seed=seed)
        assert rows["a"][0]["source_dir"] == measured_row("a")["source_dir"]
        assert rows["b-noise1"][0]["source_dir"] is None
        x, y, z = rows["b"][0]["source_dir"]
        assert np.hypot(x, y) == pytest.approx(1.0) and z == 0.0
        azimuths.append(np.arctan2(y, x))
    assert azimuths[0] != pytest.approx(azimuths[1])
    directions = np.array([_drawn_facing(f"rir{n}", 5) for n in range(2000)])
    np.testing.assert_allclose(directions.mean(axis=0), 0.0, atol=0.05)


def test_drawn_devices_are_none_of_those_that_a_model_names(measured, tmp_path, caplog):
    caplog.set_level("INFO")
    typical = [extension(name) for name in ("source_response", "mic_response")]
    flat = np.zeros(len(RESPONSE_HZ))
    named = [replace(one, of={unit: one.effect.from_vector(flat) for unit in units})
             for one, units in zip(typical, (("spk1", "spk2"), ("a", "b")), strict=True)]
    spread = [replace(one, spread=flat + 3.0) for one in named]
    of_model, of_typical, drawn, varied = (
        simulated(measured, tmp_path / out, model_file(tmp_path / f"{out}.json", *model), draw_devices=drawn)
        for out, model, drawn in (("model", named, False), ("typical", typical, False), ("drawn", named, True),
                                  ("varied", spread, True)))
    for rir in of_model:
        assert not np.array_equal(drawn[rir][1], of_model[rir][1])
        np.testing.assert_array_equal(drawn[rir][1], of_typical[rir][1])
        assert not np.array_equal(drawn[rir][1], varied[rir][1])
    assert [drawn["a"][0][key] for key in ("source_id", "mic_id")] == ["drawn-a", "drawn-a"]
    assert drawn["a-noise1"][0]["mic_id"] == "drawn-a" and drawn["a-noise1"][0]["source_id"].startswith("noise-")
    assert "the loudspeaker and the microphone of each of 2 RIRs are drawn" in caplog.text


def test_unknown_heights_are_as_in_the_model_unless_they_contradict_the_row(tmp_path):
    write_jsonl(tmp_path / "rirs.jsonl", [
        measured_row("a", source_pos_m=[1.0, 2.0, None], mic_pos_m=[4.0, 3.0, None]),
        measured_row("b", source_pos_m=[1.0, 2.0, None]),
        measured_row("c", source_pos_m=[1.0, 2.0, None], mic_pos_m=[1.0, 2.02, 1.41]),
        measured_row("d", source_pos_m=[1.0, 2.0, None], room_id="other")])
    write_model(tmp_path / "model.json", Model(heights_m={"office": {"source spk1": 1.42, "microphone a": 0.72,
                                                                     "microphone b": 0.9}}))
    rows = {row_id: row for row_id, (row, _) in simulated(tmp_path, tmp_path / "out", tmp_path / "model.json").items()}
    assert (rows["a"]["source_pos_m"], rows["a"]["mic_pos_m"]) == ([1.0, 2.0, 1.42], [4.0, 3.0, 0.72])
    assert (rows["b"]["source_pos_m"], rows["b"]["mic_pos_m"]) == ([1.0, 2.0, 1.42], [4.0, 3.0, 1.2])
    assert [rows[row_id]["drawn"] for row_id in "abcd"] == [[], [], ["source_pos_m.2"], ["source_pos_m.2"]]


def test_target_is_met_before_effects_on_the_whole_rir(measured, plain, tmp_path):
    path = model_file(tmp_path / "model.json", extension("coupled_volume", (-0.5, np.log(3.0), 0.0)),
                      extension("source_response"))
    row, rir = simulated(measured, tmp_path / "out", path)["a"]
    assert row["model"] == ["coupled_volume", "source_response"] and row["n_samples"] == len(rir)
    assert row["target_t60_s"] == plain["a"][0]["target_t60_s"]
    assert row["t30_s"] == pytest.approx(row["target_t60_s"], rel=0.05)
    assert row["acoustic_parameters"]["t30_s"][BAND_1KHZ] > 1.5 * row["t30_s"]
    # the measured EQ contains the filter; the second decay, 5 dB below the reflections, changes it by less than that
    response_db = np.interp(np.log([125.0, 4000.0]), np.log(RESPONSE_HZ), VECTORS["source_response"])
    change = np.subtract(row["acoustic_parameters"]["eq_db"], plain["a"][0]["acoustic_parameters"]["eq_db"])
    assert change[6] - change[1] == pytest.approx(response_db[1] - response_db[0], abs=5.0)


def test_sound_speed_moves_the_direct_sound(measured, tmp_path):
    path = model_file(tmp_path / "model.json", extension("sound_speed"))
    for row, _ in simulated(measured, tmp_path / "out", path).values():
        distance_m = np.linalg.norm(np.subtract(row["source_pos_m"], row["mic_pos_m"]))
        assert row["direct_sample"] == pytest.approx(FS_HZ * distance_m / speed_of_sound_m_s(35.0))


def test_measured_loudspeaker_keeps_its_response_others_draw(measured, plain, tmp_path):
    known = extension("source_response", units=["spk1"])
    path = model_file(tmp_path / "model.json", Extension(
        known.effect, known.of, np.zeros(len(RESPONSE_HZ)), np.full(len(RESPONSE_HZ), 6.0)))
    simulated_rirs = simulated(measured, tmp_path / "out", path)
    level_db = {}
    for name in "ab":
        for kind, rir in (("before", plain[name][1]), ("after", simulated_rirs[name][1])):
            power = np.abs(np.fft.rfft(rir[:4096], 4096)) ** 2
            level_db[name, kind] = 10 * np.log10([power[round(0.9 * hz * 4096 / FS_HZ):round(1.1 * hz * 4096 / FS_HZ)]
                                                  .sum() for hz in (500.0, 2000.0)])
    change_db = {name: level_db[name, "after"] - level_db[name, "before"] for name in "ab"}
    expected = np.interp(np.log([500.0, 2000.0]), np.log(RESPONSE_HZ), VECTORS["source_response"])
    np.testing.assert_allclose(change_db["a"], expected, atol=1.0)
    drawn = read_model(path).for_row(dict(source_id="spk2"), OPTIONS["seed"])[0].gains_db
    np.testing.assert_allclose(change_db["b"], np.interp(np.log([500.0, 2000.0]), np.log(RESPONSE_HZ), drawn), atol=2.5)
    assert np.array_equal(simulated_rirs["a-noise1"][1], plain["a-noise1"][1])


def test_parts_and_empty_models_reproduce_the_same_bytes(measured, plain, tmp_path):
    path = model_file(tmp_path / "model.json", *(extension(name) for name in ("source_directivity", "room_modes",
                                                                               "mic_response", "noise_floor")))
    whole = simulated(measured, tmp_path / "whole", path)
    for part in ("2/2", "1/2", None):
        simulate(measured, tmp_path / "parts", model=path, part=part, nj=2, **OPTIONS)
    for file in (tmp_path / "whole").rglob("*.wav"):
        assert file.read_bytes() == (tmp_path / "parts" / file.relative_to(tmp_path / "whole")).read_bytes()
    assert {name: row for name, (row, _) in whole.items()} == {row["id"]: row for row in read_rirs(tmp_path / "parts")}
    empty = simulated(measured, tmp_path / "empty", model_file(tmp_path / "empty.json"))
    for name, (row, rir) in empty.items():
        assert row == plain[name][0] and np.array_equal(rir, plain[name][1])


def test_changed_model_rebuilds_the_directory(measured, tmp_path):
    path = model_file(tmp_path / "model.json", extension("mic_response"))
    before = simulated(measured, tmp_path / "out", path)
    content = json.loads(path.read_text())
    content["effects"][0]["typical"] = [0.0] * len(RESPONSE_HZ)
    path.write_text(json.dumps(content))
    after = simulated(measured, tmp_path / "out", path)
    assert not np.array_equal(before["a"][1], after["a"][1])


@pytest.mark.parametrize("text, message", [
    ("[]", r"model.json: must hold an object with a list of 'effects'"),
    ('{"effects": []}', r"model.json: format=None must be 3: run roomeq close-loop again"),
    ('{"format": 3, "effects": [{"effect": "gnomes"}]}',
     r"effects\[0\]: effect='gnomes' must be one of air_absorption, "),
    ('{"format": 3, "effects": [{"effect": "occlusion", "of": {"office": {"detour_m": "far"}}}]}',
     r"effects\[0\]: of\['office'\]: detour_m='far' must be a number"),
    ('{"format": 3, "effects": [{"effect": "occlusion", "of": {"a": {"detour_m": 0.1}}}]}',
     r"effects\[0\]: typical must be 1 numbers, for what 'of' does not name: add them"),
    ('{"format": 3, "effects": [], "facings": {"a": [0, 0, 0]}}',
     r"facings\['a'\]=\[0, 0, 0\] must be a direction, three numbers that are not all 0"),
    ('{"format": 3, "effects": [], "facings": ["a"]}', r"facings=\['a'\] must map RIRs to directions"),
    ('{"format": 3, "effects": [], "heights_m": [1.4]}', r"heights_m=\[1.4\] must map rooms to heights of devices"),
    ('{"format": 3, "effects": [], "heights_m": {"office": {"source a": "1.4 m"}}}',
     r"heights_m=\{'office': \{'source a': '1.4 m'\}\} must map rooms to heights of devices, such as \{'office': "),
])
def test_broken_model_error_names_the_place(text, message, measured, tmp_path):
    (tmp_path / "model.json").write_text(text)
    with pytest.raises(ValueError, match=message):
        simulate(measured, tmp_path / "out", model=tmp_path / "model.json")
    assert not (tmp_path / "out").exists()
