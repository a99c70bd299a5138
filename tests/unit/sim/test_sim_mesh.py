"""Meshes: the same room as a shoebox, corners that are hidden, meshes that cannot be rooms."""

import re
from dataclasses import replace
from itertools import pairwise, product

import numpy as np
import pytest
import trimesh
from decays import reverberation_time
from plans import L_PLAN, box_plan, prism_obj

from roomeq.core.constants import FS_HZ
from roomeq.sim.echogram import FRAME_S, compute_echograms
from roomeq.sim.images import specular_paths
from roomeq.sim.mesh import MeshRoom, load_mesh, make_room
from roomeq.sim.meshfile import triangulate
from roomeq.sim.path_sample import sample_paths
from roomeq.sim.paths import reflection_visibility
from roomeq.sim.response import simulate_responses, trace_source
from roomeq.sim.scene import Air, Material, Scene, Shoebox
from roomeq.sim.trace import trace
from roomeq.sim.tree import find_quadrangles

DIMS_M = (6.0, 4.0, 3.0)
C = Air().speed_m_s
Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""From coordinates with z up to those of glTF, where y is up."""


@pytest.fixture
def write_obj(tmp_path):
    def write(text, name="room.obj"):
        path = tmp_path / name
        path.write_text(text)
        return path
    return write


def with_body(shell, plan):
    """Return the OBJ of a shell, and of a body of one metre in it."""
    n_corners = len(re.findall(r"(?m)^v ", shell))
    words = [line.split() for line in prism_obj(plan, 1.0, "wood").splitlines()]
    body = [[word[0], *(str(int(n) + n_corners) for n in word[1:])] if word[0] == "f" else word for word in words]
    return shell + "\n".join(map(" ".join, body)) + "\n"


@pytest.fixture
def box(write_obj):
    return load_mesh(write_obj(prism_obj(box_plan(*DIMS_M[:2]), DIMS_M[2])))


def test_obj_box_is_read_with_its_materials(box):
    assert box.surfaces == ("ceiling", "floor", "wall") and box.convex
    assert box.volume_m3 == pytest.approx(72.0)
    np.testing.assert_allclose(box.surface_area_m2, [24.0, 24.0, 60.0])


@pytest.mark.parametrize("suffix", ["ply", "stl", "glb", "off"])
def test_all_mesh_formats_give_the_same_room(box, tmp_path, suffix):
    mesh = trimesh.Trimesh(box.triangles.reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False)
    if suffix == "glb":
        mesh.vertices = mesh.vertices @ Y_UP.T
    mesh.export(tmp_path / f"box.{suffix}")
    room = load_mesh(tmp_path / f"box.{suffix}")
    assert room.surfaces == ("surface",) and room.volume_m3 == pytest.approx(72.0, rel=1e-5)
    np.testing.assert_allclose(np.sort(room.triangles.ravel()), np.sort(box.triangles.ravel()), atol=1e-5)
    np.testing.assert_allclose(room.triangles.reshape(-1, 3).max(axis=0), DIMS_M, atol=1e-5)


@pytest.mark.parametrize("how", ["with a byte order mark", "with denormals", "with lines that go on",
                                 "in glTF with percent-encoded names"])
def test_odd_but_right_files_give_the_same_room(box, write_obj, how, tmp_path):
    text = prism_obj(box_plan(*DIMS_M[:2]), DIMS_M[2])
    if "mark" in how:
        path = write_obj("\ufeff" + text)
    elif "denormals" in how:
        path = write_obj(text.replace("v 0.0 0.0 0.0", "v 1e-310 -4e-324 0.0"))
        assert "1e-310" in path.read_text()
    elif "go on" in how:
        lines = re.sub(r"(?m)^(f|v)((?: \S+)+) (\S+) (\S+)$", r"\1\2\\\n \3 \\\n\4", text)
        path = write_obj("# made in C:\\rooms\\\n" + lines)
        assert path.read_text().count("\\\n") > 10
    else:
        mesh = trimesh.Trimesh(box.triangles.reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False)
        mesh.vertices = mesh.vertices @ Y_UP.T
        files = trimesh.exchange.gltf.export_gltf(trimesh.Scene(mesh))
        for name, content in files.items():
            content = re.sub(rb'"gltf_([^"]*)"', rb'"a%20room%20\1"', content) if name == "model.gltf" else content
            (tmp_path / name.replace("gltf_", "a room ")).write_bytes(content)
        path = tmp_path / "model.gltf"
        assert b"%20" in path.read_bytes()
    np.testing.assert_allclose(np.sort(load_mesh(path).triangles.ravel()), np.sort(box.triangles.ravel()), atol=1e-6)


def test_mirrored_node_of_a_gltf_file_is_the_mirrored_room(write_obj, tmp_path):
    room = write_obj(prism_obj(L_PLAN, 3.0))
    mesh = trimesh.load_mesh(room)
    mesh.vertices = mesh.vertices[:, [0, 2, 1]] * [1.0, 1.0, -1.0]  # y is up in glTF
    scene = trimesh.Scene()
    scene.add_geometry(mesh, transform=np.diag([-1.0, 1.0, 1.0, 1.0]))
    scene.export(tmp_path / "mirrored.glb")
    mirrored, wanted = load_mesh(tmp_path / "mirrored.glb"), load_mesh(room)
    assert mirrored.volume_m3 == pytest.approx(wanted.volume_m3)
    assert mirrored.triangles[..., 0].min() == pytest.approx(-wanted.triangles[..., 0].max())


@pytest.mark.parametrize("corner_x_m, said", [(5.2, True), (5.0, False)])
def test_bodies_that_reach_out_of_the_room_are_said(write_obj, caplog, corner_x_m, said):
    """A body of one metre in a room of 6 m, flush with its wall or 0.2 m through it."""
    load_mesh(write_obj(with_body(prism_obj(box_plan(6.0, 4.0), 3.0), box_plan(1.0, 1.0, corner_x_m, 1.0))))
    assert ("bodies that reach out of the room: 1, the one" in caplog.text) == said
    assert ("by 0.2 m" in caplog.text) == said


def test_corners_that_differ_by_rounding_are_one(box):
    """Walls that are objects of their own state their corners with a rounding of their own."""
    for seed in range(10):
        rng = np.random.default_rng(seed)
        turned = box.triangles @ trimesh.transformations.rotation_matrix(rng.uniform(0, 3), (0, 0, 1))[:3, :3].T
        room = make_room(turned + rng.uniform(-1e-6, 1e-6, turned.shape), ["all"] * len(turned))
        assert room.volume_m3 == pytest.approx(72.0, rel=1e-4) and len(room.triangles) == 12


def test_memory_of_a_room_does_not_grow_with_the_positions(write_obj):
    room = load_mesh(write_obj(prism_obj(L_PLAN, 3.0)))
    calls = []
    for number in (*range(40), 39, 0):
        assert room.remember("test", number, 16, lambda: calls.append(1) or number) == number  # noqa: B023
    assert len(calls) == 41 and len(room._cache["test"]) == 16


def test_names_of_materials_may_hold_a_hash(write_obj):
    text = prism_obj(box_plan(*DIMS_M[:2]), DIMS_M[2], "brick#2").replace("usemtl floor", "usemtl brick#1 # red")
    assert load_mesh(write_obj(text)).surfaces == ("brick#1", "brick#2", "ceiling")


def test_specular_paths_of_mesh_box_equal_image_lattice(box):
    source, mic = (1.0, 1.3, 1.2), (4.2, 2.9, 1.7)
    lattice = specular_paths(Shoebox(DIMS_M), source, mic, 4)
    found = box.specular_paths(source, mic, 4)
    assert found.has_direct
    np.testing.assert_allclose(found.distance_m, lattice.distance_m, atol=1e-6)
    walls = lattice.surface_counts[:, :4].sum(axis=1)
    expected = np.column_stack([lattice.surface_counts[:, 5], lattice.surface_counts[:, 4], walls])
    assert sorted(map(tuple, found.surface_counts)) == sorted(map(tuple, expected))


@pytest.mark.parametrize("how", ["planes", "faces"])
def test_mesh_box_echogram_matches_shoebox(box, how):
    room = box if how == "planes" else replace(box, convex=False, _cache={})
    assert (room.walls is None) == (how == "faces")
    mics = np.array([(4.2, 2.9, 1.7), (2.0, 3.0, 1.0), (5.7, 3.7, 0.4)])
    levels = []
    for one in (Shoebox(DIMS_M), room):
        paths = trace(one, (1.0, 1.3, 1.2), np.full(len(one.surfaces), 0.4), num_rays=6000, max_length_m=0.4 * C,
                      speed_m_s=C,
                      rng=np.random.default_rng(0))
        assert paths.n_leaked == 0
        absorption = np.full((len(one.surfaces), 8), 0.15)
        energy = compute_echograms(paths, one, absorption, mics, ism_order=3, n_frames=350, speed_m_s=C).energy
        levels.append(10.0 * np.log10(energy[:, :, 0].reshape(3, 7, 50).sum(axis=2)))
    np.testing.assert_allclose(levels[1], levels[0], atol=1.0)
    assert abs(np.mean(levels[1] - levels[0])) < 0.15


@pytest.fixture
def two_materials(write_obj):
    """Return a room with a pillar at one wall, whose two parts lie in one plane and have another material each."""
    lines, wall = [], 0
    for line in prism_obj([(0, 0), (2, 0), (2, 1), (3, 1), (3, 0), (6, 0), (6, 4), (0, 4)], 3.0).splitlines():
        if wall and line.startswith("f "):
            lines.append(f"usemtl wall{wall}")
            wall += 1
        wall = 1 if line == "usemtl wall" else wall
        lines.append(line)
    return load_mesh(write_obj("\n".join(lines)))


def test_rays_in_a_concave_room_are_traced_to_the_faces_that_they_hit_first(two_materials):
    room, source = two_materials, np.array([1.0, 2.0, 1.5])
    paths = trace(room, source, np.zeros(len(room.surfaces)), num_rays=3000, max_length_m=30.0, speed_m_s=C,
                  rng=np.random.default_rng(0))
    assert paths.n_leaked == 0
    face, distance_m = room.first_hits(np.tile(source, (3000, 1)), paths.directions)
    np.testing.assert_allclose(paths.hits[paths.first, 3], distance_m, atol=1e-4)
    hit = paths.codes[paths.first].astype(int) >> 2
    np.testing.assert_array_equal(paths.face_surface[hit], room.face_surface[face])
    np.testing.assert_allclose(paths.normals[hit], room.normals[face], atol=1e-6)


def test_rays_that_meet_more_walls_than_expected_are_traced_to_their_end(write_obj):
    """A narrow and deep niche: rays in it meet its walls many times as often as those in the room."""
    plan = [(0, 0), (6, 0), (6, 4), (3.02, 4), (3.02, 9), (3, 9), (3, 4), (0, 4)]
    room = load_mesh(write_obj(prism_obj(plan, 3.0)))
    paths = trace(room, (3.01, 8.0, 1.5), np.full(len(room.surfaces), 0.1), num_rays=400, max_length_m=150.0,
                  speed_m_s=C, rng=np.random.default_rng(0))
    last = paths.hits[paths.first + paths.counts - 1, 3]
    assert np.isfinite(room.normals).all()  # triangles without an area are gone
    assert paths.n_leaked == 0 and paths.counts.sum() / 400 > 1.2 * 150.0 * room.surface_area_m2.sum() / (
        4.0 * room.volume_m3) + 40
    assert np.mean(last > 150.0) > 0.9  # the others end by Russian roulette


def test_mesh_box_decay_time_matches_shoebox(box):
    times_s = []
    for room in (Shoebox(DIMS_M), box):
        scene = Scene(room, [Material("all", 0.2, 0.3)] * len(room.surfaces))
        mics = np.random.default_rng(0).uniform(0.2, 0.8, (10, 3)) * DIMS_M
        times_s.append(np.mean([reverberation_time(one.rir, FS_HZ, 1000.0, "t20", direct_sample=one.direct_sample)
                                for one in simulate_responses(scene, (1.0, 1.3, 1.2), mics, num_rays=5000)]))
    assert times_s[1] == pytest.approx(times_s[0], rel=0.02)


def crosses(a, b, wall):
    """Whether a plan's line from a to b passes through a wall, its ends not counted as on the line."""
    def side(p, q, r):
        return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
    p, q = wall
    return side(a, b, p) * side(a, b, q) < 0 and side(p, q, a) * side(p, q, b) < -1e-9


