"""Echograms: how much energy the stored paths bring to receivers, per band and millisecond.

Every path counts once. Purely specular paths up to the image-source order are left to `roomeq.sim.images`. Paths
whose last reflection is diffuse are counted at every reflection by its expected contribution (next-event
estimation): a Lambert reflector of scattering s sends ``s (1 - alpha) cos(theta) / (pi d^2)`` to the receiver,
whichever way the ray itself went on. All others end in a specular reflection and are counted by the length of
their last segment inside a sphere around the receiver: energy density is ``power * length / volume``.

Once reflections are denser than samples (`roomeq.sim.trace`), only those at which the ray did go on diffusely count,
1 / s times as loud: the same on average, and there are enough of them.
"""

from functools import partial

import numpy as np

from roomeq.core.jit import N_CHUNKS, compiled, for_chunks

FRAME_S = 1e-3
_SPHERE_RADII = (0.35, 1.0)  # of the receiver [m]: as large as the room lets the late field be called uniform
NEGLIGIBLE = np.float32(1e-10)  # share of a ray's energy below which it is given up, 40 dB below -60 dB
NUDGE_M = 1e-4  # shadow rays start this far off the surface
_BATCH = 32  # receivers that are served in one pass over the rays


def compute_echograms(paths, room, absorption, mics_m, *, ism_order, n_frames, speed_m_s, visible=None,
           ray_gain=None):
    """Collect echograms.

    Parameters
    ----------
    paths : Paths
    room : Shoebox or MeshRoom
    absorption : ndarray, shape (n_surfaces, 8)
    mics_m : ndarray, shape (n_mics, 3)
    ism_order : int
        Purely specular paths with at most this many reflections are left out.
    n_frames : int
        Frames of 1 ms from the emission on.
    speed_m_s : float
    visible : ndarray, optional
        From `reflection_visibility`, which is asked if need be.
    ray_gain : ndarray, shape (n_rays, 8), optional
        Energy with which each ray leaves the source, 1 by default.

    Returns
    -------
    echograms : ndarray, shape (n_mics, n_frames, 8)
        Squared pressure per frame, relative to a direct sound of ``1 / (4 pi r)^2``; without air absorption.
    """
    mics_m = np.atleast_2d(np.asarray(mics_m, dtype=np.float64))
    single = partial(np.asarray, dtype=np.float32)
    reflection = single((1.0 - absorption)[paths.face_surface])
    scattering = single(paths.scattering[paths.face_surface])
    if visible is None:
        visible = reflection_visibility(paths, room, mics_m, n_frames=n_frames, speed_m_s=speed_m_s)
    n_rays = len(paths.counts)
    radius_m, volume_m3 = receiver_spheres(room, mics_m)
    ray_gain = np.zeros((0, 8), dtype=np.float32) if ray_gain is None else single(ray_gain)
    result = np.empty((len(mics_m), n_frames, absorption.shape[1]))
    for first in range(0, len(mics_m), _BATCH):
        batch = slice(first, first + _BATCH)
        parts = np.zeros((N_CHUNKS, len(mics_m[batch]), n_frames, absorption.shape[1]), dtype=np.float32)
        given = (single(paths.source_pos_m), paths.hits, paths.codes, paths.first, paths.counts,
                 single(paths.normals), reflection, scattering, single(mics_m[batch].T, order="C"), visible[batch],
                 single(radius_m[batch] ** 2), single(1.0 / volume_m3[batch]), ism_order,
                 np.float32(1.0 / (speed_m_s * FRAME_S)), np.float32(paths.late_m), paths.stride,
                 ray_gain)
        for_chunks(n_rays, lambda chunk, low, high: _gather(*given, low, high, parts[chunk]))  # noqa: B023
        result[batch] = parts.sum(axis=0, dtype=np.float64)
    return result / (4.0 * np.pi * n_rays)


def receiver_spheres(room, mics_m):
    """Radius [m] and volume inside the room [m3] of the sphere around each microphone, shape (n_mics,) each."""
    wanted_m = float(np.clip(0.11 * room.volume_m3 ** (1.0 / 3.0), *_SPHERE_RADII))
    radius_m = np.array([room.sphere_radius_m(mic, wanted_m) for mic in mics_m])
    return radius_m, np.array([room.sphere_volume_m3(*sphere) for sphere in zip(mics_m, radius_m, strict=True)])


def reflection_visibility(paths, room, mics_m, *, n_frames, speed_m_s):
    """Tell from which stored reflections microphones are seen.

    Returns
    -------
    ndarray of bool, shape (n_mics, n_stored)
        Of shape (0, 0) in a convex room, where all is seen. Only reflections that `compute_echograms` asks for are right.
    """
    if room.convex:
        return np.zeros((0, 0), dtype=np.bool_)
    mics_m = np.atleast_2d(mics_m)
    path_m = paths.hits[:, 3]
    late = path_m > paths.late_m
    late &= np.repeat(np.arange(len(paths.counts)) % paths.stride != 0, paths.counts) | (paths.codes & 1 == 0)
    wanted = np.flatnonzero((path_m < n_frames * FRAME_S * speed_m_s) & ~late)
    start = paths.hits[wanted, :3] + NUDGE_M * paths.normals[paths.codes[wanted] >> 1]
    visible = np.zeros((len(mics_m), len(path_m)), dtype=np.bool_)
    for m, mic in enumerate(mics_m):
        visible[m, wanted] = room.sees(start, mic)
    return visible


