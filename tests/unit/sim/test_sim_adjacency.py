"""Which faces of a mesh lie in one plane, in rooms that are turned and whose corners are rounded."""

import numpy as np
import pytest
import trimesh
from plans import prism_obj
from scipy.spatial.transform import Rotation

from roomeq.sim.diffraction import diffract, find_edges
from roomeq.sim.images import specular_paths
from roomeq.sim.mesh import load_mesh, make_room
from roomeq.sim.scene import Shoebox
from roomeq.sim.trace import trace

C = 343.0


@pytest.fixture
def curtained(tmp_path):
    """5.21 x 3.86 x 2.53 m: the second part of the first wall is a curtain."""
    path = tmp_path / "room.obj"
    text = prism_obj([(0, 0), (3.17, 0), (5.21, 0), (5.21, 3.86), (0, 3.86)], 2.53)
    walls = [line for line in text.splitlines() if line.startswith("f ")][2:]
    path.write_text(text.replace(walls[1], f"usemtl curtain\n{walls[1]}\nusemtl wall"))
    return load_mesh(path)


def turned(room, rotation, digits=12):
    names = [room.surfaces[surface] for surface in room.face_surface]
    return make_room(np.round(apply(rotation, room.triangles), digits), names)


def box(low_m, high_m):
    return trimesh.creation.box(bounds=(low_m, high_m))


def circle(n_corners, radius_m):
    angle = 2.0 * np.pi * np.arange(n_corners) / n_corners
    return np.round(radius_m * np.stack([np.cos(angle), np.sin(angle)], axis=1), 6)


def apply(rotation, triangles):
    return rotation.apply(np.array(triangles).reshape(-1, 3)).reshape(-1, 3, 3)


@pytest.mark.parametrize("digits", [3, 12])
def test_two_materials_of_a_turned_wall_lie_in_one_plane(curtained, digits):
    """Were they two, rays would meet the nearer one, though they lie in the same place but for rounding."""
    share = curtained.surface_area_m2 / curtained.surface_area_m2.sum()
    for deg in np.arange(0.0, 90.0, 7.3):
        rotation = Rotation.from_euler("z", deg, degrees=True)
        room = turned(curtained, rotation, digits)
        assert len(room.planes.mirrors) == 6 and room.walls is None
        paths = trace(room, rotation.apply((1.3, 1.2, 1.1)), np.ones(len(room.surfaces)), num_rays=300,
                      max_length_m=200.0, speed_m_s=C, rng=np.random.default_rng(0))
        met = np.bincount(paths.face_surface[paths.codes >> 2], minlength=len(share)) / len(paths.codes)
        np.testing.assert_allclose(met, share, rtol=0.1)


def test_subdivided_walls_lie_in_one_plane_each():
    """Of small triangles, rounded corners turn the normals most."""
    mesh = box((0.0, 0.0, 0.0), (5.0, 4.0, 3.0))
    for _ in range(5):
        mesh = mesh.subdivide()
    rotation = Rotation.from_rotvec([0.2, 0.4, 0.6])
    room = make_room(apply(rotation, mesh.triangles), ["wall"] * len(mesh.faces))
    assert len(room.planes.mirrors) == 6
    np.testing.assert_allclose(np.sort(np.abs(rotation.inv().apply(room.planes.mirrors[:, :3])), axis=1),
                               [[0.0, 0.0, 1.0]] * 6, atol=1e-6)


@pytest.mark.parametrize("source", [(2.0, 1.5, 1.5), (1.0, 1.0, 1.0), (3.0, 2.0, 1.2)])
@pytest.mark.parametrize("rotation", [(0.0, 0.0, 0.0), (0.0, 0.0, 0.5), (0.2, 0.4, 0.6)])
def test_paths_through_the_edges_of_a_turned_room_count_once(source, rotation):
    """In symmetric places, paths meet two walls at once: in both orders, or in none, if rounding decides."""
    walls, turn, mic = box((0.0, 0.0, 0.0), (6.0, 4.0, 3.0)), Rotation.from_rotvec(rotation), (3.0, 2.0, 1.8)
    turned_room = make_room(apply(turn, walls.triangles), ["wall"] * len(walls.faces))
    energies = [np.sum(1.0 / specular_paths(room, turn.apply(source), turn.apply(mic), 6).distance_m ** 2)
                for room, turn in ((Shoebox((6.0, 4.0, 3.0)), Rotation.identity()), (turned_room, turn))]
    assert 10.0 * np.log10(energies[1] / energies[0]) == pytest.approx(0.0, abs=0.01)