def plan_paths_by_hand(plan, source, mic, order):
    """Lengths of specular paths in a plan: mirror the source, walk back from the microphone, test every wall."""
    walls = list(pairwise([*plan, plan[0]]))

    def mirrored(point, wall):
        along = np.subtract(wall[1], wall[0]) / np.linalg.norm(np.subtract(wall[1], wall[0]))
        offset = np.subtract(point, wall[0])
        return np.array(wall[0]) + 2.0 * np.dot(offset, along) * along - offset

    found = []
    for count in range(order + 1):
        for sequence in product(range(len(walls)), repeat=count):
            images = [np.array(source)]
            for n in sequence:
                images.append(mirrored(images[-1], walls[n]))
            at, possible = np.array(mic), True
            for image, n in zip(images[:0:-1], reversed(sequence), strict=True):
                (x0, y0), (x1, y1) = walls[n]
                axis = 0 if x0 == x1 else 1
                share = ((x0, y0)[axis] - at[axis]) / (image[axis] - at[axis]) if image[axis] != at[axis] else -1.0
                point = at + share * (image - at)
                along = sorted([(y0, y1), (x0, x1)][axis])
                possible = 1e-9 < share < 1.0 and along[0] < point[1 - axis] < along[1] and not any(
                    crosses(at, point, wall) for m, wall in enumerate(walls) if m != n)
                if not possible:
                    break
                at = point
            if possible and not any(crosses(at, source, wall) for m, wall in enumerate(walls)
                                    if not count or m != sequence[0]):
                found.append(np.linalg.norm(images[-1] - mic))
    return sorted(found)


