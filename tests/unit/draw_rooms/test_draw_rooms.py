"""Drawn rooms: distributions met, distances kept, shapes closed, draws that depend on seed and number alone."""

import itertools

import numpy as np
import pytest
from scipy.stats import kstest, lognorm

from roomeq.draw_rooms.distributions import Distribution, parse_distribution
from roomeq.draw_rooms.draw import FURNITURE_DISTANCE_M, draw_room
from roomeq.draw_rooms.room_types import DIRECTIVITIES, read_room_types
from roomeq.draw_rooms.shapes import draw_shape
from roomeq.sim.mesh import MeshRoom, load_mesh, make_room

TYPES = read_room_types()
ROOMS = [draw_room(number, TYPES, seed=0) for number in range(1, 601)]
P_VALUE = 1e-3


def of_type(name):
    return [room for room in ROOMS if room.room_type.name == name]


def area_m2(shape):
    cut_m2 = 0.0 if shape.cut is None else np.prod(np.subtract(shape.cut.high, shape.cut.low)[:2])
    return shape.dims_m[0] * shape.dims_m[1] - cut_m2


def test_uniform_and_log_normal_draws_have_their_distributions():
    rng = np.random.default_rng(0)
    uniform = [Distribution(2.0, 5.0).draw(rng) for _ in range(2000)]
    assert kstest(uniform, "uniform", args=(2.0, 3.0)).pvalue > P_VALUE
    wide = parse_distribution(dict(median=0.5, spread=1.5, low=0.01, high=50.0), 0.01, 100.0)
    drawn = [wide.draw(rng) for _ in range(2000)]
    assert kstest(drawn, lognorm(np.log(1.5), scale=0.5).cdf).pvalue > P_VALUE
    cut = parse_distribution(dict(median=0.5, spread=1.5, low=0.4, high=0.6), 0.01, 100.0)
    inside = [cut.draw(rng) for _ in range(2000)]
    assert 0.4 <= min(inside) < 0.41 and 0.59 < max(inside) <= 0.6


@pytest.mark.parametrize("name", ["meeting_room", "living_room", "lecture_hall"])
def test_sizes_follow_the_distributions_of_the_type(name):
    rooms = of_type(name)
    room_type, rng = rooms[0].room_type, np.random.default_rng(1)
    for key, drawn in (("floor_area_m2", [area_m2(room.shape) for room in rooms]),
                       ("aspect", [room.shape.dims_m[0] / room.shape.dims_m[1] for room in rooms]),
                       ("height_m", [room.shape.dims_m[2] for room in rooms])):
        stated = [getattr(room_type, key).draw(rng) for _ in range(4000)]
        assert kstest(drawn, stated).pvalue > P_VALUE, key


def test_types_shapes_and_devices_have_their_shares():
    assert all(abs(len(of_type(room_type.name)) / len(ROOMS) - 1 / 3) < 0.07 for room_type in TYPES)
    for room_type in TYPES:
        rooms = of_type(room_type.name)
        assert abs(np.mean([room.shape.cut is not None for room in rooms]) - room_type.l_shaped) < 0.08
        assert abs(np.mean([bool(room.shape.pieces) for room in rooms]) - room_type.furnished) < 0.12
    talkers = np.mean([room.sources[0].directivity == "talker" for room in ROOMS])
    assert 0.8 < talkers < 0.95


def test_sources_and_microphones_keep_their_distances():
    for room in ROOMS:
        room_type, shape = room.room_type, room.shape
        for source, mic in itertools.product(room.sources, room.mics):
            assert np.linalg.norm(np.subtract(source.position_m, mic.channels_m)
                                  ).min() >= room_type.source_mic_distance_m
        for position in (*(source.position_m for source in room.sources),
                         *(channel for mic in room.mics for channel in mic.channels_m)):
            assert shape.wall_distance_m(position) >= 0.02 - 1e-9
            assert shape.furniture_distance_m(position) >= 0.02 - 1e-9
        on_walls = {place.height_m for place in room_type.sources if place.on == "wall"}
        for source in room.sources:
            if source.directivity == "talker" or not on_walls:
                assert shape.wall_distance_m(source.position_m) >= room_type.wall_distance_m - 1e-9
                assert shape.footprint_distance_m(source.position_m) >= FURNITURE_DISTANCE_M - 1e-9


