"""Simulated RIR directories: known and unknown geometry, targets, noise sources, reproducible bytes."""

import hashlib
import json
import logging
import os
import re
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from decays import reverberation_time

from roomeq.core.constants import FS_HZ
from roomeq.core.files import write_jsonl
from roomeq.core.rng import rng_for
from roomeq.corpora.characterise import characterise
from roomeq.eq.steps import compensate, fit_eq
from roomeq.loop.step import close_loop
from roomeq.records.rir_dir import load_rir, read_rirs, validate_rirs
from roomeq.sim import context
from roomeq.sim.geometry import find_place
from roomeq.sim.materials import read_materials
from roomeq.sim.response import trace_every_ray
from roomeq.sim.scene import Shoebox
from roomeq.simulate_rirs import directory, simulate, source

BOX_M = [6.0, 4.2, 3.0]


def measured_row(row_id, **known):
    row = dict(id=row_id, wav=f"{row_id}.wav", room_id="office", source_id="s1", mic_id=row_id, fs_hz=FS_HZ,
               n_samples=FS_HZ, room_dims_m=BOX_M, source_pos_m=[1.0, 2.0, 1.5], mic_pos_m=[4.0, 3.0, 1.2])
    return row | known


@pytest.fixture
def measured(tmp_path):
    rows = [
        measured_row("a1"),
        measured_row("a2", mic_pos_m=[4.5, 1.0, None]),
        measured_row("b1", room_id="unknown", source_id="x", room_dims_m=None, source_pos_m=None, mic_pos_m=None,
                     distance_m=6.3),
        measured_row("b2", room_id="unknown", source_id="x", room_dims_m=None, source_pos_m=None, mic_pos_m=None),
        measured_row("c1", room_id="flagged", mic_pos_m=[9.0, 3.0, 1.2], unreliable_geometry=True),
    ]
    (tmp_path / "measured").mkdir()
    write_jsonl(tmp_path / "measured" / "rirs.jsonl", rows)
    return tmp_path / "measured"


def run(measured, out, **options):
    simulate(measured, out, **(dict(num_rays=1000, t60_range_s=(0.3, 0.8), seed=5) | options))
    return {row["id"]: row for row in read_rirs(out)}


def test_log_names_drawn_coordinates_and_unused_keys(measured, tmp_path, caplog):
    caplog.set_level("INFO")
    rows = [measured_row("a1", mic_pos_m=None, mic_pos=[4.0, 3.0, 1.2]),
            measured_row("a2", room_dims_m=[6.0, 4.2, None])]
    write_jsonl(measured / "rirs.jsonl", rows)
    run(measured, tmp_path / "sim", num_rays=100, noise_rirs=0)
    assert "keys not used: mic_pos (did you mean mic_pos_m?)" in caplog.text
    assert ("2 of 2 RIRs have coordinates that are unknown or unreliable, and are drawn, or that lie on a surface, and "
            "are moved off it (key 'drawn'): mic_pos_m of 1, room_dims_m of 1") in caplog.text


@pytest.mark.parametrize("noise_rirs", [0, 1])
def test_rirs_of_noise_sources_are_not_simulated_after(measured, tmp_path, caplog, noise_rirs):
    caplog.set_level("INFO")
    rows = [measured_row("a1"), measured_row("a1-noise1", source_id="a1-noise1", noise_for="a1")]
    write_jsonl(measured / "rirs.jsonl", rows)
    made = run(measured, tmp_path / "sim", num_rays=100, noise_rirs=noise_rirs)
    assert list(made) == ["a1", "a1-noise1"][:1 + noise_rirs]
    assert "1 RIRs of noise sources (key 'noise_for') are left out" in caplog.text
    write_jsonl(measured / "rirs.jsonl", rows[1:])
    with pytest.raises(ValueError, match="all 1 RIRs are of noise sources"):
        run(measured, tmp_path / "sim")


def hashes(directory):
    return {str(path.relative_to(directory)): hashlib.sha256(path.read_bytes()).hexdigest()
            for path in sorted(directory.rglob("*")) if path.is_file() and path.name not in (".done", "rir_list")}


