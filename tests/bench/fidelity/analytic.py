"""What the reference must give where the answer is known otherwise: mean free path, mirrors, Lambert walls."""

import numpy as np
from scipy.optimize import brentq

from bench.fidelity.reference import SPEED_M_S


def mean_hits_per_s(dims_m, speed_m_s=SPEED_M_S):
    """Wall hits of a ray in a second, ``c S / 4 V``: exact for any scattering if rays start uniformly."""
    return speed_m_s * surface_m2(dims_m) / (4.0 * float(np.prod(dims_m)))


def surface_m2(dims_m):
    """Total wall area of a shoebox."""
    x, y, z = dims_m
    return 2.0 * (x * y + x * z + y * z)


def eyring_time_s(dims_m, absorption, speed_m_s=SPEED_M_S):
    """Reverberation time ``24 ln(10) V / (-c S ln(1 - mean alpha))`` (Eyring 1930)."""
    x, y, z = dims_m
    area = np.repeat([y * z, x * z, x * y], 2)
    mean = float(np.average(np.broadcast_to(absorption, 6), weights=area))
    return 24.0 * np.log(10.0) * float(np.prod(dims_m)) / (-speed_m_s * area.sum() * np.log(1.0 - mean))


def mirror_energy(dims_m, absorption, time_s, *, n_nodes=400, speed_m_s=SPEED_M_S):
    """Energy left in a shoebox with mirror walls (scattering 0), rays starting uniformly, by quadrature.

    A ray with direction cosine u along an axis crosses ``x = |u| c t / L`` room lengths and meets the two walls of
    that axis in turn, floor(x) times, once more with probability x - floor(x), starting with either; the axes are
    independent, and what is left is averaged over the directions.

    Parameters
    ----------
    dims_m : array_like, shape (3,)
    absorption : float or array_like, shape (6,)
    time_s : ndarray, shape (n_times,)
    n_nodes : int
        Nodes in each of polar cosine and azimuth over one octant.

    Returns
    -------
    energy : ndarray, shape (n_times,)
    """
    keep = 1.0 - np.broadcast_to(np.asarray(absorption, dtype=float), 6)
    node, weight = np.polynomial.legendre.leggauss(n_nodes)
    cosine, weight = 0.5 * (node + 1.0)[:, None], 0.5 * weight[:, None]
    azimuth = 0.5 * np.pi * (np.arange(n_nodes) + 0.5)[None, :] / n_nodes
    sine = np.sqrt(1.0 - cosine ** 2)
    cosines = (sine * np.cos(azimuth), sine * np.sin(azimuth), cosine)
    energy = []
    for t in time_s:
        left = [_axis_energy(u * speed_m_s * t / size, keep[2 * axis], keep[2 * axis + 1])
                for axis, (u, size) in enumerate(zip(cosines, dims_m, strict=True))]
        energy.append(float(np.sum(weight * left[0] * left[1] * left[2]) / n_nodes))
    return np.array(energy)


def _axis_energy(crossed, keep_low, keep_high):
    whole = np.floor(crossed)
    part = crossed - whole

    def left(n):
        more, fewer = np.ceil(0.5 * n), np.floor(0.5 * n)
        return 0.5 * (keep_low ** more * keep_high ** fewer + keep_high ** more * keep_low ** fewer)

    return (1.0 - part) * left(whole) + part * left(whole + 1.0)


def lambert_decay_per_s(dims_m, absorption, *, patch_m=0.5, speed_m_s=SPEED_M_S):
    """Late decay rate of the energy between Lambert walls (scattering 1): Kuttruff's integral equation.

    The irradiation of the walls decays as exp(-rate t) for the rate at which the largest eigenvalue of
    ``(1 - alpha_j) F_ij exp(rate d_ij / c)`` is one, F being the form factors between wall patches
    (Kuttruff, Room Acoustics, 4th ed., eq. 4.23 to 4.26).

    Parameters
    ----------
    patch_m : float
        Largest side of a patch.

    Returns
    -------
    rate : float
        [1/s]; the reverberation time is 6 ln(10) / rate.
    """
    center, normal, corners, wall = _patches(dims_m, patch_m)
    keep = 1.0 - np.broadcast_to(np.asarray(absorption, dtype=float), 6)[wall]
    distance = np.linalg.norm(center[None, :, :] - center[:, None, :], axis=2)
    form = np.zeros_like(distance)
    for first, second in np.ndindex(2, 2):  # mean over the sending patch: 2 x 2 Gauss points
        u, v = (0.5 + (2 * k - 1) / np.sqrt(12.0) for k in (first, second))
        point = corners[:, 0] + u * (corners[:, 1] - corners[:, 0]) + v * (corners[:, 3] - corners[:, 0])
        form += 0.25 * _form_factors(point, normal, corners, wall)

    def excess(rate):
        kernel = form * np.exp(rate * distance / speed_m_s) * keep[None, :]
        vector = np.ones(len(wall))
        for _ in range(60):
            vector = kernel @ vector
            value = float(vector.max())
            vector /= value
        return value - 1.0

    guess = 6.0 * np.log(10.0) / eyring_time_s(dims_m, absorption, speed_m_s)
    return brentq(excess, 0.3 * guess, 1.5 * guess, rtol=1e-6)


def _form_factors(center, normal, corners, wall):
    """Share of what Lambert's law sends from point i to patch j, exact, by Lambert's contour integral."""
    form = np.zeros((len(center), len(center)))
    for side in range(4):
        start, end = (corners[None, :, k, :] - center[:, None, :] for k in (side, (side + 1) % 4))
        across = np.cross(start, end)
        sine = np.linalg.norm(across, axis=2)
        angle = np.arctan2(sine, np.einsum("ijk,ijk->ij", start, end))
        form += angle / np.maximum(sine, 1e-12) * np.einsum("ijk,ik->ij", across, normal)
    form = np.abs(form) / (2.0 * np.pi)
    form[wall[:, None] == wall[None, :]] = 0.0
    return form


def _patches(dims_m, patch_m):
    """Centres, inward normals, corners (n, 4, 3) and wall numbers of equal patches on the six walls."""
    center, normal, corners, wall = [], [], [], []
    for axis in range(3):
        across = [(axis + 1) % 3, (axis + 2) % 3]
        count = [max(2, int(np.ceil(dims_m[k] / patch_m))) for k in across]
        size = [dims_m[k] / n for k, n in zip(across, count, strict=True)]
        grid = np.indices(count).reshape(2, -1).T
        for upper in (0, 1):
            def place(shift, axis=axis, across=across, size=size, grid=grid, upper=upper):
                point = np.zeros((len(grid), 3))
                point[:, across] = (grid + shift) * size
                point[:, axis] = upper * dims_m[axis]
                return point

            center.append(place([0.5, 0.5]))
            normal.append(np.tile(np.eye(3)[axis] * (1 - 2 * upper), (len(grid), 1)))
            corners.append(np.stack([place(shift) for shift in ([0, 0], [1, 0], [1, 1], [0, 1])], axis=1))
            wall.append(np.full(len(grid), 2 * axis + upper))
    return np.concatenate(center), np.concatenate(normal), np.concatenate(corners), np.concatenate(wall)
