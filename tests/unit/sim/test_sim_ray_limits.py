"""No single ray is heard as an echo in late sound that is left to a few rays."""

from dataclasses import replace

import numpy as np
import pytest

from roomeq.core.rng import rng_for
from roomeq.sim.echogram import compute_echograms
from roomeq.sim.path_sample import sample_paths
from roomeq.sim.ray_limits import (
    FEW_RAYS_DB,
    FEWEST_FOR_DECAY,
    FEWEST_RAYS,
    FEWEST_TO_TELL,
    LARGEST_GAIN,
    RayLimits,
    ray_limits,
)
from roomeq.sim.response import render_responses, trace_source
from roomeq.sim.scene import Air, Material, Scene, Shoebox

C = Air().speed_m_s
FRAMES_PER_M = 1000.0 / C
N_FRAMES = 1500
HALL_M, SOURCE, MIC = (14.7, 7.8, 3.8), (3.0, 2.5, 1.5), (11.0, 5.5, 1.2)


def traced(walls, floor_and_ceiling, scattering=0.1, seed=0, num_rays=10000):
    absorption = (walls, walls, walls, walls, floor_and_ceiling, floor_and_ceiling)
    scene = Scene(Shoebox(HALL_M), [Material(f"s{n}", value, scattering) for n, value in enumerate(absorption)])
    return trace_source(scene, SOURCE, num_rays=num_rays, max_length_s=1.4, rng=np.random.default_rng(seed))


