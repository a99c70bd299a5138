"""Ray contributions from each source to each microphone by time, by surfaces met, and by direction at the source.

One trace of a room answers every question of the loop: energies for other absorption, air or directivity are sums over
these tables (`roomeq.loop.predict`). The surfaces of a room count as two materials, one of floor and ceiling and one of
all others: with carpets below and tiles above, horizontal sound outlives the rest, which no single material tells.
"""

from dataclasses import dataclass

import numpy as np

from roomeq.core.jit import compiled
from roomeq.sim.echogram import FRAME_S
from roomeq.sim.paths import (
    Rules,
    at_source,
    chord,
    follow,
    receiver_spheres,
    reflection_visibility,
    segment_counts,
)

FRAME_EDGES_S = np.concatenate([
    [0.0, 2.5e-3, 5e-3, 7.5e-3], np.arange(0.01, 0.05, 0.005), np.arange(0.05, 0.3, 0.01),
    0.3 * 1.06 ** np.arange(48)])
"""Edges of the frames after the direct sound [s]; fine where features have their gates."""
N_FRAMES = len(FRAME_EDGES_S) - 1
ANGLES = np.linspace(0.0, np.pi, 9)
"""Nodes of the angle between a ray's departure and where the source faces."""
LEVEL_SHARES = np.linspace(0.0, 1.0, 6)
"""Nodes of the share of a path's reflections that floor and ceiling have."""
_TICK_S = 1.25e-3
_LEVEL = 0.7  # cosine of the slope up to which a surface counts as floor or ceiling


@dataclass(frozen=True)
class Table:
    """One source and microphone.

    Attributes
    ----------
    entries : ndarray of int, shape (n, 2)
        Where something arrives: frame, and number of reflections.
    counts : ndarray, shape (n, 6)
        What arrives there: squared pressure of all but the direct sound, before absorption and air, relative to
        ``1 / (4 pi r)^2``, at `LEVEL_SHARES`.
    angular : ndarray, shape (n, 9), or None
        Share of it that set out at `ANGLES`; None where nobody knows where the source faces.
    distance_m : float
    visible : bool
        Whether the direct sound arrives.
    direct_angle : float
        Between the direct sound's departure and where the source faces [rad]; 0 where that is unknown.
    """

    entries: np.ndarray
    counts: np.ndarray
    angular: np.ndarray | None
    distance_m: float
    visible: bool
    direct_angle: float


def collect(traced, mics_m, facings):
    """Make the tables of a traced source's microphones.

    Parameters
    ----------
    traced : roomeq.sim.response.TracedSource
        Of surfaces that scatter alike in all bands.
    mics_m : array_like, shape (n_mics, 3)
    facings : list of ndarray or None
        Where the source faces in the recording with each microphone.

    Returns
    -------
    list of Table
    """
    (paths,) = traced.paths
    room, source_pos_m, speed_m_s = traced.scene.room, traced.source_pos_m, traced.scene.air.speed_m_s
    mics_m = np.atleast_2d(np.asarray(mics_m, dtype=np.float64))
    n_frames = int(np.ceil(traced.max_length_s / FRAME_S))
    visible = reflection_visibility(paths, room, mics_m, max_path_m=n_frames * FRAME_S * speed_m_s)
    sees = np.ones(len(mics_m), dtype=bool) if room.convex else room.sees(
        np.tile(source_pos_m, (len(mics_m), 1)), mics_m)
    frame_of_tick = np.searchsorted(FRAME_EDGES_S, (np.arange(int(FRAME_EDGES_S[-1] / _TICK_S)) + 0.5) * _TICK_S) - 1
    radii_m, volumes_m3 = receiver_spheres(room, mics_m)
    level = level_surfaces(room)[paths.face_surface]
    made = []
    for m, (mic_m, facing) in enumerate(zip(mics_m, facings, strict=True)):
        distance_m = float(np.linalg.norm(mic_m - source_pos_m))
        angle = _angles(paths.directions, facing)
        counts = np.zeros((N_FRAMES, int(paths.counts.max()) + 1, len(LEVEL_SHARES)))
        angular = np.zeros((*counts.shape[:2], 0 if facing is None else len(ANGLES)))
        _count(Rules(-1, paths.late_m, paths.stride), paths.hits, paths.codes, paths.first, paths.counts, paths.normals, level,
               float(paths.scattering[0]), mic_m, visible[m] if len(visible) else np.zeros(0, dtype=np.bool_),
               radii_m[m], 1.0 / volumes_m3[m], distance_m, 1.0 / (speed_m_s * _TICK_S), frame_of_tick,
               angle / (np.pi / (len(ANGLES) - 1)), counts, angular)
        entries = np.argwhere(counts.any(axis=2))
        counts, angular = (one[entries[:, 0], entries[:, 1]] for one in (counts, angular))
        angular /= np.maximum(angular.sum(axis=1, keepdims=True), 1e-300)
        direct_angle = float(_angles((mic_m - source_pos_m)[None] / distance_m, facing)[0])
        made.append(Table(entries, counts / (4.0 * np.pi * len(paths.counts)), None if facing is None else angular,
                          distance_m, bool(sees[m]), direct_angle))
    return made


