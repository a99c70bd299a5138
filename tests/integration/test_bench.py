"""The benches still run, and what they measure with is right."""

import itertools
import json

import numpy as np
import pytest
import soundfile
from rirmaker import coloured_rir, write_rir_dir

from bench import augment_peers, cpu_types, kit, ours, projection, rooms, wer_intervals
from bench.fidelity import air, analytic, decay, early, estimate, lshape, pulses, tail, targets
from bench.fidelity.reference import trace_energy
from bench.real import bras_cr2, laboratories
from bench.speed import curves, dataset, timing
from roomeq.core.audio import write_wav
from roomeq.records.rir_dir import read_rirs


def test_reference_keeps_energy_and_mean_free_path():
    decayed = trace_energy((6, 4, 3), 0.0, 0.5, duration_s=0.2, n_rays=20_000)
    assert np.allclose(decayed.energy, 1.0)
    assert decayed.hits_per_s == pytest.approx(analytic.mean_hits_per_s((6, 4, 3)), rel=0.01)


def test_reference_equals_mirror_walls_by_quadrature():
    walls = (0.1, 0.3, 0.2, 0.1, 0.1, 0.8)
    decayed = trace_energy((6, 4, 3), walls, 0.0, duration_s=0.1, n_rays=100_000)
    chosen = np.array([10, 50, 100])
    known = analytic.mirror_energy((6, 4, 3), walls, decayed.time_s[chosen], n_nodes=200)
    assert np.all(np.abs(10.0 * np.log10(decayed.energy.mean(axis=0)[chosen] / known)) < 0.1)


def test_reference_equals_lambert_walls_by_integral_equation():
    decayed = trace_energy((6, 4, 3), 0.3, 1.0, duration_s=0.2, n_rays=100_000)
    energy = decayed.energy.mean(axis=0)
    rate = analytic.lambert_decay_per_s((6, 4, 3), 0.3, patch_m=0.6)
    assert np.log(energy[60] / energy[160]) / 0.1 == pytest.approx(rate, rel=0.015)


def test_spheres_of_the_reference_hold_the_mean_density():
    decayed = trace_energy((6, 4, 3), 0.0, 1.0, duration_s=0.3, n_rays=40_000, mics_m=[(2, 1, 1), (4, 3, 2)])
    assert decayed.density_per_m3[:, 100:].mean() * 72.0 == pytest.approx(1.0, rel=0.02)


def test_decay_time_of_an_exponential():
    time_s = np.arange(16000) / 16000.0
    assert estimate.decay_time_s(10.0 ** (-6.0 * time_s / 0.5), 1 / 16000) == pytest.approx(0.5, rel=1e-3)


def test_table_of_air_is_the_standard_s():
    for temperature_c, humidity_pct, nominal_hz, expected in air.TABLE_DB_KM:
        exact_hz = 1000.0 * 10.0 ** (round(10.0 * np.log10(nominal_hz / 1000.0)) / 10.0)
        assert 1e3 * air.iso_db_m(exact_hz, temperature_c, humidity_pct) == pytest.approx(expected, rel=0.005)


def test_pulses_are_read_to_a_thousandth():
    delays, gains = np.array([100.3, 140.7]), np.array([1.0, 0.4])
    n = np.arange(400)
    rir = 1.02 * np.sinc(n - 100.32) + 0.4 * np.sinc(n - 140.7)
    level_db, shift = pulses.fit_pulses(rir, delays, gains)
    assert level_db == pytest.approx([20 * np.log10(1.02), 0.0], abs=0.01)
    assert shift == pytest.approx([0.02, 0.0], abs=0.001)


def test_paths_by_hand_leave_out_the_hidden_direct_sound():
    hidden = lshape.hand_lengths(lshape.SOURCE, lshape.MICS["hidden"], 1)
    direct_m = np.linalg.norm(np.subtract(lshape.SOURCE, lshape.MICS["hidden"]))
    assert len(hidden) > 0 and hidden[0] > direct_m + 0.1


