"""Where measured rooms, sources and microphones are, and plausible places for what nobody measured.

A coordinate that is unknown is drawn, and the row says which were. A room without dimensions is drawn once for
all rows of that room, a source once for all its microphones.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from roomeq.core.rng import rng_for
from roomeq.records.geometry import geometry_usability
from roomeq.sim.mesh import load_mesh
from roomeq.sim.room import Room
from roomeq.sim.scene import MIN_WALL_DISTANCE_M, Shoebox

VOLUME_RANGE_M3 = (30.0, 2000.0)
HEIGHT_RANGE_M = (0.8, 1.8)  # of sources and microphones: mouths and tables
CLEARANCE_M = 0.5  # drawn positions keep this distance from walls and from each other, in small rooms a tenth
_TRIES = 500


@dataclass(frozen=True)
class Place:
    """The geometry of one response.

    Attributes
    ----------
    room : Shoebox or MeshRoom
    source_pos_m, mic_pos_m : tuple of 3 floats
    drawn : tuple of str
        What was unknown and drawn, such as ``"mic_pos_m.2"`` or ``"room_dims_m.0"``.
    """

    room: Room
    source_pos_m: tuple
    mic_pos_m: tuple
    drawn: tuple


def find_place(row, rows_of_room, directory, seed):
    """Return where a row's room, source and microphone are; draw what is unknown.

    Parameters
    ----------
    row : dict
        Row of an RIR directory.
    rows_of_room : list of dict
        All rows with the same `room_id`: their stated distances bound a room that is drawn.
    directory : Path
        What a `mesh` is relative to.
    seed : int

    Returns
    -------
    Place

    Raises
    ------
    ValueError
        A position lies outside the room, or the stated distance has no place in it; the message names the row.
    """
    try:
        if row.get("mesh"):
            room, drawn = load_mesh(Path(directory) / row["mesh"]), []
        else:
            room, drawn = _room(row, rows_of_room, seed)
        source, mic = _believed(row, "source_pos_m"), _believed(row, "mic_pos_m")
        unknown = [f"{key}.{axis}" for key, place in (("source_pos_m", source), ("mic_pos_m", mic))
                   for axis in range(3) if place[axis] is None]
        source, mic = _positions(row, room, source, mic, seed)
        drawn += unknown
        for key, place in (("source_pos_m", source), ("mic_pos_m", mic)):
            drawn += _off_the_wall(room, place, key)
            room.require_inside(key, place)
    except ValueError as error:
        raise ValueError(f"RIR {row['id']}: {error}") from None
    return Place(room, tuple(map(float, source)), tuple(map(float, mic)), tuple(drawn))


def _believed(row, key):
    """Position of a row; unknown where the row says that its geometry is unreliable."""
    if row.get(key) is None or not geometry_usability(row, needs="simulation").usable:
        return [None] * 3
    return list(row[key])


def _room(row, rows_of_room, seed):
    dims_m = list(row.get("room_dims_m") or [None] * 3)
    unknown = [axis for axis in range(3) if dims_m[axis] is None]
    if not unknown:
        return Shoebox(tuple(dims_m)), []
    rng = rng_for(seed, "room", row["room_id"])
    needed_m = max([one.get("distance_m") or 0.0 for one in rows_of_room])
    # every known position of the room's rows must have its place in it
    most_m = [max([place[axis] for one in rows_of_room for place in (one.get("source_pos_m"), one.get("mic_pos_m"))
                   if place and place[axis] is not None], default=0.0) for axis in range(3)]
    for _ in range(_TRIES):
        drawn_m = _plausible_dims_m(rng)
        found = [drawn_m[axis] if axis in unknown else dims_m[axis] for axis in range(3)]
        if np.hypot(found[0], found[1]) > 1.2 * needed_m + 2.0 * CLEARANCE_M and all(
                found[axis] > most_m[axis] + 0.1 for axis in unknown):
            break
    else:
        found = [max(found[axis], most_m[axis] + 1.0, needed_m + 2.0 if axis < 2 else 0.0)
                 if axis in unknown else dims_m[axis] for axis in range(3)]
    return Shoebox(tuple(round(float(size_m), 3) for size_m in found)), [f"room_dims_m.{axis}" for axis in unknown]


def _plausible_dims_m(rng):
    """A room that people speak in: volume log-uniform, plan 1 to 2, height growing with the floor."""
    volume_m3 = np.exp(rng.uniform(*np.log(VOLUME_RANGE_M3)))
    ratio = rng.uniform(1.0, 2.0)
    height_m = np.clip(volume_m3 ** (1.0 / 3.0) * rng.uniform(0.45, 0.75), 2.4, 10.0)
    length_m = np.sqrt(volume_m3 / height_m * ratio)
    return [length_m, length_m / ratio, height_m]


def _positions(row, room, source, mic, seed):
    """Complete both positions; a stated distance is kept where a position is free to keep it."""
    known = repr([row["room_id"], row["source_id"], source])
    distance_m = row.get("distance_m") if geometry_usability(row, needs="stated distance").usable else None
    mic_rng = rng_for(seed, "mic_pos_m", row["id"])
    free = None in mic or None in source
    for attempt in range(20):
        placed_source = _draw(room, source, rng_for(seed, f"source_pos_m {attempt}", known))
        for _ in range(_TRIES):
            placed_mic = _draw_mic(room, mic, placed_source, distance_m, mic_rng)
            if not free or _fits(room, placed_source, placed_mic, distance_m, None not in mic):
                return placed_source, placed_mic
    raise ValueError(f"distance_m={distance_m} between source and microphone has no place in the room: correct "
                     "distance or room")


def _fits(room, source, mic, distance_m, mic_known):
    apart_m = float(np.linalg.norm(np.subtract(source, mic)))
    if distance_m is None:
        return apart_m > min(CLEARANCE_M, 0.1 * min(_extent_m(room)))
    # a position that is known in part meets the distance only roughly
    tolerance_m = 0.02 if not mic_known else 0.2
    return abs(apart_m - distance_m) <= tolerance_m + 0.02 * distance_m and _inside(room, mic)


def _draw(room, place, rng):
    """Fill in the unknown coordinates of a position."""
    if None not in place:
        return list(place)
    low_m, high_m = _bounds(room)
    for _ in range(_TRIES):
        drawn = rng.uniform(low_m, high_m)
        found = [round(float(drawn[axis]), 3) if value is None else value for axis, value in enumerate(place)]
        if _inside(room, found):
            return found
    return found


def _draw_mic(room, mic, source, distance_m, rng):
    if distance_m is None or None not in mic:
        return _draw(room, mic, rng)
    unknown = [axis for axis in range(3) if mic[axis] is None]
    if len(unknown) == 3:
        angle, rise_m = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(-0.3, 0.3)
        rise_m = float(np.clip(rise_m, -distance_m, distance_m))
        level_m = np.sqrt(max(distance_m ** 2 - rise_m ** 2, 0.0))
        found = np.add(source, [level_m * np.cos(angle), level_m * np.sin(angle), rise_m])
        return [round(float(value), 4) for value in found]
    found = _draw(room, mic, rng)
    axis = unknown[-1] if len(unknown) == 1 else unknown[rng.integers(len(unknown))]
    rest = distance_m ** 2 - sum((found[other] - source[other]) ** 2 for other in range(3) if other != axis)
    if rest >= 0.0:  # the last unknown coordinate makes the distance right
        found[axis] = round(float(source[axis] + np.sqrt(rest) * rng.choice([-1.0, 1.0])), 4)
    return found


def _extent_m(room):
    low_m, high_m = room_box(room)
    return high_m - low_m


def room_box(room):
    """Corners of the box around a room, two arrays of shape (3,)."""
    if isinstance(room, Shoebox):
        return np.zeros(3), np.array(room.dims_m)
    return room.bounds_m


def _bounds(room):
    """Box that positions are drawn in."""
    low_m, high_m = room_box(room)
    size_m = high_m - low_m
    margin_m = np.minimum(CLEARANCE_M, 0.1 * size_m)
    low_m, high_m = low_m + margin_m, high_m - margin_m
    floor_m = low_m[2] - margin_m[2]
    heights_m = np.clip(floor_m + np.array(HEIGHT_RANGE_M), low_m[2], high_m[2])
    return np.array([*low_m[:2], heights_m[0]]), np.array([*high_m[:2], max(heights_m[1], heights_m[0] + 1e-6)])


def _inside(room, place):
    try:
        room.require_inside("position", place)
    except ValueError:
        return False
    return True


def _off_the_wall(room, place, key):
    """Move a measured position that lies in a wall's margin just clear of it, in place; say which coordinates."""
    moved = []
    if isinstance(room, Shoebox):
        for axis, size_m in enumerate(room.dims_m):
            clear_m = float(np.clip(place[axis], MIN_WALL_DISTANCE_M, size_m - MIN_WALL_DISTANCE_M))
            if 0.0 < abs(clear_m - place[axis]) <= MIN_WALL_DISTANCE_M + 1e-9:
                place[axis] = clear_m
                moved.append(f"{key}.{axis}")
    return moved


def noise_positions(room, room_id, seed, count):
    """Candidate places of noise sources in a room: one list for all responses, so that traces are shared.

    Parameters
    ----------
    room : Shoebox or MeshRoom
    room_id : str
    seed : int
    count : int

    Returns
    -------
    list of list of 3 floats
    """
    rng = rng_for(seed, "noise", room_id)
    return [_draw(room, [None] * 3, rng) for _ in range(count)]