def test_uneven_walls_reflect_once_each():
    """Corners are off by 1 mm, as in a scan: near most points of a wall, several of its planes are within 0.1 mm."""
    mesh = box((0.0, 0.0, 0.0), (6.0, 4.0, 3.0)).subdivide().subdivide().subdivide()
    rng = np.random.default_rng(0)
    room = make_room((mesh.vertices + rng.normal(0.0, 1e-3, mesh.vertices.shape))[mesh.faces], ["a"] * len(mesh.faces))
    source_m = np.array([1.6, 1.5, 1.4])
    for mic_m in rng.uniform([1.0, 1.0, 1.0], [5.0, 3.0, 2.0], (6, 3)):
        expected = specular_paths(Shoebox((6.0, 4.0, 3.0)), source_m, mic_m, 1).distance_m
        assert specular_paths(room, source_m, mic_m, 1).distance_m == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize("plan, n_facets", [
    (circle(64, 3.0), 64), (circle(8, 3.0), 0),
    ([(0.0, 0.0), (4.0, 0.0), (8.0, 0.35), (8.0, 5.0), (0.0, 5.0)], 0),
    ([*(circle(64, 4.0)[:33] + [0.0, 5.0]), (-4.0, 0.0), (4.0, 0.0)], 32),
], ids=["cylinder", "octagon", "wall with a bend of 5 degrees", "hall with a round end"])
def test_facets_of_curved_walls_are_told_from_flat_ones(plan, n_facets, tmp_path):
    (tmp_path / "room.obj").write_text(prism_obj(plan, 3.0))
    room = load_mesh(tmp_path / "room.obj")
    assert len(np.unique(room.planes.of_face[room.curved])) == n_facets


def test_faces_of_curved_surfaces_lie_in_planes_of_their_own():
    sphere = trimesh.creation.icosphere(subdivisions=5, radius=3.0)
    assert len(make_room(sphere.triangles, ["a"] * len(sphere.faces)).planes.mirrors) == len(sphere.faces)
    sides = 720  # 4 cm wide, half a degree from one to the next
    tube = trimesh.creation.cylinder(radius=5.0, height=4.0, sections=sides)
    assert len(make_room(tube.triangles, ["a"] * len(tube.faces)).planes.mirrors) >= sides // 2


def test_sound_around_a_body_does_not_depend_on_how_it_is_turned():
    """The edges of a face bound one face, into however many triangles it is cut and whichever way it points."""
    hall, body = box((-6.0, -6.0, -6.0), (6.0, 6.0, 6.0)), box((-0.15, -0.75, -0.5), (0.15, 0.75, 0.5))
    source, mic = np.array([-1.5, -0.3, 0.1]), np.array([1.5, 0.3, -0.2])

    def found(rotation, cuts):
        mesh = body
        for _ in range(cuts):
            mesh = mesh.subdivide()
        inner = apply(rotation, mesh.triangles)
        room = make_room(np.concatenate([hall.triangles, inner]), ["a"] * (len(hall.faces) + len(mesh.faces)))
        sound = diffract(room, rotation.apply(source), rotation.apply(mic), speed_m_s=C, n_samples=3000,
                         direct_visible=False)
        assert len(find_edges(room)) == 12 and len(np.unique(find_edges(room).faces)) == 6
        return np.abs(np.fft.rfft(sound.signals.sum(axis=0), 4096))

    straight = found(Rotation.identity(), 0)
    for rotation, cuts in zip(Rotation.random(6, np.random.default_rng(0)), [0, 0, 0, 1, 1, 2], strict=True):
        np.testing.assert_allclose(found(rotation, cuts), straight, atol=0.01 * straight.max())
