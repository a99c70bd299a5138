"""The map of a room: first reflections by geometry, edges, and what is unknown."""

import numpy as np
import pytest
from plans import L_PLAN, box_plan, prism_obj
from rirmaker import row

from roomeq.report.room_map import first_reflections, map_room
from roomeq.sim.mesh import load_mesh
from roomeq.sim.scene import WALLS, Shoebox

SOURCE, MIC = np.array([1.5, 2.0, 1.2]), np.array([4.0, 3.5, 1.6])
KNOWN = dict(source_pos_m=SOURCE.tolist(), mic_pos_m=MIC.tolist())


def test_each_wall_of_a_shoebox_reflects_once_at_equal_angles():
    dims_m = np.array([6.0, 5.0, 3.0])
    reflections = first_reflections(Shoebox(tuple(dims_m)), SOURCE, MIC, 20.0)
    assert sorted(reflection.surface for reflection in reflections) == sorted(WALLS)
    for reflection in reflections:
        axis, far = divmod(WALLS.index(reflection.surface), 2)
        point_m = reflection.points_m[1]
        assert point_m[axis] == pytest.approx(far * dims_m[axis], abs=1e-9)
        assert np.all((point_m >= -1e-9) & (point_m <= dims_m + 1e-9))
        to_source, to_mic = ((end - point_m) / np.linalg.norm(end - point_m) for end in (SOURCE, MIC))
        assert to_source[axis] == pytest.approx(to_mic[axis], abs=1e-9)
        detour_m = (np.linalg.norm(point_m - SOURCE) + np.linalg.norm(point_m - MIC) - np.linalg.norm(MIC - SOURCE))
        assert reflection.delay_s == pytest.approx(detour_m / 343.2, rel=2e-3)
    assert [reflection.delay_s for reflection in reflections] == sorted(r.delay_s for r in reflections)


def test_a_mesh_of_a_box_reflects_like_the_shoebox(tmp_path):
    (tmp_path / "box.obj").write_text(prism_obj(box_plan(6.0, 5.0), 3.0))
    expected = first_reflections(Shoebox((6.0, 5.0, 3.0)), SOURCE, MIC)
    found = first_reflections(load_mesh(tmp_path / "box.obj"), SOURCE, MIC)
    assert np.allclose([r.points_m for r in found], [r.points_m for r in expected], atol=1e-4)


def test_edges_of_a_mesh_leave_out_those_within_flat_surfaces(tmp_path):
    (tmp_path / "l.obj").write_text(prism_obj(L_PLAN, 3.0))
    room = map_room(row("a", mesh="l.obj", room_dims_m=None, source_pos_m=[1, 1, 1], mic_pos_m=[1, 4, 1]), [], tmp_path)
    assert len(room.edges_m) == 18 and room.reflections and not room.note  # six corners: below, above and between


def test_other_positions_of_the_room_are_on_the_map(tmp_path):
    rows = [row("a", **KNOWN), row("b", **(KNOWN | dict(mic_pos_m=[2.0, 2.0, None]))), row("c", "office", **KNOWN)]
    room = map_room(rows[0], rows, tmp_path)
    assert len(room.sources_m) == 1 and len(room.mics_m) == 2 and len(room.edges_m) == 12
    assert room.has_heights and not room.note and len(room.reflections) == 6


@pytest.mark.parametrize("change, note", [
    (dict(mic_pos_m=[4.0, 3.5, None]), "not all coordinates of the microphone"),
    (dict(source_pos_m=None, mic_pos_m=None), "not all coordinates of the source and the microphone"),
    (dict(mic_pos_m=[7.0, 3.5, 1.0]), "outside the room"),
    (dict(unreliable_geometry=True), "marked unreliable"),
    (dict(distance_m=9.0), "apart")])
def test_what_is_unknown_or_contradictory_is_said_and_shows_no_reflections(tmp_path, change, note):
    room = map_room(row("a", **(KNOWN | change)), [], tmp_path)
    assert note in room.note and room.reflections == []


@pytest.mark.parametrize("change", [
    dict(room_dims_m=None), dict(room_dims_m=[6.0, 5.0, None]), dict(mesh="absent.obj")])
def test_room_without_usable_dimensions_has_no_map(tmp_path, change):
    assert map_room(row("a", **(KNOWN | change)), [], tmp_path) is None
