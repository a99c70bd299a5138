"""Path samples against exact echograms, and the directions in which specular paths leave the source."""

import os
import subprocess
import sys
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import trimesh

from roomeq.core.rng import rng_for
from roomeq.sim.context import make_render_context, ray_echograms
from roomeq.sim.directivity import FirstOrder
from roomeq.sim.echogram import compute_echograms
from roomeq.sim.images import specular_paths
from roomeq.sim.mesh import make_room
from roomeq.sim.path_sample import PATHS_PER_FRAME, sample_paths
from roomeq.sim.response import trace_source
from roomeq.sim.scene import Air, Material, Scene, Shoebox
from roomeq.sim.target import scaled_absorption

C = Air().speed_m_s
DIMS_M, SOURCE, MICS = (8.0, 6.0, 3.2), (2.1, 3.3, 1.5), [(5.731, 2.217, 1.243), (4.4, 4.9, 1.9)]
N_FRAMES, ISM_ORDER = 900, 3


def box_scene(absorption, scattering):
    absorption = np.broadcast_to(absorption, (6, 8))
    return Scene(Shoebox(DIMS_M), [Material(f"wall{n}", tuple(row), scattering) for n, row in enumerate(absorption)])


def traced(scene, seed=0, num_rays=8000):
    return trace_source(scene, SOURCE, num_rays=num_rays, max_length_s=1.0, rng=np.random.default_rng(seed))


def exact(one, absorption, n=0):
    """All bands by `compute_echograms`, each from the trace that serves it, shape (n_frames, 8)."""
    result = np.empty((N_FRAMES, 8))
    for band, column in enumerate(one.trace_of_band):
        energy = compute_echograms(one.paths[column], one.scene.room, absorption, MICS[n:n + 1], ism_order=ISM_ORDER,
                        n_frames=N_FRAMES, speed_m_s=C).energy
        result[:, band] = energy[0, :, band]
    return result


def kept(one, absorption, mics=MICS, names="ab"):
    """Sample for absorption of shape (6,), in all bands, or (6, 8)."""
    rngs = [rng_for(0, "echoes", name) for name in names[:len(mics)]]
    absorption = np.asarray(absorption, float)
    absorption = np.broadcast_to(absorption[:, None] if absorption.ndim == 1 else absorption, (6, 8))
    return sample_paths(one, mics, absorption, rngs, ism_order=ISM_ORDER, n_frames=N_FRAMES)


def smooth_db(energy, ours):
    """Error of the mean over seven frames [dB], down to -60 dB of the decay."""
    window = np.ones(7) / 7.0
    mean, found = (np.convolve(values, window, "valid") for values in (energy, ours))
    remaining = np.cumsum(mean[::-1])[::-1]
    held = (remaining > 1e-6 * remaining[0]) & (mean > 0.0)
    return 10.0 * np.log10(np.maximum(found[held], 1e-30) / mean[held])


@pytest.mark.parametrize("scattering", [0.3, (0.1, 0.1, 0.1, 0.4, 0.4, 0.4, 0.4, 0.4)])
def test_sampled_echogram_is_exact_where_all_bands_absorb_alike(scattering):
    absorption = np.linspace(0.03, 0.2, 6)
    one = traced(box_scene(absorption[:, None], scattering))
    for n, sample in enumerate(kept(one, absorption)):
        everything = exact(one, one.scene.absorption, n)
        assert everything[-1].min() > 0.0
        np.testing.assert_allclose(sample.echogram(one.scene.absorption), everything, rtol=1e-4)
        only = sample.echogram(one.scene.absorption, bands=[4])
        np.testing.assert_allclose(only[:, 4], everything[:, 4], rtol=1e-4)
        assert not only[:, :4].any()


@pytest.mark.parametrize("exponent", [0.3, 0.6, 1.7, 3.0])
def test_sampled_echogram_is_unbiased_off_reference(exponent):
    """Noise of the 7 ms mean: below 0.6 dB for 0.3 to 3 times the absorption of the reference."""
    one = traced(box_scene(0.12, 0.3))
    (sample,) = kept(one, np.full(6, 0.12), MICS[:1])
    other = scaled_absorption(one.scene.absorption, exponent)
    error_db = smooth_db(exact(one, other)[:, 4], sample.echogram(other)[:, 4])
    assert np.std(error_db) < (0.35 if 0.5 < exponent < 2.0 else 0.6)
    assert abs(np.mean(error_db)) < 0.1


@pytest.mark.parametrize("exponent", [0.5, 1.0, 1.6])
def test_sample_has_the_decay_of_all_paths_where_few_rays_carry_it(exponent):
    """Under an absorbing ceiling, the energy of single rays is limited (`roomeq.sim.ray_limits`)."""
    base, offset_db = np.tile(np.array([0.04, 0.06, 0.05, 0.08, 0.08, 0.8])[:, None], 8), []
    absorption = scaled_absorption(base, exponent)
    for seed in range(4):
        one = trace_source(box_scene(base, 0.1), SOURCE, num_rays=10000, max_length_s=1.0,
                           rng=np.random.default_rng(seed), absorption=scaled_absorption(base, 0.5))
        (sample,) = kept(one, base, MICS[:1])
        offset_db.append(np.mean(smooth_db(exact(one, absorption)[:, 4], sample.echogram(absorption)[:, 4])))
    assert abs(np.mean(offset_db)) < (0.01 if exponent == 1.0 else 0.3)