def test_each_measured_rir_gives_one_at_target_and_its_noise(measured, tmp_path):
    out = tmp_path / "sim"
    rows = run(measured, out)
    assert validate_rirs(out) == 10 and set(rows) == {f"{name}{noise}" for name in ("a1", "a2", "b1", "b2", "c1")
                                                      for noise in ("", "-noise1")}
    for name in ("a1", "a2", "b1", "b2", "c1"):
        row, noise = rows[name], rows[f"{name}-noise1"]
        rir = load_rir(out, row)
        measured_s = reverberation_time(rir, FS_HZ, 1000.0, "t30", direct_sample=row["direct_sample"])
        assert measured_s == pytest.approx(row["target_t60_s"], rel=0.05)
        assert 0.3 <= row["target_t60_s"] <= 0.8
        distance_m = np.linalg.norm(np.subtract(row["source_pos_m"], row["mic_pos_m"]))
        assert row["direct_sample"] == pytest.approx(FS_HZ * distance_m / 343.2)
        assert row["measured_id"] == name and row["noise_for"] is None and row["model"] == []
        assert noise["noise_for"] == name and noise["materials"] == row["materials"]
        assert noise["mic_pos_m"] == row["mic_pos_m"] and noise["source_pos_m"] != row["source_pos_m"]
        assert all(0.0 <= a <= 1.0 for surface in row["materials"].values() for a in surface["absorption"])
    assert rows["a1"]["drawn"] == [] and rows["a2"]["drawn"] == ["mic_pos_m.2"]
    assert rows["a2"]["mic_pos_m"][:2] == [4.5, 1.0] and 0.8 <= rows["a2"]["mic_pos_m"][2] <= 1.8
    assert rows["a1-noise1"]["source_pos_m"] == rows["a2-noise1"]["source_pos_m"]
    assert rows["a1"]["materials"] != rows["a2"]["materials"]
    assert {"room_dims_m.0", "source_pos_m.1", "mic_pos_m.2"} <= set(rows["b1"]["drawn"])
    assert rows["b1"]["room_dims_m"] == rows["b2"]["room_dims_m"]
    assert rows["b1"]["source_pos_m"] == rows["b2"]["source_pos_m"]
    assert 30.0 <= np.prod(rows["b1"]["room_dims_m"]) <= 2001.0
    distance_m = np.linalg.norm(np.subtract(rows["b1"]["source_pos_m"], rows["b1"]["mic_pos_m"]))
    assert distance_m == pytest.approx(6.3, abs=0.2)
    assert "mic_pos_m.0" in rows["c1"]["drawn"] and rows["c1"]["room_dims_m"] == BOX_M


@pytest.mark.parametrize("mic_m, distance_m", [((5.0, 4.0, 1.2), 1.0), ((1.0, 1.0, 1.2), 2.0), ((5.0, 4.0, 1.2), 3.0)])
def test_unknown_source_is_drawn_at_its_distance_from_a_known_microphone(mic_m, distance_m):
    for n in range(40):
        row = dict(id=f"r{n}", room_id=f"room{n}", source_id="s", mic_id="m", room_dims_m=[10.0, 8.0, 3.5],
                   mic_pos_m=list(mic_m), distance_m=distance_m)
        place = find_place(row, [row], ".", 0)
        assert place.mic_pos_m == mic_m
        assert np.linalg.norm(np.subtract(place.source_pos_m, mic_m)) == pytest.approx(distance_m, abs=0.01)


