"""Responses at other sample rates than 16 kHz: against physics, and against each other in common octave bands."""

import numpy as np
import pytest

from roomeq.acoustics.air import air_absorption_db_m
from roomeq.acoustics.direct import find_direct
from roomeq.acoustics.iso3382 import all_metrics
from roomeq.acoustics.octaves import octave_bands
from roomeq.acoustics.parameters import measure
from roomeq.core.constants import bands_hz, exact_bands_hz
from roomeq.sim.echogram import compute_echograms
from roomeq.sim.path_sample import sample_paths
from roomeq.sim.response import simulate_responses, trace_source
from roomeq.sim.scene import Air, Material, Scene, Shoebox, eyring_time_s, with_absorption

RATES_HZ = (8000, 16000, 22050, 44100, 48000)
ROOM = Shoebox((6.0, 4.0, 3.0))
ABSORBING = (0.1, 0.12, 0.15, 0.2, 0.25, 0.3, 0.3, 0.35, 0.4)
MICS_M = np.random.default_rng(1).uniform((0.5, 0.5, 0.5), (5.5, 3.5, 2.5), (24, 3))


def scene_at(fs_hz, absorption=ABSORBING, scattering=0.2):
    return Scene(ROOM, [Material("all", absorption, scattering)] * 6, fs_hz=fs_hz)


@pytest.mark.parametrize(("fs_hz", "highest_hz"), [(8000, 4000), (16000, 8000), (22050, 8000), (32000, 16000),
                                                   (44100, 16000), (48000, 16000)])
def test_octave_bands_lie_below_half_the_sample_rate(fs_hz, highest_hz):
    assert bands_hz(fs_hz)[-1] == highest_hz and bands_hz(fs_hz)[0] == 62.5
    assert exact_bands_hz(fs_hz)[-1] < fs_hz / 2
    assert scene_at(fs_hz).absorption.shape == (6, len(bands_hz(fs_hz)))


@pytest.mark.parametrize("fs_hz", [7999, 48001, 44100.5, float("nan")])
def test_sample_rates_out_of_range_are_refused(fs_hz):
    with pytest.raises(ValueError, match="fs=.* must be a whole number of hertz from 8000 to 48000"):
        scene_at(fs_hz)


@pytest.mark.parametrize("fs_hz", RATES_HZ)
def test_direct_sound_has_its_delay_level_and_air_absorption_at_any_rate(fs_hz):
    far_m = 40.0
    room = Shoebox((60.0, 30.0, 20.0))
    scene = Scene(room, [Material("open", 1.0, 0.0)] * 6, fs_hz=fs_hz)
    (response,) = simulate_responses(scene, (5.0, 15.0, 10.0), (5.0 + far_m, 15.0, 10.0), num_rays=200)
    assert response.direct_sample == pytest.approx(fs_hz * far_m / Air().speed_m_s)
    # at 40 m the air delays nothing, but its minimum phase shifts the found onset by a fraction of a sample
    assert find_direct(response.rir, fs_hz)[0] == pytest.approx(response.direct_sample, abs=2.0)
    bands = np.array(exact_bands_hz(fs_hz)[:-1])
    spectrum = np.abs(np.exp(-2j * np.pi * np.outer(bands / fs_hz, np.arange(len(response.rir)))) @ response.rir)
    level_db = 20.0 * np.log10(spectrum * 4.0 * np.pi * far_m)
    assert level_db == pytest.approx(-far_m * air_absorption_db_m(bands), abs=0.2)


def test_decay_and_clarity_agree_between_rates_in_common_bands():
    measured = {}
    for fs_hz in RATES_HZ:
        responses = [response for seed in range(3) for response in simulate_responses(
            scene_at(fs_hz), (2.0, 1.5, 1.5), MICS_M, num_rays=5000, seed=seed)]
        found = [all_metrics(response.rir, fs_hz, response.direct_sample, 1) for response in responses]
        level_db = [10.0 * np.log10(fs_hz * np.sum(octave_bands(response.rir, fs_hz) ** 2, axis=1))
                    for response in responses]
        measured[fs_hz] = [np.mean([row[key] for row in found], axis=0) for key in ("t20_s", "c50_db")] + [
            np.mean(level_db, axis=0)]
    for fs_hz in RATES_HZ:
        # below 250 Hz and in the highest band of a rate, one response scatters too much or the band is cut
        common = slice(2, min(len(bands_hz(fs_hz)), 8) - 1)
        t20_s, c50_db, level_db = (values[common] for values in measured[fs_hz])
        expected = [values[common] for values in measured[16000]]
        assert t20_s == pytest.approx(expected[0], rel=0.05)
        assert c50_db == pytest.approx(expected[1], abs=0.6)
        assert level_db == pytest.approx(expected[2], abs=0.5)


