"""What rays bring from each source to each microphone, counted by time, number of reflections and departure angle.

One trace of a room answers every question of the loop: energies for other absorption, air or directivity are sums over
these tables (`roomeq.loop.predict`). Surfaces of a room are taken as one material here: what is unknown of a measured
room is how much it absorbs, per band, and how much it scatters.
"""

from dataclasses import dataclass

import numpy as np

from roomeq.sim.gather import FRAME_S, spheres, visibility
from roomeq.sim.jit import compiled

FRAME_EDGES_S = np.concatenate([
    [0.0, 2.5e-3, 5e-3, 7.5e-3], np.arange(0.01, 0.05, 0.005), np.arange(0.05, 0.3, 0.01),
    0.3 * 1.06 ** np.arange(48)])
"""Edges of the frames after the direct sound [s]; fine where cells have their gates."""
N_FRAMES = len(FRAME_EDGES_S) - 1
ANGLES = np.linspace(0.0, np.pi, 9)
"""Nodes of the angle between a ray's departure and where the source faces."""
_TICK_S = 1.25e-3


@dataclass(frozen=True)
class Table:
    """One source and microphone.

    Attributes
    ----------
    counts : ndarray, shape (N_FRAMES, n_reflections, n_angles)
        Squared pressure of all but the direct sound, before absorption and air, relative to ``1 / (4 pi r)^2``.
    distance_m : float
    visible : bool
        Whether the direct sound arrives.
    direct_angle : float
        Between the direct sound's departure and where the source faces [rad]; 0 where that is unknown.
    """

    counts: np.ndarray
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
    visible = visibility(paths, room, mics_m, n_frames=int(np.ceil(traced.max_length_s / FRAME_S)),
                         speed_m_s=speed_m_s)
    sees = np.ones(len(mics_m), dtype=bool) if room.convex else room.sees(
        np.tile(source_pos_m, (len(mics_m), 1)), mics_m)
    frame_of_tick = np.searchsorted(FRAME_EDGES_S, (np.arange(int(FRAME_EDGES_S[-1] / _TICK_S)) + 0.5) * _TICK_S) - 1
    radii_m, volumes_m3 = spheres(room, mics_m)
    made = []
    for m, (mic_m, facing) in enumerate(zip(mics_m, facings, strict=True)):
        distance_m = float(np.linalg.norm(mic_m - source_pos_m))
        angle = _angles(paths.directions, facing)
        counts = np.zeros((N_FRAMES, int(paths.counts.max()) + 1, 1 if facing is None else len(ANGLES)))
        _count(source_pos_m, paths.hits, paths.codes, paths.counts, paths.normals, float(paths.scattering[0]), mic_m,
               visible[m] if len(visible) else np.zeros((0, 0), dtype=np.bool_), radii_m[m],
               1.0 / volumes_m3[m], distance_m, 1.0 / (speed_m_s * _TICK_S), frame_of_tick,
               angle / (np.pi / (len(ANGLES) - 1)), paths.late_m, paths.stride, counts)
        made.append(Table(counts / (4.0 * np.pi * len(paths.hits)), distance_m, bool(sees[m]),
                          float(_angles((mic_m - source_pos_m)[None] / distance_m, facing)[0])))
    return made


def _angles(directions, facing):
    """Angles [rad] between unit vectors and a facing, 0 where that is unknown."""
    return np.zeros(len(directions)) if facing is None else np.arccos(np.clip(directions @ facing, -1.0, 1.0))


@compiled
def _put(counts, frame, n, node, weight):
    if counts.shape[2] == 1:
        counts[frame, n, 0] += weight
    else:
        low = min(int(node), counts.shape[2] - 2)
        counts[frame, n, low] += weight * (low + 1.0 - node)
        counts[frame, n, low + 1] += weight * (node - low)


@compiled
def _count(source, hits, codes, n_hits, normals, scattering, mic, visible, radius_m, per_volume, distance_m,
           ticks_per_m, frame_of_tick, node, late_m, stride, counts):
    """Add all rays to `counts`; paths count as in `roomeq.sim.gather`, the direct sound apart."""
    all_visible, n_ticks = len(visible) == 0, len(frame_of_tick)
    for ray in range(len(n_hits)):
        px, py, pz, path = source[0], source[1], source[2], 0.0
        weight, late, was_diffuse = 1.0, stride == 1, True
        for n in range(n_hits[ray]):
            hx, hy, hz, new_path = hits[ray, n, 0], hits[ray, n, 1], hits[ray, n, 2], hits[ray, n, 3]
            if not was_diffuse:
                length = max(new_path - path, 1e-9)
                ux, uy, uz = (hx - px) / length, (hy - py) / length, (hz - pz) / length
                vx, vy, vz = mic[0] - px, mic[1] - py, mic[2] - pz
                along = ux * vx + uy * vy + uz * vz
                inside = radius_m * radius_m - (vx * vx + vy * vy + vz * vz - along * along)
                if inside > 0.0:
                    half = np.sqrt(inside)
                    start, stop = max(0.0, along - half), min(length, along + half)
                    tick = int((path + 0.5 * (start + stop) - distance_m) * ticks_per_m)
                    if stop > start and tick < n_ticks:
                        _put(counts, frame_of_tick[max(tick, 0)], n, node[ray], weight * (stop - start) * per_volume)
            px, py, pz, path = hx, hy, hz, new_path
            if not late and path > late_m:
                if ray % stride != 0:
                    break
                late, weight = True, weight * stride
            face = codes[ray, n] >> 1
            if scattering > 0.0:
                vx, vy, vz = mic[0] - hx, mic[1] - hy, mic[2] - hz
                d2 = vx * vx + vy * vy + vz * vz
                d = np.sqrt(d2)
                cosine = (vx * normals[face, 0] + vy * normals[face, 1] + vz * normals[face, 2]) / d
                tick = int((path + d - distance_m) * ticks_per_m)
                if cosine > 0.0 and tick < n_ticks and (all_visible or visible[ray, n]):
                    _put(counts, frame_of_tick[max(tick, 0)], n + 1, node[ray],
                         weight * scattering * cosine / (np.pi * d2))
            was_diffuse = (codes[ray, n] & 1) == 1