def test_occluded_receiver_gets_only_hand_computed_paths(write_obj):
    room = load_mesh(write_obj(prism_obj(L_PLAN, 3.0)))
    assert not room.convex and room.volume_m3 == pytest.approx(3.0 * 20.0)
    source, places = (5.0, 1.1), [(0.9, 5.2), (1.7, 3.1), (1.3, 1.2), (3.3, 0.4), (0.4, 2.6)]
    lengths = []
    for mic in places:
        expected = plan_paths_by_hand(L_PLAN, source, mic, 2)
        found = room.specular_paths((*source, 1.5), (*mic, 1.5), 2)
        level = found.surface_counts[:, [room.surfaces.index("floor"), room.surfaces.index("ceiling")]].sum(axis=1) == 0
        np.testing.assert_allclose(found.distance_m[level], expected, atol=1e-6)
        distance_m = np.hypot(*np.subtract(mic, source))
        assert found.has_direct == (len(expected) > 0 and expected[0] == pytest.approx(distance_m))
        lengths.append(len(expected))
    assert lengths[0] == 0 and max(lengths) >= 6
    scene = Scene(room, [Material("all", 0.2, 0.3)] * 3)
    near, far = simulate_responses(scene, (*source, 1.5), [(*places[2], 1.5), (*places[0], 1.5)], num_rays=4000)
    assert near.direct_visible and not far.direct_visible and near.leaked_share == 0.0
    around_m = np.hypot(3.0, 0.9) + np.hypot(1.1, 3.2)  # past the inner corner at (2, 2)
    silent = int(around_m / C * FS_HZ) - 200
    assert np.abs(far.rir[:silent]).max() < 1e-3 * np.abs(near.rir).max() < np.abs(far.rir[silent:]).max()


