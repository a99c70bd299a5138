"""Signal processing of augmentation: equation 1 against plain numpy, alignment, SNR, level."""

import numpy as np
import pytest
from datadirs import burst, decay
from hypothesis import given, settings
from hypothesis import strategies as st

from roomeq.augment.mix import (
    BLOCK,
    PEAK_LIMIT,
    convolve,
    direct_shift,
    loop,
    mean_power,
    mix,
    spectra_of,
    without_rumble,
)

SAMPLE = np.float32(2**-16)


def db(ratio):
    return 10 * np.log10(ratio)


@pytest.mark.parametrize("n_samples, n_taps, start", [
    (1, 1, 0), (100, 4000, 0), (5000, 1, 0), (5000, 300, 299), (40000, 16001, 712), (200001, 1000, 99), (300, 300, 7),
    (BLOCK, BLOCK, BLOCK - 1), (BLOCK, BLOCK + 1, BLOCK), (9 * BLOCK, 5 * BLOCK + 1, 5 * BLOCK),
    (9, 9 * BLOCK, 8 * BLOCK)])
def test_convolution_matches_numpy(n_samples, n_taps, start):
    rng = np.random.default_rng(3)
    x, h = rng.standard_normal(n_samples), rng.standard_normal(n_taps)
    expected = np.convolve(x, h)[start:start + n_samples]
    y = convolve(spectra_of(x.astype(np.float32)), h.astype(np.float32), start, n_samples)
    assert y.shape == (n_samples,) and y.dtype == np.float32
    assert np.max(np.abs(y[:len(expected)] - expected)) < 2e-5 * np.sqrt(n_taps) * np.abs(x).max()


@given(n=st.integers(1, 3000), m=st.integers(1, 500), data=st.data())
@settings(max_examples=40)
def test_convolution_matches_numpy_at_any_lengths(n, m, data):
    start = data.draw(st.integers(0, m - 1))
    rng = np.random.default_rng(n * 1000 + m)
    x, h = rng.standard_normal(n), rng.standard_normal(m)
    y = convolve(spectra_of(x.astype(np.float32)), h.astype(np.float32), start, n)
    assert np.allclose(y, np.convolve(x, h)[start:start + n], atol=1e-4 * np.sqrt(m))


@pytest.mark.parametrize("n_samples", [1, 255, 256, 257, 1000])
def test_mean_power_counts_every_sample(n_samples):
    x = np.random.default_rng(n_samples).standard_normal(n_samples).astype(np.float32)
    assert mean_power(x) == pytest.approx(np.mean(x.astype(float) ** 2), rel=1e-6)


@pytest.mark.parametrize("polarity", [1, -1])
@pytest.mark.parametrize("reflection", [0.0, 1.8, -1.8])
def test_reverberated_speech_is_aligned_to_the_clean_speech(polarity, reflection):
    """Also with inverted polarity, and if the first reflection is stronger than the direct sound."""
    rng = np.random.default_rng(5)
    h = polarity * decay(rng, direct=333)
    h[333 + 40] += polarity * reflection
    x = burst(rng, 32000).astype(np.float32)
    shift = direct_shift(dict(id="h"), h)
    assert shift == 333
    y = convolve(spectra_of(x), h.astype(np.float32), shift, len(x))
    lags = np.arange(-30, 31)
    correlation = [polarity * np.dot(x[100:-100], np.roll(y, -lag)[100:-100]) for lag in lags]
    assert lags[np.argmax(correlation)] == 0


def test_direct_shift_prefers_row_then_parameters_then_onset():
    h = decay(np.random.default_rng(5), direct=333)
    parameters = dict(acoustic_parameters=dict(direct_sample=330.6))
    assert direct_shift(dict(id="h", direct_sample=331.7) | parameters, h) == 332
    assert direct_shift(dict(id="h") | parameters, h) == 331
    assert direct_shift(dict(id="h", direct_sample=None, acoustic_parameters=None), h) == 333


@pytest.mark.parametrize("row, h, message", [
    (dict(id="h", direct_sample=5000.0), np.ones(4000), r"direct_sample=5000.0 of RIR h must lie in its 4000 samples"),
    (dict(id="h", direct_sample=-3.0), np.ones(4000), "direct_sample=-3.0 of RIR h"),
    (dict(id="h"), np.zeros(4000), "RIR h: impulse response is silent")])
def test_rir_without_direct_sound_is_named(row, h, message):
    with pytest.raises(ValueError, match=message):
        direct_shift(row, h)


def test_mix_matches_equation_1():
    """x_r = g (x*h_s + a n*h_i + b d), a and b from the SNRs, g from the clean RMS."""
    rng = np.random.default_rng(7)
    x, h, h_i = burst(rng, 30000, 0.02), decay(rng), decay(rng, direct=150)
    n, d = rng.standard_normal(30000 + len(h_i) - 1), rng.standard_normal(30000)
    speech, point = np.convolve(x, h)[100:100 + 30000], np.convolve(n, h_i)[len(h_i) - 1:len(h_i) - 1 + 30000]
    a = np.sqrt(np.mean(speech**2) / np.mean(point**2) / 10**1.2)
    b = np.sqrt(np.mean(speech**2) / np.mean(d**2) / 10**0.5)
    raw = speech + a * point + b * d
    expected = raw * np.sqrt(np.mean(x**2) / np.mean(raw**2))

    x32, h32, h_i32 = (v.astype(np.float32) for v in (x, h, h_i))
    point32 = convolve(spectra_of(n.astype(np.float32)), h_i32, len(h_i) - 1, 30000)
    mixed = mix(x32, convolve(spectra_of(x32), h32, 100, 30000), [(d.astype(np.float32), 5.0), (point32, 12.0)])
    assert np.max(np.abs(mixed.samples - expected)) < SAMPLE
    assert mixed.peak_gain_db == 0.0
    assert mixed.gain_db == pytest.approx(db(np.mean(x**2) / np.mean(raw**2)), abs=1e-3)
    assert mixed.snr_db == pytest.approx(db(np.mean(speech**2) / np.mean((a * point + b * d) ** 2)), abs=1e-3)


