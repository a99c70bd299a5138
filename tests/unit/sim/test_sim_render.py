"""The synthesis of responses: its low thirds of octaves have a lower sample rate, which must not be heard."""

import numpy as np
import pytest

from roomeq.acoustics.iso3382 import all_metrics
from roomeq.core.constants import exact_bands_hz
from roomeq.sim import render

LENGTH_S = 1.2


def echogram(n_bands, onset_s=0.01):
    """Decays of 1.2 s in the lowest octave to 0.35 s in the highest, shape (n_frames, n_bands)."""
    middle_s = (np.arange(LENGTH_S / render.FRAME_S) + 0.5)[:, None] * render.FRAME_S
    decays = np.exp(-6.0 * np.log(10.0) * middle_s / np.linspace(1.2, 0.35, n_bands)) * render.FRAME_S
    return np.where(middle_s > onset_s, decays, 0.0)


@pytest.mark.parametrize("fs_hz", [8000.0, 16000.0, 48000.0])
def test_low_thirds_at_a_lower_rate_are_those_at_the_full_rate(fs_hz, monkeypatch):
    n_samples, octaves_hz = int(LENGTH_S * fs_hz), np.array(exact_bands_hz(fs_hz))
    distance_m, level = np.array([3.3, 5.1, 6.2, 7.7]), np.array([0.01, 0.006, -0.006, 0.004])
    gains = np.outer(level, np.linspace(1.0, 0.4, len(octaves_hz)))
    noise = render.tail_noise(n_samples, 100.0, 343.0, np.random.default_rng(1), fs_hz)

    def rendered():
        return render.render(distance_m, gains, echogram(len(octaves_hz)), noise, speed_m_s=343.0, n_samples=n_samples,
                             fs_hz=fs_hz)

    low = rendered()
    monkeypatch.setattr(render, "_LOW_SHARE", 0.0)
    full = rendered()
    assert not np.array_equal(low, full)  # some thirds have the lower rate
    spectrum, error = np.abs(np.fft.rfft(full)) ** 2, np.abs(np.fft.rfft(low - full)) ** 2
    octave = np.round(np.log2(np.maximum(np.fft.rfftfreq(n_samples, 1.0 / fs_hz), 1.0) / octaves_hz[0]))
    for band in range(len(octaves_hz)):
        assert error[octave == band].sum() < 1e-3 * spectrum[octave == band].sum()
    measured, expected = all_metrics(low, fs_hz), all_metrics(full, fs_hz)
    for decay in ("edt_s", "t20_s", "t30_s"):
        np.testing.assert_allclose(measured[decay], expected[decay], rtol=0.005)
    np.testing.assert_allclose(measured["c50_db"], expected["c50_db"], atol=0.1)  # a tenth of a JND