@compiled
def _add(row, weight, g0, g1, g2, g3, g4, g5, g6, g7):
    row[0] += weight * g0
    row[1] += weight * g1
    row[2] += weight * g2
    row[3] += weight * g3
    row[4] += weight * g4
    row[5] += weight * g5
    row[6] += weight * g6
    row[7] += weight * g7


@compiled
def _gather(source, hits, codes, first, counts, normals, reflection, scattering, mics, visible, radius2, per_volume,
            ism_order, frames_per_m, late_m, stride, ray_gain, low, high, echo):
    """Add rays `low` to `high` to `echo`, shape (n_mics, n_frames, 8).

    All in single precision. First what a reflection means to every microphone, which is vectorised over them, then
    the adding up; the eight bands are eight variables, so that they are added at once.
    """
    n_mics, n_frames, _ = echo.shape
    all_visible = len(visible) == 0
    zero, one = np.float32(0.0), np.float32(1.0)
    mx, my, mz = mics[0], mics[1], mics[2]
    along, weight, frame = np.empty(n_mics, np.float32), np.empty(n_mics, np.float32), np.empty(n_mics, np.float32)
    for ray in range(low, high):
        g0, g1, g2, g3, g4, g5, g6, g7 = one, one, one, one, one, one, one, one
        if len(ray_gain):
            g = ray_gain[ray]
            g0, g1, g2, g3, g4, g5, g6, g7 = g[0], g[1], g[2], g[3], g[4], g[5], g[6], g[7]
        px, py, pz, path = source[0], source[1], source[2], zero
        specular, late = True, stride == 1
        was_diffuse = True
        for n in range(counts[ray]):
            at = first[ray] + n
            hx, hy, hz, new_path = hits[at, 0], hits[at, 1], hits[at, 2], hits[at, 3]
            if not was_diffuse and (n > ism_order or not specular):
                length = new_path - path
                scale = one / max(length, np.float32(1e-9))
                ux, uy, uz = (hx - px) * scale, (hy - py) * scale, (hz - pz) * scale
                for m in range(n_mics):
                    vx, vy, vz = mx[m] - px, my[m] - py, mz[m] - pz
                    along[m] = ux * vx + uy * vy + uz * vz
                    weight[m] = radius2[m] - (vx * vx + vy * vy + vz * vz - along[m] * along[m])
                for m in range(n_mics):
                    if weight[m] > zero:
                        half = np.sqrt(weight[m])
                        start, stop = max(zero, along[m] - half), min(length, along[m] + half)
                        middle = (path + np.float32(0.5) * (start + stop)) * frames_per_m
                        if stop > start and middle < n_frames:
                            _add(echo[m, np.uint32(middle)], (stop - start) * per_volume[m],
                                 g0, g1, g2, g3, g4, g5, g6, g7)
            px, py, pz, path = hx, hy, hz, new_path
            face = codes[at] >> 1
            rho = reflection[face]
            g0, g1, g2, g3 = g0 * rho[0], g1 * rho[1], g2 * rho[2], g3 * rho[3]
            g4, g5, g6, g7 = g4 * rho[4], g5 * rho[5], g6 * rho[6], g7 * rho[7]
            if max(max(max(g0, g1), max(g2, g3)), max(max(g4, g5), max(g6, g7))) < NEGLIGIBLE:
                break
            if not late and path > late_m:
                if ray % stride != 0:
                    break
                late, k = True, np.float32(stride)
                g0, g1, g2, g3, g4, g5, g6, g7 = g0 * k, g1 * k, g2 * k, g3 * k, g4 * k, g5 * k, g6 * k, g7 * k
            was_diffuse = (codes[at] & 1) == 1
            s = scattering[face]
            if path > late_m:
                s = one if was_diffuse else zero
            if s > zero:
                nx, ny, nz = normals[face, 0], normals[face, 1], normals[face, 2]
                for m in range(n_mics):
                    vx, vy, vz = mx[m] - hx, my[m] - hy, mz[m] - hz
                    d2 = vx * vx + vy * vy + vz * vz
                    d = np.sqrt(d2)
                    weight[m] = s * (vx * nx + vy * ny + vz * nz) / (np.float32(np.pi) * d2 * d)
                    frame[m] = (path + d) * frames_per_m
                for m in range(n_mics):
                    if weight[m] > zero and frame[m] < n_frames and (all_visible or visible[m, at]):
                        _add(echo[m, np.uint32(frame[m])], weight[m], g0, g1, g2, g3, g4, g5, g6, g7)
            if was_diffuse:
                specular = False