@pytest.mark.parametrize("snr_db", [-20.0, 0.0, 15.0, 60.0])
def test_mix_meets_the_snr(snr_db):
    rng = np.random.default_rng(8)
    x, noise = burst(rng, 50000).astype(np.float32), rng.standard_normal(50000).astype(np.float32)
    mixed = mix(x, x, [(noise, snr_db)])
    gain = 10 ** (mixed.gain_db / 20)
    added = mixed.samples / gain - x
    assert db(mean_power(x) / mean_power(added)) == pytest.approx(snr_db, abs=0.02)
    assert mixed.snr_db == pytest.approx(snr_db, abs=0.01)


@pytest.mark.parametrize("fs_hz", [8000, 16000, 22050, 48000])
@pytest.mark.parametrize("frequency_hz, largest_db", [(0.0, -120.0), (5.0, -30.0), (10.0, -18.0)])
def test_rumble_is_removed(fs_hz, frequency_hz, largest_db):
    x = np.cos(2 * np.pi * frequency_hz * np.arange(2 * fs_hz) / fs_hz + 1.0).astype(np.float32)
    assert db(mean_power(without_rumble(x, fs_hz)[fs_hz // 2:-fs_hz // 2]) + 1e-13) < db(0.5) + largest_db


@pytest.mark.parametrize("fs_hz", [8000, 16000, 22050, 48000])
@pytest.mark.parametrize("frequency_hz", [40.0, 100.0, 780.0, 800.0, 1000.0])
def test_sound_stays_as_it_is(fs_hz, frequency_hz):
    x = np.cos(2 * np.pi * frequency_hz * np.arange(2 * fs_hz) / fs_hz + 1.0).astype(np.float32)
    np.testing.assert_allclose(without_rumble(x, fs_hz)[fs_hz // 2:-fs_hz // 2], x[fs_hz // 2:-fs_hz // 2], atol=0.02)


@pytest.mark.parametrize("n_samples", [1, 7, 20, 21, 1000])
def test_short_signal_has_rumble_removed(n_samples):
    x = np.random.default_rng(0).standard_normal(n_samples).astype(np.float32)
    result = without_rumble(x, 16000)
    assert result.shape == x.shape and result.dtype == np.float32 and np.all(np.isfinite(result))


def test_mix_has_the_level_of_the_clean_utterance():
    rng = np.random.default_rng(8)
    x, reverberated = burst(rng, 50000).astype(np.float32), (7 * burst(rng, 50000)).astype(np.float32)
    mixed = mix(x, reverberated, [])
    assert mixed.peak_gain_db == 0 and mixed.snr_db is None
    assert mean_power(mixed.samples) == pytest.approx(mean_power(x), rel=1e-4)


def test_high_peak_reduces_the_level():
    x = np.full(1000, 0.5, np.float32)
    reverberated = np.full(1000, 0.01, np.float32)
    reverberated[500] = -1.0
    mixed = mix(x, reverberated, [])
    assert np.abs(mixed.samples).max() == pytest.approx(PEAK_LIMIT, rel=1e-5)
    assert mixed.peak_gain_db < -3
    assert np.allclose(mixed.samples, reverberated * 10 ** (mixed.gain_db / 20), rtol=1e-4)


@pytest.mark.parametrize("clean, reverberated, noise, message", [
    (0, 1, 1, "utterance is silent"), (1, 0, 1, "reverberated utterance is silent"), (1, 1, 0, "noise is silent")])
def test_silent_input_is_refused(clean, reverberated, noise, message):
    signals = [np.full(100, value, np.float32) for value in (clean, reverberated, noise)]
    with pytest.raises(ValueError, match=message):
        mix(signals[0], signals[1], [(signals[2], 10.0)])


def test_looped_noise_has_no_click_and_keeps_its_power():
    rng = np.random.default_rng(2)
    tone = np.sin(2 * np.pi * 100.3 * np.arange(9000) / 16000).astype(np.float32)
    looped = loop(tone, 123, 50000)
    assert looped.shape == (50000,)
    assert np.abs(np.diff(looped)).max() < 1.5 * np.abs(np.diff(tone)).max()
    noise = rng.standard_normal(9000).astype(np.float32)
    assert db(mean_power(loop(noise, 5, 90000)) / mean_power(noise)) == pytest.approx(0, abs=0.15)
    ring = 9000 - 800
    assert np.array_equal(loop(noise, 5, 2 * ring)[:ring], loop(noise, 5, 2 * ring)[ring:])
    assert np.array_equal(loop(noise, 1000, 100), noise[1000:1100])


@pytest.mark.parametrize("n_noise", [1, 2, 3, 5])
def test_noise_of_a_few_samples_can_be_looped(n_noise):
    assert np.all(loop(np.ones(n_noise, np.float32), 3, 100) >= 1)
