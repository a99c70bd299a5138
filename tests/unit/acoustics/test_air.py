"""Air and the octave filter bank against the standard and against what they promise."""

import numpy as np
import pytest

from roomeq.acoustics.air import air_absorption_db_m, band_attenuation_per_m, speed_of_sound_m_s
from roomeq.acoustics.filterbank import octave_filterbank
from roomeq.acoustics.octaves import octave_gains
from roomeq.core.constants import EXACT_BANDS_HZ, FS_HZ, exact_bands_hz

# ISO 9613-2:1996, table 2 (computed by ISO 9613-1 at the exact mid-band frequencies 63 Hz to 8 kHz) [dB/km]
TABLE_DB_KM = {
    (10, 70): (0.1, 0.4, 1.0, 1.9, 3.7, 9.7, 32.8, 117),
    (20, 70): (0.1, 0.3, 1.1, 2.8, 5.0, 9.0, 22.9, 76.6),
    (30, 70): (0.1, 0.3, 1.0, 3.1, 7.4, 12.7, 23.1, 59.3),
    (15, 20): (0.3, 0.6, 1.2, 2.7, 8.2, 28.2, 88.8, 202),
    (15, 50): (0.1, 0.5, 1.2, 2.2, 4.2, 10.8, 36.2, 129),
    (15, 80): (0.1, 0.3, 1.1, 2.4, 4.1, 8.3, 23.7, 82.8),
}


@pytest.mark.parametrize("air", TABLE_DB_KM)
def test_air_absorption_matches_iso_9613_table(air):
    computed = 1000.0 * air_absorption_db_m(EXACT_BANDS_HZ, *air)
    for value, listed in zip(computed, TABLE_DB_KM[air], strict=True):
        printed_to = 1.0 if listed >= 100 else 0.1
        assert abs(value - listed) <= 0.5 * printed_to + 0.005 * listed


def test_air_absorption_agrees_with_pyfar():
    pyfar = pytest.importorskip("pyfar")
    for temperature_c, humidity in ((5.0, 0.3), (20.0, 0.5), (28.0, 0.8)):
        expected, *_ = pyfar.constants.air_attenuation(temperature_c, np.array(EXACT_BANDS_HZ), humidity)
        computed = air_absorption_db_m(EXACT_BANDS_HZ, temperature_c, 100.0 * humidity)
        # pyfar returns dB per metre
        np.testing.assert_allclose(computed, np.ravel(expected), rtol=0.005)


def test_band_attenuation_applies_to_energy():
    per_m = np.array(band_attenuation_per_m(20.0, 50.0, 48000))[:8]
    np.testing.assert_allclose(10.0 * np.log10(np.exp(per_m)), air_absorption_db_m(EXACT_BANDS_HZ), rtol=1e-9)


@pytest.mark.parametrize("fs_hz", [8000, 16000])
@pytest.mark.parametrize("humidity_pct", [20.0, 50.0, 80.0])
def test_octave_at_half_the_sample_rate_decays_as_what_is_recorded_of_it(fs_hz, humidity_pct):
    band_hz, speed_m_s, of_room_per_s = exact_bands_hz(fs_hz)[-1], speed_of_sound_m_s(20.0), 6.0 * np.log(10.0) / 0.5
    frequency_hz = np.fft.rfftfreq(4096, 1.0 / fs_hz)
    per_s = of_room_per_s + speed_m_s * air_absorption_db_m(frequency_hz, 20.0, humidity_pct) * np.log(10.0) / 10.0
    time_s = np.linspace(0.0, 0.5, 1000)
    curve = octave_gains(4096, fs_hz, band_hz) ** 2 / per_s @ np.exp(-np.outer(per_s, time_s))
    level_db = 10.0 * np.log10(curve / curve[0])
    in_t30 = (level_db < -5.0) & (level_db > -35.0)
    t30_s = -60.0 / np.polyfit(time_s[in_t30], level_db[in_t30], 1)[0]
    of_band_per_s = of_room_per_s + speed_m_s * band_attenuation_per_m(20.0, humidity_pct, fs_hz)[-1]
    assert 6.0 * np.log(10.0) / of_band_per_s == pytest.approx(t30_s, rel=0.015)


def test_speed_of_sound_at_reference_temperatures():
    assert speed_of_sound_m_s(20.0) == pytest.approx(343.2)
    assert speed_of_sound_m_s(0.0) == pytest.approx(331.3, abs=0.1)


@pytest.mark.parametrize("given, message", [
    (dict(temperature_c=99.0), r"temperature_c=99 must lie in \[-20, 50\]"),
    (dict(humidity_pct=-1.0), r"humidity_pct=-1 must lie in \[0, 100\]"),
    (dict(pressure_kpa=1.0), r"pressure_kpa=1 must lie in \[10, 200\]"),
])
def test_impossible_air_is_rejected(given, message):
    with pytest.raises(ValueError, match=message):
        air_absorption_db_m(1000.0, **given)


@pytest.mark.parametrize("n_fft", [8192, 24300])
def test_filterbank_gains_sum_to_one(n_fft):
    gains = octave_filterbank(n_fft, FS_HZ)
    np.testing.assert_allclose(gains.sum(axis=0), 1.0, atol=1e-12)
    frequency = np.fft.rfftfreq(n_fft, 1.0 / FS_HZ)
    for band, mid_hz in enumerate(EXACT_BANDS_HZ):
        assert gains[band, np.argmin(np.abs(frequency - mid_hz))] > 0.99
    assert np.all(gains[0, frequency < 60.0] == 1.0) and np.all(gains[7, frequency > 7950.0] == 1.0)
