"""Positions of rooms, sources and microphones; unknown coordinates are drawn from plausible ranges.

The row of a simulated RIR lists the coordinates that were drawn. A room without dimensions is drawn once for all rows
of that room. A source is drawn at the same place for all its microphones, except for a row whose microphone or stated
distance does not allow that place.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from roomeq.core.arrays import FloatArray
from roomeq.core.rng import rng_for
from roomeq.records.geometry import geometry_usability
from roomeq.sim.mesh import MeshRoom, load_mesh
from roomeq.sim.room import Room
from roomeq.sim.scene import MIN_WALL_DISTANCE_M, Shoebox

VOLUME_RANGE_M3 = (30.0, 2000.0)
HEIGHT_RANGE_M = (0.8, 1.8)  # of sources and microphones: seated and standing talkers, tables
CLEARANCE_M = 0.5  # of drawn positions from walls and from each other, at most a tenth of the room's size
_TRIES = 500

Position = list[float | None]
"""Three coordinates [m]; None where one is unknown."""


@dataclass(frozen=True)
class Place:
    """The geometry of one response.

    Attributes
    ----------
    room
    source_pos_m, mic_pos_m
        Three coordinates each.
    drawn
        Names of the coordinates that were drawn, such as ``"mic_pos_m.2"`` or ``"room_dims_m.0"``.
    channels_m
        Positions of the microphones of an array, of which `mic_pos_m` is the first; empty for a single microphone.
    """

    room: Room
    source_pos_m: tuple[float, ...]
    mic_pos_m: tuple[float, ...]
    drawn: tuple[str, ...]
    channels_m: tuple[tuple[float, ...], ...] = ()


def find_place(row: Mapping[str, Any], rows_of_room: Iterable[Mapping[str, Any]], directory: str | Path,
               seed: int) -> Place:
    """Return the room and positions of a row; unknown coordinates are drawn.

    Parameters
    ----------
    row
        Row of an RIR directory.
    rows_of_room
        All rows with the same `room_id`; their stated distances bound the size of a room that is drawn.
    directory
        Directory that the path of a `mesh` is relative to.
    seed

    Raises
    ------
    ValueError
        A position lies outside the room, or the stated distance does not fit in it; the message names the row.
    """
    try:
        drawn: list[str] = []
        if row.get("mesh"):
            room: Room = load_mesh(Path(directory) / row["mesh"])
        else:
            room, drawn = _room(row, rows_of_room, seed)
        known_source, known_mic = _usable_position(row, "source_pos_m"), _usable_position(row, "mic_pos_m")
        unknown = [f"{key}.{axis}" for key, place in (("source_pos_m", known_source), ("mic_pos_m", known_mic))
                   for axis in range(3) if place[axis] is None]
        source, mic = _positions(row, room, known_source, known_mic, seed)
        drawn += unknown
        for key, place in (("source_pos_m", source), ("mic_pos_m", mic)):
            drawn += _clear_walls(room, place, key)
            room.require_inside(key, place)
        channels = _channels(row.get("channel_pos_m") or [], mic)
        for n, position in enumerate(channels):
            room.require_inside(f"channel_pos_m[{n}]", position)
    except ValueError as error:
        raise ValueError(f"RIR {row['id']}: {error}") from None
    return Place(room, tuple(map(float, source)), tuple(map(float, mic)), tuple(drawn), channels)


def towards_microphone(place: Place) -> FloatArray:
    """Return the unit vector from a source to its microphone, shape (3,)."""
    towards = np.subtract(place.mic_pos_m, place.source_pos_m)
    return np.asarray(towards / np.linalg.norm(towards))


def _channels(stated_m: Sequence[Position], mic_m: Sequence[float]) -> tuple[tuple[float, ...], ...]:
    """Return the positions of an array's microphones, which move with the first one; empty if they are unknown."""
    if len(stated_m) < 2 or any(None in position for position in stated_m):
        return ()
    positions_m = np.array(stated_m, dtype=float)
    moved_m = positions_m - positions_m[0] + mic_m
    return tuple(tuple(round(float(value), 6) for value in position) for position in moved_m)


