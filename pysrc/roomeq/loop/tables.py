"""Ray contributions from each source to each microphone by time, by surfaces met, and by direction at the source.

One trace of a room answers every question of the loop: energies for other absorption, air or directivity are sums over
these tables (`roomeq.loop.predict`). Contributions are collected by the direction of their departure, so that they need
not be collected again for a source that turns.

The surfaces of a room count as two materials, one of floor and ceiling and one of all others. A single material could
not describe a room with carpets and acoustic tiles, where horizontal sound decays more slowly than the rest.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike

from roomeq.core.arrays import Array, BoolArray, FloatArray, IntArray, Number
from roomeq.core.jit import compiled
from roomeq.loop.traces import StoredArray
from roomeq.sim.echogram import FRAME_S
from roomeq.sim.mesh import MeshRoom
from roomeq.sim.paths import (
    BEHIND,
    SEEN,
    Rules,
    at_source,
    chord,
    follow,
    receiver_spheres,
    reflection_visibility,
    segment_counts,
)
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


class _Rays(NamedTuple):
    """Traced rays, as `roomeq.sim.trace.Paths` stores them."""

    hits: Array
    codes: Array
    first: IntArray
    n_hits: IntArray
    normals: FloatArray
    curved: BoolArray
    level: BoolArray
    """Whether each face belongs to floor or ceiling, shape (n_faces,)."""
    scattering: float


class _Receiver(NamedTuple):
    """A microphone, the sphere around it, and the time axis of its table."""

    position_m: FloatArray
    visible: Array
    """Which hits it sees, by `roomeq.sim.paths.reflection_visibility`; empty if it sees all."""
    radius_m: float
    per_volume: float
    distance_m: float
    ticks_per_m: float
    frame_of_tick: IntArray


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
        departed in each cell of directions, shape (n, n_cells), for `turned`.
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
    radii_m, volumes_m3 = receiver_spheres(room, mics_m)
    rays = _Rays(paths.hits, paths.codes, paths.first, paths.counts, paths.normals, paths.curved,
                 level_surfaces(room)[paths.face_surface], float(paths.scattering[0]))
    rules = Rules(-1, paths.late_m)
    cell = np.argmax(paths.directions.astype(np.float32) @ _CELLS.T, axis=1)
    by_cell = np.argsort(cell, kind="stable")
    tables = []
    for m, mic_m in enumerate(mics_m):
        distance_m = float(np.linalg.norm(mic_m - source_pos_m))
        receiver = _Receiver(mic_m, visible[m] if len(visible) else np.zeros(0, dtype=np.uint8), radii_m[m],
                             1.0 / volumes_m3[m], distance_m, 1.0 / (speed_m_s * _TICK_S), frame_of_tick)
        counts = np.zeros((len(edges_s) - 1, int(paths.counts.max()) + 1, len(LEVEL_SHARES)))
        found = _count(rules, rays, receiver, by_cell, cell, counts)
        filled = np.flatnonzero(counts.any(axis=2))
        departed = _by_entry(*found, filled, counts[:, :, 0].size)
        departed /= np.maximum(departed.sum(axis=1, keepdims=True), 1e-30)
        entries = np.stack(np.divmod(filled, counts.shape[1]), axis=1).astype(np.int32)
        of_entries = counts.reshape(-1, len(LEVEL_SHARES))[filled] / (4.0 * np.pi * len(paths.counts))
        tables.append((Table(entries, of_entries.astype(np.float32), distance_m, bool(sees[m])),
                       departed.astype(np.float16)))
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


@compiled
def _put(counts: FloatArray, frame: int, n: int, node: float, weight: float) -> None:
    """Distribute a weight over the two grid points next to `node`."""
    low = min(int(node), counts.shape[2] - 2)
    counts[frame, n, low] += weight * (low + 1.0 - node)
    counts[frame, n, low + 1] += weight * (node - low)


@compiled
def _count(rules: Rules, rays: _Rays, receiver: _Receiver, order: IntArray, cell: IntArray, counts: FloatArray
           ) -> tuple[Array, Array, IntArray]:
    """Add the contributions of all rays to `counts`, by the rules of `roomeq.sim.paths`, and to cells of directions.

    Parameters
    ----------
    rules : Rules
    rays : _Rays
    receiver : _Receiver
    order : ndarray of int, shape (n_rays,)
        Rays by their cell.
    cell : ndarray of int, shape (n_rays,)
        Of the direction in which each ray departs.
    counts : ndarray, shape (n_frames, n_reflections, 6)

    Returns
    -------
    place : ndarray of int32, shape (n,)
        Where there is a contribution in the first two axes of `counts`, one cell after the other.
    amount : ndarray of float32, shape (n,)
    end : ndarray of int, shape (n_cells,)
        After the last of each cell.
    """
    hits, codes, first, n_hits, normals, curved, level, scattering = rays  # counting references takes time in the loop
    mic, visible, frame_of_tick, distance_m = (receiver.position_m, receiver.visible, receiver.frame_of_tick,
                                               receiver.distance_m)
    all_visible, n_ticks = len(visible) == 0, len(frame_of_tick)
    radius_m, per_volume, ticks_per_m = receiver.radius_m, receiver.per_volume, receiver.ticks_per_m
    n_shares = counts.shape[2] - 1.0
    n_reflections, most = counts.shape[1], 2 * len(hits)
    place, amounts, end = np.empty(most, np.int32), np.empty(most, np.float32), np.zeros(_N_CELLS, np.int64)
    of_cell = np.zeros(counts.shape[0] * n_reflections, np.float32)  # of one after the other: all would be large
    n_found = n_kept = 0
    for k in range(len(order)):
        ray = order[k]
        weight, n_level = 1.0, 0
        step, hit = at_source(), (0.0, 0.0, 0.0, 0.0)
        for n in range(n_hits[ray]):
            at = first[ray] + n
            (px, py, pz, path), hit = hit, (np.float64(hits[at, 0]), np.float64(hits[at, 1]), np.float64(hits[at, 2]),
                                            np.float64(hits[at, 3]))
            hx, hy, hz, new_path = hit
            if segment_counts(step, rules, n):
                length = max(new_path - path, 1e-9)
                ux, uy, uz = (hx - px) / length, (hy - py) / length, (hz - pz) / length
                vx, vy, vz = mic[0] - px, mic[1] - py, mic[2] - pz
                along = ux * vx + uy * vy + uz * vz
                inside = radius_m * radius_m - (vx * vx + vy * vy + vz * vz - along * along)
                if inside > 0.0:
                    enter, leave = chord(along, inside, length)
                    tick = int((path + 0.5 * (enter + leave) - distance_m) * ticks_per_m)
                    if leave > enter and tick < n_ticks and (all_visible or visible[at] & BEHIND == 0):
                        amount = weight * (leave - enter) * per_volume
                        frame = frame_of_tick[max(tick, 0)]
                        _put(counts, frame, n, n_shares * n_level / n, amount)
                        n_found = _note(place, n_found, of_cell, frame * n_reflections + n, np.float32(amount))
            if n + 1 == n_hits[ray]:
                break
            face = codes[at] >> 2
            step = follow(step, rules, codes[at], new_path, scattering, curved[face])
            if step.represents_two:
                weight *= 2.0
            n_level += 1 if level[face] else 0
            if step.scattered > 0.0:
                vx, vy, vz = mic[0] - hx, mic[1] - hy, mic[2] - hz
                d2 = vx * vx + vy * vy + vz * vz
                d = np.sqrt(d2)
                cosine = (vx * normals[face, 0] + vy * normals[face, 1] + vz * normals[face, 2]) / d
                tick = int((new_path + d - distance_m) * ticks_per_m)
                if cosine > 0.0 and tick < n_ticks and (all_visible or visible[at] & SEEN):
                    amount = weight * step.scattered * cosine / (np.pi * d2)
                    frame = frame_of_tick[max(tick, 0)]
                    _put(counts, frame, n + 1, n_shares * n_level / (n + 1), amount)
                    n_found = _note(place, n_found, of_cell, frame * n_reflections + n + 1, np.float32(amount))
        if k + 1 == len(order) or cell[order[k + 1]] != cell[ray]:
            for at in range(n_kept, n_found):
                amounts[at] = of_cell[place[at]]
                of_cell[place[at]] = 0.0
            n_kept = n_found
            end[cell[ray]] = n_kept
    return place[:n_kept], amounts[:n_kept], end


@compiled
def _note(place: Array, n_found: int, of_cell: Array, at: int, amount: Number) -> int:
    """Add an amount to a cell, whose first amount at a place makes it one more that is found; return their number."""
    if of_cell[at] == 0.0:
        place[n_found] = at
        n_found += 1
    of_cell[at] += amount
    return n_found


@compiled
def _by_entry(place: Array, amount: Array, end: IntArray, filled: IntArray, size: int) -> Array:
    """Return the amounts of `_count` of each entry in each cell, shape (n_entries, n_cells).

    The entries lie at `filled` of `size` places.
    """
    entry_at, by_entry = np.zeros(size, np.int64), np.zeros((len(filled), len(end)), np.float32)
    for entry in range(len(filled)):
        entry_at[filled[entry]] = entry
    first = 0
    for cell in range(len(end)):
        for n in range(first, end[cell]):
            by_entry[entry_at[place[n]], cell] = amount[n]
        first = max(first, end[cell])
    return by_entry