def _angles(directions, facing):
    """Angles [rad] between unit vectors and a facing, 0 where that is unknown."""
    return np.zeros(len(directions)) if facing is None else np.arccos(np.clip(directions @ facing, -1.0, 1.0))


def level_surfaces(room):
    """Whether each surface of a room is floor, ceiling or the like, by area, ndarray of bool."""
    walls = room.walls
    normals, face_surface = (room.normals, room.face_surface) if walls is None else (walls.normals, walls.face_surface)
    area = np.ones(len(normals)) if walls is not None else room.face_area_m2
    flat = area * (np.abs(normals[:, 2]) > _LEVEL)
    return np.array([flat[face_surface == surface].sum() > 0.5 * area[face_surface == surface].sum()
                     for surface in range(len(room.surfaces))])


@compiled
def _put(counts, frame, n, node, weight):
    low = min(int(node), counts.shape[2] - 2)
    counts[frame, n, low] += weight * (low + 1.0 - node)
    counts[frame, n, low + 1] += weight * (node - low)


@compiled
def _count(rules, hits, codes, first, n_hits, normals, level, scattering, mic, visible, radius_m, per_volume, distance_m,
           ticks_per_m, frame_of_tick, node, counts, angular):
    """Add the contributions of all rays to `counts` and `angular`, by the rules of `roomeq.sim.paths`.

    In double precision, and with one exception: late reflections contribute by next-event estimation whether or not
    the ray continues diffusely.
    """
    all_visible, n_ticks, turned = len(visible) == 0, len(frame_of_tick), angular.shape[2] > 0
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
                    if leave > enter and tick < n_ticks:
                        amount = weight * (leave - enter) * per_volume
                        _put(counts, frame_of_tick[max(tick, 0)], n, n_shares * n_level / n, amount)
                        if turned:
                            _put(angular, frame_of_tick[max(tick, 0)], n, node[ray], amount)
            face = codes[at] >> 1
            step = follow(step, rules, ray, codes[at], new_path, scattering)
            if step.ends:
                break
            if step.becomes_late:
                weight *= rules.stride
            n_level += 1 if level[face] else 0
            if scattering > 0.0:
                vx, vy, vz = mic[0] - hx, mic[1] - hy, mic[2] - hz
                d2 = vx * vx + vy * vy + vz * vz
                d = np.sqrt(d2)
                cosine = (vx * normals[face, 0] + vy * normals[face, 1] + vz * normals[face, 2]) / d
                tick = int((new_path + d - distance_m) * ticks_per_m)
                if cosine > 0.0 and tick < n_ticks and (all_visible or visible[at]):
                    amount = weight * scattering * cosine / (np.pi * d2)
                    _put(counts, frame_of_tick[max(tick, 0)], n + 1, n_shares * n_level / (n + 1), amount)
                    if turned:
                        _put(angular, frame_of_tick[max(tick, 0)], n + 1, node[ray], amount)
