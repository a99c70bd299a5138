"""An energy ray tracer for shoeboxes with a rectangular screen in them or none."""

import numba
import numpy as np

from worlds.draws import C0, LENGTH_S, N_BANDS

BIN_M = C0 * 1e-3  # path length of one bin: 1 ms at the declared temperature
N_BINS = round(LENGTH_S * 1000)
N_ANGLES = 12  # classes of the cosine between departure and facing
RADIUS_M = 0.3  # of the sphere that catches rays
N_RAYS = 12000
COHERENT_ORDER = 4  # specular paths up to here are image sources
QUIET = 1e-8


@numba.njit(cache=True)
def _lambert(normal_axis, inward):
    """Direction of diffuse reflection off a wall."""
    u, v = np.random.random(), np.random.random()
    out = np.empty(3)
    radius, angle = np.sqrt(u), 2.0 * np.pi * v
    out[normal_axis] = inward * np.sqrt(1.0 - u)
    out[(normal_axis + 1) % 3] = radius * np.cos(angle)
    out[(normal_axis + 2) % 3] = radius * np.sin(angle)
    return out


@numba.njit(cache=True)
def _to_screen(at, way, centre, axes, half):
    """Distance along a ray to a rectangle; infinite if it passes by."""
    across = np.dot(way, axes[2])
    if abs(across) < 1e-9:
        return np.inf
    t = np.dot(centre - at, axes[2]) / across
    if t < 1e-6:
        return np.inf
    point = at + t * way - centre
    if abs(np.dot(point, axes[0])) > half[0] or abs(np.dot(point, axes[1])) > half[1]:
        return np.inf
    return t


@numba.njit(cache=True)
def trace(dims, source, mics, facings, absorption, scattering, centre, axes, half, n_rays, seed):
    """Trace rays of one source past several microphones.

    Specular paths up to `COHERENT_ORDER` that never met the screen are left out.

    Parameters
    ----------
    dims, source : ndarray, shape (3,)
    mics, facings : ndarray, shape (n_mics, 3)
        Where the microphones are; where the source faces when each is recorded.
    absorption : ndarray, shape (6, 8)
    scattering : ndarray, shape (6,)
    centre, axes, half : ndarray, shape (3,), (3, 3) and (2,)
        The screen: centre, unit vectors (across, up, normal), half sizes; none where they are 0.
    n_rays, seed : int

    Returns
    -------
    energy : ndarray, shape (n_mics, N_ANGLES, 8, N_BINS)
        Squared pressure per bin of path length, where 1/(4 pi r)² is that of the direct sound.
    """
    np.random.seed(seed)
    n_mics = len(mics)
    energy = np.zeros((n_mics, N_ANGLES, N_BANDS, N_BINS), dtype=np.float32)
    screened = half[0] * half[1] > 0.0
    scale = 1.0 / (4.0 / 3.0 * np.pi * RADIUS_M ** 3 * n_rays * 4.0 * np.pi)
    longest = N_BINS * BIN_M
    keep = 1.0 - absorption
    class_of = np.empty(n_mics, dtype=np.int64)
    weight = np.empty(N_BANDS)
    for _ in range(n_rays):
        z, turn = 2.0 * np.random.random() - 1.0, 2.0 * np.pi * np.random.random()
        flat = np.sqrt(1.0 - z * z)
        way = np.array([flat * np.cos(turn), flat * np.sin(turn), z])
        for m in range(n_mics):
            cosine = np.dot(way, facings[m])
            class_of[m] = min(N_ANGLES - 1, int((cosine + 1.0) / 2.0 * N_ANGLES))
        at = source.copy()
        weight[:] = scale
        gone, order, specular = 0.0, 0, True
        while gone < longest and weight.max() > QUIET * scale:
            reach, wall = np.inf, 0
            for axis in range(3):
                if way[axis] > 1e-12:
                    t = (dims[axis] - at[axis]) / way[axis]
                    if t < reach:
                        reach, wall = t, 2 * axis + 1
                elif way[axis] < -1e-12:
                    t = -at[axis] / way[axis]
                    if t < reach:
                        reach, wall = t, 2 * axis
            if screened:
                t = _to_screen(at, way, centre, axes, half)
                if t < reach:
                    reach, wall = t, -1
            if not (specular and order <= COHERENT_ORDER):
                for m in range(n_mics):
                    off = mics[m] - at
                    near = np.dot(off, way)
                    squared = RADIUS_M ** 2 - (np.dot(off, off) - near * near)
                    if squared > 0.0:
                        span = np.sqrt(squared)
                        enter, leave = max(near - span, 0.0), min(near + span, reach)
                        if leave > enter:
                            k = int((gone + 0.5 * (enter + leave)) / BIN_M)
                            if k < N_BINS:
                                for b in range(N_BANDS):
                                    energy[m, class_of[m], b, k] += weight[b] * (leave - enter)
            gone += reach
            at = at + reach * way
            if wall < 0:  # a hard screen, a little rough
                side = -1.0 if np.dot(way, axes[2]) > 0.0 else 1.0
                if np.random.random() < 0.3:
                    local = _lambert(2, side)
                    way = local[0] * axes[0] + local[1] * axes[1] + local[2] * axes[2]
                else:
                    way = way - 2.0 * np.dot(way, axes[2]) * axes[2]
                weight *= 0.95
                specular = False
                continue
            axis = wall // 2
            at[axis] = 0.0 if wall % 2 == 0 else dims[axis]
            for b in range(N_BANDS):
                weight[b] *= keep[wall, b]
            order += 1
            if np.random.random() < scattering[wall]:
                way = _lambert(axis, 1.0 if wall % 2 == 0 else -1.0)
                specular = False
            else:
                way[axis] = -way[axis]
    return energy


NO_SCREEN = (np.zeros(3), np.eye(3), np.zeros(2))
