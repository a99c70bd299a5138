"""Echograms: how much energy the stored paths bring to receivers, per band and millisecond.

Every path counts once. Purely specular paths up to the image-source order are left to `roomeq.sim.early`. Paths
whose last reflection is diffuse are counted at every reflection by its expected contribution (next-event
estimation): a Lambert reflector of scattering s sends ``s (1 - alpha) cos(theta) / (pi d^2)`` to the receiver,
whichever way the ray itself went on. All others end in a specular reflection and are counted by the length of
their last segment inside a sphere around the receiver: energy density is ``power * length / volume``.
"""

import numpy as np

from roomeq.sim.jit import N_CHUNKS, compiled, for_chunks

FRAME_S = 1e-3
_SPHERE_RADII = (0.35, 1.0)  # of the receiver [m]: as large as the room lets the late field be called uniform
NEGLIGIBLE = np.float32(1e-10)  # share of a ray's energy below which it is given up, 40 dB below -60 dB
NUDGE_M = 1e-4  # shadow rays start this far off the surface
_BATCH = 8  # receivers that are served in one pass over the rays


def gather(paths, room, absorption, mics_m, *, ism_order, n_frames, speed_m_s, n_rays=None,
           visible=None):
    """Collect echograms.

    Parameters
    ----------
    paths : Paths
    room : Shoebox or MeshRoom
    absorption : ndarray, shape (n_slots, 8)
    mics_m : ndarray, shape (n_mics, 3)
    ism_order : int
        Purely specular paths with at most this many reflections are left out.
    n_frames : int
        Frames of 1 ms from the emission on.
    speed_m_s : float
    n_rays : int, optional
        Use the first so many rays only.
    visible : ndarray, optional
        From `visibility`, which is asked if need be.

    Returns
    -------
    echograms : ndarray, shape (n_mics, n_frames, 8)
        Squared pressure per frame, relative to a direct sound of ``1 / (4 pi r)^2``; without air absorption.
    """
    mics_m = np.atleast_2d(np.asarray(mics_m, dtype=np.float64))
    reflection = (1.0 - absorption)[paths.face_slot].astype(np.float32)
    scattering = paths.scattering[paths.face_slot]
    if visible is None:
        visible = visibility(paths, room, mics_m, n_frames=n_frames, speed_m_s=speed_m_s)
    n_rays = len(paths.hits) if n_rays is None else min(n_rays, len(paths.hits))
    wanted_m = float(np.clip(0.11 * room.volume_m3 ** (1.0 / 3.0), *_SPHERE_RADII))
    radius_m = np.array([room.sphere_radius_m(mic, wanted_m) for mic in mics_m])
    volume_m3 = np.array([room.sphere_volume_m3(*sphere) for sphere in zip(mics_m, radius_m, strict=True)])
    result = np.empty((len(mics_m), n_frames, absorption.shape[1]))
    for first in range(0, len(mics_m), _BATCH):
        batch = slice(first, first + _BATCH)
        parts = np.zeros((N_CHUNKS, len(mics_m[batch]), n_frames, absorption.shape[1]), dtype=np.float32)
        given = (paths.source_pos_m, paths.hits, paths.codes, paths.counts, paths.normals, reflection, scattering,
                 mics_m[batch], visible[batch], radius_m[batch] ** 2, 1.0 / volume_m3[batch], ism_order,
                 1.0 / (speed_m_s * FRAME_S), paths.late_m, paths.stride)
        for_chunks(n_rays, lambda chunk, low, high: _gather(*given, low, high, parts[chunk]))  # noqa: B023
        result[batch] = parts.sum(axis=0, dtype=np.float64)
    return result / (4.0 * np.pi * n_rays)