DOOR_PLAN = [(0, 0), (5, 0), (5, 2.5), (5.1, 2.5), (5.1, 0), (10.1, 0), (10.1, 6), (5.1, 6), (5.1, 3.5), (5, 3.5),
             (5, 6), (0, 6)]


def test_sound_that_is_scattered_around_a_corner_comes_before_any_mirrored_one(write_obj):
    """From the next room through a door, the first specular path is long."""
    scene = Scene(load_mesh(write_obj(prism_obj(DOOR_PLAN, 3.0))), [Material("all", 0.2, 0.3)] * 3)
    source, mic = (1.0, 0.8, 1.5), (9.0, 1.2, 1.2)
    (response,) = simulate_responses(scene, source, mic, num_rays=4000, diffraction=False)
    speculars_m = scene.room.specular_paths(source, mic, 6).distance_m
    assert not response.direct_visible and speculars_m[0] > 1.6 * response.direct_sample * C / FS_HZ
    traced = trace_source(scene, source, num_rays=4000, rng=np.random.default_rng(0))
    energy = compute_echograms(traced.paths[0], scene.room, scene.absorption, np.array([mic]), ism_order=6,
                               n_frames=800, speed_m_s=C).energy[0, :, 4]
    onset_s = speculars_m[0] / C
    early = np.sum(np.square(response.rir[:int(onset_s * FS_HZ) - 20])) / np.sum(np.square(response.rir))
    assert early > 0.02
    assert early == pytest.approx(energy[:int(onset_s / FRAME_S) - 1].sum() / energy.sum(), rel=0.5)