def test_image_sources_of_a_cube():
    length_m, gain = early.image_sources((2, 2, 2), (0.0,) * 6, (1, 1, 1), (1, 1, 1.5), 1)
    assert len(length_m) == 7
    assert gain == pytest.approx(1.0 / (4.0 * np.pi * length_m))


@pytest.mark.parametrize("triangles", [rooms.box_triangles((2, 3, 4)), rooms.l_triangles()[0],
                                       rooms.furnished_triangles(2000)[0]], ids=["box", "L", "furnished"])
def test_meshes_of_the_benches_face_outward(triangles):
    a, b, c = triangles.transpose(1, 0, 2)
    assert np.allclose(np.cross(b - a, c - a).sum(axis=0), 0.0, atol=1e-9)  # closed
    assert np.einsum("ij,ij->", a, np.cross(b, c)) > 0.0


def test_one_room_through_ours():
    dims_m = (6.0, 4.0, 3.0)
    scene = ours.box_scene(dims_m, 0.3, 0.5)
    (one,) = ours.simulate(scene, (1.7, 1.3, 1.6), [(4.4, 2.9, 1.2)], n_rays=4000)
    found = estimate.rir_decay_time_s(one.rir, one.fs_hz, one.direct_sample)
    assert found == pytest.approx(0.316, rel=0.1)  # of the reference: tests/bench/fidelity says it to a percent
    assert targets.octave_t30_s(one) == pytest.approx(0.33, rel=0.2)
    assert tail._echo_density(one.rir[2000:4000])[-1] == pytest.approx(1.0, abs=0.3)


def test_positions_are_apart_and_inside():
    sources, mics = decay.positions((6, 4, 3), np.random.default_rng(0), apart_m=2.0)
    assert np.all(np.linalg.norm(mics - sources[:, None], axis=2) >= 2.0)
    assert np.all((mics > 0.5) & (mics < np.array([5.5, 3.5, 2.5])))


def test_rows_of_the_data_set():
    rows = dataset.rows(40)
    assert len({row["id"] for row in rows}) == 40
    assert {row["room_id"] for row in rows} == set(dataset.ROOMS_M)


def test_exponent_of_a_line_is_one():
    assert curves.exponent([[1, 2.0], [10, 20.0], [100, 200.0]]) == pytest.approx(1.0)


def test_the_first_call_is_timed_apart():
    calls = []
    timing.repeated(calls.append, 3)
    assert calls == [0, 1, 2, 3]


def test_sections_are_written_printed_and_resumed(tmp_path, capsys, monkeypatch):
    def section(quick):
        return kit.Section("some", "Some", ["a"], [[np.float64(1.25)], [None]],
                           [kit.Check("x", 2.0, high=1.0), kit.Check("y", 1.0)], curves={"c": [np.nan]})

    monkeypatch.setattr("sys.argv", ["run.py", "--quick", "--out", str(tmp_path), "--resume"])
    chosen = kit.arguments("bench", ["some"])
    kit.run_sections("demo", {"some": section}, chosen, {"some": lambda axis, result: axis.plot([1, 2])})
    assert "MISS x: 2  (<= 1)" in capsys.readouterr().out
    assert (tmp_path / "demo.png").stat().st_size > 1000
    again = kit.run_sections("demo", {"some": None}, chosen, {})
    assert again["some"].rows == [[1.25], [None]]


def test_kaldis_convolution_errs_at_0_hz_and_at_half_the_rate_only():
    x, h = np.random.default_rng(0).standard_normal((2, 3000))[:, :2000]
    h = np.convolve(h, [1.0, 0.0, -1.0])  # nothing at either
    assert augment_peers.convolve_as_kaldi(x, h) == pytest.approx(np.convolve(x, h), abs=1e-9)
    h[0] += 1.0
    error = augment_peers.convolve_as_kaldi(x, h) - np.convolve(x, h)
    assert np.abs(error).max() > 0.001
    assert error[2:3000] == pytest.approx(error[:2998])  # an offset and an alternating sequence


