"""Compensated RIRs: the EQ measured again meets the target; level, decay and direct sound do not change."""

import json

import numpy as np
import pytest
from decays import reverberation_time
from rirmaker import DIRECT, coloured_rir, row, write_rir_dir
from scipy.signal import freqz

from roomeq.acoustics.direct import find_direct
from roomeq.acoustics.subband_eq import analyse
from roomeq.core.audio import read_audio
from roomeq.core.constants import BANDS_HZ, FS_HZ
from roomeq.core.digests import digest
from roomeq.core.files import read_json, write_json
from roomeq.eq.compensation import apply_filter, compensate_rir, design_filter, summarise
from roomeq.eq.gmm import fit_gmm
from roomeq.eq.steps import compensate
from roomeq.records.rir_dir import load_rir, read_rirs, rir_path, validate_rirs, write_rirs

TARGET_DB = np.array([8.0, 5.0, 4.0, 2.0, 0.0, -3.0, -5.0, -13.0])
FREE_TARGETS = np.random.default_rng(0).normal(np.delete(TARGET_DB, 4), 3.0, (40, 7))


def test_filter_meets_its_gains_and_is_linear_phase():
    gain_db = np.array([6.0, 6.0, 3.0, 0.0, 0.0, -3.0, -6.0, -6.0])
    fir = design_filter(gain_db, 511)
    assert np.allclose(fir, fir[::-1]), "linear phase"
    _, response = freqz(fir, worN=np.array(BANDS_HZ), fs=FS_HZ)
    assert 20 * np.log10(np.abs(response)) == pytest.approx(gain_db, abs=0.6)
    between = np.interp(np.log(1414.0), np.log(BANDS_HZ), gain_db)
    assert 20 * np.log10(np.abs(freqz(fir, worN=[1414.0], fs=FS_HZ)[1][0])) == pytest.approx(between, abs=0.2)


def test_flat_filter_returns_the_response():
    rir = coloured_rir(0)
    assert apply_filter(rir, design_filter(np.zeros(8), 511)) == pytest.approx(rir, abs=1e-9)


@pytest.mark.parametrize("time_s", [0.2, 0.6, 2.0])
def test_measured_eq_of_compensated_rirs_meets_the_target(time_s):
    errors = []
    for seed in range(12):
        target_db = np.insert(FREE_TARGETS[seed], 4, 0.0)
        rir = coloured_rir(seed, time_s=time_s, length_s=1.5 * time_s + 0.1)
        result = compensate_rir(rir, DIRECT, target_db)
        assert analyse(result.samples, DIRECT).eq_db == pytest.approx(result.achieved_db)
        errors.append(np.delete(np.abs(result.achieved_db - target_db), 4))
    assert np.median(errors) < 0.5
    assert np.percentile(errors, 95) < 1.5


@pytest.mark.parametrize("direct_sample", [0, 47, 255])
def test_steep_targets_are_met_wherever_the_direct_sound_is(direct_sample):
    rng, time_s = np.random.default_rng(3), np.arange(8000) / FS_HZ
    mean_db, spread_db = np.array([[-10, -4, -1, 0, -1, -3, -8], [8, 5, 3, 2, 3, 4, 6]])
    for _ in range(20):
        tail = 0.05 * rng.standard_normal(8000) * 10.0 ** (-3.0 * time_s / rng.uniform(0.3, 1.0))
        tail[0], tail[1:40] = 1.0, 0.0
        target_db = np.insert(np.maximum(rng.normal(mean_db, spread_db), -20.0), 4, 0.0)  # 31 Hz bins follow these
        result = compensate_rir(np.concatenate([np.zeros(direct_sample), tail]), direct_sample, target_db)
        assert result.achieved_db == pytest.approx(target_db, abs=1.5)


def test_corrected_design_beats_a_single_pass_at_low_bands():
    def error_db(achieved_db):
        return np.mean(np.abs(achieved_db - TARGET_DB)[:, :2])

    def single_pass(rir):
        fir = design_filter(TARGET_DB - analyse(rir, DIRECT).eq_db, 511)
        return analyse(apply_filter(rir, fir), DIRECT).eq_db

    rirs = [coloured_rir(seed) for seed in range(10)]
    corrected_db = [compensate_rir(rir, DIRECT, TARGET_DB).achieved_db for rir in rirs]
    assert error_db(corrected_db) < 0.5 * error_db([single_pass(rir) for rir in rirs])