def test_sixteen_kilohertz_band_decays_as_eyring_says_in_a_diffuse_room():
    scene = scene_at(48000, absorption=0.2, scattering=0.9)
    responses = simulate_responses(scene, (2.0, 1.5, 1.5), MICS_M[:8], num_rays=5000, seed=1)
    times_s = np.mean([all_metrics(response.rir, 48000, response.direct_sample, 1)["t20_s"] for response in responses],
                      axis=0)
    assert times_s[4:] == pytest.approx(eyring_time_s(scene)[4:], rel=0.1)


@pytest.mark.parametrize("fs_hz", [8000, 16000, 48000])
def test_absorption_of_a_scene_is_replaced_in_all_of_its_bands(fs_hz):
    scene = scene_at(fs_hz)
    wanted = np.random.default_rng(0).uniform(0.1, 0.5, scene.absorption.shape)
    assert np.array_equal(with_absorption(scene, wanted).absorption, wanted)


def test_ninth_band_is_treated_like_the_first_eight():
    absorption = np.tile(np.linspace(0.1, 0.5, 9), (6, 1))
    absorption[:, 8] = absorption[:, 2]
    scene = scene_at(48000, absorption=tuple(absorption[0]))
    traced = trace_source(scene, (2.0, 1.5, 1.5), num_rays=500, max_length_s=0.3, rng=np.random.default_rng(0))
    gain = np.random.default_rng(1).uniform(0.1, 1.0, (500, 9))
    gain[:, 8] = gain[:, 2]
    full = compute_echograms(traced.paths[0], ROOM, absorption, MICS_M[:2], ism_order=2, n_frames=300,
                             speed_m_s=scene.air.speed_m_s, ray_gain=gain).energy
    assert full.shape == (2, 300, 9) and np.any(full[..., 8]) and np.array_equal(full[..., 8], full[..., 2])
    (sample,) = sample_paths(traced, MICS_M[:1], absorption, [np.random.default_rng(2)], ism_order=2,
                             n_frames=300)
    echogram = sample.echogram(absorption, ray_gain=gain)
    assert np.any(echogram[:, 8]) and np.array_equal(echogram[:, 8], echogram[:, 2])
    only = sample.echogram(absorption, bands=[2, 8], ray_gain=gain)
    assert np.array_equal(only[:, [2, 8]], echogram[:, [2, 8]]) and not np.any(np.delete(only, [2, 8], axis=1))


def test_material_of_eight_bands_keeps_its_highest_value_above_them():
    material = Material("panel", tuple(np.linspace(0.1, 0.8, 8)), 0.1)
    assert Scene(ROOM, [material] * 6, fs_hz=48000).absorption[0, 7:] == pytest.approx([0.8, 0.8])
    nine = Material("panel", tuple(np.linspace(0.1, 0.9, 9)), 0.1)
    assert Scene(ROOM, [nine] * 6, fs_hz=48000).absorption[0, 8] == pytest.approx(0.9)
    assert Scene(ROOM, [nine] * 6, fs_hz=8000).absorption.shape == (6, 7)


@pytest.mark.parametrize("fs_hz", [8000, 48000])
def test_acoustic_parameters_have_a_value_per_band_and_no_eq_away_from_16_khz(fs_hz):
    (response,) = simulate_responses(scene_at(fs_hz), (2.0, 1.5, 1.5), (4.0, 3.0, 1.2), num_rays=2000)
    parameters = measure(response.rir, fs_hz)
    assert len(parameters["t30_s"]) == len(parameters["c50_valid"]) == len(bands_hz(fs_hz))
    assert "eq_db" not in parameters
