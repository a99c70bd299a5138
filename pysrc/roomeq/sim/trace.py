"""Ray tracing: the reflections of rays from a source, stored independently of receivers and absorption.

Each ray leaves the source with an equal share of its power. At a surface it continues specularly or, with a
probability equal to the scattering coefficient, diffusely (Lambert's law). No absorption is applied, so one trace
serves all receivers and all absorption coefficients; bands with equal scattering share a trace.

Once reflections are denser than samples, far more paths arrive than a smooth decay needs: from then on one ray in a
few continues and represents the others.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike

from roomeq.core.arrays import Array, FloatArray, IntArray, Number
from roomeq.core.jit import compiled, for_chunks, mix, uniform
from roomeq.sim.room import Room, Walls

if TYPE_CHECKING:
    from roomeq.sim.mesh import MeshRoom

RETRIES = 6
"""Attempts to find a surface for a ray that passed between two faces at their common edge."""
LATE_RAYS = 5000
"""Rays that are followed to the end, at least, if there are so many."""
MAX_STRIDE = 4
_LATE_RATE_HZ = 16000.0
"""Largest number of rays that one late ray represents."""
GOLDEN_RATIO = 0.5 * (1.0 + np.sqrt(5.0))


@dataclass(frozen=True)
class Paths:
    """The reflections of the rays of one source.

    Attributes
    ----------
    source_pos_m
        Shape (3,).
    directions
        Unit vectors in which the rays leave the source, shape (n_rays, 3).
    hits
        Position of each reflection and the length of the path up to it [m], ray by ray, shape (n_stored, 4), float32.
    codes
        ``2 * face + continues_diffusely`` of each reflection, shape (n_stored,), unsigned.
    first
        Index of each ray's first reflection, shape (n_rays,). There may be unused elements between two rays.
    normals
        Unit normals of the faces into the air, shape (n_faces, 3).
    face_surface
        Surface of each face, shape (n_faces,).
    counts
        Reflections stored of each ray, shape (n_rays,), int32.
    scattering
        Scattering coefficient of each surface, as traced, shape (n_surfaces,).
    late_m, stride
        Beyond this length of path, one ray in `stride` continues and represents the others.
    max_length_m
        Rays end with the first reflection beyond this length of path.
    n_leaked
        Rays that left the room through a gap between faces.
    """

    source_pos_m: FloatArray
    directions: FloatArray
    hits: Array
    codes: Array
    first: IntArray
    normals: FloatArray
    face_surface: IntArray
    counts: Array
    scattering: FloatArray
    late_m: float
    stride: int
    max_length_m: float
    n_leaked: int


class _Traced(NamedTuple):
    """Stored reflections; see `Paths`."""

    hits: Array
    codes: Array
    first: IntArray
    counts: Array
    n_leaked: int


def sphere_directions(n_rays: int, rng: np.random.Generator) -> FloatArray:
    """Return evenly distributed unit vectors, a Fibonacci lattice in a random orientation, shape (n_rays, 3).

    Each represents the same solid angle (Swinbank and Purser, Q. J. R. Meteorol. Soc. 132 (2006) 1769). Their order is
    random, so that any number of them from the start is a fair sample.
    """
    index = np.arange(n_rays) + 0.5
    z = 1.0 - 2.0 * index / n_rays
    angle = 2.0 * np.pi * index / GOLDEN_RATIO
    radius = np.sqrt(1.0 - z ** 2)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)
    rotation, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    return rng.permutation(points @ rotation)


def trace(room: Room, source_pos_m: ArrayLike, scattering: ArrayLike, *, num_rays: int, max_length_m: float,
          speed_m_s: float, rng: np.random.Generator) -> Paths:
    """Trace rays from a source.

    Parameters
    ----------
    room
    source_pos_m
        Shape (3,).
    scattering
        Scattering coefficient of each surface, shape (n_surfaces,).
    num_rays
    max_length_m
        Length of path up to which rays are followed.
    speed_m_s
        Speed of sound.
    rng

    Returns
    -------
    Paths
    """
    source_pos_m = np.asarray(source_pos_m, dtype=np.float64)
    scattering = np.asarray(scattering, dtype=np.float64)
    directions = sphere_directions(num_rays, rng)
    seed = np.uint64(rng.integers(2 ** 63))
    late_m = late_after_s(room.volume_m3, speed_m_s) * speed_m_s
    stride = int(np.clip(num_rays // LATE_RAYS, 1, MAX_STRIDE))
    end_m = np.where(np.arange(num_rays) % stride == 0, max_length_m, min(late_m, max_length_m))
    faces = room.walls or cast("MeshRoom", room)
    of_faces = scattering[faces.face_surface]
    if room.walls is not None:
        traced = _trace_between_walls(room.walls, source_pos_m, directions, of_faces, end_m, seed)
    else:
        traced = _trace_in_mesh(cast("MeshRoom", room), source_pos_m, directions, of_faces, end_m, seed)
    return Paths(source_pos_m, directions, traced.hits, traced.codes, traced.first, faces.normals, faces.face_surface,
                 traced.counts, scattering, late_m, stride, max_length_m, traced.n_leaked)


def late_after_s(volume_m3: float, speed_m_s: float) -> float:
    """Return when reflections become so dense that single ones no longer matter, at any sample rate [s]."""
    return dense_after_s(volume_m3, speed_m_s, _LATE_RATE_HZ)


def dense_after_s(volume_m3: float, speed_m_s: float, rate_hz: float) -> float:
    """Return when reflections, which arrive at ``4 pi c^3 t^2 / V`` (Kuttruff, eq. 4.6), reach a rate [s]."""
    return float(np.sqrt(rate_hz * volume_m3 / (4.0 * np.pi * speed_m_s ** 3)))


def _code_type(n_faces: int) -> type[np.uint8] | type[np.uint32]:
    return np.uint8 if n_faces < 128 else np.uint32


def _trace_between_walls(walls: Walls, source: FloatArray, directions: FloatArray, scattering: FloatArray,
                         end_m: FloatArray, seed: np.uint64) -> _Traced:
    """Trace a room that is bounded by a few planes: the next hit is on the nearest plane ahead."""
    n_rays = len(directions)
    # more than a specular ray can meet in a box
    capacity = (1.2 * end_m * np.sqrt(np.sum(1.0 / walls.size_m ** 2))).astype(np.int64) + 40
    start = np.concatenate([[0], np.cumsum(capacity)])
    hits, codes = np.empty((start[-1], 4), np.float32), np.empty(start[-1], _code_type(len(walls.normals)))
    first, counts = np.empty(n_rays, dtype=np.int64), np.empty(n_rays, dtype=np.int32)
    # each chunk fills its share of the store from the front, so that unused pages are never touched
    for_chunks(n_rays, lambda chunk, low, high: _trace_convex(
        walls.normals, walls.offsets, source, directions, scattering, end_m, seed, low, high, capacity, start[low],
        hits, codes, first, counts))
    return _Traced(hits, codes, first, counts, 0)


def _trace_in_mesh(room: "MeshRoom", source: FloatArray, directions: FloatArray, scattering: FloatArray,
                   end_m: FloatArray, seed: np.uint64) -> _Traced:
    """Trace any closed mesh: all rays together, reflection by reflection."""
    n_rays = len(directions)
    counts = np.zeros(n_rays, dtype=np.int32)
    position, before = np.tile(source, (n_rays, 1)), np.tile(source, (n_rays, 1))
    way, length = directions.copy(), np.zeros(n_rays)
    active, n_leaked = np.arange(n_rays), 0
    steps: list[tuple[IntArray, Array, Array]] = []
    while len(active):
        face, distance = _next_hits(room, position, way, before, active, seed, len(steps))
        lost = face < 0
        n_leaked += int(lost.sum())
        active, face, distance = active[~lost], face[~lost], distance[~lost]
        hits, codes = np.empty((len(active), 4), np.float32), np.empty(len(active), _code_type(len(room.normals)))
        _advance(room.normals, active, face, distance, scattering, seed, len(steps), position, before, way, length,
                 hits, codes)
        counts[active] += 1
        steps.append((active, hits, codes))
        active = active[length[active] <= end_m[active]]
    first = np.concatenate([[0], np.cumsum(counts[:-1], dtype=np.int64)])
    hits = np.empty((counts.sum(), 4), np.float32)
    codes = np.empty(len(hits), _code_type(len(room.normals)))
    for n, (rays, step_hits, step_codes) in enumerate(steps):
        hits[first[rays] + n], codes[first[rays] + n] = step_hits, step_codes
    return _Traced(hits, codes, first, counts, n_leaked)


def _next_hits(room: "MeshRoom", position: FloatArray, way: FloatArray, before: FloatArray, active: IntArray,
               seed: np.uint64, n: int) -> tuple[IntArray, FloatArray]:
    """Return faces and distances of the active rays' next hits; rays that pass between two faces are shot again.

    Each attempt starts a little further back and in a slightly different direction, in place.
    """
    face, distance = room.first_hits(position[active], way[active])
    lost = np.flatnonzero(face < 0)
    if not len(lost):
        return face, distance
    rng = np.random.default_rng([int(seed), n])
    for attempt in range(RETRIES):
        if not len(lost):
            break
        rays = active[lost]
        position[rays] += 10.0 ** (attempt - RETRIES) * (before[rays] - position[rays])
        way[rays] += 10.0 ** (attempt - RETRIES) * rng.standard_normal((len(rays), 3))
        way[rays] /= np.linalg.norm(way[rays], axis=1)[:, None]
        face[lost], distance[lost] = room.first_hits(position[rays], way[rays])
        lost = lost[face[lost] < 0]
    return face, distance


@compiled
def reflect(normals: Array, face: Number, scattering: Number, stream: Number, n: Number, way: Array) -> bool:
    """Turn `way` at reflection `n` of a ray, specularly or diffusely; return whether diffusely.

    A diffuse direction is the normal plus a point on the unit sphere, which is Lambert's cosine distribution.
    """
    nx, ny, nz = normals[face, 0], normals[face, 1], normals[face, 2]
    if uniform(stream, 3 * n) >= scattering:
        twice = 2.0 * (way[0] * nx + way[1] * ny + way[2] * nz)
        way[0], way[1], way[2] = way[0] - twice * nx, way[1] - twice * ny, way[2] - twice * nz
        return False
    rise = 1.0 - 2.0 * uniform(stream, 3 * n + 1)
    radius = np.sqrt(max(0.0, 1.0 - rise * rise))
    angle = 2.0 * np.pi * uniform(stream, 3 * n + 2)
    x, y, z = nx + radius * np.cos(angle), ny + radius * np.sin(angle), nz + rise
    scale = 1.0 / np.sqrt(max(x * x + y * y + z * z, 1e-20))
    way[0], way[1], way[2] = x * scale, y * scale, z * scale
    return True


@compiled
def _trace_convex(normals: Array, offsets: Array, source: Array, directions: Array, scattering: Array, end_m: Array,
                  seed: Number, low: Number, high: Number, capacity: Array, stored: Number, hits: Array, codes: Array,
                  first: Array, counts: Array) -> None:
    """Trace rays `low` to `high` between planes; the air is where ``normal . x > offset`` for all of them."""
    n_faces = len(normals)
    height, approach, way = np.empty(n_faces), np.empty(n_faces), np.empty(3)
    for ray in range(low, high):
        stream = mix(seed + np.uint64(ray))
        first[ray] = stored
        x, y, z = source[0], source[1], source[2]
        way[0], way[1], way[2] = directions[ray, 0], directions[ray, 1], directions[ray, 2]
        for face in range(n_faces):
            height[face] = normals[face, 0] * x + normals[face, 1] * y + normals[face, 2] * z - offsets[face]
        length, n = 0.0, 0
        while n < capacity[ray] and length <= end_m[ray]:
            ahead, ahead_height, ahead_approach = -1, 1e30, 1.0
            for face in range(n_faces):
                toward = -(normals[face, 0] * way[0] + normals[face, 1] * way[1] + normals[face, 2] * way[2])
                approach[face] = toward
                # height / toward < ahead_height / ahead_approach
                if toward > 1e-12 and height[face] * ahead_approach < ahead_height * toward:
                    ahead, ahead_height, ahead_approach = face, height[face], toward
            if ahead < 0:  # along the wall to within rounding
                break
            distance = max(ahead_height / ahead_approach, 0.0)
            x, y, z = x + distance * way[0], y + distance * way[1], z + distance * way[2]
            for face in range(n_faces):
                height[face] -= distance * approach[face]
            height[ahead] = 0.0
            length += distance
            diffuse = reflect(normals, ahead, scattering[ahead], stream, n, way)
            hits[stored, 0], hits[stored, 1], hits[stored, 2], hits[stored, 3] = x, y, z, length
            codes[stored] = 2 * ahead + (1 if diffuse else 0)
            stored += 1
            n += 1
        counts[ray] = n


@compiled
def _advance(normals: Array, active: Array, faces: Array, distances: Array, scattering: Array, seed: Number, n: Number,
             position: Array, before: Array, way: Array, length: Array, hits: Array, codes: Array) -> None:
    """Move the active rays to just off their hits, store reflection `n` and turn them."""
    for i in range(len(active)):
        ray, face, distance = active[i], faces[i], distances[i]
        for axis in range(3):
            before[ray, axis] = position[ray, axis]
            position[ray, axis] += distance * way[ray, axis]
            hits[i, axis] = position[ray, axis]
        length[ray] += distance
        hits[i, 3] = length[ray]
        diffuse = reflect(normals, face, scattering[face], mix(seed + np.uint64(ray)), n, way[ray])
        codes[i] = 2 * face + (1 if diffuse else 0)
        for axis in range(3):
            position[ray, axis] += 1e-4 * normals[face, axis]