def test_compensation_keeps_level_decay_and_direct_sound():
    for polarity in (1, -1):
        rir = polarity * coloured_rir(3, time_s=0.5, length_s=0.9, direct=8.0)
        compensated = compensate_rir(rir, DIRECT, TARGET_DB).samples
        assert len(compensated) == len(rir)
        assert analyse(compensated, DIRECT).level_db[4] == pytest.approx(analyse(rir, DIRECT).level_db[4], abs=0.1)
        assert reverberation_time(compensated, FS_HZ, direct_sample=DIRECT) == pytest.approx(
            reverberation_time(rir, FS_HZ, direct_sample=DIRECT), rel=0.05)
        sample, sign = find_direct(compensated, FS_HZ, expected_sample=DIRECT)
        assert (round(sample), sign) == (DIRECT, polarity)


@pytest.fixture
def dirs(tmp_path):
    """Simulated RIRs of two rooms, one with a noise RIR, and a mixture."""
    items = [(row(f"sim{n}", f"room{n % 2}", model=["rays"], direct_sample=float(DIRECT), direct_polarity=1,
                  noise_for=None), coloured_rir(n)) for n in range(6)]
    noise = (row("sim0-noise", "room0", direct_sample=float(DIRECT), direct_polarity=1, noise_for="sim0"),
             coloured_rir(50))
    (tmp_path / "eq").mkdir()
    write_json(tmp_path / "eq" / "gmm.json", fit_gmm(FREE_TARGETS, ["room0"] * 40, n_components=2, seed=0))
    return write_rir_dir(tmp_path / "sim", [*items, noise], [dict(id="hum", room_id=None)]), tmp_path / "eq"


def test_rows_state_target_and_achieved_eq(dirs, tmp_path):
    summary = compensate(*dirs, tmp_path / "out", seed=0)
    assert validate_rirs(tmp_path / "out") == 7
    rows = rows_by_id(tmp_path / "out")
    assert len({tuple(row["eq_target_db"]) for row in rows.values() if "eq_target_db" in row}) == 6
    sim3 = rows["sim3"]
    rir = load_rir(tmp_path / "out", sim3)
    assert analyse(rir, DIRECT).eq_db == pytest.approx(sim3["eq_achieved_db"], abs=1e-3)
    assert np.subtract(sim3["eq_achieved_db"], sim3["eq_target_db"]) == pytest.approx(sim3["eq_error_db"], abs=1e-3)
    assert sim3["model"] == ["rays", "room_eq"]
    assert (sim3["direct_sample"], sim3["acoustic_parameters"]["direct_sample"]) == (DIRECT, DIRECT)
    assert summary == read_json(tmp_path / "out" / "compensation.json")
    assert summary["held"] and summary["n_rirs"] == 6


def test_noise_elsewhere_counts_as_part_of_compensated_rirs(dirs, tmp_path):
    rows = [json.loads(line) for line in (dirs[0] / "noises.jsonl").read_text().splitlines()]
    (dirs[0] / rows[0]["wav"]).rename(tmp_path / "hum.wav")
    (dirs[0] / "noises.jsonl").write_text(json.dumps(rows[0] | dict(wav="../hum.wav")) + "\n")
    compensate(*dirs, tmp_path / "out", seed=0)
    digest(tmp_path / "out")
    (tmp_path / "hum.wav").write_bytes(b"another recording")
    with pytest.raises(ValueError, match=r"hum\.wav: changed since .*out was made of it"):
        digest(tmp_path / "out")


def test_mesh_stays_that_of_the_simulated_rir(dirs, tmp_path):
    write_rirs(dirs[0], [row | dict(mesh="room.obj") for row in read_rirs(dirs[0])])
    compensate(*dirs, tmp_path / "below" / "out", seed=0)
    assert {row["mesh"] for row in read_rirs(tmp_path / "below" / "out")} == {"../../sim/room.obj"}


def rows_by_id(rir_dir):
    return {row["id"]: row for row in read_rirs(rir_dir)}


def smooth_spectra_db(rir_dir):
    """Level of each RIR of a directory in steps of 49 Hz from 98 Hz up, by id."""
    spectra = {row["id"]: np.abs(np.fft.rfft(read_audio(rir_path(rir_dir, row)), 32768)) for row in read_rirs(rir_dir)}
    return {rir_id: 20 * np.log10(spectrum[200:16000].reshape(-1, 100).mean(axis=1))
            for rir_id, spectrum in spectra.items()}