def test_bytes_depend_on_the_seed_alone(measured, tmp_path):
    """Threads, parts, order of work and other rows change no byte."""
    run(measured, tmp_path / "one")
    for part in ("2/2", "1/2", None):
        simulate(measured, tmp_path / "parts", num_rays=1000, t60_range_s=(0.3, 0.8), seed=5, part=part)
    assert hashes(tmp_path / "parts") == hashes(tmp_path / "one")
    script = ("import sys; from roomeq.simulate_rirs import simulate\n"
              "simulate(sys.argv[1], sys.argv[2], num_rays=1000, t60_range_s=(0.3, 0.8), seed=5)")
    for threads in ("1", "2"):
        environment = os.environ | dict(NUMBA_NUM_THREADS=threads, PYTHONPATH=os.pathsep.join(sys.path))
        out = tmp_path / f"threads{threads}"
        subprocess.run([sys.executable, "-c", script, str(measured), str(out)], check=True, env=environment)
        assert hashes(out) == hashes(tmp_path / "one")
    rows = {row["id"]: row for row in read_rirs(tmp_path / "one")}
    (tmp_path / "fewer").mkdir()
    write_jsonl(tmp_path / "fewer" / "rirs.jsonl", [row for row in read_rirs(measured) if row["id"] in ("a2", "c1")])
    fewer = run(tmp_path / "fewer", tmp_path / "few")
    assert fewer == {name: rows[name] for name in fewer}
    other = run(measured, tmp_path / "other", seed=6)
    assert other["a1"]["target_t60_s"] != rows["a1"]["target_t60_s"]


@pytest.mark.parametrize("noise_rirs, counts", [(0, "5 RIRs with .* and 0 of noise sources"),
                                                (1, "5 RIRs with .* and 5 of noise sources")])
def test_log_counts_the_rirs_of_noise_sources(measured, tmp_path, caplog, noise_rirs, counts):
    caplog.set_level("INFO")
    run(measured, tmp_path / "sim", num_rays=200, noise_rirs=noise_rirs)
    assert re.search(counts, caplog.text)


def test_second_run_does_nothing(measured, tmp_path):
    run(measured, tmp_path / "sim")
    before = (tmp_path / "sim" / "rirs.jsonl").stat().st_mtime_ns
    run(measured, tmp_path / "sim")
    assert (tmp_path / "sim" / "rirs.jsonl").stat().st_mtime_ns == before


@pytest.mark.parametrize("known, message", [
    (dict(mic_pos_m=[7.0, 3.0, 1.2]), r"RIR a1: mic_pos_m\[0\]=7 must lie in \[0.01, 5.99\] m"),
    (dict(mic_pos_m=[1.0, 2.0, 1.51]), r"RIR a1: source and microphone are 0.01 m apart"),
    (dict(temperature_c=90.0), r"RIR a1: temperature_c=90 must lie in"),
    (dict(mesh="room.obj"), r"RIR a1: .*room.obj: no such mesh file"),
])
def test_wrong_geometry_is_refused_with_the_id_of_the_rir(tmp_path, caplog, known, message):
    caplog.set_level(logging.INFO)
    (tmp_path / "measured").mkdir()
    write_jsonl(tmp_path / "measured" / "rirs.jsonl", [measured_row("a1", **known)])
    with pytest.raises(ValueError, match=message):
        simulate(tmp_path / "measured", tmp_path / "sim", num_rays=1000)
    assert "drawing another target" not in caplog.text
    assert not (tmp_path / "sim").exists()


@pytest.mark.parametrize("options, message", [
    (dict(t60_range_s=(2.0, 0.2)), r"t60_range=.* the smaller first"),
    (dict(t60_range_s=(0.2, "a")), r"t60_range=\(0.2, 'a'\) must be two times"),
    (dict(t60_range_s=0.5), r"t60_range=0.5 must be two times"),
    (dict(t60_range_s=0), r"t60_range=0 must be two times"),
    (dict(t60_range_s=()), r"t60_range=\(\) must be two times"),
    (dict(num_rays=3), r"num_rays=3 must lie in \[100, "),
    (dict(num_rays=300.0), r"num_rays=300.0 must be a whole number"),
    (dict(noise_rirs="1"), r"noise_rirs='1' must be a whole number"),
    (dict(seed=-1), r"seed=-1 must lie in \[0, "),
    (dict(fs_hz="16000"), r"fs='16000' must be a whole number"),
    (dict(noise_rirs=9), r"noise_rirs=9 must lie in"),
    (dict(ism_order=-1), r"ism_order=-1 must lie in"),
    (dict(materials="absent.toml"), r"absent.toml: cannot be read as a table of materials"),
])
def test_options_out_of_range_are_refused(measured, tmp_path, options, message):
    with pytest.raises(ValueError, match=message):
        simulate(measured, tmp_path / "sim", **options)


