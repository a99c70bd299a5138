"""Draw a room with its sources and microphones; all that is drawn depends on the seed and the room's number alone."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from roomeq.core.arrays import FloatArray
from roomeq.core.rng import rng_for
from roomeq.draw_rooms.room_types import MicPlace, RoomType, SourcePlace, draw_index, draw_type
from roomeq.draw_rooms.shapes import Shape, draw_count, draw_shape
from roomeq.sim.scene import Air

TABLE_M = 0.75
"""Height of the tables in a room whose furniture is not drawn."""
FURNITURE_DISTANCE_M = 0.1
"""Least distance of sources and microphones from furniture, except of what stands on it."""
_OFF_WALL_M = (0.02, 0.05)  # distance of devices on walls
_FROM_CORNER_M = 0.3
_CLEAR_M = 0.02  # least distance of each microphone of an array from all surfaces
_ROOMS, _TRIES = 20, 100

Point = tuple[float, float, float]
AnyPlace = TypeVar("AnyPlace", SourcePlace, MicPlace)


@dataclass(frozen=True)
class DrawnSource:
    """A source: its id, position [m], the direction that it faces (None: omnidirectional) and its kind."""

    id: str
    position_m: Point
    facing: Point | None
    directivity: str


@dataclass(frozen=True)
class DrawnMic:
    """A microphone or an array: its id and the positions of its channels [m]."""

    id: str
    channels_m: tuple[Point, ...]


@dataclass(frozen=True)
class DrawnRoom:
    """A room that was drawn, without its materials and its reverberation time."""

    id: str
    room_type: RoomType
    shape: Shape
    air: Air
    sources: tuple[DrawnSource, ...]
    mics: tuple[DrawnMic, ...]


def room_id(number: int) -> str:
    """Return the id of a room by its number, counted from 1."""
    return f"room{number:05d}"


def draw_room(number: int, types: Sequence[RoomType], seed: int) -> DrawnRoom:
    """Draw a room.

    Raises
    ------
    ValueError
        The type's rooms have no place for its sources and microphones.
    """
    rng = rng_for(seed, "drawn room", room_id(number))
    room_type = draw_type(types, rng)
    air = Air(round(room_type.temperature_c.draw(rng), 1), round(room_type.humidity_pct.draw(rng), 1))
    for _ in range(_ROOMS):
        shape = draw_shape(room_type, rng)
        sources = _place_all(shape, room_type, room_type.sources, draw_count(room_type.num_sources, rng), [], rng)
        mics = _place_all(shape, room_type, room_type.microphones, draw_count(room_type.num_mics, rng),
                          [channels[0] for _, channels in sources], rng)
        if sources and mics:
            target_m = mics[0][1][0]
            return DrawnRoom(
                room_id(number), room_type, shape, air,
                tuple(_source(f"s{n}", place, channels[0], target_m, rng)
                      for n, (place, channels) in enumerate(sources, start=1)),
                tuple(DrawnMic(f"m{n}", tuple(map(_point, channels))) for n, (_, channels) in enumerate(mics, start=1)))
    raise ValueError(f"{room_id(number)}: rooms of type {room_type.name!r} have no place for its sources and "
                     f"microphones: reduce wall_distance_m={room_type.wall_distance_m:g}, source_mic_distance_m="
                     f"{room_type.source_mic_distance_m:g} or furniture, or draw larger rooms")


def _source(name: str, place: SourcePlace, position_m: FloatArray, target_m: FloatArray,
            rng: np.random.Generator) -> DrawnSource:
    """Turn a source about the vertical, away from a target."""
    turned_rad = np.radians(place.turned_deg.draw(rng))
    azimuth_rad = np.arctan2(target_m[1] - position_m[1], target_m[0] - position_m[0]) + turned_rad
    facing = round(float(np.cos(azimuth_rad)), 6), round(float(np.sin(azimuth_rad)), 6), 0.0
    return DrawnSource(name, _point(position_m), None if place.directivity == "omnidirectional" else facing,
                       place.directivity)


def _point(position_m: FloatArray) -> Point:
    x, y, z = (float(value) for value in position_m)
    return x, y, z


def _place_all(shape: Shape, room_type: RoomType, places: Sequence[AnyPlace], count: int, sources: list[FloatArray],
               rng: np.random.Generator) -> list[tuple[AnyPlace, FloatArray]]:
    """Place sources, or microphones clear of the sources, in a room; return an empty list if one has no place.

    Each comes with the positions of its channels, shape (n_channels, 3).
    """
    placed: list[tuple[AnyPlace, FloatArray]] = []
    for _ in range(count):
        place = places[draw_index([place.share for place in places], rng)]
        for _ in range(_TRIES):
            channels_m = np.round(_draw_channels(shape, room_type, place, rng), 3)
            others = [*sources, *(channels[0] for _, channels in placed)]
            if _is_clear(shape, room_type, place, channels_m) and all(
                    np.linalg.norm(channels_m - other, axis=1).min() >= room_type.source_mic_distance_m
                    for other in others):
                placed.append((place, channels_m))
                break
        else:
            return []
    return placed


def _draw_channels(shape: Shape, room_type: RoomType, place: SourcePlace | MicPlace,
                   rng: np.random.Generator) -> FloatArray:
    """Draw the positions of a source, a microphone or an array somewhere in the box around a room."""
    turn_rad, tables = rng.uniform(0.0, 2.0 * np.pi), [piece.box for piece in shape.pieces if piece.is_table]
    height_m = place.height_m.draw(rng)
    if place.on == "wall":
        edges = shape.edges
        edge = edges[draw_index([edge.length_m for edge in edges], rng)]
        along_m = _FROM_CORNER_M + rng.random() * (edge.length_m - 2.0 * _FROM_CORNER_M)
        centre = (np.add(edge.start, np.multiply(edge.along, along_m))
                  + np.multiply(edge.inward, rng.uniform(*_OFF_WALL_M)))
        turn_rad = np.arctan2(edge.along[1], edge.along[0])
    elif place.on == "table" and tables:
        table = tables[rng.integers(len(tables))]
        height_m += table.high[2]
        centre = rng.uniform(np.add(table.low[:2], _CLEAR_M), np.subtract(table.high[:2], _CLEAR_M))
    else:
        height_m += TABLE_M if place.on == "table" else 0.0
        centre = rng.uniform([0.0, 0.0], shape.dims_m[:2])
    x, y, z = np.array(getattr(place, "array_m", ((0.0, 0.0, 0.0),))).T
    return np.column_stack([centre[0] + x * np.cos(turn_rad) - y * np.sin(turn_rad),
                            centre[1] + x * np.sin(turn_rad) + y * np.cos(turn_rad), height_m + z])


def _is_clear(shape: Shape, room_type: RoomType, place: SourcePlace | MicPlace, channels_m: FloatArray) -> bool:
    on_table = place.on == "table" and any(piece.is_table for piece in shape.pieces)
    free = place.on != "wall" and not on_table
    from_furniture_m = _CLEAR_M if on_table else FURNITURE_DISTANCE_M
    furniture_distance_m = shape.footprint_distance_m if free else shape.furniture_distance_m
    return all(_CLEAR_M <= position[2] <= shape.dims_m[2] - _CLEAR_M
               and shape.wall_distance_m(position) >= (room_type.wall_distance_m if free and n == 0 else _CLEAR_M)
               and furniture_distance_m(position) >= from_furniture_m - 1e-9
               for n, position in enumerate(channels_m))
