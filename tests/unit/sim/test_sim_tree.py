"""Searches of a tree of faces, against all triangles one by one."""

import numpy as np
import pytest

from bench.rooms import box_triangles, furnished_triangles, l_triangles
from roomeq.sim.mesh import make_room
from roomeq.sim.trace import trace
from roomeq.sim.tree import first_hits, sees

DIMS_M = (12.0, 8.0, 4.0)


def rooms():
    """Return rooms by name: furniture, an L, a hall of shrinking steps far from the origin."""
    steps = [box_triangles(DIMS_M, (150.0, -180.0, 0.0))]
    for n in range(12):
        size_m = 1.5 * 0.5 ** n
        steps.append(box_triangles((size_m, size_m, size_m), (151.0 + 3.0 * (1.0 - 0.45 ** n), -178.0, 1.0)))
    return {"furniture": furnished_triangles(600), "L": l_triangles(),
            "steps": (np.concatenate(steps), ["all"] * (12 * len(steps)))}


@pytest.fixture(params=["furniture", "L", "steps"])
def room(request):
    return make_room(*rooms()[request.param])


def points_in_air(room, count, seed=0):
    """Draw points in a room, all of which see the room's faces from the front."""
    low, high = room.bounds_m
    points = np.random.default_rng(seed).uniform(low + 0.01, high - 0.01, (2 * count, 3))
    face, _ = room.first_hits(points, np.tile([0.36, 0.48, 0.8], (len(points), 1)))
    return points[face >= 0][:count]


