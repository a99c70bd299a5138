"""Ray contributions from each source to each microphone by time, by surfaces met, and by direction at the source.

One trace of a room answers every question of the loop: energies for other absorption, air or directivity are sums over
these tables (`roomeq.loop.predict`). The surfaces of a room count as two materials, one of floor and ceiling and one of
all others. A single material could not describe a room with carpets and acoustic tiles, where horizontal sound decays
more slowly than the rest.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike

from roomeq.core.arrays import Array, BoolArray, FloatArray, IntArray
from roomeq.core.jit import compiled
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
    angular : ndarray, shape (n, 9), or None
        Share of it that departed at `ANGLES`; None where it is unknown in which direction the source faces.
    distance_m : float
    visible : bool
        Whether the direct sound arrives.
    direct_angle : float
        Between the direct sound's departure and the direction that the source faces [rad]; 0 where that is unknown.
    facing : ndarray, shape (3,), or None
        That direction.
    """

    entries: IntArray
    counts: FloatArray
    angular: FloatArray | None
    distance_m: float
    visible: bool
    direct_angle: float
    facing: FloatArray | None


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


def collect(traced: TracedSource, mics_m: ArrayLike, facings: Sequence[FloatArray | None]) -> list[Table]:
    """Collect the ray contributions of a traced source to its microphones.

    Parameters
    ----------
    traced : roomeq.sim.response.TracedSource
        Its surfaces scatter alike in all bands.
    mics_m : array_like, shape (n_mics, 3)
    facings : sequence of ndarray or None
        Direction that the source faces in the recording with each microphone.
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
    tables = []
    for m, (mic_m, facing) in enumerate(zip(mics_m, facings, strict=True)):
        distance_m = float(np.linalg.norm(mic_m - source_pos_m))
        receiver = _Receiver(mic_m, visible[m] if len(visible) else np.zeros(0, dtype=np.uint8), radii_m[m],
                             1.0 / volumes_m3[m], distance_m, 1.0 / (speed_m_s * _TICK_S), frame_of_tick)
        angle_node = _angles(paths.directions, facing) / _STEP
        counts = np.zeros((len(edges_s) - 1, int(paths.counts.max()) + 1, len(LEVEL_SHARES)))
        angular = np.zeros((*counts.shape[:2], 0 if facing is None else len(ANGLES)))
        _count(rules, rays, receiver, angle_node, counts, angular)
        entries = np.argwhere(counts.any(axis=2))
        counts, angular = (whole[entries[:, 0], entries[:, 1]] for whole in (counts, angular))
        angular /= np.maximum(angular.sum(axis=1, keepdims=True), 1e-300)
        direct_angle = float(_angles((mic_m - source_pos_m)[None] / distance_m, facing)[0])
        counts /= 4.0 * np.pi * len(paths.counts)
        tables.append(Table(np.ascontiguousarray(entries, np.int32), counts.astype(np.float32),
                            None if facing is None else angular.astype(np.float32), distance_m, bool(sees[m]),
                            direct_angle, facing))
    return tables


def _angles(directions: FloatArray, facing: FloatArray | None) -> FloatArray:
    """Angles [rad] between unit vectors, shape (n, 3), and a facing; 0 where that is unknown."""
    return np.zeros(len(directions)) if facing is None else np.arccos(np.clip(directions @ facing, -1.0, 1.0))


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
def _count(rules: Rules, rays: _Rays, receiver: _Receiver, angle_node: FloatArray, counts: FloatArray,
           angular: FloatArray) -> None:
    """Add the contributions of all rays to `counts` and `angular`, by the rules of `roomeq.sim.paths`.

    Parameters
    ----------
    rules : Rules
    rays : _Rays
    receiver : _Receiver
    angle_node : ndarray, shape (n_rays,)
        Angle of departure of each ray, in steps of `ANGLES`.
    counts : ndarray, shape (n_frames, n_reflections, 6)
    angular : ndarray, shape (n_frames, n_reflections, 9 or 0)
    """
    hits, codes, first, n_hits, normals, curved, level, scattering = rays  # counting references takes time in the loop
    mic, visible, frame_of_tick, distance_m = (receiver.position_m, receiver.visible, receiver.frame_of_tick,
                                               receiver.distance_m)
    all_visible, n_ticks, directive = len(visible) == 0, len(frame_of_tick), angular.shape[2] > 0
    radius_m, per_volume, ticks_per_m = receiver.radius_m, receiver.per_volume, receiver.ticks_per_m
    n_shares = counts.shape[2] - 1.0
    for ray in range(len(n_hits)):
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
                        _put(counts, frame_of_tick[max(tick, 0)], n, n_shares * n_level / n, amount)
                        if directive:
                            _put(angular, frame_of_tick[max(tick, 0)], n, angle_node[ray], amount)
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
                    _put(counts, frame_of_tick[max(tick, 0)], n + 1, n_shares * n_level / (n + 1), amount)
                    if directive:
                        _put(angular, frame_of_tick[max(tick, 0)], n + 1, angle_node[ray], amount)
