"""The rule that says for what the geometry of an RIR row may be used."""

import pytest
from rirmaker import row

from roomeq.records.geometry import geometry_usability

POSITIONS = dict(source_pos_m=[1.0, 1.0, 1.0], mic_pos_m=[4.0, 3.0, 1.5])


@pytest.mark.parametrize("needs, keys, reason", [
    ("consistency", {}, None),
    ("consistency", POSITIONS, None),
    ("consistency", dict(unreliable_geometry=True), "the positions are marked unreliable"),
    ("consistency", dict(geometry_problem="source on mic"), "source on mic"),
    ("consistency", dict(mic_pos_m=[1.0, None, 3.5]), "mic_pos_m[2]=3.5 lies outside the room (0 to 3 m)"),
    ("consistency", dict(source_pos_m=[-0.1, 1.0, 1.0]), "source_pos_m[0]=-0.1 lies outside the room (0 to 6 m)"),
    ("consistency", dict(room_dims_m=None, mic_pos_m=[99.0, 1.0, 1.0]), None),
    ("simulation", {}, None),
    ("simulation", dict(mic_pos_m=[99.0, 1.0, 1.0]), None),
    ("simulation", dict(unreliable_geometry=True), "the positions are marked unreliable"),
    ("simulation", dict(geometry_problem="source on mic"), "source on mic"),
    ("stated distance", dict(unreliable_geometry=True), None),
    ("stated distance", dict(geometry_problem="source on mic"), "source on mic"),
    ("same position", POSITIONS, None),
    ("same position", POSITIONS | dict(unreliable_geometry=True), "the positions are marked unreliable"),
    ("same position", dict(source_pos_m=[1.0, 1.0, 1.0]), "mic_pos_m=None has unknown coordinates"),
    ("same position", POSITIONS | dict(room_dims_m=None), None),
    ("loop", POSITIONS, None),
    ("loop", POSITIONS | dict(unreliable_geometry=True), "the positions are marked unreliable"),
    ("loop", POSITIONS | dict(room_dims_m=[6.0, None, 3.0]), "room_dims_m=[6.0, None, 3.0] has unknown coordinates"),
    ("loop", POSITIONS | dict(room_dims_m=None, mesh="room.obj"), None),
    ("loop", dict(mic_pos_m=[4.0, 3.0, 1.5]), "source_pos_m=None has unknown coordinates"),
])
def test_usability_and_reason_follow_the_need(needs, keys, reason):
    usability = geometry_usability(row("a", **keys), needs=needs)
    assert usability == (reason is None, reason)