def test_sample_distinguishes_surfaces_and_bands():
    absorption = np.outer([0.02, 0.1, 0.05, 0.3, 0.15, 0.5], np.linspace(0.4, 1.2, 8))
    noise_db, offset_db = [], []
    for seed in range(3):
        one = traced(box_scene(absorption, 0.3), seed)
        (sample,) = kept(one, one.scene.absorption, MICS[:1])
        everything, found = exact(one, one.scene.absorption), sample.echogram(one.scene.absorption)
        error_db = [smooth_db(everything[:, band], found[:, band]) for band in range(8)]
        noise_db.append([np.std(band_db) for band_db in error_db])
        offset_db.append([np.mean(band_db) for band_db in error_db])
    assert np.max(np.mean(noise_db, axis=0)) < 0.6
    assert np.max(np.abs(np.mean(offset_db, axis=0))) < 0.1


@pytest.mark.parametrize("greatest", [0.9, 0.999, 1.0])
def test_no_path_outweighs_all_paths_at_least_absorption(greatest):
    """Where some bands absorb nearly everything, a path still has no more energy than all have at the least."""
    absorption = np.full((6, 8), 0.1)
    absorption[:4, 2:5] = greatest
    one = traced(box_scene(absorption, 0.3), num_rays=4000)
    everything = exact(one, absorption)
    (sample,) = kept(one, absorption, MICS[:1])
    assert np.isfinite(sample.weight).all()
    share = np.prod((1.0 - absorption) ** sample.reflection_counts[0, ..., None].astype(float), axis=2)
    energy = sample.weight[0, ..., None] * share
    assert (energy <= 1.001 * everything[:, :1, None].max(axis=2)[:, None]).all()
    found = sample.echogram(absorption)
    assert np.isfinite(found).all()
    for band in range(8):
        assert 10.0 * np.log10(found[:, band].sum() / everything[:, band].sum()) == pytest.approx(0.0, abs=0.5)


@pytest.mark.parametrize("scene", [
    pytest.param(box_scene(0.02, 0.3), id="long rays"),
    pytest.param(Scene(make_room(trimesh.creation.box(bounds=[(0.0, 0.0, 0.0), (4.0, 4.0, 3.0)]).triangles,
                                 [f"triangle{n}" for n in range(12)]),
                       [Material(f"triangle{n}", 0.1, 0.3) for n in range(12)]), id="many surfaces")])
def test_reflections_are_counted_along_the_way(scene):
    one = trace_source(scene, SOURCE, num_rays=1000, max_length_s=3.0, rng=np.random.default_rng(0))
    (paths,), n_surfaces = one.paths, len(scene.room.surfaces)
    (sample,) = sample_paths(one, np.array([[3.0, 2.0, 1.2]]), scene.absorption, [rng_for(0, "echoes", "a")],
                             ism_order=ISM_ORDER, n_frames=3000)
    assert paths.counts.max() > 255 or n_surfaces > 8
    for frame, place in [(10, 0), (300, 5), (1200, 15), (2500, 1)]:
        last, ray = int(sample.last_reflection[0, frame, place]), sample.rays[0, frame, place]
        met = paths.face_surface[paths.codes[paths.first[ray]:last + 1] >> 2]
        np.testing.assert_array_equal(sample.reflection_counts[0, frame, place],
                                      np.bincount(met, minlength=n_surfaces))


def test_fully_absorbing_surfaces_silence_their_paths():
    one = traced(box_scene(0.2, 0.3), num_rays=1000)
    (sample,) = kept(one, np.full(6, 0.2), MICS[:1])
    assert not sample.echogram(np.ones((6, 8))).any() and sample.echogram(np.zeros((6, 8))).all(axis=1)[100:500].all()


def test_ray_gains_apply_to_their_own_paths():
    one = traced(box_scene(0.2, 0.6), num_rays=4000)
    (sample,) = kept(one, np.full(6, 0.2), MICS[:1])
    up = (one.paths[0].directions[:, 2] > 0.0).astype(float)[:, None] * np.ones(8)
    parts = [sample.echogram(one.scene.absorption, ray_gain=gain) for gain in (up, 1.0 - up)]
    np.testing.assert_allclose(parts[0] + parts[1], sample.echogram(one.scene.absorption), rtol=1e-5)
    late = parts[0][100:, 4].sum() / (parts[0] + parts[1])[100:, 4].sum()
    assert late == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize("height_m", [0.03, 1.2])