def parameters(t20_s, valid=True):
    bands = [1.4] * 4 + [t20_s] + [0.2] * 3
    return dict(acoustic_parameters=dict(t20_s=bands, t20_valid=[True] * 4 + [valid] + [True] * 3))


def test_targets_lie_in_the_range_of_the_measured_rooms(tmp_path, caplog):
    caplog.set_level("INFO")
    dull = [measured_row(f"a{n}", mic_pos_m=[4.0, 1.0 + n / 2, 1.2], **parameters(t20_s, valid))
            for n, (t20_s, valid) in enumerate([(0.40, True), (0.44, True), (1.9, True), (None, False), (3.0, False)])]
    live = [measured_row(f"b{n}", room_id="hall", mic_pos_m=[4.0, 1.0 + n / 2, 1.2], **parameters(0.6))
            for n in range(5)]
    (tmp_path / "in").mkdir()
    write_jsonl(tmp_path / "in/rirs.jsonl", dull + live)
    rows = run(tmp_path / "in", tmp_path / "sim", t60_range_s="measured", noise_rirs=0)
    assert "T60 of the rooms lies between 0.44 and 0.60 s at 1 kHz" in caplog.text
    targets_s = [row["target_t60_s"] for row in rows.values()]
    assert 0.44 <= min(targets_s) < max(targets_s) <= 0.60 and len(set(targets_s)) == 10


def test_measured_targets_without_valid_t20_are_refused(measured, tmp_path):
    with pytest.raises(ValueError, match="measured: t60_range=measured: no RIR has a valid T20 .* characterise"):
        simulate(measured, tmp_path / "sim", t60_range_s="measured")


def test_own_table_of_materials_is_read_and_checked(tmp_path):
    table = read_materials()
    assert all(table.names(use) for use in ("wall", "floor", "ceiling"))
    columns = np.unique(np.array(list(table.scattering.values())), axis=1)
    assert columns.shape[1] <= 3, "each distinct column of scattering coefficients costs a trace"
    path = tmp_path / "own.toml"
    path.write_text("[materials.felt]\nabsorption = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8]\n")
    assert read_materials(path).names("wall") == ["felt"]
    path.write_text("[materials.felt]\nabsorption = [0.1, 0.2, 1.3, 0.4, 0.5, 0.6, 0.7, 0.8]\n")
    with pytest.raises(ValueError, match=r"own.toml: absorption\[2\]=1.3 of material 'felt' must lie in \[0, 1\]"):
        read_materials(path)
    path.write_text("[materials.felt]\nuse = ['wall']\nabsorption = 0.1\n")
    with pytest.raises(ValueError, match=r"no material with use 'floor'"):
        read_materials(path)


def test_mesh_rows_use_materials_named_in_the_mesh(tmp_path):
    from plans import L_PLAN, prism_obj
    (tmp_path / "measured").mkdir()
    (tmp_path / "measured" / "room.obj").write_text(prism_obj(L_PLAN, 3.0, "brick_bare"))
    write_jsonl(tmp_path / "measured" / "rirs.jsonl", [
        measured_row("m1", mesh="room.obj", room_dims_m=None, source_pos_m=[5.0, 1.0, 1.5], mic_pos_m=[1.0, 5.0, 1.5])])
    rows = run(tmp_path / "measured", tmp_path / "sim", num_rays=1000)
    assert (tmp_path / "sim" / rows["m1"]["mesh"]).samefile(tmp_path / "measured" / "room.obj")
    assert rows["m1"]["materials"]["brick_bare"]["material"] == "brick_bare"
    assert rows["m1"]["direct_visible"] is False
    assert rows["m1"]["t30_s"] == pytest.approx(rows["m1"]["target_t60_s"], rel=0.05)
    written = json.loads((tmp_path / "sim" / "rirs.jsonl").read_text().splitlines()[0])
    assert written["leaked_share"] == 0.0 and written["few_rays_db"] is None  # so few rays do not tell