def energies(paths, absorption, at_m):
    """Return the energy of each ray at a length of path, ray by ray."""
    found = []
    for first, count in zip(paths.first, paths.counts, strict=True):
        ray = slice(first, first + count)
        passed = paths.hits[ray, 3] < at_m
        codes = paths.codes[ray][passed]
        alive = not passed.all()
        found.append(alive * np.prod((1.0 - absorption[paths.face_surface[codes >> 2]]) * (1.0 + (codes & 2) // 2)))
    return np.array(found)


def found_limits(one, **how):
    (paths,) = one.paths
    reflected = (1.0 - one.scene.absorption)[paths.face_surface].astype(np.float32)
    how = dict(emitted=np.zeros((0, 8), np.float32), n_frames=N_FRAMES, frames_per_m=FRAMES_PER_M) | how
    return ray_limits(paths, reflected, **how)


def limits(one, **how):
    return found_limits(one, **how).largest[:, 0]


def test_energies_are_winsorized_where_few_rays_have_them():
    one = traced(0.05, 0.7)
    (paths,), limit = one.paths, limits(one)
    for frame in (64, 320, 960):  # times at which energies are compared
        energy = energies(paths, one.scene.absorption[:, 0], frame / FRAMES_PER_M)
        assert np.minimum(energy, limit[frame]).sum() == pytest.approx(FEWEST_RAYS * limit[frame], rel=1e-3)
    assert energy.max() > 2.0 * limit[960]


@pytest.mark.parametrize("n_bands", [2, 8])
@pytest.mark.parametrize("ceiling", [0.05, 0.3, 0.7])
@pytest.mark.parametrize("num_rays", [4000, 10000])
def test_limits_do_not_depend_on_how_many_energies_are_sorted_first(num_rays, ceiling, n_bands, monkeypatch):
    one, found = traced(0.05, ceiling, num_rays=num_rays), []
    for n_sorted in (4, 6, FEWEST_RAYS):
        monkeypatch.setattr("roomeq.sim.ray_limits._FIRST_SORTED", n_sorted)
        found.append(found_limits(one, n_bands=n_bands))
    for other in found[:2]:
        np.testing.assert_array_equal(other.largest, found[2].largest)
        np.testing.assert_array_equal(other.gain, found[2].gain)


def test_limited_rays_carry_the_energy_of_all_if_enough_tell_it():
    """What the limit takes from single rays goes to all, but for what fewer than `FEWEST_FOR_DECAY` rays carry."""
    one = traced(0.05, 0.7)
    (paths,), limit = one.paths, found_limits(one)
    for frame in (64, 320, 640, 960):
        energy = energies(paths, one.scene.absorption[:, 0], frame / FRAMES_PER_M)
        kept = limit.gain[frame, 0] * np.minimum(energy, limit.largest[frame, 0]).sum()
        assert kept == pytest.approx(np.minimum(energy, kept / FEWEST_FOR_DECAY).sum(), rel=1e-3)
        if frame < 960:
            assert kept == pytest.approx(energy.sum(), rel=1e-3)
    assert limit.gain[640, 0] > 1.2 and energy.max() > energy.sum() / FEWEST_FOR_DECAY


def test_energy_of_few_rays_does_not_raise_all_others_without_bound():
    """Where a ceiling absorbs nearly everything, a few rays have nearly all energy."""
    gain = found_limits(traced(0.03, 0.999)).gain
    assert gain.min() == 1.0 and gain.max() == pytest.approx(LARGEST_GAIN)


def test_no_ray_is_limited_in_a_diffuse_field():
    one = traced(0.2, 0.2, scattering=0.5)
    (paths,), limit = one.paths, found_limits(one)
    for frame in (64, 320, 640):
        assert energies(paths, one.scene.absorption[:, 0], frame / FRAMES_PER_M).max() < limit.largest[frame, 0]
        assert limit.gain[frame, 0] == 1.0


def test_energy_at_the_source_counts():
    one = traced(0.05, 0.7)
    emitted = np.full((10000, 8), 4.0, np.float32)
    np.testing.assert_allclose(limits(one, emitted=emitted)[:960], 4.0 * limits(one)[:960], rtol=1e-4)


def test_few_rays_are_not_limited():
    assert np.isinf(limits(traced(0.05, 0.7, num_rays=500))).all()


def test_late_level_under_an_absorbing_ceiling_is_that_of_many_rays():
    """If limited rays did not get back what others lose, 10,000 rays would lose 2 dB from 0.6 to 0.7 s."""
    mics, how = np.random.default_rng(0).uniform(0.2, 0.8, (4, 3)) * HALL_M, dict(ism_order=-1, n_frames=700)

    def level_db(num_rays, seed):
        one = traced(0.05, 0.7, seed=seed, num_rays=num_rays)
        energy = compute_echograms(one.paths[0], one.scene.room, one.scene.absorption, mics, speed_m_s=C, **how).energy
        return 10.0 * np.log10(energy[:, 600:, 4].sum())

    few_db, many_db = (np.mean([level_db(num_rays, seed) for seed in range(n)])
                       for num_rays, n in ((10000, 10), (100000, 2)))
    assert few_db == pytest.approx(many_db, abs=1.2)


@pytest.mark.parametrize(("alpha", "ceiling", "few"), [(0.05, 0.7, True), (0.1, 0.1, False)])
def test_decay_of_few_rays_is_told(alpha, ceiling, few):
    """From a sample of paths as from all of them; more rays tell the decay better."""
    one = traced(alpha, ceiling)
    sample = sample_paths(one, [MIC], one.scene.absorption, [rng_for(0, "echoes", "m")], ism_order=6, n_frames=N_FRAMES)
    found = [render_responses(one, [MIC], [np.random.default_rng(0)], path_samples=samples)[0].few_rays_db
             for samples in (sample, None)]
    assert [value > FEW_RAYS_DB for value in found] == [few, few] and found[0] == pytest.approx(found[1], abs=1.0)
    many = traced(alpha, ceiling, num_rays=200000)
    told = render_responses(many, [MIC], [np.random.default_rng(0)])[0].few_rays_db
    assert told < min(found[1], FEW_RAYS_DB) if few else told <= found[1]


def test_fewer_rays_than_limits_ask_for_tell_nothing_of_the_decay():
    for num_rays, known in ((FEWEST_TO_TELL - 1, False), (FEWEST_TO_TELL, True)):
        one = traced(0.05, 0.7, num_rays=num_rays)
        assert (render_responses(one, [MIC], [np.random.default_rng(0)])[0].few_rays_db is not None) == known


def test_gain_of_a_sample_is_that_of_its_echogram():
    """For other absorption than before, and for bands of two traces."""
    materials = [Material(f"s{n}", alpha, (0.1,) * 4 + (0.5,) * 4) for n, alpha in enumerate([0.05] * 5 + [0.7])]
    one = trace_source(Scene(Shoebox(HALL_M), materials), SOURCE, num_rays=10000, max_length_s=1.4,
                       rng=np.random.default_rng(0))
    absorption = one.scene.absorption
    (sample,) = sample_paths(one, [MIC], absorption, [rng_for(0, "echoes", "m")], ism_order=6, n_frames=N_FRAMES)
    without = replace(sample, limited=replace(sample.limited, log_gain=np.zeros_like(sample.limited.log_gain)))
    assert len(one.paths) == 2
    for factor in (1.0, 1.2, 1.0):
        gain = sample.limited_gain(factor * absorption, range(8))
        np.testing.assert_allclose(sample.echogram(factor * absorption), gain * without.echogram(factor * absorption),
                                   rtol=1e-6)
        assert gain.max(axis=0).min() > 1.1
        assert np.array_equal(sample.limited_gain(factor * absorption, [6, 2]), gain[:, [6, 2]])


def largest_rise_db(echogram):
    """Return the largest rise of the energy in 20 ms above that of the 60 ms before, down to -50 dB of the decay."""
    energy = echogram[:N_FRAMES // 20 * 20].reshape(-1, 20).sum(axis=1)
    left = np.cumsum(energy[::-1])[::-1]
    before = np.convolve(energy, np.ones(3) / 3.0, "valid")[:-1]
    return max(10.0 * np.log10(energy[n + 3] / before[n]) for n in range(1, len(before))
               if left[n + 3] > 1e-5 * left[0])


def test_late_sound_of_a_hall_with_absorbing_ceiling_has_no_echoes(monkeypatch):
    """Without limits, single rays that stay horizontal rise above the decay by tens of decibels."""
    def rises_db():
        found = []
        for seed in range(6):
            one = traced(0.04, 0.8, scattering=0.2, seed=seed)
            absorption = one.scene.absorption
            how = dict(ism_order=6, n_frames=N_FRAMES)
            (sample,) = sample_paths(one, [MIC], absorption, [rng_for(seed, "echoes", "m")], **how)
            exact = compute_echograms(one.paths[0], one.scene.room, absorption, [MIC], speed_m_s=C, **how).energy
            found.append([largest_rise_db(echogram[:, 4]) for echogram in (sample.echogram(absorption), exact[0])])
        return np.max(found, axis=0)

    limited = rises_db()
    for module in ("path_sample", "echogram"):
        monkeypatch.setattr(f"roomeq.sim.{module}.ray_limits", lambda paths, reflected, emitted, n_frames, frames_per_m,
                            n_bands=8: RayLimits(*np.full((2, n_frames, n_bands), [[[np.inf]], [[1.0]]], np.float32)))
    unlimited = rises_db()
    assert (limited < 12.0).all() and (unlimited > 15.0).all()