def _usable_position(row: Mapping[str, Any], key: str) -> Position:
    """Return a position of a row; unknown if the row says that its geometry is unreliable."""
    if row.get(key) is None or not geometry_usability(row, needs="simulation").usable:
        return [None] * 3
    return list(row[key])


def _room(row: Mapping[str, Any], rows_of_room: Iterable[Mapping[str, Any]], seed: int) -> tuple[Shoebox, list[str]]:
    """Return the room of a row, with the names of the dimensions that were drawn."""
    dims_m = list(row.get("room_dims_m") or [None] * 3)
    unknown = [axis for axis in range(3) if dims_m[axis] is None]
    if not unknown:
        return Shoebox(tuple(dims_m)), []
    rng = rng_for(seed, "room", row["room_id"])
    rows = list(rows_of_room)
    needed_m = max([member.get("distance_m") or 0.0 for member in rows])
    # the room must contain every known position of its rows
    positions = [member.get(key) for member in rows for key in ("source_pos_m", "mic_pos_m")]
    most_m = [max([position[axis] for position in positions if position and position[axis] is not None], default=0.0)
              for axis in range(3)]
    for _ in range(_TRIES):
        drawn_m = _plausible_dims_m(rng)
        size_m = [drawn_m[axis] if axis in unknown else dims_m[axis] for axis in range(3)]
        if np.hypot(size_m[0], size_m[1]) > 1.2 * needed_m + 2.0 * CLEARANCE_M and all(
                size_m[axis] > most_m[axis] + 0.1 for axis in unknown):
            break
    else:
        size_m = [max(size_m[axis], most_m[axis] + 1.0, needed_m + 2.0 if axis < 2 else 0.0)
                  if axis in unknown else dims_m[axis] for axis in range(3)]
    return Shoebox(tuple(round(float(value), 3) for value in size_m)), [f"room_dims_m.{axis}" for axis in unknown]


def _plausible_dims_m(rng: np.random.Generator) -> list[float]:
    """Draw a room for speech: log-uniform volume, length up to twice the width, height growing with the volume."""
    volume_m3 = np.exp(rng.uniform(*np.log(VOLUME_RANGE_M3)))
    ratio = rng.uniform(1.0, 2.0)
    height_m = np.clip(volume_m3 ** (1.0 / 3.0) * rng.uniform(0.45, 0.75), 2.4, 10.0)
    length_m = np.sqrt(volume_m3 / height_m * ratio)
    return [length_m, length_m / ratio, height_m]


def _positions(row: Mapping[str, Any], room: Room, source: Position, mic: Position,
               seed: int) -> tuple[list[float], list[float]]:
    """Complete both positions; a stated distance is kept if one of them is free to be moved."""
    known = repr([row["room_id"], row["source_id"], source])
    distance_m = row.get("distance_m") if geometry_usability(row, needs="stated distance").usable else None
    mic_rng = rng_for(seed, "mic_pos_m", row["id"])
    source_known, mic_known = None not in source, None not in mic
    for attempt in range(_TRIES if mic_known else 20):
        source_rng = rng_for(seed, f"source_pos_m {attempt}", known)
        placed_source = (_draw_at(room, source, cast(list[float], mic), distance_m, source_rng) if mic_known else
                         _draw(room, source, source_rng))
        if not (source_known or _inside(room, placed_source)):
            continue
        for _ in range(1 if mic_known else _TRIES):
            placed_mic = _draw_at(room, mic, placed_source, distance_m, mic_rng)
            if (source_known and mic_known) or _fits(room, placed_source, placed_mic, distance_m, mic_known):
                return placed_source, placed_mic
    raise ValueError(f"distance_m={distance_m} between source and microphone has no place in the room: correct "
                     "distance or room")


def _fits(room: Room, source: list[float], mic: list[float], distance_m: float | None, mic_known: bool) -> bool:
    apart_m = float(np.linalg.norm(np.subtract(source, mic)))
    if distance_m is None:
        return apart_m > min(CLEARANCE_M, 0.1 * min(_extent_m(room)))
    # a partly known position meets the distance only roughly
    tolerance_m = 0.02 if not mic_known else 0.2
    return abs(apart_m - distance_m) <= tolerance_m + 0.02 * distance_m and _inside(room, mic)