def test_rirs_with_the_decay_of_few_rays_are_counted(caplog):
    rows = [dict(few_rays_db=2.5), dict(few_rays_db=1.0), dict(few_rays_db=None), {}]  # the last of an older version
    directory._warn_of_few_rays(rows[1:], "sim", SimpleNamespace(num_rays=10000))
    assert not caplog.text
    with caplog.at_level(logging.INFO):
        directory._warn_of_few_rays(rows, "sim", SimpleNamespace(num_rays=3599))
    assert "sim: 3599 rays do not tell whether the decay of an octave is that of a few of them" in caplog.text
    caplog.clear()
    directory._warn_of_few_rays(rows, "sim", SimpleNamespace(num_rays=10000))
    assert "sim: in 1 of 4 RIRs, few rays tell the decay of an octave (few_rays_db above 2)" in caplog.text


def test_mesh_rooms_give_the_same_bytes_with_two_processes(tmp_path):
    from plans import L_PLAN, prism_obj
    (tmp_path / "measured").mkdir()
    (tmp_path / "measured" / "room.obj").write_text(prism_obj(L_PLAN, 3.0, "brick_bare"))
    write_jsonl(tmp_path / "measured" / "rirs.jsonl", [
        measured_row(f"m{n}", mesh="room.obj", room_dims_m=None, source_id=f"s{n}",
                     source_pos_m=[5.0, 1.0 + n / 4, 1.5], mic_pos_m=[1.0, 5.0, 1.5]) for n in range(2)])
    for nj in (1, 2):
        run(tmp_path / "measured", tmp_path / f"nj{nj}", num_rays=500, nj=nj)
    assert hashes(tmp_path / "nj1") == hashes(tmp_path / "nj2")


@pytest.mark.parametrize("mesh", [False, True])
def test_bytes_do_not_depend_on_whether_responses_share_a_trace(mesh, tmp_path, monkeypatch):
    from plans import L_PLAN, prism_obj
    (tmp_path / "measured").mkdir()
    (tmp_path / "measured" / "room.obj").write_text(prism_obj(L_PLAN, 3.0, "brick_bare"))
    known = dict(mesh="room.obj", room_dims_m=None) if mesh else {}
    write_jsonl(tmp_path / "measured" / "rirs.jsonl", [
        measured_row(f"m{n}", source_pos_m=[5.0, 1.5, 1.5], mic_pos_m=[1.0 + n / 4, 1.0, 1.5], **known)
        for n in range(8)])
    calls = []
    monkeypatch.setattr(source, "trace_every_ray", lambda **how: calls.append(how) or trace_every_ray(**how))
    run(tmp_path / "measured", tmp_path / "shared", noise_rirs=1)
    n_shared = len(calls)
    assert n_shared == 2  # for the source, and for the noise source that all have in common
    monkeypatch.setattr(source, "_SHARED_BYTES", 0)  # so that each has a trace of its own
    run(tmp_path / "measured", tmp_path / "alone", noise_rirs=1)
    assert len(calls) == n_shared
    assert hashes(tmp_path / "shared") == hashes(tmp_path / "alone")


