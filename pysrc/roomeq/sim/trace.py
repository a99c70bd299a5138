"""Rays: what each of them meets on its way, stored so that receivers and materials can come later.

A ray leaves the source with an equal share of its power. Where it meets a surface it goes on specularly or, with
a probability equal to the scattering coefficient, diffusely (Lambert's law). No absorption is applied, so one
trace serves all receivers and all absorption coefficients; bands with equal scattering share a trace.
"""

from dataclasses import dataclass

import numpy as np

from roomeq.sim.jit import compiled, for_chunks, mix, uniform

GOLDEN_RATIO = 0.5 * (1.0 + np.sqrt(5.0))


@dataclass(frozen=True)
class Paths:
    """What the rays of one source met.

    Attributes
    ----------
    source_pos_m : ndarray, shape (3,)
    hits : ndarray of float32, shape (n_rays, capacity, 4)
        Position of each reflection and the length of the path up to there [m].
    codes : ndarray of unsigned int, shape (n_rays, capacity)
        ``2 * face + went_on_diffusely`` per reflection.
    counts : ndarray of int32, shape (n_rays,)
        Reflections stored per ray.
    scattering : ndarray, shape (n_slots,)
        Scattering coefficient of each slot that the rays were traced with.
    max_length_m : float
        Rays end with the first reflection beyond this length.
    n_leaked : int
        Rays that slipped through the surface.
    """

    source_pos_m: np.ndarray
    hits: np.ndarray
    codes: np.ndarray
    counts: np.ndarray
    scattering: np.ndarray
    max_length_m: float
    n_leaked: int


def sphere_directions(n_rays, rng):
    """Well distributed unit vectors: a Fibonacci lattice in a random orientation, shape (n_rays, 3).

    Each stands for the same solid angle (Swinbank and Purser, Q. J. R. Meteorol. Soc. 132 (2006) 1769). Their
    order is random, so that the first few are a fair sample of all.
    """
    index = np.arange(n_rays) + 0.5
    z = 1.0 - 2.0 * index / n_rays
    angle = 2.0 * np.pi * index / GOLDEN_RATIO
    radius = np.sqrt(1.0 - z ** 2)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)
    rotation, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    return rng.permutation(points @ rotation)


def trace(room, source_pos_m, scattering, *, num_rays, max_length_m, rng):
    """Follow rays from a source.

    Parameters
    ----------
    room : Shoebox or MeshRoom
    source_pos_m : array_like, shape (3,)
    scattering : array_like, shape (n_slots,)
        Scattering coefficient of each slot.
    num_rays : int
    max_length_m : float
        How far to follow a ray [m].
    rng : numpy.random.Generator

    Returns
    -------
    Paths
    """
    source_pos_m = np.asarray(source_pos_m, dtype=np.float64)
    scattering = np.asarray(scattering, dtype=np.float64)
    directions = sphere_directions(num_rays, rng)
    seed = np.uint64(rng.integers(2 ** 63))
    if hasattr(room, "trace"):
        return room.trace(source_pos_m, directions, scattering, max_length_m, seed)
    capacity = _capacity(room.dims_m, max_length_m)
    hits = np.empty((num_rays, capacity, 4), dtype=np.float32)
    codes = np.empty((num_rays, capacity), dtype=np.uint8)
    counts = np.empty(num_rays, dtype=np.int32)
    dims_m = np.array(room.dims_m)
    for_chunks(num_rays, lambda chunk, first, last: _trace_box(
        dims_m, source_pos_m, directions, scattering, max_length_m, seed, first, last, hits, codes, counts))
    return Paths(source_pos_m, hits, codes, counts, scattering, max_length_m, 0)


def _capacity(dims_m, max_length_m):
    """Reflections per ray that there is room for: the most that a specular ray can meet, and some."""
    return int(1.2 * max_length_m * np.sqrt(np.sum(1.0 / np.square(dims_m)))) + 40


@compiled
def lambert(normal, u, v, out):
    """Write a cosine-distributed direction about `normal` to `out`: the normal plus a point on the unit sphere."""
    z = 1.0 - 2.0 * u
    radius = np.sqrt(max(0.0, 1.0 - z * z))
    angle = 2.0 * np.pi * v
    x = normal[0] + radius * np.cos(angle)
    y = normal[1] + radius * np.sin(angle)
    z = normal[2] + z
    scale = 1.0 / np.sqrt(max(x * x + y * y + z * z, 1e-20))
    out[0], out[1], out[2] = x * scale, y * scale, z * scale


@compiled
def _trace_box(dims_m, source, directions, scattering, max_length_m, seed, first, last, hits, codes, counts):
    """Trace rays `first` to `last` in a box; axis a has faces 2a (at 0) and 2a + 1 (at its length)."""
    capacity = hits.shape[1]
    normal = np.zeros(3)
    out = np.zeros(3)
    for ray in range(first, last):
        stream = mix(seed + np.uint64(ray))
        x, y, z = source[0], source[1], source[2]
        dx, dy, dz = directions[ray, 0], directions[ray, 1], directions[ray, 2]
        length = 0.0
        n = 0
        while n < capacity and length < max_length_m:
            tx = (dims_m[0] - x) / dx if dx > 1e-12 else (-x / dx if dx < -1e-12 else 1e30)
            ty = (dims_m[1] - y) / dy if dy > 1e-12 else (-y / dy if dy < -1e-12 else 1e30)
            tz = (dims_m[2] - z) / dz if dz > 1e-12 else (-z / dz if dz < -1e-12 else 1e30)
            if tx <= ty and tx <= tz:
                axis, t, high = 0, tx, dx > 0.0
            elif ty <= tz:
                axis, t, high = 1, ty, dy > 0.0
            else:
                axis, t, high = 2, tz, dz > 0.0
            x = min(max(x + t * dx, 0.0), dims_m[0])
            y = min(max(y + t * dy, 0.0), dims_m[1])
            z = min(max(z + t * dz, 0.0), dims_m[2])
            length += t
            face = 2 * axis + (1 if high else 0)
            diffuse = uniform(stream, 3 * n) < scattering[face]
            if diffuse:
                normal[0], normal[1], normal[2] = 0.0, 0.0, 0.0
                normal[axis] = -1.0 if high else 1.0
                lambert(normal, uniform(stream, 3 * n + 1), uniform(stream, 3 * n + 2), out)
                dx, dy, dz = out[0], out[1], out[2]
            elif axis == 0:
                dx = -dx
            elif axis == 1:
                dy = -dy
            else:
                dz = -dz
            if axis == 0:
                x = dims_m[0] if high else 0.0
            elif axis == 1:
                y = dims_m[1] if high else 0.0
            else:
                z = dims_m[2] if high else 0.0
            hits[ray, n, 0], hits[ray, n, 1], hits[ray, n, 2], hits[ray, n, 3] = x, y, z, length
            codes[ray, n] = 2 * face + (1 if diffuse else 0)
            n += 1
        counts[ray] = n
