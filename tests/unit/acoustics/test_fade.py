"""A fade-out or silence at the end of a response against the same response without it."""

import numpy as np
import pytest
from scipy.signal import butter, sosfilt
from test_iso3382 import DIRECT, room

from roomeq.acoustics.fade import length_before_fade, length_before_last_bit
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
    np.round(3000.0 * room(0.5, length_s=1.0, snr_db=60.0)),
    room(0.2) + 0.02 * room(1.5),
    faded(room(0.5, snr_db=50.0), 0.05, "hann")])
def test_responses_without_a_long_fade_are_whole(rir):
    assert length_before_fade(rir, FS_HZ, DIRECT) == len(np.trim_zeros(rir, "b"))


@pytest.mark.parametrize("quantise", [np.round, np.floor, np.trunc])
def test_the_last_bit_is_neither_decay_nor_noise(quantise):
    """Slow decay at low frequencies, as in most rooms: the last bit follows its sign, not that of the other bands."""
    below_400 = butter(4, 400.0, fs=FS_HZ, output="sos")
    for seed in range(6):
        rir = 3.0 * sosfilt(below_400, room(1.0, seed)) + room(0.4, 50 + seed, direct=10.0)
        exact, quiet = (all_metrics(h, FS_HZ, DIRECT, 1) for h in (rir, quantise(300.0 * rir / np.abs(rir).max())))
        for decay in ("t20", "t30"):
            valid = np.array(quiet[f"{decay}_valid"][1:])
            exact_s, quiet_s = (np.array(of_file[f"{decay}_s"][1:])[valid] for of_file in (exact, quiet))
            np.testing.assert_allclose(quiet_s.astype(float), exact_s.astype(float), rtol=0.15)


def test_last_bit_of_a_response_with_an_offset_is_found():
    step = 2.0 ** -15
    rir = step * np.floor(1000.0 * room(0.3) / 2.0 + 40.0)
    assert 0.25 < (length_before_last_bit(rir, FS_HZ) - DIRECT) / FS_HZ < 0.35
    assert length_before_last_bit(rir + 1e-3 * step * room(1.0), FS_HZ) == len(rir)


def test_a_decay_to_the_smallest_numbers_has_no_last_bit():
    rir = room(0.2, length_s=1.0) * np.append(np.ones(DIRECT), np.geomspace(1.0, 1e-320, FS_HZ))
    with np.errstate(all="raise", under="ignore"):
        assert length_before_last_bit(rir, FS_HZ) == len(rir)


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
    for padded_db, cut_db in zip(padded["band_noise_floor_db"][3:], cut["band_noise_floor_db"][3:], strict=True):
        assert padded_db == (None if cut_db is None else pytest.approx(cut_db, abs=0.5))
    np.testing.assert_array_equal(padded["eq_valid"], cut["eq_valid"])
    np.testing.assert_allclose(padded["eq_db"], cut["eq_db"], atol=0.1)
    for padded_s, cut_s, valid in zip(padded["t20_s"], cut["t20_s"], cut["t20_valid"], strict=True):
        assert not valid or padded_s == pytest.approx(cut_s, rel=0.02)


def test_dither_behind_a_short_fade_changes_no_decay_time():
    rir = faded(room(0.3, snr_db=40.0, length_s=0.8), 0.06, "hann")
    cut, padded = (all_metrics(of_file, FS_HZ) for of_file in (rir, dithered(rir)))
    assert padded["t30_valid"][3:] == cut["t30_valid"][3:]
    np.testing.assert_allclose(padded["t20_s"][3:], cut["t20_s"][3:], rtol=0.02)