@pytest.mark.parametrize("facing", [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)])
@pytest.mark.parametrize("pattern", ["cardioid", "figure_eight"])
def test_specular_sound_reaches_directive_microphones_as_from_image_sources(pattern, facing, height_m):
    """Near a surface, a ray may be reflected within the receiver sphere: its sound doesn't come from that place."""
    scene, mic_m, n_frames = box_scene(0.1, 0.0), np.array([4.0, 3.0, height_m]), 130
    directivity = partial(FirstOrder(pattern, facing).pressure, fs_hz=scene.fs_hz)
    images = specular_paths(scene.room, SOURCE, mic_m, 25)
    late = (images.surface_counts.sum(axis=1) > 1) & (images.distance_m < n_frames * 1e-3 * scene.air.speed_m_s)
    power = images.gains(scene.absorption, scene.scattering, scene.attenuation_per_m)[late, 4] ** 2
    expected = np.sum(power * directivity(images.arrival[late])[:, 4] ** 2) / np.sum(power)
    source = traced(scene, num_rays=40_000)
    one, = sample_paths(source, [mic_m], scene.absorption, [np.random.default_rng(0)], ism_order=1, n_frames=n_frames)
    arrival = one.gain_of_arrivals(source.paths, mic_m, directivity)
    directive, plain = (one.echogram(scene.absorption, arrival_gain=gain)[:, 4].sum() for gain in (arrival, None))
    assert 10.0 * np.log10(directive / plain / expected) == pytest.approx(0.0, abs=0.4)


def test_frames_follow_the_speed_of_sound():
    """A sample that was drawn at one speed of sound serves another: the echogram is that of all paths at that speed."""
    scene = box_scene(0.12, 0.3)
    one = traced(scene)
    samples = kept(one, np.full(6, 0.12), MICS[:1])
    warm = replace(one, scene=replace(scene, air=Air(temperature_c=48.0)))
    options = dict(length_s=0.8, ism_order=ISM_ORDER, diffraction=False)
    contexts = [make_render_context(warm, MICS[:1], [rng_for(0, "tail", "a")], path_samples=given, **options)
                for given in (samples, None)]
    found, everything = (ray_echograms(context, scene.absorption, range(8)).energy[0] for context in contexts)
    error_db = smooth_db(everything[:700, 4], found[:700, 4])
    assert abs(np.mean(error_db)) < 0.02 and np.std(error_db) < 0.35


def test_sample_is_independent_of_other_microphones():
    one = traced(box_scene(0.2, 0.3), num_rays=1000)
    both, alone = kept(one, np.full(6, 0.2)), kept(one, np.full(6, 0.2), MICS[1:], "b")
    for name in ("weight", "reflection_counts", "last_reflection"):
        np.testing.assert_array_equal(getattr(both[1], name), getattr(alone[0], name))
    assert both[0].weight.shape == (1, N_FRAMES, PATHS_PER_FRAME)


def test_sample_is_identical_for_any_thread_count():
    program = ("import hashlib, sys; sys.path.insert(0, sys.argv[1]); import test_sim_path_sample as t; "
               "one = t.kept(t.traced(t.box_scene(0.2, 0.3), num_rays=1000), 0.2)[1]; "
               "arrays = one.weight, one.reflection_counts, one.last_reflection; "
               "print(hashlib.sha256(b''.join(array.tobytes() for array in arrays)).hexdigest())")
    printed = {subprocess.run([sys.executable, "-c", program, os.path.dirname(__file__)], text=True, check=True,
                              capture_output=True, env=os.environ | {"NUMBA_NUM_THREADS": threads}).stdout
               for threads in ("1", "2", "3")}
    assert len(printed) == 1


def box_mesh():
    corners = np.array([[x, y, z] for x in (0, DIMS_M[0]) for y in (0, DIMS_M[1]) for z in (0, DIMS_M[2])], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return make_room(corners[[face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]], ["wall"] * 12)


def test_specular_departures_lead_to_the_microphone():
    """Followed from the source as a ray, each passes the microphone after its length."""
    images = specular_paths(Shoebox(DIMS_M), SOURCE, MICS[0], 3)
    np.testing.assert_allclose(np.linalg.norm(images.departure, axis=1), 1.0)
    for distance_m, departure in zip(images.distance_m, images.departure, strict=True):
        # a box unfolds into triangle waves along each axis
        unfolded = np.asarray(SOURCE) + distance_m * departure
        folded = np.abs((unfolded + DIMS_M) % (2.0 * np.array(DIMS_M)) - DIMS_M)
        np.testing.assert_allclose(folded, MICS[0], atol=1e-9)
    mesh = specular_paths(box_mesh(), SOURCE, MICS[0], 3)
    np.testing.assert_allclose(mesh.distance_m, images.distance_m, atol=1e-6)
    np.testing.assert_allclose(mesh.departure, images.departure, atol=1e-6)


def test_microphones_of_a_small_array_share_a_sample():
    one = traced(box_scene(0.2, 0.3), num_rays=1000)
    centre = np.array(MICS[0])
    mics = [centre, centre + [0.09, 0.0, 0.0], centre + [0.18, 0.0, 0.0], centre + [0.0, 0.05, 0.05], MICS[1]]
    samples = kept(one, np.full(6, 0.2), mics, "abcde")
    assert [[other is sample for other in samples].index(True) for sample in samples] == [0, 0, 2, 0, 4]
