"""An energy ray tracer for shoeboxes with a rectangular screen in them or none."""

import numba
import numpy as np

from testbed.draws import C0, LENGTH_S, N_BANDS

BIN_M = C0 * 1e-3  # path length of one bin: 1 ms at the declared temperature
N_BINS = round(LENGTH_S * 1000)
N_ANGLES = 12  # classes of the cosine between departure and facing
RADIUS_M = 0.3  # of the sphere that catches rays
N_RAYS = 24000
COHERENT_ORDER = 4  # specular paths up to here are image sources
QUIET = 1e-7  # of a ray's energy: where it ends
SCREEN_SCATTERING, SCREEN_ABSORPTION = 0.3, 0.05


@numba.njit(cache=True)
def _uniform(state):
    """Next number in [0, 1) of a ray's own stream (splitmix64), so that what other rays met doesn't change it."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return float((z ^ (z >> np.uint64(31))) >> np.uint64(11)) / 9007199254740992.0


@numba.njit(cache=True, inline="always")
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(cache=True)
def _turn_lambert(way, normal_axis, inward, state):
    """Turn a direction to a diffuse one off a plane across an axis."""
    u, angle = _uniform(state), 2.0 * np.pi * _uniform(state)
    radius = np.sqrt(u)
    way[normal_axis] = inward * np.sqrt(1.0 - u)
    way[(normal_axis + 1) % 3] = radius * np.cos(angle)
    way[(normal_axis + 2) % 3] = radius * np.sin(angle)


@numba.njit(cache=True)
def _to_screen(at, way, centre, axes, half):
    """Distance along a ray to a rectangle; infinite if it passes by."""
    across = _dot(way, axes[2])
    if abs(across) < 1e-9:
        return np.inf
    t = (_dot(centre, axes[2]) - _dot(at, axes[2])) / across
    if t < 1e-6:
        return np.inf
    for k in range(2):
        if abs(_dot(at, axes[k]) + t * _dot(way, axes[k]) - _dot(centre, axes[k])) > half[k]:
            return np.inf
    return t


@numba.njit(cache=True)
def _off_screen(way, axes, state):
    """Turn a direction as a hard screen does that is a little rough."""
    out = _dot(way, axes[2])
    if _uniform(state) < SCREEN_SCATTERING:
        local = np.empty(3)
        _turn_lambert(local, 2, -1.0 if out > 0.0 else 1.0, state)
        for k in range(3):
            way[k] = local[0] * axes[0, k] + local[1] * axes[1, k] + local[2] * axes[2, k]
    else:
        for k in range(3):
            way[k] -= 2.0 * out * axes[2, k]


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
    state = np.zeros(1, dtype=np.uint64)
    n_mics = len(mics)
    energy = np.zeros((n_mics, N_ANGLES, N_BANDS, N_BINS), dtype=np.float32)
    screened = half[0] * half[1] > 0.0
    scale = 1.0 / (4.0 / 3.0 * np.pi * RADIUS_M ** 3 * n_rays * 4.0 * np.pi)
    longest = N_BINS * BIN_M
    keep = 1.0 - absorption
    class_of = np.empty(n_mics, dtype=np.int64)
    weight = np.empty(N_BANDS)
    way, at = np.empty(3), np.empty(3)
    for ray in range(n_rays):
        state[0] = np.uint64(seed) * np.uint64(2 ** 32) + np.uint64(ray) * np.uint64(2 ** 16)
        z, turn = 2.0 * _uniform(state) - 1.0, 2.0 * np.pi * _uniform(state)
        flat = np.sqrt(1.0 - z * z)
        way[0], way[1], way[2] = flat * np.cos(turn), flat * np.sin(turn), z
        for m in range(n_mics):
            class_of[m] = max(0, min(N_ANGLES - 1, int((_dot(way, facings[m]) + 1.0) / 2.0 * N_ANGLES)))
        at[:] = source
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
                    x, y, up = mics[m, 0] - at[0], mics[m, 1] - at[1], mics[m, 2] - at[2]
                    near = x * way[0] + y * way[1] + up * way[2]
                    squared = RADIUS_M ** 2 - (x * x + y * y + up * up - near * near)
                    if squared > 0.0:
                        span = np.sqrt(squared)
                        enter, leave = max(near - span, 0.0), min(near + span, reach)
                        if leave > enter:
                            k = int((gone + 0.5 * (enter + leave)) / BIN_M)
                            if k < N_BINS:
                                for b in range(N_BANDS):
                                    energy[m, class_of[m], b, k] += weight[b] * (leave - enter)
            gone += reach
            for axis in range(3):
                at[axis] += reach * way[axis]
            if wall < 0:
                _off_screen(way, axes, state)
                weight *= 1.0 - SCREEN_ABSORPTION
                specular = False
                continue
            axis = wall // 2
            at[axis] = 0.0 if wall % 2 == 0 else dims[axis]
            for b in range(N_BANDS):
                weight[b] *= keep[wall, b]
            order += 1
            if _uniform(state) < scattering[wall]:
                _turn_lambert(way, axis, 1.0 if wall % 2 == 0 else -1.0, state)
                specular = False
            else:
                way[axis] = -way[axis]
    return energy


NO_SCREEN = (np.zeros(3), np.eye(3), np.zeros(2))