@pytest.mark.parametrize(("rows_per_item", "n_traces"), [(8, 3), (4, 4), (3, 4)])
def test_noise_source_of_several_loudspeakers_is_traced_once_and_bytes_do_not_depend_on_it(
        rows_per_item, n_traces, tmp_path, monkeypatch):
    (tmp_path / "measured").mkdir()
    write_jsonl(tmp_path / "measured" / "rirs.jsonl", [
        measured_row(f"s{s}m{n}", source_id=f"s{s}", source_pos_m=[5.0, 1.0 + s, 1.5],
                     mic_pos_m=[1.0 + n / 4, 3.5, 1.5]) for s in range(2) for n in range(4)])
    run(tmp_path / "measured", tmp_path / "usual")
    calls = []
    monkeypatch.setattr(source, "trace_every_ray", lambda **how: calls.append(how) or trace_every_ray(**how))
    monkeypatch.setattr(source, "_SHARED_FROM", 1.5)  # so that any two responses share a trace
    monkeypatch.setattr(directory, "ROWS_PER_ITEM", rows_per_item)
    run(tmp_path / "measured", tmp_path / "other")
    assert len(calls) == n_traces
    assert hashes(tmp_path / "usual") == hashes(tmp_path / "other")


def test_decays_slower_than_eyring_are_not_cut_off(tmp_path):
    """Between reflecting walls, below an absorbing ceiling, sound decays for far longer than in a diffuse field."""
    surfaces = {surface: dict(absorption=0.6 if surface in ("floor", "ceiling") else 0.05, scattering=0.1)
                for surface in Shoebox(BOX_M).surfaces}
    hall = measured_row("hall", room_dims_m=[12.0, 8.0, 4.0], materials=surfaces, target_t60_s=None)
    (tmp_path / "in").mkdir()
    write_jsonl(tmp_path / "in" / "rirs.jsonl", [hall])
    rows = run(tmp_path / "in", tmp_path / "out")
    assert rows["hall"]["t30_s"] == pytest.approx(1.4, rel=0.15)
    rir = load_rir(tmp_path / "out", rows["hall-noise1"])
    assert np.sum(np.square(rir[-800:])) < 1e-5 * np.sum(np.square(rir))


def test_decays_much_slower_than_eyring_are_followed_further(tmp_path):
    """Rays are traced again where they were not followed to the end of the decay, which takes 5 s in this corridor."""
    surfaces = dict(default=dict(absorption=0.05, scattering=0.02))
    places = dict(room_dims_m=[40.0, 2.0, 2.6], source_pos_m=[2.0, 1.0, 1.5], mic_pos_m=[10.0, 0.7, 1.6])
    (tmp_path / "in").mkdir()
    write_jsonl(tmp_path / "in" / "rirs.jsonl", [
        measured_row("corridor", materials=surfaces, target_t60_s=None, **places)])
    rows = run(tmp_path / "in", tmp_path / "out", num_rays=10000)
    assert rows["corridor"]["t30_s"] == pytest.approx(4.9, rel=0.15)
    assert all(row["n_samples"] > 3 * FS_HZ for row in rows.values())


def test_scattering_may_be_stated_up_to_16_khz(tmp_path):
    (tmp_path / "in").mkdir()
    stated = dict(floor=dict(absorption=[0.1] * 9, scattering=[0.1, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.6, 0.6]))
    write_jsonl(tmp_path / "in" / "rirs.jsonl", [measured_row("a", materials=stated)])
    row = run(tmp_path / "in", tmp_path / "out", noise_rirs=0)["a"]
    assert row["materials"]["floor"]["scattering"] == [0.1, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.6, 0.6]


def test_target_out_of_reach_is_drawn_again_and_logged(tmp_path, caplog):
    caplog.set_level("INFO")
    far = measured_row("far", room_dims_m=[28.0, 11.0, 3.3], source_pos_m=[1.0, 1.0, 1.5], mic_pos_m=[27.0, 10.0, 1.5])
    (tmp_path / "in").mkdir()
    write_jsonl(tmp_path / "in" / "rirs.jsonl", [far])
    range_s = (0.06, 1.0)
    short = next(seed for seed in range(1000) if rng_for(seed, "t60", "far").uniform(*range_s) < 0.08)
    row = run(tmp_path / "in", tmp_path / "out", t60_range_s=range_s, seed=short)["far"]
    assert "target_t60_s again" in row["drawn"] and "drawing another target" in caplog.text
    assert row["t30_s"] == pytest.approx(row["target_t60_s"], rel=0.05)