def test_directive_sources_face_along_the_floor():
    for source in (source for room in ROOMS for source in room.sources):
        assert (source.facing is None) == (DIRECTIVITIES[source.directivity] is None)
        assert source.facing[2] == 0.0 and np.linalg.norm(source.facing) == pytest.approx(1.0, abs=1e-5)


def test_rooms_depend_on_seed_and_number_alone():
    again = [draw_room(number, TYPES, seed=0) for number in (600, 3)]
    assert again == [ROOMS[599], ROOMS[2]]
    assert draw_room(3, TYPES, seed=1) != ROOMS[2]


def test_l_shaped_and_furnished_rooms_are_closed_and_have_their_volume(tmp_path):
    both = [room for room in ROOMS if room.shape.cut is not None and room.shape.pieces][:12]
    plain = [room for room in ROOMS if room.shape.cut is not None and not room.shape.pieces][:8]
    corners = {(room.shape.cut.low[0] == 0.0, room.shape.cut.low[1] == 0.0) for room in (*both, *plain)}
    assert len(corners) == 4
    for room in (*both, *plain):
        mesh = room.shape.room()  # refuses a mesh that is not closed
        assert isinstance(mesh, MeshRoom)
        solid_m3 = sum(np.prod(np.subtract(piece.box.high, piece.box.low)) for piece in room.shape.pieces)
        assert mesh.volume_m3 == pytest.approx(area_m2(room.shape) * room.shape.dims_m[2] - solid_m3, rel=1e-4)
        (tmp_path / "room.obj").write_text(room.shape.obj())
        read = load_mesh(tmp_path / "room.obj")
        assert read.surfaces == mesh.surfaces and np.allclose(read.surface_area_m2, mesh.surface_area_m2, rtol=1e-4)
        for source in room.sources:
            mesh.require_inside("source_pos_m", source.position_m)
        for channel in room.mics[0].channels_m:
            mesh.require_inside("mic_pos_m", channel)


def test_a_mesh_with_a_face_left_out_is_refused():
    """What the test above relies on."""
    shape = next(room.shape for room in ROOMS if room.shape.pieces)
    triangles = [corners[[0, 1, 2]] for corners, _ in shape.polygons()]
    with pytest.raises(ValueError, match="the mesh has holes"):
        make_room(np.array(triangles), ["wall"] * len(triangles))


def test_furniture_does_not_overlap():
    for shape in (room.shape for room in ROOMS if len(room.shape.pieces) > 1):
        for one, other in itertools.combinations(shape.pieces, 2):
            assert not one.box.meets(other.box, 0.09)


def test_din_18041_gives_the_time_by_volume():
    (hall,) = [room_type for room_type in TYPES if room_type.name == "lecture_hall"]
    rng = np.random.default_rng(0)
    times_s = [hall.t60_s.draw(250.0, rng) for _ in range(2000)]
    assert np.median(times_s) == pytest.approx(1.25 * (0.32 * np.log10(250.0) - 0.17), rel=0.05)


OWN = """
[cell]
floor_area_m2 = [9, 12]
aspect = 1
height_m = 2.5
t60_s = "materials"
[[cell.sources]]
height_m = 1.2
[[cell.microphones]]
on = "wall"
height_m = 1.5
array_m = [[-0.03, 0, 0], [0.03, 0, 0]]
"""


def own(tmp_path, old="", new=""):
    assert old in OWN
    (tmp_path / "own.toml").write_text(OWN.replace(old, new, 1))
    return read_room_types(tmp_path / "own.toml")


