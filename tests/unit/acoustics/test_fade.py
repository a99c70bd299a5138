"""A fade-out or silence at the end of a response against the same response without it."""

import numpy as np
import pytest
from test_iso3382 import DIRECT, room

from roomeq.acoustics.fade import length_before_fade
from roomeq.acoustics.iso3382 import all_metrics
from roomeq.acoustics.parameters import measure
from roomeq.core.constants import FS_HZ
from roomeq.loop.features import feature_slice, measure_features

WINDOWS = dict(linear=lambda x: 1.0 - x, hann=lambda x: 0.5 + 0.5 * np.cos(np.pi * x))


def faded(rir, share, window):
    n = round(share * (len(rir) - DIRECT))
    return rir * np.append(np.ones(len(rir) - n), WINDOWS[window](np.linspace(0.0, 1.0, n)))


@pytest.mark.parametrize("share", [0.2, 0.3, 0.5])
@pytest.mark.parametrize("window", ["linear", "hann"])
@pytest.mark.parametrize("time_s, snr_db", [(0.5, 55.0), (0.7, 50.0)])
def test_fade_out_changes_no_decay_time(time_s, snr_db, window, share):
    rir = room(time_s, snr_db=snr_db, length_s=1.6)
    whole, cut = (all_metrics(of_file, FS_HZ) for of_file in (rir, faded(rir, share, window)))
    for decay in ("t20", "t30"):
        valid = np.array(cut[f"{decay}_valid"])
        assert valid[2:].all()
        errors = np.array(cut[f"{decay}_s"])[valid] / np.array(whole[f"{decay}_s"])[valid] - 1.0
        assert np.abs(errors[2:]).max() < 0.02


def test_noise_of_a_faded_recording_is_that_ahead_of_the_fade():
    rir = room(0.4, snr_db=45.0, length_s=1.6)
    whole, cut = (measure_features(of_file) for of_file in (rir, faded(rir, 0.4, "hann")))
    levels_db = [10.0 * np.log10(of_rir.white[3:]) for of_rir in (whole, cut)]
    np.testing.assert_allclose(*levels_db, atol=2.0)
    late = feature_slice("late")
    np.testing.assert_array_equal(cut.valid[late], whole.valid[late])


@pytest.mark.parametrize("rir", [
    *(room(time_s, seed, length_s=length_s, snr_db=snr_db) for seed, (time_s, length_s, snr_db) in enumerate(
        (time_s, length_s, snr_db) for time_s in (0.2, 0.5, 2.0) for length_s in (0.3, 1.0, 3.0)
        for snr_db in (30.0, 60.0, None))),
    np.trim_zeros(np.round(3000.0 * room(0.5, length_s=2.0)), "b"),
    room(0.2) + 0.02 * room(1.5),
    faded(room(0.5, snr_db=50.0), 0.05, "hann")])
def test_responses_without_a_long_fade_are_whole(rir):
    assert length_before_fade(rir, FS_HZ, DIRECT) == len(np.trim_zeros(rir, "b"))


def dithered(rir, silence_s=0.5):
    """Append silence to a response and round it to 16 bits with dither, as sound editors and sox do."""
    step = np.abs(rir).max() * 2.0 ** -14
    padded = np.append(rir, np.zeros(round(silence_s * FS_HZ))) / step
    rng = np.random.default_rng(1)
    return step * np.round(padded + rng.uniform(-0.5, 0.5, len(padded)) + rng.uniform(-0.5, 0.5, len(padded)))


@pytest.mark.parametrize("time_s, snr_db, length_s", [(0.3, 40.0, 0.8), (0.4, 50.0, 0.5), (1.0, 60.0, 0.4)])
def test_dither_behind_a_cut_changes_no_parameter(time_s, snr_db, length_s):
    rir = room(time_s, snr_db=snr_db, length_s=length_s)
    cut, padded = (measure(of_file) for of_file in (rir, dithered(rir)))
    for metric in ("edt", "t20", "t30", "c50"):
        assert padded[f"{metric}_valid"][3:] == cut[f"{metric}_valid"][3:]
    np.testing.assert_array_equal(padded["eq_valid"], cut["eq_valid"])
    np.testing.assert_allclose(padded["eq_db"], cut["eq_db"], atol=0.1)
    for padded_s, cut_s, valid in zip(padded["t20_s"], cut["t20_s"], cut["t20_valid"], strict=True):
        assert not valid or padded_s == pytest.approx(cut_s, rel=0.02)


def test_dither_behind_a_short_fade_changes_no_decay_time():
    rir = faded(room(0.3, snr_db=40.0, length_s=0.8), 0.06, "hann")
    cut, padded = (all_metrics(of_file, FS_HZ) for of_file in (rir, dithered(rir)))
    assert padded["t30_valid"][3:] == cut["t30_valid"][3:]
    np.testing.assert_allclose(padded["t20_s"][3:], cut["t20_s"][3:], rtol=0.02)
