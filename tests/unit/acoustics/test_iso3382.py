"""ISO 3382 quantities against decays that are known by construction, and against pyrato."""

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from roomeq.acoustics.iso3382 import all_metrics, decay_time, energy_decay
from roomeq.acoustics.noise_intersection import find_noise_intersection, remaining_energy
from roomeq.acoustics.octaves import octave_bands, octave_gains
from roomeq.core.constants import EXACT_BANDS_HZ, FS_HZ

DIRECT = 320


def room(time_s, seed=0, *, length_s=1.5, snr_db=None, direct=0.0, inverted=False):
    """Exponentially decaying noise from `DIRECT` on, an impulse at its start, stationary noise below it."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(length_s * FS_HZ)) / FS_HZ
    rir = np.concatenate([np.zeros(DIRECT), rng.standard_normal(len(t)) * 10.0 ** (-3.0 * t / time_s)])
    rir[DIRECT] = direct or 2.0
    if snr_db is not None:
        rir += rng.standard_normal(len(rir)) * 10.0 ** (-snr_db / 20.0)
    return -rir if inverted else rir


def test_octave_filter_gains_at_edges_and_neighbours():
    frequencies = np.fft.rfftfreq(2 ** 16, 1.0 / FS_HZ)
    for band_hz in EXACT_BANDS_HZ[:-1]:
        level_db = np.interp(band_hz * 2.0 ** np.array([-1, -0.5, 0, 0.5, 1]), frequencies,
                             20 * np.log10(octave_gains(2 ** 16, FS_HZ, band_hz)))
        assert level_db[[1, 3]] == pytest.approx(-3.01, abs=0.1)
        assert level_db[2] == pytest.approx(0.0, abs=0.01)
        assert max(level_db[[0, 4]]) < -20.0


@pytest.mark.parametrize("time_s", [0.2, 0.7, 1.5])
def test_decay_time_of_ideal_line_is_exact(time_s):
    edc_db = -60.0 * np.arange(FS_HZ) / FS_HZ / time_s
    for decay in ("edt", "t20", "t30"):
        assert decay_time(edc_db, FS_HZ, decay) == pytest.approx(time_s, rel=1e-9)


def test_decay_time_is_none_for_short_decay():
    assert decay_time(np.linspace(0.0, -30.0, 1000), FS_HZ, "t30") is None
    assert decay_time(np.linspace(0.0, -30.0, 1000), FS_HZ, "t20") is not None


@pytest.mark.parametrize("time_s", [0.3, 0.8, 2.0])
def test_decay_times_of_decaying_noise(time_s):
    found = [all_metrics(room(time_s, seed, length_s=2.0, snr_db=70.0), FS_HZ) for seed in range(6)]
    for key, tolerance in (("edt_s", 0.08), ("t20_s", 0.03), ("t30_s", 0.02)):
        mean_s = np.mean([metrics[key][4:] for metrics in found], axis=0)
        assert mean_s == pytest.approx(time_s, rel=tolerance), key
        assert all(all(metrics[key.replace("_s", "_valid")][4:]) for metrics in found), key


@pytest.mark.parametrize("snr_db", [30.0, 40.0, 60.0])
def test_noise_intersection_lies_where_decay_meets_noise(snr_db):
    time_s = 0.6
    intersections_s, levels_db = [], []
    for seed in range(5):
        intersection = find_noise_intersection(remaining_energy(room(time_s, seed, snr_db=snr_db)[DIRECT:]), FS_HZ)
        intersections_s.append(intersection.sample / FS_HZ)
        levels_db.append(10 * np.log10(intersection.noise_power))
    assert np.mean(intersections_s) == pytest.approx(time_s * snr_db / 60.0, rel=0.05)
    assert np.mean(levels_db) == pytest.approx(-snr_db, abs=0.3)


@pytest.mark.parametrize("gap_s", [0.025, 0.09, 0.17])
def test_gap_behind_the_direct_sound_is_no_end_of_the_decay(gap_s):
    """In a large room, no reflection arrives for tens of milliseconds."""
    time_s, gap = 1.2, round(gap_s * FS_HZ)
    rir = room(time_s, length_s=2.5, snr_db=80.0)
    rir[DIRECT + 1:] = np.concatenate([1e-5 * rir[:gap], rir[DIRECT + 1:-gap]])
    metrics = all_metrics(rir, FS_HZ)
    assert np.array(metrics["t20_s"][3:]) == pytest.approx(time_s, rel=0.15) and all(metrics["t20_valid"][3:])


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("gap_s", "noise_db"), [(0.02, -np.inf), (0.06, -np.inf), (0.03, -70.0), (0.06, -65.0)])
def test_drr_of_a_response_with_a_gap_behind_the_direct_sound_is_known(gap_s, noise_db, seed):
    """A source that is close to the microphone in a large room."""
    rng, gap = np.random.default_rng(seed), round(gap_s * FS_HZ)
    tail = room(0.8, seed + 10, length_s=1.5)[DIRECT + 1:]
    tail[:gap] = 0.0
    drr_db = 6.0
    tail *= np.sqrt(10.0 ** (-0.1 * drr_db) / np.sum(tail ** 2))
    rir = np.concatenate([np.zeros(DIRECT), [1.0], tail])
    rir += 10.0 ** (0.05 * noise_db) * rng.standard_normal(len(rir))
    metrics = all_metrics(rir, FS_HZ, DIRECT, 1)
    assert metrics["drr_db"] == pytest.approx(drr_db, abs=1.0) and metrics["noise_intersection_s"] > 2.0 * gap_s


@pytest.mark.parametrize("lead", [0, 47])
def test_decay_times_do_not_depend_on_the_silence_before_the_direct_sound(lead):
    """Zero-phase filters spread the direct sound to both sides, also where nothing is recorded before it."""
    rir = room(0.6, snr_db=60.0, direct=60.0)[DIRECT:]
    cut, whole = (all_metrics(np.concatenate([np.zeros(n), rir]), FS_HZ, n, 1) for n in (lead, 1600))
    for key in ("edt_s", "t20_s", "t30_s"):
        assert cut[key] == pytest.approx(whole[key], rel=0.005), key


def test_noise_before_the_direct_sound_is_no_energy_of_the_decay():
    rirs = [np.concatenate([1e-1 * np.random.default_rng(0).standard_normal(n), room(0.3, snr_db=20.0)])
            for n in (160, 80000)]
    near, far = (all_metrics(rir, FS_HZ, len(rir) - 1.5 * FS_HZ, 1) for rir in rirs)
    assert near["decay_range_db"] == pytest.approx(far["decay_range_db"], abs=1.0)


def test_decays_as_short_as_that_of_the_filter_are_not_valid_by_chance():
    """At 62.5 Hz and 0.3 s, the product of bandwidth and time is 13."""
    found = [all_metrics(room(0.3, seed, direct=6.0), FS_HZ) for seed in range(20)]
    assert max(metrics["edt_s"][0] for metrics in found) > 0.36
    assert sum(metrics[f"{decay}_valid"][0] for metrics in found for decay in ("edt", "t20", "t30")) < 6
    assert not any(metrics["edt_valid"][0] for metrics in found)
    assert all(metrics["t30_valid"][2] for metrics in found)


def test_strong_direct_sound_leaves_t20_and_t30_valid():
    metrics = all_metrics(room(0.6, snr_db=70.0, direct=80.0), FS_HZ)
    assert max(metrics["edt_s"][3:]) < 0.1 and all(metrics["t20_valid"]) and all(metrics["t30_valid"])


def test_response_ending_above_its_noise_has_no_floor():
    intersection = find_noise_intersection(remaining_energy(room(1.5, length_s=0.7)[DIRECT:]), FS_HZ)
    assert (intersection.sample, intersection.noise_power) == (round(0.7 * FS_HZ), 0.0)
    # energy of the decay beyond the truncation: 1/(2 rate) of the power at its end
    expected = 10.0 ** (-6.0 * 0.7 / 1.5) * 1.5 * FS_HZ / (6.0 * np.log(10.0))
    assert 10 * np.log10(intersection.rest_energy / expected) == pytest.approx(0.0, abs=1.0)


@pytest.mark.parametrize("time_s, length_s", [(0.5, 0.15), (0.5, 0.2), (0.5, 0.3), (1.0, 0.3), (1.0, 0.5)])
@pytest.mark.parametrize("direct", [2.0, 20.0])
def test_scatter_of_a_decay_that_is_cut_off_is_no_noise_floor(time_s, length_s, direct):
    for seed in range(20):
        metrics = all_metrics(room(time_s, seed, length_s=length_s, direct=direct), FS_HZ, DIRECT, 1)
        assert not any(floor_db is not None for floor_db in metrics["band_noise_floor_db"]), seed


@pytest.mark.parametrize("time_s, length_s", [(0.3, 0.06), (0.3, 0.1), (0.5, 0.06)])
def test_direct_sound_is_no_part_of_a_decay_that_is_cut_off(time_s, length_s):
    """Its level falls to that of the reflections within a block; a fit through it would end the decay too early."""
    errors = []
    for seed in range(10):
        rir = room(time_s, seed, direct=40.0)
        cut, whole = (all_metrics(h, FS_HZ, DIRECT, 1) for h in (rir[:DIRECT + round(length_s * FS_HZ)], rir))
        errors += [cut["edt_s"][n] / whole["edt_s"][n] - 1.0 for n in range(2, 8) if cut["edt_valid"][n]]
    assert min(errors, default=0.0) > -0.3


@pytest.mark.parametrize("time_s, length_s, direct", [(1.0, 0.05, 2.0), (2.0, 0.1, 20.0), (2.0, 0.25, 20.0)])
def test_drr_of_a_response_that_is_cut_off_is_right_or_unknown(time_s, length_s, direct):
    errors_db = []
    for seed in range(10):
        rir = room(time_s, seed, direct=direct)
        cut, whole = (all_metrics(h, FS_HZ, DIRECT, 1)["drr_db"] for h in (rir[:DIRECT + round(length_s * FS_HZ)], rir))
        errors_db += [] if cut is None else [cut - whole]
    assert np.max(np.abs(errors_db), initial=0.0) < 1.5


@pytest.mark.parametrize("snr_db", [30.0, 40.0, 50.0])
@pytest.mark.parametrize("time_s, length_s", [(0.3, 0.8), (0.5, 1.0), (1.0, 2.0)])
def test_noise_floor_is_seen_where_it_lasts(time_s, length_s, snr_db):
    """At 62.5 Hz, noise of a few tenths of a second scatters as much as some decays fall."""
    found = [all_metrics(room(time_s, seed, length_s=length_s, snr_db=snr_db), FS_HZ)["band_noise_floor_db"]
             for seed in range(10)]
    seen = np.mean([[floor_db is not None for floor_db in floors_db] for floors_db in found], axis=0)
    assert seen[0] > 0.4 and seen[1] > 0.7 and np.all(seen[2:] > 0.9)


def test_noise_that_hides_the_decay_is_a_floor():
    found = [all_metrics(room(0.5, seed, length_s=1.0, snr_db=3.0, direct=20.0), FS_HZ)["band_noise_floor_db"]
             for seed in range(10)]
    assert np.mean([[floor_db is not None for floor_db in floors_db] for floors_db in found]) > 0.9


def test_second_slope_of_a_decay_is_no_noise_floor():
    """A coupled room whose decay takes three times as long, from 20 dB below on."""
    for seed in range(10):
        rir = room(0.4, seed, length_s=0.7) + 0.1 * room(1.2, 100 + seed, length_s=0.7)
        assert all_metrics(rir, FS_HZ, DIRECT, 1)["band_noise_floor_db"] == [None] * 8, seed


def test_validity_requires_decay_range():
    metrics = all_metrics(room(0.6, snr_db=40.0), FS_HZ)
    assert metrics["t20_valid"][4] and not metrics["t30_valid"][4]
    assert metrics["decay_range_db"][4] == pytest.approx(40.0, abs=4.0)
    assert not any(all_metrics(room(0.6, snr_db=25.0), FS_HZ)["t20_valid"])


def test_validity_requires_bandwidth_time_product():
    metrics = all_metrics(room(0.15, snr_db=80.0), FS_HZ)
    assert not metrics["t30_valid"][0], "44 Hz times 0.15 s is 6.6, less than 16"
    assert metrics["t30_valid"][3]


@pytest.mark.parametrize("time_s", [0.4, 1.0])
def test_c50_of_exponential_decay(time_s):
    # E(0..t) / E(t..inf) = exp(13.8 t / T) - 1
    expected_db = 10 * np.log10(np.expm1(6.0 * np.log(10.0) * 0.05 / time_s))
    found = np.mean([all_metrics(room(time_s, seed, snr_db=60.0), FS_HZ)["c50_db"] for seed in range(8)], axis=0)
    assert found[3:] == pytest.approx(expected_db, abs=0.7)


def test_c50_does_not_depend_on_zeros_ahead_of_a_noisy_recording():
    noisy = np.concatenate([np.zeros(100), room(0.4, snr_db=45.0)[DIRECT:]])
    found = [all_metrics(np.concatenate([np.zeros(ahead), noisy]), FS_HZ)["c50_db"] for ahead in (0, 4 * FS_HZ)]
    assert found[1][3:] == pytest.approx(found[0][3:], abs=0.1)


@pytest.mark.parametrize("times_noise", [0.1, 2.0])
def test_c50_does_not_depend_on_noise_long_ahead_of_the_response(times_noise):
    """As of a recording that starts seconds ahead, in which people still move."""
    rir = room(0.3, snr_db=35.0)
    ahead = times_noise * 10.0 ** (-35.0 / 20.0) * np.random.default_rng(1).standard_normal(5 * FS_HZ)
    found = [all_metrics(h, FS_HZ, len(h) - 1.5 * FS_HZ, 1)["c50_db"] for h in (rir, np.concatenate([ahead, rir]))]
    assert found[1] == pytest.approx(found[0], abs=0.2)


@pytest.mark.parametrize("time_s, snr_db", [(1.0, 42.0), (1.0, 40.0), (2.0, 42.0), (2.0, 40.0)])
def test_drr_is_left_out_where_the_noise_hides_the_decay(time_s, snr_db):
    """Direct sound and decay of equal energy; the noise is 8 to 11 dB below the beginning of the decay."""
    for seed in range(8):
        rng = np.random.default_rng(seed)
        decay = rng.standard_normal(round(1.5 * time_s * FS_HZ)) * 10.0 ** (-3.0 * np.arange(1.5 * time_s * FS_HZ) /
                                                                            (time_s * FS_HZ))
        rir = np.concatenate([np.zeros(DIRECT), decay / np.sqrt(np.sum(decay ** 2))])
        rir[DIRECT] = 1.0
        rir += rng.standard_normal(len(rir)) * 10.0 ** (-snr_db / 20.0)
        found_db = all_metrics(rir, FS_HZ, DIRECT, 1)["drr_db"]
        assert found_db is None or abs(found_db) < 2.5


def test_drr_is_recovered_for_both_polarities():
    rir = room(0.5, snr_db=70.0, direct=30.0)
    gate = DIRECT + 40
    expected_db = 10 * np.log10(np.sum(rir[DIRECT - 40:gate] ** 2) / np.sum(rir[gate:] ** 2))
    for inverted in (False, True):
        metrics = all_metrics(room(0.5, snr_db=70.0, direct=30.0, inverted=inverted), FS_HZ)
        assert metrics["drr_db"] == pytest.approx(expected_db, abs=0.1)
        assert metrics["direct_polarity"] == (-1 if inverted else 1)


@pytest.mark.parametrize("level_db, is_valid", [(-15.0, False), (-30.0, True)])
def test_narrow_noise_that_hides_the_decay_makes_its_octave_invalid(level_db, is_valid):
    """The level of a fan at 114 to 135 Hz rises and falls by as much as a decay within 50 ms."""
    fan_band = butter(2, [114.0, 135.0], "band", fs=FS_HZ, output="sos")
    for seed in range(1, 4):
        rir = room(2.0, seed, length_s=2.0)
        fan = sosfilt(fan_band, np.random.default_rng(100 + seed).standard_normal(len(rir)))
        start = octave_bands(rir, FS_HZ)[1][DIRECT:DIRECT + FS_HZ // 10]
        fan *= 10.0 ** (0.05 * level_db) * np.sqrt(np.mean(start ** 2) / np.mean(fan ** 2))
        clean, noisy = (all_metrics(h, FS_HZ, DIRECT, 1) for h in (rir, rir + fan))
        assert noisy["edt_valid"][1] == noisy["c50_valid"][1] == is_valid
        if is_valid:
            assert noisy["c50_db"][1] == pytest.approx(clean["c50_db"][1], abs=1.1)


def test_trailing_zeros_are_not_a_noise_floor():
    rir = room(0.5, snr_db=60.0)
    assert all_metrics(np.pad(rir, (0, 20000)), FS_HZ)["t30_s"] == pytest.approx(all_metrics(rir, FS_HZ)["t30_s"])


@pytest.mark.parametrize("rir", [np.eye(1, 4000, 100)[0], np.zeros(4000)])
def test_direct_sound_after_the_last_sample_that_is_not_zero_is_refused(rir):
    with pytest.raises(ValueError, match="direct_sample=101 must lie before the end of the response"):
        all_metrics(rir, FS_HZ, 101.0, 1)


def test_spike_has_no_valid_t30():
    rir = np.zeros(8000)
    rir[100] = 1.0
    metrics = all_metrics(rir, FS_HZ)
    assert metrics["drr_db"] is None
    assert not any(metrics["t30_valid"])


@pytest.mark.parametrize("time_s", [0.4, 1.2])
def test_t30_and_c50_agree_with_pyrato(time_s):
    pyfar, pyrato = pytest.importorskip("pyfar"), pytest.importorskip("pyrato")
    rir = room(time_s, 3, snr_db=65.0)
    band = octave_bands(rir, FS_HZ)[4]
    edc = pyrato.edc.energy_decay_curve_chu_lundeby(pyfar.Signal(band[DIRECT:], FS_HZ), smoothing_parameter=1000,
                                                  plot=False)
    theirs = float(np.squeeze(pyrato.parameters.reverberation_time_linear_regression(edc, T="T30")))
    ours = decay_time(energy_decay(band, FS_HZ, DIRECT).edc_db, FS_HZ, "t30")
    assert ours == pytest.approx(theirs, rel=0.02)
    clarity_db = float(np.squeeze(pyrato.parameters.clarity(edc, early_time_limit=50)))
    assert all_metrics(rir, FS_HZ, DIRECT, 1)["c50_db"][4] == pytest.approx(clarity_db, abs=0.3)