def test_an_array_on_a_wall_lies_along_it(tmp_path):
    types = own(tmp_path)
    assert types[0].t60_s.draw(30.0, np.random.default_rng(0)) is None
    for number in range(1, 30):
        room = draw_room(number, types, seed=0)
        first, second = np.array(room.mics[0].channels_m)
        distances_m = [room.shape.wall_distance_m(channel) for channel in (first, second)]
        assert distances_m[0] == pytest.approx(distances_m[1], abs=1.1e-3) and 0.019 <= distances_m[0] <= 0.051
        assert np.linalg.norm(first - second) == pytest.approx(0.06, abs=2e-3)


def test_names_choose_among_the_types_of_the_package():
    assert [room_type.name for room_type in read_room_types("lecture_hall,meeting_room")] == ["meeting_room",
                                                                                            "lecture_hall"]
    with pytest.raises(ValueError, match="room_types: 'car' must be a TOML file or among meeting_room, living_room"):
        read_room_types("meeting_room,car")
    for empty in ("", ","):
        with pytest.raises(ValueError, match=f"room_types='{empty}' must be a TOML file or among meeting_room, "):
            read_room_types(empty)


@pytest.mark.parametrize("old, new, message", [
    ("height_m = 2.5", "heigth_m = 2.5", r"cell: key 'heigth_m' must be one of .*: did you mean height_m\?"),
    ("aspect = 1", "", "cell: key 'aspect' is missing: add it"),
    ("[9, 12]", "[12, 9]", r"cell: floor_area_m2=\[12, 9\] must be a number, \[LOW, HIGH\] or .*in \[2, 5000\]"),
    ("[9, 12]", "'large'", "cell: floor_area_m2='large' must be a number"),
    ("[9, 12]", "true", "cell: floor_area_m2=True must be a number"),
    ("[9, 12]", "{median = 10, spread = 1, low = 5, high = 20}", r"floor_area_m2=.* S in \(1, 10\]"),
    ('"materials"', '{din_18041 = "A9", ratio = 1}', 't60_s=.* or "materials"; or {din_18041 = "A1|A2|A3|A4"'),
    ('on = "wall"', 'on = "roof"', r"cell: microphones\[0\]: on='roof' must be one of free, table, wall: correct it"),
    ("height_m = 1.2", "height = 1.2", r"cell: sources\[0\]: key 'height' must be one of"),
    ("[[cell.sources]]\nheight_m = 1.2", "sources = 1", "cell: sources=1 must be one or more tables"),
    ("[0.03, 0, 0]", "[0.03, 0]", r"microphones\[0\]: array_m=.* must be 1 to 64 positions \[x, y, z\]"),
    ("[cell]", "[cell", r"own.toml: cannot be read as types of rooms"),
    ("[cell]", "['a b']", r"type 'a b' must be named by letters, digits"),
])
def test_a_wrong_table_is_refused_with_key_and_rule(tmp_path, old, new, message):
    with pytest.raises(ValueError, match=message) as refused:
        own(tmp_path, old, new)
    assert str(tmp_path / "own.toml") in str(refused.value)


def test_a_room_without_place_is_refused(tmp_path):
    types = own(tmp_path, "aspect = 1", "aspect = 1\nwall_distance_m = 2")
    with pytest.raises(ValueError, match="room00001: rooms of type 'cell' have no place .* wall_distance_m=2"):
        draw_room(1, types, seed=0)


def test_shapes_take_furniture_that_fits_only():
    tiny = next(room_type for room_type in TYPES if room_type.name == "living_room")
    rng = np.random.default_rng(3)
    for _ in range(50):
        shape = draw_shape(tiny, rng)
        for piece in shape.pieces:
            assert np.all(np.array(piece.box.low) >= 0.0) and np.all(np.array(piece.box.high) <= shape.dims_m)


