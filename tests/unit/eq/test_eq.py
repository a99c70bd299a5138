"""EQ analysis against spectra known by construction; the mixture against the distribution it was drawn from."""

import numpy as np
import pytest
from rirmaker import DIRECT, coloured_rir, row, write_rir_dir
from scipy.signal import butter, resample_poly, sosfilt

from enough_rirs import main as enough_rirs
from roomeq.acoustics.subband_eq import N_FRAME, N_LEAD, POINT_BINS, analyse, energy_spectrum
from roomeq.core.constants import BANDS_HZ, FS_HZ
from roomeq.core.files import read_json, read_jsonl, write_json
from roomeq.core.rng import rng_for
from roomeq.eq.compensation import compensate_rir
from roomeq.eq.fit import eq_row, fill_missing, screen_outliers, usable_eq
from roomeq.eq.gmm import FREE, JND_DB, draw_target, fit_gmm, read_gmm, room_weights, sample_eq, with_reference
from roomeq.eq.steps import fit_eq
from roomeq.records.rir_dir import read_rirs

SHAPE_DB = np.array([6.0, 4.0, 3.0, -2.0, 0.0, -3.0, -6.0, -9.0])


def record(rir_id, vector_db, room_id="hall", **more):
    """Return an EQ record, all points measured, not screened."""
    return dict(id=rir_id, room_id=room_id, eq_db=with_reference(vector_db).tolist(), valid=[True] * 8, edge_db=None,
                screen=None) | more


def test_the_eight_points_are_powers_of_two_bins():
    assert POINT_BINS == (2, 4, 8, 16, 32, 64, 128, 256)


def test_eq_of_an_impulse_is_flat():
    rir = np.zeros(2000)
    rir[DIRECT + 200] = 1.0
    eq = analyse(rir + 1e-9 * np.eye(1, 2000, 1999).ravel(), DIRECT)
    assert eq.eq_db == pytest.approx(0.0, abs=1e-3)
    assert eq.valid.all()


