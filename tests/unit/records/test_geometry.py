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
    ("consistency", POSITIONS | dict(mic_pos_m=[1.0, 1.0, 1.0]),
     "source and microphone are 0 m apart and must be at least 0.05 m, which the simulator needs"),
    ("consistency", POSITIONS | dict(mic_pos_m=[1.03, 1.0, 1.0]),
     "source and microphone are 0.03 m apart and must be at least 0.05 m, which the simulator needs"),
    ("consistency", POSITIONS | dict(mic_pos_m=[1.05, 1.0, 1.0]), None),
    ("consistency", dict(distance_m=0.03),
     "source and microphone are 0.03 m apart and must be at least 0.05 m, which the simulator needs"),
    ("consistency", POSITIONS | dict(mic_pos_m=[1.03, 1.0, None]), None),
    ("consistency", POSITIONS | dict(distance_m=9.9), "distance_m=9.9 but the positions are 3.64 m apart"),
    ("consistency", POSITIONS | dict(mic_pos_m=[4.0, 3.0, None], distance_m=1.0),
     "distance_m=1 but the positions are at least 3.61 m apart"),
    ("consistency", POSITIONS | dict(mic_pos_m=[4.0, 3.0, None], distance_m=3.5), None),
    ("consistency", POSITIONS | dict(mic_pos_m=[4.0, 3.0, None], distance_m=3.9), None),
    ("consistency", dict(source_pos_m=[1.0, 1.0, 1.0], distance_m=1.0), None),
    ("consistency", dict(room_dims_m=[6.0, -5.0, 3.0]), "room_dims_m[1]=-5 must be positive"),
    ("simulation", {}, None),
    ("simulation", dict(mic_pos_m=[99.0, 1.0, 1.0]), None),
    ("simulation", dict(unreliable_geometry=True), "the positions are marked unreliable"),
    ("simulation", dict(geometry_problem="source on mic"), "source on mic"),
    ("stated distance", dict(unreliable_geometry=True), None),
    ("stated distance", dict(geometry_problem="source on mic"), "source on mic"),
    ("same position", POSITIONS, None),
    ("same position", POSITIONS | dict(unreliable_geometry=True), "the positions are marked unreliable"),
    ("same position", dict(source_pos_m=[1.0, 1.0, 1.0]), "mic_pos_m=None: x and y must be known"),
    ("same position", POSITIONS | dict(mic_pos_m=[4.0, None, 1.5]),
     "mic_pos_m=[4.0, None, 1.5]: x and y must be known"),
    ("same position", dict(source_pos_m=[1.0, 1.0, None], mic_pos_m=[4.0, 3.0, None]), None),
    ("same position", POSITIONS | dict(room_dims_m=None), None),
    ("loop", POSITIONS, None),
    ("loop", POSITIONS | dict(unreliable_geometry=True), "the positions are marked unreliable"),
    ("loop", POSITIONS | dict(geometry_problem="source on mic"), "the positions are marked as contradictory"),
    ("loop", POSITIONS | dict(binaural=True, unreliable_geometry=True),
     "binaural, where an omnidirectional microphone is needed"),
    ("loop", POSITIONS | dict(room_dims_m=[6.0, None, 3.0]), "the room's dimensions are unknown"),
    ("loop", POSITIONS | dict(room_dims_m=None, mesh="room.obj"), None),
    ("loop", POSITIONS | dict(mesh="room.obj", mic_pos_m=[-4.0, 3.0, 1.5]), None),
    ("loop", POSITIONS | dict(mesh="room.obj", mic_pos_m=[4.0, 3.0, None]), "x, y and z of microphone are unknown"),
    ("loop", dict(mic_pos_m=[4.0, 3.0, 1.5]), "x and y of source are unknown"),
    ("loop", POSITIONS | dict(mic_pos_m=[4.0, None, 1.5]), "x and y of microphone are unknown"),
    ("loop", {}, "x and y of source and microphone are unknown"),
    ("loop", dict(room_dims_m=None), "the room's dimensions and x and y of source and microphone are unknown"),
    ("loop", dict(source_pos_m=[1.0, 1.0, None], mic_pos_m=[4.0, 3.0, None]), None),
    ("loop", POSITIONS | dict(room_dims_m=[6.0, 0.0, 3.0]), "the room has a dimension of 0 or less"),
    ("loop", POSITIONS | dict(mic_pos_m=[4.0, 5.1, None]), "a position lies outside the room"),
    ("loop", POSITIONS | dict(unreliable_geometry=True, source_pos_m=[-1.0, 1.0, None]),
     "a position lies outside the room"),
    ("loop", POSITIONS | dict(mic_pos_m=[1.0, 1.0, 1.0]), "source and microphone are closer than the simulator allows"),
    ("loop", POSITIONS | dict(mic_pos_m=[1.0, 1.03, 1.0]),
     "source and microphone are closer than the simulator allows"),
    ("loop", POSITIONS | dict(mic_pos_m=[1.0, 1.05, 1.0]), None),
    ("loop", POSITIONS | dict(mic_pos_m=[1.0, 1.03, 1.5]), None),
    ("loop", POSITIONS | dict(mic_pos_m=[1.0, 1.03, None]),
     "source and microphone are one above the other, and their heights are not known"),
    ("loop", POSITIONS | dict(mic_pos_m=[1.0, 1.05, None]), None),
    ("loop", POSITIONS | dict(distance_m=9.9), "the stated distance is not that of the positions"),
    ("loop", POSITIONS | dict(mic_pos_m=[4.0, 3.0, None], distance_m=1.0),
     "the stated distance is not that of the positions"),
])
def test_usability_and_reason_follow_the_need(needs, keys, reason):
    usability = geometry_usability(row("a", **keys), needs=needs)
    assert usability == (reason is None, reason)