def test_a_projection_is_rates_times_units():
    step = dict(unit="hours", done=2.0, cpu_s=7200.0, peak_mib=100.0, written=4e9)
    *_, hours, disk = projection.tables(dict(augment=step)).splitlines()
    assert hours.startswith("| **core-hours**") and f"| {projection.HOURS:.3g} |" in hours
    assert f"| {2 * projection.HOURS:.3g} |" in disk


def test_differences_between_runs_are_found_and_told(tmp_path):
    for name, level, value in (("a", 0.5, 1.0), ("b", 0.50002, 1.001)):
        kit_dir = tmp_path / name / "data/rirs.sim.train"
        kit_dir.mkdir(parents=True)
        soundfile.write(kit_dir / "x.wav", np.full(100, level), 16000, subtype="FLOAT")
        (kit_dir / "rirs.jsonl").write_text(json.dumps(dict(id="x", t30_s=[value])) + "\n")
        (kit_dir / "rir_list").write_text(f"{tmp_path / name}/x.wav\n")
    found = cpu_types.compare(tmp_path / "a", tmp_path / "b")["simulated"]
    assert (found["files"], found["different"], found["audio_lsb"], found["words"]) == (3, 2, 1, 0)
    assert found["audio_db"] == pytest.approx(20 * np.log10(0.00002 / 0.5), abs=0.2)
    assert found["numbers"] == [pytest.approx(0.001, rel=0.01), ".t30_s", 1.0, 1.001]


def test_interval_bench_measures_what_it_says():
    scenario = wer_intervals.Scenario(1, 10, 0, 0, 0)
    errors, words = wer_intervals.draw(scenario, np.random.default_rng(0))
    assert words.sum() == 2000 and errors.sum() == pytest.approx(400, abs=90)
    found = wer_intervals.measure(scenario, 20)
    assert all(0.6 < share <= 1.0 for share in found["held"].values())
    # of words that are all alike: 1.96 sqrt(p (1 - p) / n) on either side
    assert found["width"]["utterances"] == pytest.approx(2 * 196 * np.sqrt(0.2 * 0.8 / 2000), rel=0.08)


@pytest.fixture
def bras():
    """The bench, where its data are there."""
    if not bras_cr2.DATA.is_dir():
        pytest.skip(f"{bras_cr2.DATA} is absent")
    return bras_cr2


def test_measured_room_is_extruded_from_its_plan(bras):
    room = bras.room()
    assert room.volume_m3 == pytest.approx(145.7, abs=0.1)
    assert set(room.surfaces) == set(bras.surfaces()) and not room.convex
    windows = dict(zip(room.surfaces, bras.scene("initial").absorption, strict=True))["wall8"]
    assert windows[1] == pytest.approx(0.53 * np.mean([0.105, 0.101, 0.099]) + 0.47 * np.mean([0.047, 0.049, 0.054]))


def test_drivers_of_a_loudspeaker_add_up_to_one_source(bras):
    rir = np.random.default_rng(0).standard_normal(4000)
    np.testing.assert_allclose(bras.add_drivers([rir] * 3), rir, atol=1e-12)


