"""The room of an RIR as far as its row says: outline, positions and first reflections."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from roomeq.acoustics.air import speed_of_sound_m_s
from roomeq.core.arrays import FloatArray
from roomeq.records.geometry import find_contradiction, geometry_usability, is_known
from roomeq.records.schema import RirRow
from roomeq.sim.images import specular_paths
from roomeq.sim.room import Room
from roomeq.sim.scene import Shoebox

logger = logging.getLogger(__name__)

_SAME_PLANE = 0.999  # cosine of the angle between faces of one flat surface


@dataclass(frozen=True)
class Reflection:
    """A specular reflection of first order.

    Attributes
    ----------
    surface : str
        Name of the reflecting surface.
    points_m : ndarray, shape (3, 3)
        Source, point of reflection and microphone.
    delay_s : float
        Arrival after the direct sound.
    """

    surface: str
    points_m: FloatArray
    delay_s: float


@dataclass(frozen=True)
class RoomMap:
    """What is known of a room.

    Attributes
    ----------
    edges_m : ndarray, shape (n_edges, 2, 3)
        The edges of the room.
    sources_m, mics_m : list of positions
        All that the directory has in this room, with NaN for unknown coordinates.
    source_m, mic_m : ndarray, shape (3,)
        Positions of the chosen RIR; NaN where unknown.
    source_dir : ndarray, optional
        Direction that the source faces.
    reflections : list of Reflection
        In the order of arrival; empty where the positions are not known.
    note : str
        What is unknown or contradictory; empty if nothing is.
    """

    edges_m: FloatArray
    sources_m: list[FloatArray]
    mics_m: list[FloatArray]
    source_m: FloatArray
    mic_m: FloatArray
    source_dir: FloatArray | None
    reflections: list[Reflection]
    note: str

    @property
    def has_heights(self) -> bool:
        """Whether a section can show the source and the microphone."""
        return bool(np.isfinite([self.source_m[2], self.mic_m[2]]).any())


def map_room(row: RirRow, rows: Sequence[RirRow], directory: Path) -> RoomMap | None:
    """Return the map of an RIR's room, or None where neither dimensions nor mesh of the room can be used.

    Parameters
    ----------
    row : dict
        The RIR.
    rows : sequence of dict
        RIRs of its directory, for the other positions in the room.
    directory : Path
        The RIR directory.
    """
    room = _room_of(row, directory)
    if room is None:
        return None
    in_room = [other for other in rows if other["room_id"] == row["room_id"]]
    source_m, mic_m = _position(row, "source_pos_m"), _position(row, "mic_pos_m")
    contradiction = find_contradiction(row)
    reason = contradiction.detail if contradiction else geometry_usability(row, needs="consistency").reason
    notes = [reason] if reason else []
    unknown = [name for name, position_m in (("source", source_m), ("microphone", mic_m))
               if not np.isfinite(position_m).all()]
    reflections: list[Reflection] = []
    if unknown:
        notes.append(f"not all coordinates of the {' and the '.join(unknown)} are known, so reflections are not shown")
    elif not notes:
        reflections = first_reflections(room, source_m, mic_m, row.get("temperature_c"))
    direction = _position(row, "source_dir")
    return RoomMap(_edges(room), _unique(in_room, "source_pos_m"), _unique(in_room, "mic_pos_m"), source_m, mic_m,
                   direction if np.isfinite(direction[:2]).all() else None, reflections, "; ".join(notes))


def outline(room: Room) -> RoomMap:
    """Return the map of a room without source and microphone."""
    unknown = np.full(3, np.nan)
    return RoomMap(_edges(room), [], [], unknown, unknown, None, [], "")


def first_reflections(room: Room, source_m: FloatArray, mic_m: FloatArray,
                      temperature_c: float | None = None) -> list[Reflection]:
    """Return the specular reflections of first order, sorted by arrival.

    The point of reflection follows from the direction of departure and the length of the path: it lies at the distance
    ``t = (L^2 - |d|^2) / (2 (L + u . d))`` from the source, where L is the length, u the direction and d the vector
    from the microphone to the source.
    """
    paths = specular_paths(room, source_m, mic_m, order=1)
    offset_m = source_m - mic_m
    direct_m = float(np.linalg.norm(offset_m))
    speed_m_s = speed_of_sound_m_s(20.0 if temperature_c is None else temperature_c)
    found = []
    for length_m, counts, departure in zip(paths.distance_m, paths.surface_counts, paths.departure, strict=True):
        if counts.sum() == 1:
            to_wall_m = (length_m ** 2 - direct_m ** 2) / (2.0 * (length_m + departure @ offset_m))
            points_m = np.array([source_m, source_m + to_wall_m * departure, mic_m])
            found.append(Reflection(room.surfaces[int(np.argmax(counts))], points_m,
                                    float((length_m - direct_m) / speed_m_s)))
    return found


def _room_of(row: RirRow, directory: Path) -> Room | None:
    """Return the room of a row; None, with a line in the log, where its mesh or its dimensions cannot be used."""
    dims_m: Any = row.get("room_dims_m")
    try:
        if row.get("mesh"):
            from roomeq.sim.mesh import load_mesh

            return load_mesh(directory / str(row["mesh"]))
        return Shoebox(tuple(dims_m)) if is_known(dims_m) else None
    except (ValueError, OSError) as error:
        logger.warning("no map of room %s: %s", row["room_id"], error)
        return None


def _position(row: RirRow, key: str) -> FloatArray:
    return np.array(row.get(key) or [None] * 3, dtype=np.float64)  # None becomes NaN


def _unique(rows: Sequence[RirRow], key: str) -> list[FloatArray]:
    """Return the different positions of some rows whose x and y are known."""
    positions = {tuple(_position(row, key)): _position(row, key) for row in rows}
    return [position for position in positions.values() if np.isfinite(position[:2]).all()]


def _edges(room: Room) -> FloatArray:
    """Return the edges of a room without those within flat surfaces, shape (n_edges, 2, 3)."""
    if isinstance(room, Shoebox):
        corners = np.array(np.meshgrid(*((0.0, size_m) for size_m in room.dims_m), indexing="ij")).reshape(3, -1).T
        return np.array([(a, b) for i, a in enumerate(corners) for b in corners[i + 1:] if np.sum(a != b) == 1])
    triangles, normals = room.triangles, room.normals  # type: ignore[attr-defined]
    sides: dict[tuple, list[tuple[FloatArray, FloatArray]]] = {}
    for triangle, normal in zip(np.round(triangles, 6), normals, strict=True):
        for a, b in ((0, 1), (1, 2), (2, 0)):
            ends = sorted((tuple(triangle[a]), tuple(triangle[b])))
            sides.setdefault(tuple(ends), []).append((np.array(ends), normal))
    kept = [faces[0][0] for faces in sides.values()
            if len(faces) == 1 or min(float(faces[0][1] @ normal) for _, normal in faces[1:]) < _SAME_PLANE]
    return np.array(kept)