def test_surface_hides_what_is_behind_it_from_a_microphone_close_to_it(write_obj):
    """The sphere around a microphone at a partition reaches into the room behind, where the source is."""
    plan = [(0, 0), (10, 0), (10, 6), (5.1, 6), (5.1, 0.8), (5, 0.8), (5, 6), (0, 6)]
    scene = Scene(load_mesh(write_obj(prism_obj(plan, 3.0))), [Material("all", 0.2, 0.1)] * 3)
    mics = np.array([(4.97, 4.0, 1.2), (4.4, 4.0, 1.2)])
    traced = trace_source(scene, (8.0, 4.5, 1.5), num_rays=10000, rng=np.random.default_rng(0))
    energy = compute_echograms(traced.paths[0], scene.room, scene.absorption, mics, ism_order=-1, n_frames=500,
                               speed_m_s=C).energy[:, :, 4].sum(axis=1)
    assert 10.0 * np.log10(energy[0] / energy[1]) == pytest.approx(0.0, abs=1.5)
    sample, _ = sample_paths(traced, mics, scene.absorption, [np.random.default_rng(n) for n in (1, 2)], ism_order=-1,
                             n_frames=500)
    echogram = sample.echogram(scene.absorption, bands=[4])[:, 4]
    assert 10.0 * np.log10(echogram.sum() / energy[0]) == pytest.approx(0.0, abs=0.3)


def test_no_shadow_ray_is_needed_from_faces_that_are_in_sight(write_obj, monkeypatch):
    """What microphones see is the same without the search, and it finds most faces of a concave room with a box."""
    room = load_mesh(write_obj(with_body(prism_obj(L_PLAN, 3.0), box_plan(0.5, 0.5, 1.0, 1.0))))
    assert not room.convex
    mics_m = np.random.default_rng(0).uniform((0.2, 0.2, 1.2), (5.8, 1.8, 2.8), (10, 3))
    rays = trace(room, (0.6, 0.6, 0.6), [0.3] * len(room.surfaces), num_rays=2000, max_length_m=60.0, speed_m_s=C,
                 rng=np.random.default_rng(0))
    seen = reflection_visibility(rays, room, mics_m, max_path_m=60.0)
    in_sight = room.faces_in_sight(mics_m)
    assert 0.3 < in_sight.mean() < 0.9
    monkeypatch.setattr(MeshRoom, "faces_in_sight", lambda *_: np.zeros_like(in_sight))
    np.testing.assert_array_equal(reflection_visibility(rays, room, mics_m, max_path_m=60.0), seen)