def visibility(paths, room, mics_m, *, n_frames, speed_m_s):
    """Tell from which stored reflections microphones are seen.

    Returns
    -------
    ndarray of bool, shape (n_mics, n_rays, capacity)
        Of shape (0, 0, 0) in a convex room, where all is seen. Only reflections that `gather` asks for are right.
    """
    if room.convex:
        return np.zeros((0, 0, 0), dtype=np.bool_)
    mics_m = np.atleast_2d(mics_m)
    wanted = np.arange(paths.hits.shape[1]) < paths.counts[:, None]
    wanted &= paths.hits[:, :, 3] < n_frames * FRAME_S * speed_m_s
    late = paths.hits[:, :, 3] > paths.late_m
    late[::paths.stride] = False
    wanted &= ~late
    ray, n = np.nonzero(wanted)
    start = paths.hits[ray, n, :3] + NUDGE_M * paths.normals[paths.codes[ray, n] >> 1]
    visible = np.zeros((len(mics_m), *wanted.shape), dtype=np.bool_)
    for m, mic in enumerate(mics_m):
        visible[m, ray, n] = room.sees(start, mic)
    return visible


@compiled
def _gather(source, hits, codes, counts, normals, reflection, scattering, mics, visible, radius2, per_volume, ism_order,
            frames_per_m, late_m, stride, low, high, echo):
    """Add rays `low` to `high` to `echo`, shape (n_mics, n_frames, 8)."""
    n_mics, n_frames, _ = echo.shape
    all_visible = len(visible) == 0
    g = np.empty(8, dtype=np.float32)
    for ray in range(low, high):
        g[:] = 1.0
        px, py, pz, path = source[0], source[1], source[2], 0.0
        specular, late = True, stride == 1
        was_diffuse = True
        for n in range(counts[ray]):
            hx, hy, hz = hits[ray, n, 0], hits[ray, n, 1], hits[ray, n, 2]
            new_path = hits[ray, n, 3]
            if not was_diffuse and (n > ism_order or not specular):
                length = new_path - path
                scale = 1.0 / max(length, 1e-9)
                ux, uy, uz = (hx - px) * scale, (hy - py) * scale, (hz - pz) * scale
                for m in range(n_mics):
                    vx, vy, vz = mics[m, 0] - px, mics[m, 1] - py, mics[m, 2] - pz
                    along = ux * vx + uy * vy + uz * vz
                    half2 = radius2[m] - (vx * vx + vy * vy + vz * vz - along * along)
                    if half2 > 0.0:
                        half = np.sqrt(half2)
                        start = max(0.0, along - half)
                        stop = min(length, along + half)
                        frame = int((path + 0.5 * (start + stop)) * frames_per_m)
                        if stop > start and frame < n_frames:
                            w = np.float32((stop - start) * per_volume[m])
                            for b in range(8):
                                echo[m, frame, b] += w * g[b]
            px, py, pz, path = hx, hy, hz, new_path
            face = codes[ray, n] >> 1
            most = np.float32(0.0)
            for b in range(8):
                g[b] *= reflection[face, b]
                most = max(most, g[b])
            if most < NEGLIGIBLE:
                break
            if not late and path > late_m:
                if ray % stride != 0:
                    break
                late = True
                for b in range(8):
                    g[b] *= stride
            s = scattering[face]
            if s > 0.0:
                for m in range(n_mics):
                    vx, vy, vz = mics[m, 0] - hx, mics[m, 1] - hy, mics[m, 2] - hz
                    d2 = vx * vx + vy * vy + vz * vz
                    d = np.sqrt(d2)
                    height = vx * normals[face, 0] + vy * normals[face, 1] + vz * normals[face, 2]
                    frame = int((path + d) * frames_per_m)
                    if height > 0.0 and frame < n_frames and (all_visible or visible[m, ray, n]):
                        w = np.float32(s * height / (np.pi * d2 * d))
                        for b in range(8):
                            echo[m, frame, b] += w * g[b]
            was_diffuse = (codes[ray, n] & 1) == 1
            if was_diffuse:
                specular = False