def test_noise_rir_passes_through_the_filter_of_its_rir(dirs, tmp_path):
    compensate(*dirs, tmp_path / "out", seed=0)
    rows = rows_by_id(tmp_path / "out")
    before, after = (smooth_spectra_db(directory) for directory in (dirs[0], tmp_path / "out"))
    gain_db = {name: after[name] - before[name] for name in before}
    assert gain_db["sim0-noise"] == pytest.approx(gain_db["sim0"], abs=0.7)
    assert np.abs(gain_db["sim1"] - gain_db["sim0"]).max() > 1.0
    assert rows["sim0-noise"]["noise_for"] == "sim0" and "eq_target_db" not in rows["sim0-noise"]


def test_parts_jobs_and_order_give_the_same_bytes(dirs, tmp_path):
    compensate(*dirs, tmp_path / "one", seed=0)
    compensate(*dirs, tmp_path / "two", seed=0, nj=2)
    for part in ("2/2", "1/2"):
        assert compensate(*dirs, tmp_path / "parts", seed=0, part=part) is None
    compensate(*dirs, tmp_path / "parts", seed=0)
    for repeated in ("two", "parts"):
        for path in sorted((tmp_path / "one").rglob("*.*")):
            name = path.relative_to(tmp_path / "one")
            if path.is_file() and str(name) not in ("rir_list", ".done"):
                assert (tmp_path / repeated / name).read_bytes() == path.read_bytes(), name


def test_targets_follow_the_room_only_with_match_rooms(dirs, tmp_path):
    gmm = read_json(dirs[1] / "gmm.json")
    gmm["weights_of_room"]["room0"] = [0.0, 1.0]
    write_json(dirs[1] / "gmm.json", gmm)
    targets = {}
    for match_rooms in (True, False):
        compensate(*dirs, tmp_path / str(match_rooms), match_rooms=match_rooms, seed=0)
        targets[match_rooms] = {row["id"]: row.get("eq_target_db") for row in read_rirs(tmp_path / str(match_rooms))}
    assert targets[True]["sim1"] == targets[False]["sim1"], "room1 was not measured"
    assert any(targets[True][name] != targets[False][name] for name in ("sim0", "sim2", "sim4"))


def test_summary_names_rirs_that_missed_their_target():
    good = dict(id="good", eq_error_db=[0.1] * 8, eq_gain_db=[0.0] * 8)
    bad = dict(id="bad", eq_error_db=[2.5] + [0.1] * 7, eq_gain_db=[30.0, 2.0] + [0.0] * 6)
    summary = summarise([good] * 9 + [bad])
    assert summary["missed"] == {"bad": dict(hz=62.5, error_db=2.5, steepest_db=28.0)}
    assert summary["held"] and summary["median_db"] == pytest.approx(0.1)
    assert not summarise([bad])["held"]


def test_even_number_of_taps_is_refused(dirs, tmp_path):
    with pytest.raises(ValueError, match="taps=512 must be odd"):
        compensate(*dirs, tmp_path / "out", seed=0, taps=512)


def test_noise_rir_without_its_rir_is_refused(dirs, tmp_path):
    write_rir_dir(tmp_path / "orphan", [(row("a", noise_for="gone"), coloured_rir(0))])
    with pytest.raises(ValueError, match="noise_for='gone' of RIR a is no RIR"):
        compensate(tmp_path / "orphan", dirs[1], tmp_path / "out", seed=0)


def test_compensated_rirs_are_not_compensated_again(dirs, tmp_path):
    compensate(*dirs, tmp_path / "once", seed=0)
    with pytest.raises(ValueError, match=r"once: RIR \S+ was compensated already \(key 'eq_gain_db'\)"):
        compensate(tmp_path / "once", dirs[1], tmp_path / "twice", seed=0)


def test_rir_without_direct_sound_is_named(dirs, tmp_path):
    cut = coloured_rir(0)[:DIRECT + 300]
    write_rir_dir(tmp_path / "cut", [(row("a", direct_sample=900.0, direct_polarity=1), cut)])
    with pytest.raises(ValueError, match="a.wav: direct_sample=900 must lie in"):
        compensate(tmp_path / "cut", dirs[1], tmp_path / "out", seed=0)
    assert not (tmp_path / "out").exists()
