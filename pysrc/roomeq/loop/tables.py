"""Ray contributions from each source to each microphone by time, by surfaces met, and by direction at the source.

One trace of a room answers every question of the loop: energies for other absorption, air or directivity are sums over
these tables (`roomeq.loop.predict`). Contributions are collected by the direction of their departure, so that they need
not be collected again for a source that turns.

The surfaces of a room count as two materials, one of floor and ceiling and one of all others. A single material could
not describe a room with carpets and acoustic tiles, where horizontal sound decays more slowly than the rest.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from roomeq.core.arrays import Array, BoolArray, FloatArray
from roomeq.loop.contributions import Receiver, add_contributions, by_direction, nearest_directions, walk_rays
from roomeq.loop.traces import StoredArray
from roomeq.sim.echogram import FRAME_S
from roomeq.sim.mesh import MeshRoom
from roomeq.sim.paths import receiver_spheres, reflection_visibility
from roomeq.sim.response import TracedSource
from roomeq.sim.room import Room

FRAME_EDGES_S = np.concatenate([
    [0.0, 2.5e-3, 5e-3, 7.5e-3], np.arange(0.01, 0.05, 0.005), np.arange(0.05, 0.3, 0.01),
    0.3 * 1.06 ** np.arange(66)])
"""Edges of the frames after the direct sound [s]; fine where features have their gates. They end at 13.2 s."""
_USUAL_EDGES = int(np.searchsorted(FRAME_EDGES_S, 4.7))
"""Edges that are used where no response is longer, as in most sets: more would take time."""
ANGLES = np.linspace(0.0, np.pi, 9)
"""Grid of the angle between a ray's departure and the direction that the source faces [rad]."""
_STEP = ANGLES[1]
OF_SPHERE = np.array([0.5 * (1.0 - np.sin(_STEP) / _STEP) if angle in (0.0, np.pi)
                      else np.sin(angle) * (1.0 - np.cos(_STEP)) / _STEP for angle in ANGLES])
"""Share of all directions at `ANGLES`, each distributed over the two angles next to it, shape (9,)."""
_N_CELLS = 256
_HEIGHT, _TURN = 1.0 - (2.0 * np.arange(_N_CELLS) + 1.0) / _N_CELLS, np.pi * (1.0 + np.sqrt(5.0)) * np.arange(_N_CELLS)
_CELLS = np.stack([np.sqrt(1.0 - _HEIGHT ** 2) * np.cos(_TURN), np.sqrt(1.0 - _HEIGHT ** 2) * np.sin(_TURN), _HEIGHT],
                  axis=1).astype(np.float32)
"""Directions on a Fibonacci lattice, unit vectors: a ray counts as departing in the nearest one. At 8 kHz, where lobes
are narrowest, that changes the energy of a frame by 0.3 dB (rms), below 4 kHz by 0.05 dB."""
LEVEL_SHARES = np.linspace(0.0, 1.0, 6)
"""Grid of the share of floor and ceiling in a path's reflections."""
_TICK_S = 1.25e-3
_LEVEL = 0.7  # cosine of the slope up to which a surface counts as floor or ceiling


@dataclass(frozen=True)
class Table:
    """The ray contributions from one source to one microphone.

    Attributes
    ----------
    entries : ndarray of int, shape (n, 2)
        Frame of arrival and number of reflections of each entry.
    counts : ndarray, shape (n, 6)
        Squared pressure of all but the direct sound, before absorption and air, relative to ``1 / (4 pi r)^2``, at
        `LEVEL_SHARES`.
    distance_m : float
    visible : bool
        Whether the direct sound arrives.
    angular : ndarray, shape (n, 9), or None
        Share of it that departed at `ANGLES`; None where it is unknown in which direction the source faces.
    direct_angle : float
        Between the direct sound's departure and the direction that the source faces [rad]; 0 where that is unknown.
    facing : ndarray, shape (3,), or None
        That direction.
    departures : StoredArray, or None
        What `facing` needs (`turned`), where it is to be estimated: the share that departed in each cell of directions,
        shape (n, n_cells).
    """

    entries: Array
    counts: Array
    distance_m: float
    visible: bool
    angular: Array | None = None
    direct_angle: float = 0.0
    facing: FloatArray | None = None
    departures: StoredArray | None = None


def frame_edges_s(tables: Sequence[Table]) -> FloatArray:
    """Return the edges of the frames that some tables need, shape (n_frames + 1,), the first of `FRAME_EDGES_S`."""
    n_frames = max(int(table.entries[:, 0].max(initial=-1)) + 1 for table in tables)
    return _edges_up_to(FRAME_EDGES_S[n_frames])


def _edges_up_to(length_s: float) -> FloatArray:
    return FRAME_EDGES_S[:_USUAL_EDGES] if length_s <= FRAME_EDGES_S[_USUAL_EDGES - 1] else FRAME_EDGES_S