def all_crossings(room, origins, ways):
    """Distances [lengths of the ways] at which lines meet each triangle, infinite elsewhere (Moller, Trumbore)."""
    a, b, c = room.triangles.transpose(1, 0, 2)
    result = np.full((len(origins), len(a)), np.inf)
    for n, (origin, way) in enumerate(zip(origins, ways, strict=True)):
        p = np.cross(way, c - a)
        determinant = np.einsum("ij,ij->i", b - a, p)
        q = np.cross(origin - a, b - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.einsum("ij,ij->i", origin - a, p) / determinant
            v = q @ way / determinant
            distance = np.einsum("ij,ij->i", q, c - a) / determinant
            result[n] = np.where((u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (distance > 0.0), distance, np.inf)
    return result


@pytest.mark.parametrize("name", ["furniture", "L"])  # near the origin: Embree computes in single precision
def test_first_hits_are_those_of_embree(name):
    room = make_room(*rooms()[name])
    construction, core = (pytest.importorskip(f"embreex.{module}") for module in ("mesh_construction", "rtcore_scene"))
    scene = core.EmbreeScene()
    construction.TriangleMesh(scene, room.triangles.astype(np.float32))
    origins = points_in_air(room, 4000)
    ways = np.random.default_rng(2).standard_normal(origins.shape)
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    face, distance = first_hits(room.tree, origins, ways)
    embree = scene.run(origins.astype(np.float32), ways.astype(np.float32), output=True)
    assert np.mean(np.abs(embree["tfar"] / distance - 1.0) < 1e-4) > 0.999
    assert np.mean(np.abs(room.normals[embree["primID"]] - room.normals[face]).max(axis=1) < 1e-6) > 0.998


@pytest.mark.parametrize("missing", [np.nan, np.inf])
def test_rays_with_missing_numbers_hit_nothing(missing):
    room, inside = make_room(*rooms()["L"]), np.array([[1.0, 1.0, 1.0]])
    for origin, way in ((np.full((1, 3), missing), [[0.0, 0.0, 1.0]]), (inside, np.full((1, 3), missing))):
        assert room.first_hits(np.asarray(origin), np.asarray(way))[0][0] == -1
    assert room.sees(inside, np.full((1, 3), missing)).shape == (1,)
    with pytest.raises(ValueError, match="must lie inside"):
        room.require_inside("mic_pos_m", [missing] * 3)


def test_first_hits_are_the_nearest_of_all_triangles(room):
    origins = points_in_air(room, 800)
    ways = np.random.default_rng(1).standard_normal(origins.shape)
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    face, distance = first_hits(room.tree, origins, ways)
    expected = all_crossings(room, origins, ways)
    np.testing.assert_allclose(distance, expected.min(axis=1), rtol=1e-9)
    np.testing.assert_allclose(room.normals[face], room.normals[expected.argmin(axis=1)], atol=1e-9)


def test_rays_along_the_axes_are_not_lost(room):
    origins = points_in_air(room, 300)
    for way in np.concatenate([np.eye(3), -np.eye(3)]):
        ways = np.tile(way, (len(origins), 1))
        _, distance = first_hits(room.tree, origins, ways)
        np.testing.assert_allclose(distance, all_crossings(room, origins, ways).min(axis=1), rtol=1e-9)


def test_rays_at_edges_and_corners_pass_between_no_faces(room):
    source = points_in_air(room, 1)[0]
    a, b, c = room.triangles.transpose(1, 0, 2)
    aims = np.concatenate([a, b, c, 0.5 * (a + b), 0.3 * b + 0.7 * c, 0.9 * c + 0.1 * a])
    ways = aims - source
    lengths = np.linalg.norm(ways, axis=1)
    face, distance = first_hits(room.tree, np.tile(source, (len(aims), 1)), ways / lengths[:, None])
    assert (face >= 0).all() and (distance < lengths + 1e-4).all()


def test_lines_are_obstructed_where_a_triangle_crosses_them(room):
    points = points_in_air(room, 1600)
    from_m, to_m = points[:800], points[800:]
    expected = all_crossings(room, from_m, to_m - from_m).min(axis=1) >= 1.0
    np.testing.assert_array_equal(sees(room.tree, from_m, to_m), expected)
    assert 5 < np.count_nonzero(~expected)


def test_faces_of_a_box_are_quadrangles_and_of_a_concave_floor_only_convex_parts(room):
    tree = room.tree
    in_tree = tree.faces[tree.faces >= 0]
    assert len(in_tree) == len(np.unique(in_tree)) < len(room.triangles)
    box = make_room(box_triangles(DIMS_M), ["all"] * 12)
    assert np.count_nonzero(box.tree.faces >= 0) == 6
    two_materials = make_room(box_triangles(DIMS_M), ["a", "b"] * 6)
    assert np.count_nonzero(two_materials.tree.faces >= 0) == 12


def test_traces_of_a_mesh_do_not_depend_on_the_number_of_threads(room, monkeypatch):
    def traced(threads):
        monkeypatch.setenv("NUMBA_NUM_THREADS", str(threads))
        return trace(room, points_in_air(room, 1)[0], np.full(len(room.surfaces), 0.3), num_rays=900,
                     max_length_m=120.0, speed_m_s=343.0, rng=np.random.default_rng(0), absorption=0.2)

    one, three = traced(1), traced(3)
    assert one.n_leaked == 0
    np.testing.assert_array_equal(one.hits, three.hits)
    np.testing.assert_array_equal(one.codes, three.codes)


def test_a_trace_does_not_depend_on_the_trace_that_it_follows(room):
    source = points_in_air(room, 1)[0]

    def traced(scattering, absorption, like=None):
        return trace(room, source, np.full(len(room.surfaces), scattering), num_rays=900, max_length_m=300.0,
                     speed_m_s=343.0, rng=np.random.default_rng(0), absorption=absorption, like=like)

    alone, other = traced(0.35, 0.1), traced(0.3, 0.4)
    following = traced(0.35, 0.1, like=other)
    assert not np.array_equal(alone.counts, other.counts)
    np.testing.assert_array_equal(following.hits, alone.hits)
    np.testing.assert_array_equal(following.codes, alone.codes)
    np.testing.assert_array_equal(following.counts, alone.counts)
