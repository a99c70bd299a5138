"""The gain of late sound near surfaces, against coherent image sources and Waterhouse's limits."""

from functools import partial

import numpy as np
import pytest
import trimesh
from plans import box_plan, prism_obj

from roomeq.core.constants import exact_bands_hz
from roomeq.sim.boundary import near_images
from roomeq.sim.directivity import FirstOrder
from roomeq.sim.images import specular_paths
from roomeq.sim.mesh import load_mesh, make_room
from roomeq.sim.response import simulate_responses
from roomeq.sim.scene import Material, Scene, Shoebox

DIMS_M = (6.2, 4.3, 2.9)
BAND = 3
LATE_S = 0.1, 0.18
MICS_M = np.random.default_rng(5).uniform(0.8, np.array(DIMS_M) - 0.8, (12, 3))
AT_FLOOR = MICS_M * [1.0, 1.0, 0.0] + [0.0, 0.0, 0.03]


def scene_of(room, absorption, scattering=0.0):
    return Scene(room, [Material("all", absorption, scattering)] * len(room.surfaces))


def late_energy(rir, fs_hz):
    """Return the energy of the late part of a response from 250 Hz to 1 kHz: one octave has few modes."""
    first, last = (round(time_s * fs_hz) for time_s in LATE_S)
    spectrum, frequency_hz = np.fft.rfft(rir[first:last]), np.fft.rfftfreq(last - first, 1.0 / fs_hz)
    inside = np.abs(np.log2(frequency_hz[1:] / exact_bands_hz(fs_hz)[BAND])) < 1.5
    return np.sum(np.abs(spectrum[1:][inside]) ** 2)


def of_image_sources(scene, source_m, mic_m):
    images = specular_paths(scene.room, source_m, mic_m, 28)
    pressure = images.gains(scene.absorption, scene.scattering, scene.attenuation_per_m)[:, BAND]
    sample = images.distance_m / scene.air.speed_m_s * scene.fs_hz
    n_samples, whole = round(LATE_S[1] * scene.fs_hz) + 2, np.floor(sample).astype(int)
    rir = np.zeros(n_samples)  # linear interpolation between samples is exact enough below 1.4 kHz
    for place, share in ((whole, 1.0 - (sample - whole)), (whole + 1, sample - whole)):
        inside = place < n_samples
        np.add.at(rir, place[inside], (pressure * share)[inside])
    return rir


@pytest.mark.parametrize("source_m, mics_m", [
    ((2.0, 1.5, 1.5), MICS_M), ((2.0, 1.5, 1.5), AT_FLOOR), ((2.0, 1.5, 0.03), MICS_M), ((2.0, 1.5, 0.03), AT_FLOOR)])
def test_late_level_near_surfaces_is_that_of_coherent_image_sources(source_m, mics_m):
    scene = scene_of(Shoebox(DIMS_M), 0.2)
    simulated = np.mean([late_energy(response.rir, scene.fs_hz) for seed in range(2)
                         for response in simulate_responses(scene, source_m, mics_m, seed=seed)])
    expected = np.mean([late_energy(of_image_sources(scene, source_m, mic_m), scene.fs_hz) for mic_m in mics_m])
    assert 10.0 * np.log10(simulated / expected) == pytest.approx(0.0, abs=1.2)


@pytest.mark.parametrize("point_m, gain", [
    ((5.0, 4.0, 2.0), 1.0), ((5.0, 4.0, 0.01), 2.0), ((5.0, 0.01, 0.01), 4.0), ((0.01, 0.01, 0.01), 8.0)])
def test_gain_is_waterhouses_in_shoebox_and_mesh(point_m, gain, tmp_path):
    (tmp_path / "box.obj").write_text(prism_obj(box_plan(10.0, 8.0), 4.0))
    for room in (Shoebox((10.0, 8.0, 4.0)), load_mesh(tmp_path / "box.obj")):
        scene = scene_of(room, 0.0)
        assert near_images(scene, point_m).gain(scene, scene.absorption)[BAND] == pytest.approx(gain, rel=0.02)
        absorbing = scene_of(room, 1.0)
        np.testing.assert_allclose(near_images(absorbing, point_m).gain(absorbing, absorbing.absorption), 1.0)


@pytest.mark.parametrize("absorption, scattering", [(0.05, 0.0), (0.5, 0.3), (0.8, 0.1)])
@pytest.mark.parametrize("walls", [[2], [1, 2]])
def test_gain_is_that_of_plane_waves_from_all_directions(absorption, scattering, walls):
    """A wall reflects a share of the energy; what it scatters of that is in phase with nothing."""
    scene, point_m = scene_of(Shoebox((10.0, 8.0, 4.0)), absorption, scattering), np.full(3, 2.0)
    point_m[walls] = 0.02
    directions = np.random.default_rng(0).standard_normal((20_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    wave_number = 2.0 * np.pi * exact_bands_hz(scene.fs_hz)[BAND] / scene.air.speed_m_s
    reflected = 1.0 - absorption
    relative = np.ones(len(directions))
    for wall in walls:
        mirrored = np.sqrt(reflected * (1.0 - scattering)) * np.exp(2j * wave_number * directions[:, wall] * 0.02)
        relative *= (np.abs(1.0 + mirrored) ** 2 + reflected * scattering) / (1.0 + reflected)
    gain = near_images(scene, point_m).gain(scene, scene.absorption)[BAND]
    assert 10.0 * np.log10(gain / relative.mean()) == pytest.approx(0.0, abs=0.05)


def test_table_has_no_gain_at_wavelengths_above_twice_its_size(tmp_path):
    shell, table = (trimesh.creation.box(bounds=bounds) for bounds in (
        [(0.0, 0.0, 0.0), (6.0, 5.0, 3.0)], [(2.0, 2.0, 0.7), (3.6, 2.8, 0.74)]))
    room = make_room(np.concatenate([shell.triangles, table.triangles]), ["wall"] * 24)
    scene = scene_of(room, 0.0)
    gain = near_images(scene, (2.8, 2.4, 0.77)).gain(scene, scene.absorption)
    np.testing.assert_allclose(gain[:2], 1.0, atol=0.05)
    np.testing.assert_allclose(gain[2:4], 2.0, atol=0.1)


@pytest.mark.parametrize("pattern, facing, gain", [
    ("omnidirectional", (0.0, 0.0, 1.0), 2.0), ("cardioid", (1.0, 0.0, 0.0), 2.0), ("cardioid", (0.0, 0.0, 1.0), 1.5),
    ("figure_eight", (0.0, 0.0, 1.0), 0.0)])
def test_directivities_hear_the_part_that_is_in_phase(pattern, facing, gain):
    """Close to a rigid floor, the particle velocity has no vertical part."""
    scene = scene_of(Shoebox((10.0, 8.0, 4.0)), 0.0)
    directivity = partial(FirstOrder(pattern, facing).pressure, fs_hz=scene.fs_hz)
    near = near_images(scene, (5.0, 4.0, 0.01), directivity)
    assert near.gain(scene, scene.absorption)[BAND] == pytest.approx(gain, abs=0.04)