def collect(traced: TracedSource, mics_m: ArrayLike) -> list[tuple[Table, Array]]:
    """Collect the ray contributions of a traced source to its microphones.

    Parameters
    ----------
    traced : roomeq.sim.response.TracedSource
        Its surfaces scatter alike in all bands.
    mics_m : array_like, shape (n_mics, 3)

    Returns
    -------
    list of (Table, ndarray)
        For each microphone, the table of a source that faces nobody knows where, and the share of each entry that
        departed in each cell of directions, shape (n, n_cells), for `turned`; see
        `roomeq.loop.contributions.by_direction`.
    """
    (paths,) = traced.paths
    room, source_pos_m, speed_m_s = traced.scene.room, traced.source_pos_m, traced.scene.air.speed_m_s
    mics_m = np.atleast_2d(np.asarray(mics_m, dtype=np.float64))
    n_frames = int(np.ceil(traced.max_length_s / FRAME_S))
    visible = reflection_visibility(paths, room, mics_m, max_path_m=n_frames * FRAME_S * speed_m_s)
    sees = np.ones(len(mics_m), dtype=bool) if room.convex else cast(MeshRoom, room).sees(
        np.tile(source_pos_m, (len(mics_m), 1)), mics_m)
    edges_s = _edges_up_to(traced.max_length_s)
    frame_of_tick = np.searchsorted(edges_s, (np.arange(int(edges_s[-1] / _TICK_S)) + 0.5) * _TICK_S) - 1
    shape = len(edges_s) - 1, int(paths.counts.max()) + 1, len(LEVEL_SHARES)
    radii_m, volumes_m3 = receiver_spheres(room, mics_m)
    walk = walk_rays(paths, level_surfaces(room)[paths.face_surface], len(LEVEL_SHARES))
    cell = nearest_directions(paths.directions, _CELLS)
    tables = []
    for m, mic_m in enumerate(mics_m):
        distance_m = float(np.linalg.norm(mic_m - source_pos_m))
        receiver = Receiver(mic_m.astype(np.float32), (paths.normals @ mic_m).astype(np.float32),
                            visible[m] if len(visible) else np.zeros(0, dtype=np.uint8),
                            np.float32(radii_m[m]), np.float32(1.0 / volumes_m3[m]), np.float32(distance_m),
                            np.float32(1.0 / (speed_m_s * _TICK_S)), (shape[1] * frame_of_tick).astype(np.int32))
        counts = np.zeros(shape)
        place, amount, end = add_contributions(paths.reflections, walk, receiver, counts)
        filled = np.flatnonzero(counts.any(axis=2))
        departed = by_direction(place, amount, end, cell, _N_CELLS, filled, counts[:, :, 0].size)
        entries = np.stack(np.divmod(filled, counts.shape[1]), axis=1).astype(np.int32)
        of_entries = counts.reshape(-1, len(LEVEL_SHARES))[filled] / (4.0 * np.pi * len(paths.counts))
        tables.append((Table(entries, of_entries.astype(np.float32), distance_m, bool(sees[m])),
                       departed))
    return tables


def turned(table: Table, departures: Array, direct: FloatArray, facing: FloatArray) -> Table:
    """Return the table of a source that faces in a direction, a unit vector.

    Parameters
    ----------
    table : Table
    departures : ndarray, shape (n, n_cells)
        From `collect`.
    direct : ndarray, shape (3,)
        Direction in which the direct sound departs, a unit vector.
    facing : ndarray, shape (3,)
    """
    node = _angles(_CELLS, facing) / _STEP
    shares = np.maximum(0.0, 1.0 - np.abs(node[:, None] - np.arange(len(ANGLES)))).astype(np.float32)
    angular = departures.astype(np.float32) @ shares
    return replace(table, angular=angular / np.maximum(angular.sum(axis=1, keepdims=True), 1e-30), facing=facing,
                   direct_angle=float(_angles(direct[None], facing)[0]))


def _angles(directions: Array, facing: FloatArray) -> FloatArray:
    """Return the angles [rad] between unit vectors, shape (n, 3), and a facing."""
    return np.asarray(np.arccos(np.clip(directions @ facing, -1.0, 1.0)))


def level_surfaces(room: Room) -> BoolArray:
    """Tell whether most of the area of each surface of a room is about horizontal, as floor and ceiling are."""
    if room.walls is None:
        mesh = cast(MeshRoom, room)
        normals, face_surface, area = mesh.normals, mesh.face_surface, mesh.face_area_m2
    else:
        normals, face_surface = room.walls.normals, room.walls.face_surface
        area = np.ones(len(normals))
    horizontal = area * (np.abs(normals[:, 2]) > _LEVEL)
    return np.array([horizontal[face_surface == surface].sum() > 0.5 * area[face_surface == surface].sum()
                     for surface in range(len(room.surfaces))])