def _draw(room: Room, place: Sequence[float | None], rng: np.random.Generator) -> list[float]:
    """Draw the unknown coordinates of a position."""
    if None not in place:
        return cast(list[float], list(place))
    low_m, high_m = _bounds(room)
    for _ in range(_TRIES):
        drawn = rng.uniform(low_m, high_m)
        position = [round(float(drawn[axis]), 3) if value is None else value for axis, value in enumerate(place)]
        if _inside(room, position):
            break
    return position


def _draw_at(room: Room, place: Position, other: list[float], distance_m: float | None,
             rng: np.random.Generator) -> list[float]:
    """Draw the unknown coordinates of a position, at a stated distance from another one if there is one."""
    if distance_m is None or None not in place:
        return _draw(room, place, rng)
    unknown = [axis for axis in range(3) if place[axis] is None]
    if len(unknown) == 3:
        angle, rise_m = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(-0.3, 0.3)
        rise_m = float(np.clip(rise_m, -distance_m, distance_m))
        level_m = np.sqrt(max(distance_m ** 2 - rise_m ** 2, 0.0))
        position_m = np.add(other, [level_m * np.cos(angle), level_m * np.sin(angle), rise_m])
        return [round(float(value), 4) for value in position_m]
    position = _draw(room, place, rng)
    axis = unknown[-1] if len(unknown) == 1 else unknown[rng.integers(len(unknown))]
    rest = distance_m ** 2 - sum((position[k] - other[k]) ** 2 for k in range(3) if k != axis)
    if rest >= 0.0:  # the last unknown coordinate is set to meet the distance
        position[axis] = round(float(other[axis] + np.sqrt(rest) * rng.choice([-1.0, 1.0])), 4)
    return position


def _extent_m(room: Room) -> FloatArray:
    low_m, high_m = room_box(room)
    return high_m - low_m


def room_box(room: Room) -> tuple[FloatArray, FloatArray]:
    """Return the corners of the box around a room, two arrays of shape (3,)."""
    if isinstance(room, Shoebox):
        return np.zeros(3), np.array(room.dims_m)
    return cast(MeshRoom, room).bounds_m


def _bounds(room: Room) -> tuple[FloatArray, FloatArray]:
    """Return the corners of the box that positions are drawn in."""
    low_m, high_m = room_box(room)
    size_m = high_m - low_m
    margin_m = np.minimum(CLEARANCE_M, 0.1 * size_m)
    low_m, high_m = low_m + margin_m, high_m - margin_m
    floor_m = low_m[2] - margin_m[2]
    heights_m = np.clip(floor_m + np.array(HEIGHT_RANGE_M), low_m[2], high_m[2])
    return np.array([*low_m[:2], heights_m[0]]), np.array([*high_m[:2], max(heights_m[1], heights_m[0] + 1e-6)])


def _inside(room: Room, place: list[float]) -> bool:
    try:
        room.require_inside("position", place)
    except ValueError:
        return False
    return True


def _clear_walls(room: Room, place: list[float], key: str) -> list[str]:
    """Move a measured position out of the margin of walls, in place; return the names of the moved coordinates."""
    moved = []
    if isinstance(room, Shoebox):
        for axis, size_m in enumerate(room.dims_m):
            clear_m = float(np.clip(place[axis], MIN_WALL_DISTANCE_M, size_m - MIN_WALL_DISTANCE_M))
            if 0.0 < abs(clear_m - place[axis]) <= MIN_WALL_DISTANCE_M + 1e-9:
                place[axis] = clear_m
                moved.append(f"{key}.{axis}")
    return moved


def noise_positions(room: Room, room_id: str, seed: int, count: int) -> list[list[float]]:
    """Draw the positions of noise sources in a room; all its responses share them, and so their traces."""
    rng = rng_for(seed, "noise", room_id)
    return [_draw(room, [None] * 3, rng) for _ in range(count)]