def hann_smoothed_level_db(part):
    """Level of a response at the eight points: its whole periodogram, smoothed by the transform of a Hann window."""
    n_fft = 8192
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(N_FRAME) / N_FRAME)
    kernel = np.abs(np.fft.fft(window, n_fft)) ** 2
    smoothed = np.fft.ifft(np.fft.fft(np.abs(np.fft.fft(part, n_fft)) ** 2) * np.fft.fft(kernel / kernel.sum())).real
    return 10 * np.log10(smoothed[np.array(POINT_BINS) * n_fft // N_FRAME])


@pytest.mark.parametrize("n_samples", [1, 100, 511, 512, 640, 4000])
def test_energy_spectrum_keeps_the_energy_of_the_part(n_samples):
    part = np.random.default_rng(n_samples).standard_normal(n_samples)
    energy = energy_spectrum(part)
    both_sides = np.concatenate([energy, energy[1:-1]])
    assert both_sides.mean() == pytest.approx(np.sum(part ** 2), rel=1e-9)


def test_energy_spectrum_is_the_smoothed_periodogram():
    part = coloured_rir(0, eq_db=SHAPE_DB)[DIRECT:DIRECT + 4000]
    level_db = 10 * np.log10(energy_spectrum(part)[list(POINT_BINS)])
    assert level_db == pytest.approx(hann_smoothed_level_db(part), abs=0.1)


@pytest.mark.parametrize("position", [0, 1, 32, 77, 128, 255, 300])
def test_energy_spectrum_weights_all_samples_equally(position):
    assert energy_spectrum(np.eye(1, 400, position).ravel()) == pytest.approx(1.0)


def direct_sound(eq_db):
    """Return 0.6 s with a minimum-phase direct sound of a given octave spectrum at sample `DIRECT`."""
    f = np.fft.rfftfreq(4096, 1 / FS_HZ)
    log_gain = np.interp(np.log(np.maximum(f, 1.0)), np.log(BANDS_HZ), eq_db) * np.log(10) / 20
    cepstrum = np.fft.irfft(log_gain)
    cepstrum[1:2048] *= 2.0
    cepstrum[2049:] = 0.0
    rir = np.zeros(9600)
    rir[DIRECT:DIRECT + 512] = np.fft.irfft(np.exp(np.fft.rfft(cepstrum)), 4096)[:512]
    return rir


@pytest.mark.parametrize("tail_db", [None, -10.0], ids=["direct sound alone", "tail 10 dB below"])
def test_direct_sound_contributes_its_energy(tail_db):
    rir = direct_sound((-3.0, -2.0, -1.0, 0.0, 0.0, 1.0, 3.0, 4.0))
    if tail_db is not None:
        tail = coloured_rir(1, eq_db=(9.0, 6.0, 3.0, 0.0, 0.0, -4.0, -8.0, -12.0), direct=0.0)
        rir[DIRECT + 50:] += tail[DIRECT:][:len(rir) - DIRECT - 50] * np.sqrt(
            10 ** (tail_db / 10) * np.sum(rir ** 2) / np.sum(tail ** 2))
    level_db = hann_smoothed_level_db(rir[:8192])
    assert analyse(rir, DIRECT).eq_db == pytest.approx(level_db - level_db[4], abs=0.5)


@pytest.mark.parametrize("shift", [-10, -3, 3, 10])
def test_onset_errors_of_a_few_samples_hardly_change_the_eq(shift):
    for seed in range(5):
        rir = coloured_rir(seed, direct=8.0)
        assert analyse(rir, DIRECT + shift).eq_db == pytest.approx(analyse(rir, DIRECT).eq_db, abs=0.05)


def test_response_shorter_than_a_frame_is_analysed():
    rir = direct_sound(SHAPE_DB)[:DIRECT + 300]
    level_db = hann_smoothed_level_db(rir)
    assert analyse(rir, DIRECT).eq_db == pytest.approx(level_db - level_db[4], abs=0.1)


def test_last_samples_contribute():
    rir = np.zeros(DIRECT + 900)
    rir[DIRECT], rir[-1] = 1.0, -1.0
    assert energy_spectrum(rir[DIRECT - N_LEAD:]) == pytest.approx(2.0)


def test_mean_eq_of_coloured_decays_is_their_colour():
    eqs_db = [analyse(coloured_rir(seed, eq_db=SHAPE_DB, time_s=1.0), DIRECT).eq_db for seed in range(60)]
    assert np.mean(eqs_db, axis=0) == pytest.approx(SHAPE_DB, abs=1.2)


def test_eq_ignores_gain_and_polarity():
    rir = coloured_rir(0)
    assert analyse(-7.0 * rir, DIRECT).eq_db == pytest.approx(analyse(rir, DIRECT).eq_db)


def test_point_covered_by_noise_is_invalid_others_unchanged():
    colour = (-45.0, -20.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    quiet = analyse(coloured_rir(0, eq_db=colour), DIRECT)
    noisy = analyse(coloured_rir(0, eq_db=colour, snr_db=40.0, length_s=3.0), DIRECT)
    assert noisy.valid.tolist() == [False] + [True] * 7
    assert noisy.eq_db[2:] == pytest.approx(quiet.eq_db[2:], abs=2.5)


def test_digital_silence_after_the_response_is_no_noise():
    rng = np.random.default_rng(4)
    rir = coloured_rir(3) + 0.01 * np.abs(coloured_rir(3)).max() * rng.standard_normal(len(coloured_rir(3)))
    padded = np.concatenate([rir, np.zeros(5 * FS_HZ)])
    np.testing.assert_allclose(analyse(padded, DIRECT).snr_db, analyse(rir, DIRECT).snr_db, atol=1e-9)


def test_direct_sound_behind_the_end_is_refused():
    with pytest.raises(ValueError, match="must lie before the response's end"):
        analyse(np.zeros(2000), DIRECT)


def test_room_weights_are_equal_for_each_room():
    weights = room_weights(["a", "a", "a", "b"])
    assert weights == pytest.approx([1 / 6, 1 / 6, 1 / 6, 1 / 2])


def test_outliers_are_judged_by_rooms_not_by_the_majority():
    rng = np.random.default_rng(0)
    big = [record(f"big{n}", rng.normal(0.0, 1.0, 7), "big") for n in range(100)]
    small = [record(f"small{n}", rng.normal(shift, 1.0, 7), f"small{n}")
             for n, shift in enumerate((-6, 6, 8, -8, 0, 1, -3, 2))]
    odd = [record("odd", [-35.0, 0, 0, 0, 0, 0, 0], "odd")]
    records = big + small + odd
    screen_outliers(records)
    assert [record["id"] for record in records if record["screen"]] == ["odd"]
    assert "62.5 Hz" in odd[0]["screen"]


@pytest.mark.parametrize("n_each", [1, 4])
def test_two_rooms_do_not_make_each_other_outliers(n_each):
    """Of two rooms, none is the odd one."""
    rng = np.random.default_rng(0)
    records = [record(f"{room}{n}", rng.normal(0.0, 0.5, 7) + levels_db, room) for n in range(n_each)
               for room, levels_db in (("a", np.zeros(7)), ("b", np.array([-22.0, 0, 0, 0, 0, 20.0, 0])))]
    screen_outliers(records)
    assert not any(record["screen"] for record in records)


def test_roll_off_is_replaced_by_the_level_at_its_edge():
    rolled_off = record("a", np.arange(7.0), edge_db=-4.0)
    rolled_off["valid"][7] = False
    assert usable_eq(rolled_off) == pytest.approx([0, 1, 2, 3, 4, 5, -4])


def test_missing_points_are_drawn_given_the_measured_ones():
    rng = np.random.default_rng(1)
    low = rng.normal(0.0, 5.0, 400)
    vectors = np.column_stack([low + rng.normal(0.0, 0.5, 400), low, *rng.normal(0.0, 1.0, (5, 400))])
    records = [record(f"r{n:03d}", vector) for n, vector in enumerate(vectors)]
    for incomplete in records[::4]:
        incomplete["valid"][0] = False
    filled = fill_missing(records, seed=0)
    assert filled[1::4] == pytest.approx(vectors[1::4])
    drawn = filled[::4, 0]
    assert np.corrcoef(drawn, low[::4])[0, 1] > 0.9
    assert np.std(drawn) == pytest.approx(np.std(low), rel=0.25)
    assert np.array_equal(filled, fill_missing(records, seed=0))
    reordered = fill_missing(records[::-1], seed=0)[::-1]
    assert reordered == pytest.approx(filled, abs=1e-6)


@pytest.mark.parametrize("share", [0.5, 0.9])
def test_drawn_points_scatter_as_the_measured_ones(share):
    rng, n = np.random.default_rng(0), 800
    vectors_db = rng.multivariate_normal(np.zeros(7), 9.0 * (0.5 * np.eye(7) + 0.5), size=n)
    lacks_62_hz = np.arange(n) < share * n
    records = [dict(id=f"r{k}", eq_db=with_reference(vector_db).tolist(), valid=[not lacks_62_hz[k], *[True] * 7],
                    edge_db=None) for k, vector_db in enumerate(vectors_db)]
    filled = fill_missing(records, seed=0)
    assert filled[lacks_62_hz, 0].std() == pytest.approx(vectors_db[~lacks_62_hz, 0].std(), rel=0.1)


def test_point_that_no_rir_has_is_found_before_the_fit(tmp_path, capsys):
    """As in recordings of sweeps that begin at 100 Hz."""
    known = dict(eq_db=[0.0] * 8, eq_valid=[False] + [True] * 7, eq_edge_db=None)
    write_rir_dir(tmp_path, [(row(f"r{n}", acoustic_parameters=known), coloured_rir(n)) for n in range(9)])
    assert enough_rirs([str(tmp_path), "7"]) == 1
    assert "none of 9 measured RIRs has a valid EQ at 62.5 Hz" in capsys.readouterr().err


def test_refusal_says_why_rirs_are_left_out(tmp_path, capsys):
    """As of a small loudspeaker: the two lowest points lie in the noise of every RIR."""
    known = dict(eq_db=[0.0] * 8, eq_valid=[False] * 2 + [True] * 6, eq_edge_db=None)
    write_rir_dir(tmp_path, [(row(f"r{n}", acoustic_parameters=known), coloured_rir(n)) for n in range(9)])
    assert enough_rirs([str(tmp_path), "7"]) == 1
    assert "left after screening of 9 (9 dead bands)" in capsys.readouterr().err


@pytest.fixture(scope="module")
def two_clusters():
    """Vectors of two well separated clusters, 3 to 1, each a room."""
    rng = np.random.default_rng(0)
    factor = np.tril(rng.normal(0.0, 1.0, (7, 7))) + 3.0 * np.eye(7)
    vectors = np.concatenate([rng.standard_normal((300, 7)) @ factor.T + 20.0, rng.standard_normal((100, 7)) - 20.0])
    return vectors, ["big"] * 300 + ["small"] * 100, factor @ factor.T


def test_mixture_recovers_two_known_clusters(two_clusters):
    vectors, rooms, covariance = two_clusters
    gmm = fit_gmm(vectors, rooms, n_components=2, seed=0)
    assert gmm["weights"] == pytest.approx([0.75, 0.25], abs=1e-3)
    assert np.array(gmm["means_db"])[:, 0] == pytest.approx([20.0, -20.0], abs=0.8)
    # the fit adds the square of the just noticeable difference, 1 dB², to every variance
    assert np.array(gmm["covariances_db2"][0]) - np.eye(7) == pytest.approx(covariance, abs=4.0)
    assert gmm["weights_of_room"]["big"] == pytest.approx([1.0, 0.0], abs=1e-6)


def test_samples_have_the_moments_of_the_mixture(two_clusters):
    gmm = fit_gmm(two_clusters[0], two_clusters[1], n_components=2, seed=0)
    drawn = sample_eq(gmm, 40000, np.random.default_rng(0))
    first = drawn[drawn[:, 0] > 0]
    assert len(first) / len(drawn) == pytest.approx(0.75, abs=0.01)
    assert first.mean(axis=0) == pytest.approx(np.array(gmm["means_db"][0]), abs=0.15)
    assert np.cov(first.T) == pytest.approx(np.array(gmm["covariances_db2"][0]), abs=0.6)


def test_weight_rooms_gives_rooms_equal_weight(two_clusters):
    gmm = fit_gmm(two_clusters[0], two_clusters[1], n_components=2, weight_rooms=True, seed=0)
    assert gmm["weights"] == pytest.approx([0.5, 0.5], abs=0.01)


def test_targets_differ_by_rir_and_not_by_order(two_clusters):
    gmm = fit_gmm(two_clusters[0], two_clusters[1], n_components=2, seed=0)
    targets = {name: draw_target(gmm, 3, name) for name in ("a", "b", "c")}
    assert len({tuple(target) for target in targets.values()}) == 3
    assert np.array_equal(draw_target(gmm, 3, "c"), targets["c"])
    assert np.array_equal(targets["a"], sample_eq(gmm, 1, rng_for(3, "EQ target", "a"))[0])


def test_targets_of_a_room_use_its_component_weights(two_clusters):
    gmm = fit_gmm(two_clusters[0], two_clusters[1], n_components=2, seed=0)
    names = [f"r{n}" for n in range(50)]
    assert all(draw_target(gmm, 0, name, "small")[0] < 0 for name in names)
    assert all(draw_target(gmm, 0, name, "big")[0] > 0 for name in names)
    assert {bool(draw_target(gmm, 0, name, "never measured")[0] > 0) for name in names} == {True, False}


def test_component_is_as_wide_as_its_rirs():
    vectors = np.random.default_rng(0).normal(0.0, [1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0], (400, 7))
    gmm = fit_gmm(vectors, ["room"] * 400, n_components=1, seed=0)
    assert np.array(gmm["covariances_db2"][0]) == pytest.approx(np.cov(vectors.T, bias=True), abs=1e-6)


@pytest.mark.parametrize("weight_rooms", [False, True])
def test_one_rir_makes_a_component_of_min_width(weight_rooms):
    vector_db = np.arange(7.0)
    gmm = fit_gmm(vector_db[None], ["hall"], n_components=1, weight_rooms=weight_rooms, seed=0)
    np.testing.assert_allclose(gmm["means_db"], vector_db[None])
    np.testing.assert_allclose(gmm["covariances_db2"][0], JND_DB ** 2 * np.eye(7), atol=1e-9)
    assert gmm["weights"] == [1.0] and gmm["n_rirs"] == 1


@pytest.mark.filterwarnings("ignore:Number of distinct clusters")
def test_nearly_as_many_components_as_rirs_keep_min_width():
    rng = np.random.default_rng(0)
    vectors = np.concatenate([np.repeat(rng.normal(0, 3, (1, 7)), 7, axis=0), rng.normal(0, 3, (2, 7))])
    gmm = fit_gmm(vectors, ["big"] * 7 + ["x", "y"], seed=0)
    smallest = min(np.linalg.eigvalsh(np.array(matrix)).min() for matrix in gmm["covariances_db2"])
    assert smallest >= 1.0 - 1e-9, "no component is narrower than 1 dB"


@pytest.fixture
def rir_dirs(tmp_path):
    """Measured and simulated RIR directories."""
    rng = np.random.default_rng(0)
    measured = [(row(f"real{n}", f"room{n % 3}"), coloured_rir(n, eq_db=SHAPE_DB + rng.normal(0, 2, 8)))
                for n in range(12)]
    simulated = [(row(f"sim{n}", f"room{n % 3}", direct_sample=float(DIRECT)), coloured_rir(100 + n)) for n in range(4)]
    noise = (row("sim0-noise", "room0", noise_for="sim0"), coloured_rir(200))
    return write_rir_dir(tmp_path / "real", measured), write_rir_dir(tmp_path / "sim", [*simulated, noise])


def test_fit_eq_writes_mixture_eqs_and_screening(rir_dirs, tmp_path):
    real_dir, sim_dir = rir_dirs
    gmm = fit_eq(real_dir, [sim_dir], tmp_path / "eq", n_components=2, seed=0)
    assert read_gmm(tmp_path / "eq") == gmm == read_gmm(tmp_path / "eq" / "gmm.json")
    measured, simulated, resampled = (read_jsonl(tmp_path / "eq" / f"{name}.jsonl")
                                      for name in ("measured", "simulated", "resampled"))
    assert (len(measured), len(simulated)) == (12, 4)
    assert len(resampled) == read_json(tmp_path / "eq" / "screening.json")["n_used"] == 12
    assert measured[0]["eq_db"][4] == resampled[0]["eq_db"][4] == 0.0
    assert np.mean([record["eq_db"] for record in measured], axis=0) == pytest.approx(SHAPE_DB, abs=4.0)
    assert fit_eq(real_dir, [sim_dir], tmp_path / "eq", n_components=2, seed=0) is None


def test_fit_eq_gives_the_same_bytes_with_more_jobs(rir_dirs, tmp_path):
    for name, nj in (("one", 1), ("two", 2)):
        fit_eq(rir_dirs[0], [rir_dirs[1]], tmp_path / name, n_components=2, seed=0, nj=nj)
    for name in ("gmm.json", "measured.jsonl", "simulated.jsonl", "resampled.jsonl", "screening.json"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


def test_eq_outside_the_excitation_is_not_measured_without_acoustic_parameters_either(tmp_path):
    narrow = resample_poly(resample_poly(coloured_rir(0), 441, 640), 640, 441)
    sweep = sosfilt(butter(20, 90.0, "high", fs=16000, output="sos"), coloured_rir(1))
    directory = write_rir_dir(tmp_path / "real", [(row("narrow"), narrow), (row("sweep"), sweep)])
    assert [eq_row(directory, given)["valid"] for given in read_rirs(directory)] == [[True] * 7 + [False],
                                                                                    [False] + [True] * 7]


def test_fewer_rirs_than_components_leave_no_output(rir_dirs, tmp_path):
    with pytest.raises(ValueError, match="12 measured RIRs are left after screening of 12: must be at least 13"):
        fit_eq(rir_dirs[0], [], tmp_path / "eq", n_components=13, seed=0)
    assert not (tmp_path / "eq").exists()


def test_rirs_are_counted_as_the_fit_counts_them(rir_dirs, capsys):
    message = f"{rir_dirs[0]}: 12 measured RIRs are left after screening of 12: must be at least 13, the mixture's"
    assert enough_rirs([str(rir_dirs[0]), "12"]) == 0
    assert enough_rirs([str(rir_dirs[0]), "13"]) == 1
    assert capsys.readouterr().err.startswith(f"enough_rirs.py: {message}")


def test_simulated_rirs_are_not_taken_for_measured_ones(rir_dirs, tmp_path):
    for key, value in (("seed", 0), ("model", []), ("measured_id", "r1")):
        simulated = write_rir_dir(tmp_path / key, [(row("r1", **{key: value}), coloured_rir(1))])
        with pytest.raises(ValueError, match=rf"{key}: RIR r1 is simulated \(key '{key}'\), but measured RIRs are"):
            fit_eq(simulated, [rir_dirs[0]], tmp_path / "eq", n_components=1, seed=0)


def test_zero_components_are_refused(rir_dirs, tmp_path):
    with pytest.raises(ValueError, match="n_components=0 must be"):
        fit_eq(rir_dirs[0], [], tmp_path / "eq", n_components=0, seed=0)


@pytest.mark.parametrize("gmm, message", [
    (dict(weights=[1.0]), "not a mixture"),
    (dict(weights=[1.0], means_db=[[0.0]], covariances_db2=[[[1.0]]]), r"\(k, 7\)")])
def test_malformed_mixture_file_is_refused(tmp_path, gmm, message):
    write_json(tmp_path / "gmm.json", gmm)
    with pytest.raises(ValueError, match=message):
        read_gmm(tmp_path)
    with pytest.raises(ValueError, match="no such mixture: run fit-eq"):
        read_gmm(tmp_path / "elsewhere")


def test_seven_points_are_free():
    assert len(FREE) == 7 and 4 not in FREE


@pytest.mark.parametrize(("change", "message"), [
    (dict(target_db=np.full(8, np.nan)), r"target_db=\[nan, .* must be 8 finite levels"),
    (dict(target_db=np.zeros(3)), "must be 8 finite levels"),
    (dict(target_db=np.full(8, 6.0)), r"target_db\[4\]=6 must be 0 dB, the level at 1 kHz"),
    (dict(taps=510), r"taps=510 must be odd and lie in \[3, 4095\]"),
    (dict(rir=np.ones((2, 800))), r"has shape \(2, 800\): must be mono"),
    (dict(rir=np.r_[np.ones(10), np.nan]), "holds nan at sample 10"),
    (dict(direct_sample=801), "direct_sample=801 must lie in the response's 800 samples")])
def test_compensation_of_what_is_no_response_or_no_target_is_refused(change, message):
    arguments = dict(rir=np.exp(-np.arange(800.0) / 80), direct_sample=0, target_db=np.zeros(8)) | change
    with pytest.raises(ValueError, match=message):
        compensate_rir(**arguments)


def test_one_directory_is_as_good_as_a_list(rir_dirs, tmp_path):
    real, sim = rir_dirs
    for out, directories in (("one", str(sim)), ("list", [sim])):
        fit_eq(real, directories, tmp_path / out, n_components=2, seed=0)
    assert (tmp_path / "one/simulated.jsonl").read_bytes() == (tmp_path / "list/simulated.jsonl").read_bytes()