def test_faces_in_sight_are_those_that_are_seen_as_a_whole(write_obj):
    """No other one is found, and none is missed. The floor is left out, of which a part lies inside the body."""
    room = load_mesh(write_obj(with_body(prism_obj(L_PLAN, 3.0), box_plan(0.5, 0.5, 1.0, 1.0))))
    rng = np.random.default_rng(1)
    mics_m = rng.uniform((0.2, 0.2, 1.2), (5.8, 1.8, 2.8), (6, 3))
    share = rng.dirichlet(np.ones(3), 1000)
    seen = np.array([[np.all(room.sees(share @ corners + 1e-4 * normal, mic_m))
                      for corners, normal in zip(room.triangles, room.normals, strict=True)] for mic_m in mics_m])
    of_one_face = find_quadrangles(room.triangles, room.normals, room.offsets, room.face_surface)[:2]
    for first, second in zip(*of_one_face, strict=True):
        seen[:, [first, second]] = np.all(seen[:, [first, second]], axis=1, keepdims=True)
    above_floor = room.triangles[:, :, 2].max(axis=1) > 0.0
    np.testing.assert_array_equal(room.faces_in_sight(mics_m)[:, above_floor], seen[:, above_floor])
    assert 0.2 < seen[:, above_floor].mean() < 0.8


def test_energy_is_conserved_in_room_with_table(write_obj):
    shell = prism_obj(box_plan(6.0, 4.0), 3.0)
    table = prism_obj(box_plan(2.0, 1.0, 2.0, 1.5), 0.6, "wood")
    lifted = []
    for line in table.splitlines():
        words = line.split()
        if words[0] == "v":
            words[3] = str(float(words[3]) + 0.4)
        elif words[0] == "f":
            words[1:] = [str(int(word) + 8) for word in words[1:]]
        lifted.append(" ".join(words))
    room = load_mesh(write_obj(shell + "\n".join(lifted)))
    assert room.volume_m3 == pytest.approx(72.0 - 1.2)
    with pytest.raises(ValueError, match="outside the air"):
        room.require_inside("mic_pos_m", (3.0, 2.0, 0.7))
    paths = trace(room, (1.0, 1.0, 1.5), np.full(len(room.surfaces), 0.5), num_rays=5000, max_length_m=0.3 * C,
                      speed_m_s=C,
                  rng=np.random.default_rng(0))
    assert paths.n_leaked == 0
    mics = np.array([(5.0, 3.0, 1.2), (1.0, 3.2, 2.0), (4.8, 0.8, 0.7), (3.0, 2.0, 1.8)])
    rigid = np.zeros((len(room.surfaces), 8))
    energy = compute_echograms(paths, room, rigid, mics, ism_order=0, n_frames=280, speed_m_s=C).energy
    uniform = C * 1e-3 / room.volume_m3 / (4.0 * np.pi)
    assert energy[:, 150:, 0].mean() / uniform == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize("off_m, said", [(0.0, False), (1e-3, True)])
def test_uneven_surfaces_of_many_faces_are_said(off_m, said, caplog):
    walls = trimesh.creation.box((6.0, 4.0, 3.0)).subdivide().subdivide().subdivide()
    corners_m = walls.vertices + np.random.default_rng(0).normal(0.0, off_m, walls.vertices.shape)
    room = make_room(corners_m[walls.faces], ["all"] * len(walls.faces))
    room.specular_paths((0.5, 0.3, 0.2), (-1.0, 0.0, 1.0), 2)
    assert ("uneven surfaces of many small faces" in caplog.text) is said


def test_facets_of_a_curved_wall_reflect_as_much_energy_as_it():
    """Each of several facets shows the same reflection: image sources in them, in phase, would be 4 dB too loud."""
    cylinder = trimesh.creation.cylinder(radius=3.0, height=3.0, sections=128)
    room = make_room(cylinder.triangles, ["all"] * len(cylinder.faces))
    scene = Scene(room, [Material("plaster", 0.15, 0.1)])
    mics_m = np.random.default_rng(5).uniform([-1.6, -1.0, -0.8], [1.6, 1.0, 0.8], (6, 3))
    energies = []
    for ism_order in (0, 6):
        responses = simulate_responses(scene, (-1.4, -1.5, -0.1), mics_m, ism_order=ism_order, num_rays=5000)
        energies.append(np.mean([np.sum(response.rir ** 2) for response in responses]))
    assert 10.0 * np.log10(energies[1] / energies[0]) == pytest.approx(0.0, abs=0.3)


