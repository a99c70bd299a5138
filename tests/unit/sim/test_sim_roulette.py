"""Rays that were traced once play roulette for any absorption as if they had been traced for it."""

import numpy as np
import pytest

from bench.rooms import l_triangles
from roomeq.sim.mesh import make_room
from roomeq.sim.response import trace_every_ray, trace_source
from roomeq.sim.scene import Air, Material, Scene, Shoebox
from roomeq.sim.trace import play_roulette, trace
from roomeq.sim.walls import Walls

C = Air().speed_m_s
SOURCE_M = (1.3, 1.1, 1.4)


ROOMS = {"box": lambda: Shoebox((6.0, 4.0, 3.0)), "convex": lambda: Shoebox((6.0, 4.0, 3.0)),
         "L": lambda: make_room(*l_triangles())}


def traced(room, absorption, length_m, scattering=0.3):
    return trace(room, SOURCE_M, np.full(len(room.surfaces), scattering), num_rays=10000, max_length_m=length_m,
                 speed_m_s=C, rng=np.random.default_rng(0), absorption=absorption)


def assert_same_paths(found, expected):
    assert found.n_leaked == expected.n_leaked and found.max_length_m == expected.max_length_m
    np.testing.assert_array_equal(found.counts, expected.counts)
    here, there = (np.concatenate([np.arange(first, first + count)
                                   for first, count in zip(paths.first, paths.counts, strict=True)])
                   for paths in (found, expected))
    np.testing.assert_array_equal(found.hits[here], expected.hits[there])
    np.testing.assert_array_equal(found.codes[here], expected.codes[there])


@pytest.mark.parametrize("length_m", [60.0, 250.0])
@pytest.mark.parametrize("absorption", [0.02, 0.15, 0.5])
@pytest.mark.parametrize("name", sorted(ROOMS))
def test_paths_are_those_of_a_trace_with_that_absorption(name, absorption, length_m, monkeypatch):
    room = ROOMS[name]()
    if name == "convex":
        monkeypatch.setattr(Walls, "box", None)
    every = traced(room, None, 250.0)
    of_surfaces = np.linspace(absorption, min(2.0 * absorption, 0.9), len(room.surfaces))
    found, expected = play_roulette(every, room, of_surfaces, length_m), traced(room, of_surfaces, length_m)
    assert (every.counts > expected.counts).any()
    assert_same_paths(found, expected)


def test_rays_that_leaked_before_they_end_are_counted():
    room = ROOMS["box"]()
    every = traced(room, None, 100.0)
    every.counts[:3] = 2  # a ray's last reflection is the one before the gap
    assert play_roulette(every, room, np.full(6, 0.2), 100.0).n_leaked == 3
    assert play_roulette(every, room, np.full(6, 0.2), 0.1).n_leaked == 0


def test_reflections_that_no_ray_uses_continue_nowhere():
    room = ROOMS["L"]()
    found = play_roulette(traced(room, None, 250.0), room, np.full(len(room.surfaces), 0.3), 100.0)
    used = np.zeros(len(found.codes), bool)
    for first, count in zip(found.first, found.counts, strict=True):
        used[first:first + count] = True
    assert not used.all() and not found.codes[~used].any()


def test_rays_cannot_be_followed_further_than_they_were_traced():
    room = ROOMS["box"]()
    with pytest.raises(ValueError, match="max_length_m=101.0 must be at most that of the paths, 100.0"):
        play_roulette(traced(room, None, 100.0), room, np.full(6, 0.2), 101.0)


def test_source_with_several_columns_of_scattering_plays_for_the_bands_of_each():
    scene = Scene(Shoebox((6.0, 4.0, 3.0)), [Material("wall", 0.1, (0.1,) * 4 + (0.4,) * 4)] * 6)
    absorption = np.linspace(0.05, 0.4, 48).reshape(6, 8)
    how = dict(num_rays=10000, rng=np.random.default_rng(0))
    expected = trace_source(scene, SOURCE_M, max_length_s=0.5, absorption=absorption, **how)
    how["rng"] = np.random.default_rng(0)
    found = trace_every_ray(scene, SOURCE_M, max_length_s=0.9, **how).play_roulette(absorption, 0.5)
    assert len(found.paths) == 2 and found.trace_of_band == expected.trace_of_band
    assert found.max_length_s == expected.max_length_s
    np.testing.assert_array_equal(found.expected_absorption, absorption)
    for one, other in zip(found.paths, expected.paths, strict=True):
        assert_same_paths(one, other)
