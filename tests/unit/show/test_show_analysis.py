"""The analysis of an RIR that is to be shown, at any sample rate."""

import numpy as np
import pytest
from rirmaker import coloured_rir
from scipy.signal import butter, sosfilt

from roomeq.acoustics.iso3382 import all_metrics
from roomeq.acoustics.parameters import measure
from roomeq.core.constants import bands_hz
from roomeq.records.parameters import reverberation_time_s, value_of
from roomeq.show.analysis import FRAME_S, analyse

T60_S = 0.5


def decaying_noise(fs_hz, length_s=1.0, noise=0.0):
    """Return a direct sound at 20 ms and noise that decays by 60 dB in `T60_S`."""
    rng = np.random.default_rng(1)
    time_s = np.arange(round(length_s * fs_hz)) / fs_hz
    decay = rng.standard_normal(len(time_s)) * 10 ** (-3 * time_s / T60_S)
    rir = np.concatenate([np.zeros(round(0.02 * fs_hz)), decay])
    rir[round(0.02 * fs_hz)] = 8.0
    return rir + noise * rng.standard_normal(len(rir))


@pytest.mark.parametrize("fs_hz, n_bands", [(8000, 7), (16000, 8), (22050, 8), (44100, 9), (48000, 9)])
def test_bands_and_decay_times_follow_the_sample_rate(fs_hz, n_bands):
    rir = analyse(decaying_noise(fs_hz), fs_hz)
    assert rir.bands_hz == bands_hz(fs_hz) and len(rir.decays) == n_bands
    assert all(len(rir.parameters[key]) == n_bands for key in ("t30_s", "c50_db", "eq_db"))
    for decay in rir.decays[3:]:
        name, time_s, offset_db, valid = decay.fit
        assert name == "T30" and valid and time_s == pytest.approx(T60_S, rel=0.06)
        assert decay.curve_db[0] == pytest.approx(0.0, abs=1e-9) and abs(offset_db) < 4.0
    assert rir.band_levels_db.shape[0] == n_bands and rir.band_levels_db.max() == 0.0


def test_fitted_line_lies_on_the_decay_curve():
    for decay in analyse(decaying_noise(16000), 16000).decays[3:]:
        _, time_s, offset_db, _ = decay.fit
        part = (decay.curve_db <= -5.0) & (decay.curve_db >= -35.0)
        line_db = offset_db - 60.0 * decay.curve_s[part] / time_s
        assert np.abs(line_db - decay.curve_db[part]).max() < 1.5


def test_noise_intersection_is_where_the_level_stops_falling():
    decay = analyse(decaying_noise(16000, noise=10 ** -2), 16000).decays[4]
    assert decay.has_noise and decay.fit[1] == pytest.approx(T60_S, rel=0.1)
    assert decay.intersection_s == pytest.approx(T60_S * 40 / 60, rel=0.25)
    after_db = decay.level_db[round(1.3 * decay.intersection_s / FRAME_S):]
    assert np.ptp(np.convolve(after_db, np.ones(40) / 40, "valid")) < 3.0


def test_parameters_at_16_khz_are_those_of_characterise():
    samples = coloured_rir(3)
    assert analyse(samples, 16000).parameters == measure(samples)


@pytest.mark.parametrize("fs_hz", [16000, 48000, 44100])
def test_points_of_the_eq_below_the_noise_are_not_valid_at_any_rate(fs_hz):
    rng = np.random.default_rng(5)
    time_s = np.arange(3 * fs_hz) / fs_hz
    rir = np.concatenate([np.zeros(fs_hz // 10), rng.standard_normal(len(time_s)) * 10.0 ** (-3.0 * time_s / 0.5)])
    hum_hz = np.array([55.0, 62.0, 70.0, 120.0, 126.0])
    hum = np.sin(2.0 * np.pi * hum_hz[:, None] * np.arange(len(rir)) / fs_hz).sum(axis=0)
    valid = analyse(rir + 0.03 * hum, fs_hz, "a").parameters["eq_valid"]
    assert valid[:2] == [False, False] and all(valid[3:7])


@pytest.mark.parametrize("fs_hz", [16000, 44100, 48000])
def test_what_a_sweep_does_not_reach_is_not_valid_at_any_rate(fs_hz):
    """A sweep from 100 Hz to 6 kHz."""
    band = butter(24, (100.0, 6000.0), "bandpass", fs=fs_hz, output="sos")
    rng = np.random.default_rng(2)
    rir = sosfilt(band, decaying_noise(fs_hz)) + 1e-5 * rng.standard_normal(round(1.02 * fs_hz))
    parameters = analyse(rir, fs_hz).parameters
    for key in ("t20_valid", "c50_valid", "eq_valid"):
        assert parameters[key] == [False, *[True] * 6, *[False] * (len(parameters[key]) - 7)], key


def test_point_of_the_eq_at_half_the_rate_is_not_valid():
    assert analyse(np.eye(1, 4000, 400)[0], 8000, "a").parameters["eq_valid"] == [True] * 6 + [False]


def test_response_of_an_impulse_is_flat_at_any_rate():
    for fs_hz in (8000, 16000, 44100, 48000):
        samples = np.zeros(fs_hz // 2)
        samples[fs_hz // 10] = -0.5
        rir = analyse(samples, fs_hz)
        assert np.abs(rir.response[1]).max() < 1e-6 and rir.direct.polarity == -1
        assert rir.direct_s == pytest.approx(0.1, abs=1e-4)


def test_response_cut_off_early_has_no_decay_time_of_zero():
    samples = decaying_noise(16000)[:360]  # 2.5 ms after the direct sound
    assert 0.0 < min(time_s for time_s in all_metrics(samples, 16000)["t30_s"] if time_s is not None) < 5e-5
    rir = analyse(samples, 16000)
    assert all(time_s != 0.0 for key in ("edt_s", "t20_s", "t30_s") for time_s in rir.parameters[key])
    assert any(decay.fit is None for decay in rir.decays)


def test_levels_over_frequency_agree_between_rates():
    import soxr

    high = decaying_noise(48000)
    both = [analyse(high, 48000), analyse(soxr.resample(high, 48000, 16000, quality="VHQ"), 16000)]
    levels_db = [np.interp(bands_hz(8000)[:6], *rir.response) for rir in both]
    assert np.abs(levels_db[0] - levels_db[1]).max() < 0.5


@pytest.mark.parametrize("samples, fs_hz, rule", [
    (np.zeros(8000), 16000, "silent"), (np.ones((2, 800)), 16000, "mono"), (np.full(800, np.nan), 16000, "finite"),
    (np.ones(800), 4000, "8000")])
def test_what_cannot_be_analysed_is_refused_by_name(samples, fs_hz, rule):
    with pytest.raises(ValueError, match=f"^hall: .*{rule}"):
        analyse(samples, fs_hz, "hall")


def test_values_that_are_not_valid_are_none():
    parameters = dict(t30_s=[0.5, 0.6], t30_valid=[False, True], t20_s=[0.4, 0.5], t20_valid=[True, True])
    assert value_of(parameters, "t30", 0) is None and value_of(parameters, "t30", 1) == 0.6
    assert value_of(parameters, "c50", 0) is None and value_of(parameters, "t30", 7) is None
    assert reverberation_time_s(parameters, 0) == 0.4 and reverberation_time_s(parameters, 1) == 0.6