@pytest.mark.parametrize("first", range(6))
@pytest.mark.parametrize("plan, area", [
    (L_PLAN, 20.0), ([(0, 0), (8, 0), (8, 3), (4, 3), (4, 6), (0, 6)], 36.0),  # a corner on the diagonal of two others
    ([(0, 0), (0.3, 0), (0.3, 0.1), (0.1, 0.1), (0.1, 0.2), (0, 0.2)], 0.04)])
def test_polygons_are_triangulated(plan, area, first):
    corners = np.array([(x, y, 1.0) for x, y in [*plan[first:], *plan[:first]]])
    cut = triangulate(corners)
    areas = [0.5 * np.cross(corners[b] - corners[a], corners[c] - corners[a])[2] for a, b, c in cut]
    assert len(cut) == 4 and min(areas) > 0.0 and sum(areas) == pytest.approx(area)


def test_invalid_room_meshes_are_rejected(write_obj, tmp_path, box):
    whole = prism_obj(box_plan(4.0, 3.0), 2.5)
    with pytest.raises(ValueError, match=r"the mesh has holes: 4 edges don't join exactly two faces.*close the holes"):
        load_mesh(write_obj(whole.rsplit("f", 1)[0], "hole.obj"))
    with pytest.raises(ValueError, match=r"the normals of the mesh point into the room \(its volume is -30 m3\)"):
        make_room(box.triangles[:, ::-1] * [4 / 6, 3 / 4, 2.5 / 3], ["a"] * 12)
    with pytest.raises(ValueError, match=r"crossing.obj: .*face 1 2 3 4 5 crosses itself"):
        load_mesh(write_obj("v 0 0 0\nv 4 0 0\nv 4 3 0\nv 1 -1 0\nv 0 3 0\nf 1 2 3 4 5\n", "crossing.obj"))
    cupboards = [trimesh.creation.box(bounds=bounds).triangles[:, ::-1] for bounds in (
        [(1, 1, 0.03), (2, 1.5, 1)], [(2, 1, 0.03), (3, 1.5, 1)])]
    with pytest.raises(ValueError, match=r"more than two faces .* meet in 4 edges, .* 1 mm apart or join"):
        make_room(np.concatenate([box.triangles, *cupboards]), ["a"] * 36)
    turned = box.triangles.copy()
    turned[0] = turned[0, ::-1]
    with pytest.raises(ValueError, match=r"neighbouring faces of the mesh have opposite normals"):
        make_room(turned, ["a"] * 12)
    beside = box.triangles + [20.0, 0.0, 0.0]
    with pytest.raises(ValueError, match=r"body around \[23.0, 2.0, 1.5\] m lies outside of the largest one"):
        make_room(np.concatenate([1.1 * box.triangles, beside]), ["a"] * 24)
    a, b, c, d = np.array([(2, 1, 0.7), (4, 1, 0.7), (4, 2, 0.7), (2, 2, 0.7)])  # a desk with two faces in one place
    with pytest.raises(ValueError, match=r"body around \[3.0, 1.5, 0.7\] m has no thickness"):
        make_room(np.concatenate([box.triangles, [[a, b, c], [a, c, d], [d, c, b], [d, b, a]]]), ["a"] * 16)
    with pytest.raises(ValueError, match=r"no such mesh file"):
        load_mesh(tmp_path / "absent.obj")
    with pytest.raises(ValueError, match=r"must be one of \.obj"):
        load_mesh(write_obj("", "room.txt"))
    with pytest.raises(ValueError, match=r"empty.obj: holds no triangles"):
        load_mesh(write_obj("", "empty.obj"))
    with pytest.raises(ValueError, match=r"cannot be read as a mesh"):
        load_mesh(write_obj("v 0 0 0\nf 1 2 3\n", "broken.obj"))