def test_rooms_whose_octaves_differ_widely_in_absorption_are_simulated(shared_repro, tmp_path):
    """The materials of one noise source absorb everything in three octaves: its path sample once overflowed."""
    options = "simulate --t60-range 0.28690000000000004,1.0642 --seed 0".split()
    made = subprocess.run([sys.executable, "-m", "roomeq", *options, shared_repro / "echogram-overflow",
                           tmp_path / "sim"], capture_output=True, text=True)
    assert made.returncode == 0, made.stderr
    assert "Warning" not in made.stderr
    for row in read_rirs(tmp_path / "sim"):
        assert np.isfinite(load_rir(tmp_path / "sim", row)).all()


@pytest.mark.parametrize("which", ["a1", "a1-noise1"])
def test_response_that_is_not_finite_stops_with_rir_room_and_remedy(measured, tmp_path, monkeypatch, which):
    """No other materials are drawn in silence, and nothing is written."""
    ray_echograms, wanted = context.ray_echograms, which.endswith("noise1")

    def overflow(of, *args):
        made = ray_echograms(of, *args)
        is_noise = tuple(of.traced.source_pos_m) != (1.0, 2.0, 1.5)
        if is_noise == wanted and made.energy.shape[2] == 8:
            made.energy[:, 40, 6:] = np.inf
        return made

    monkeypatch.setattr(context, "ray_echograms", overflow)
    message = (rf"^RIR {which} of room office: the response at mic_pos_m=\[4.0, 3.0, 1.2\] is not finite in the "
               r"octaves at 4000, 8000 Hz, where surfaces absorb up to [0-9.]+: choose other materials, another "
               "range of T60 or another seed$")
    with pytest.raises(ValueError, match=message):
        run(measured, tmp_path / "sim")
    assert not (tmp_path / "sim").exists()


def test_rows_have_parameters_and_only_main_rirs_a_target(measured, tmp_path):
    for row in run(measured, tmp_path / "out").values():
        assert row["acoustic_parameters"]["direct_sample"] == pytest.approx(row["direct_sample"], abs=1e-3)
        assert (row["target_t60_s"] is None) == bool(row["noise_for"])


@pytest.mark.parametrize("fs_hz, n_bands", [(8000, 7), (48000, 9)])
def test_other_rates_have_their_own_bands_and_fit_no_16_khz_step(measured, tmp_path, fs_hz, n_bands):
    out = tmp_path / "sim"
    rows = run(measured, out, fs_hz=fs_hz)
    assert validate_rirs(out) == 10
    for row in rows.values():
        assert row["fs_hz"] == fs_hz and len(row["acoustic_parameters"]["c50_db"]) == n_bands
        assert "eq_db" not in row["acoustic_parameters"]
    (tmp_path / "gmm.json").write_text("{}")
    for step in (lambda: compensate(out, tmp_path / "gmm.json", tmp_path / "c", seed=0),
                 lambda: fit_eq(out, [], tmp_path / "f", seed=0), lambda: close_loop([out], tmp_path / "l"),
                 lambda: characterise(out, tmp_path / "m")):
        with pytest.raises(ValueError, match=f"RIR a1(-noise1)? has fs_hz={fs_hz} and must have 16000"):
            step()


def test_a_model_needs_16_khz(measured, tmp_path):
    with pytest.raises(ValueError, match=r"fs=48000 must be 16000 with model=m.json"):
        simulate(measured, tmp_path / "sim", model="m.json", fs_hz=48000)


def test_row_that_is_edited_before_it_is_hashed_counts_as_edited(measured, tmp_path, monkeypatch):
    def read_and_edit(directory):
        rows, table = read_rirs(directory), directory / "rirs.jsonl"
        if "flagged" in (text := table.read_text()):
            table.write_text(text.replace("flagged", "kitchen"))
        return rows

    monkeypatch.setattr("roomeq.simulate_rirs.step.read_rirs", read_and_edit)
    assert run(measured, tmp_path / "sim", noise_rirs=0)["c1"]["room_id"] == "kitchen"