def test_measured_room_is_left_out_where_it_is_absent(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(bras_cr2, "DATA", tmp_path / "nowhere")
    monkeypatch.setattr("sys.argv", ["bras_cr2.py", "--out", str(tmp_path)])
    bras_cr2.main()
    assert "nowhere is absent" in capsys.readouterr().out and not list(tmp_path.iterdir())


def test_laboratories_need_their_recordings(tmp_path, monkeypatch):
    monkeypatch.setattr("sys.argv", ["laboratories.py", "--out", str(tmp_path), "--data", str(tmp_path / "nowhere")])
    with pytest.raises(SystemExit, match="holds no folder with a manifest.csv: give the recordings with --data"):
        laboratories.main()


def test_hidden_facings_are_compared_by_their_angles_to_the_microphone(tmp_path):
    rows = [dict(id=name, room_id="room", source_id=source, mic_id="m", room_dims_m=[5.0, 4.0, 3.0],
                 source_pos_m=[1.0, 1.0, 1.0], mic_pos_m=[3.0, 1.0, 1.0], source_dir=facing)
            for name, source, facing in (("a", "found", [0.0, 1.0, 0.0]), ("b", "missed", [0.6, 0.8, 0.0]),
                                         ("c", "unknown", None))]
    directory = write_rir_dir(tmp_path, [(row, np.ones(16)) for row in rows])
    stated = laboratories.hide_facings([directory])
    assert [row["source_dir"] for row in read_rirs(directory)] == [None] * 3
    compared = laboratories.compared_facings(stated, dict(facings=dict(a=[1.0, 0.0, 2.0])))  # seen 63 degrees off
    assert [found[:2] for found in compared] == [["found", 1], ["missed", 1]]
    np.testing.assert_allclose([found[2:] for found in compared], [[90.0, 63.4, 26.6], [53.1, 0.0, 53.1]], atol=0.1)


def test_laboratories_share_no_room_and_are_thinned_out_evenly(tmp_path):
    """The rooms of a corpus that two folders hold are taken from the first; RIRs that the loop cannot use are not."""
    header = "file,rir_id,room,room_dims_m,source_pos_m,mic_pos_m,source_id,mic_id\n"
    rooms = {"first": ["BUT_Q301", "labA_1"], "second": ["Q301", "labA_2", "labB_1"]}
    seeds = itertools.count()  # equal recordings of two rooms would count as copies
    for folder, names in rooms.items():
        (tmp_path / folder).mkdir()
        lines = []
        for room in names:
            for n in range(6):
                file = f"{room}-{n}.wav"
                write_wav(tmp_path / folder / file, coloured_rir(next(seeds)), 16000)
                mic = "?" if n == 5 else f"{2 + 0.1 * n} 3 1.2"
                lines.append(f"{file},{folder}-{room}-{n},{room},6 5 3,1 1 1.5,{mic},s,m\n")
        (tmp_path / folder / "manifest.csv").write_text(header + "".join(lines))
    found = laboratories.read_laboratories([tmp_path / "first", tmp_path / "second"], tmp_path / "work", 3)
    ids = {name: [row["id"] for row in read_rirs(path)] for name, path in found.items()}
    assert {name: len(rows) for name, rows in ids.items()} == {"Q301": 3, "labA": 6, "labB": 3}
    assert ids["Q301"] == ["first-BUT_Q301-0", "first-BUT_Q301-2", "first-BUT_Q301-4"]
    assert all(laboratories.has_scored_room(path) for path in found.values())


def test_parameters_of_a_room_count_from_the_onset_of_each_octave():
    time_s = np.arange(32000) / 16000.0
    noise = np.random.default_rng(0).standard_normal(32000)
    rir = np.append(np.zeros(3000), noise * 10.0 ** (-3.0 * time_s / 0.8))
    t20_s, edt_s, c50_db = bras_cr2.parameters(rir)
    np.testing.assert_allclose(t20_s[4:], 0.8, rtol=0.06)
    np.testing.assert_allclose(edt_s[4:], 0.8, rtol=0.15)
    np.testing.assert_allclose(c50_db[4:], 10.0 * np.log10(10.0 ** (6.0 * 0.05 / 0.8) - 1.0), atol=1.0)


def test_fine_structure_leaves_out_the_level_and_its_trend():
    rir = np.random.default_rng(0).standard_normal(8000)
    spectrum = np.fft.rfft(rir) * np.fft.rfftfreq(8000, 1.0 / 16000) ** 0.5
    tilted = bras_cr2.fine_structure(5.0 * np.fft.irfft(spectrum))
    inner = slice(12, -12)
    assert abs(tilted[inner].mean()) < 1.0
    assert np.corrcoef(tilted[inner], bras_cr2.fine_structure(rir)[inner])[0, 1] > 0.97
