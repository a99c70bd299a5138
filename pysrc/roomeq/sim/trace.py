"""Ray tracing: the reflections of rays from a source, stored independently of receivers and absorption.

Each ray leaves the source with an equal share of its power. At a surface it continues specularly or, with a
probability equal to the scattering coefficient, diffusely (Lambert's law). No absorption is applied, so one trace
serves all receivers and all absorption coefficients; bands with equal scattering share a trace.

Late rays play Russian roulette (`roomeq.sim.roulette`), which ends rays, and changes the way of none. Where a source is
needed for several expected absorptions, its rays are traced once without it, and play it for each: the paths are the
same as of a trace for this absorption.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike

from roomeq.core.arrays import Array, BoolArray, FloatArray, IntArray, Number, Numbers
from roomeq.core.jit import compiled, for_chunks, inlined, mix, uniform
from roomeq.sim.box_trace import trace_box
from roomeq.sim.room import Room
from roomeq.sim.roulette import Roulette, play_at, roulette_for
from roomeq.sim.tree import BEHIND_M, FRONTS, Tree, first_hit, memory

if TYPE_CHECKING:
    from roomeq.sim.mesh import MeshRoom

_LATE_RATE_HZ = 16000.0
GOLDEN_RATIO = 0.5 * (1.0 + np.sqrt(5.0))


class Reflections(NamedTuple):
    """The stored reflections of rays, for kernels; see `Paths`."""

    hits: Array
    codes: Array
    first: IntArray
    counts: Array


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
        ``4 * face + 2 * represents_two + continues_diffusely`` of each reflection, shape (n_stored,), unsigned. From
        a reflection that represents two on, the ray's energy counts twice as much as before. A ray's last reflection
        only ends the way to it: nothing is reflected there. 0 for reflections after a ray's last one.
    first
        Index of each ray's first reflection, shape (n_rays,).
    normals
        Unit normals of the faces into the air, shape (n_faces, 3).
    face_surface
        Surface of each face, shape (n_faces,).
    curved
        Whether each face is a facet of a curved surface, shape (n_faces,).
    counts
        Reflections stored of each ray, shape (n_rays,), int32.
    scattering
        Scattering coefficient of each surface, as traced, shape (n_surfaces,).
    late_m
        Beyond this length of path, reflections are dense, and rays play Russian roulette.
    max_length_m
        Rays end with the first reflection beyond this length of path.
    n_leaked
        Rays that left the room through a gap between faces.
    seed
        Of the random numbers of the rays.
    """

    source_pos_m: FloatArray
    directions: FloatArray
    hits: Array
    codes: Array
    first: IntArray
    normals: FloatArray
    face_surface: IntArray
    curved: BoolArray
    counts: Array
    scattering: FloatArray
    late_m: float
    max_length_m: float
    n_leaked: int
    seed: np.uint64

    @property
    def reflections(self) -> Reflections:
        """The stored reflections."""
        return Reflections(self.hits, self.codes, self.first, self.counts)


def sphere_directions(n_rays: int, rng: np.random.Generator) -> FloatArray:
    """Return evenly distributed unit vectors, a Fibonacci lattice in a random orientation, shape (n_rays, 3).

    Each represents the same solid angle (Swinbank and Purser, Q. J. R. Meteorol. Soc. 132 (2006) 1769). Their order is
    random, so that any number of them from the start is a fair sample.
    """
    rotation, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    return rng.permutation(_lattice(n_rays) @ rotation)


@lru_cache(maxsize=4)
def _lattice(n_points: int) -> FloatArray:
    index = np.arange(n_points) + 0.5
    z = 1.0 - 2.0 * index / n_points
    angle = 2.0 * np.pi * index / GOLDEN_RATIO
    radius = np.sqrt(1.0 - z ** 2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)


def trace(room: Room, source_pos_m: ArrayLike, scattering: ArrayLike, *, num_rays: int, max_length_m: float,
          speed_m_s: float, rng: np.random.Generator, absorption: ArrayLike | None = 0.0,
          like: Paths | None = None) -> Paths:
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
    absorption
        That is expected of each surface, shape (n_surfaces,) or one for all. With None, rays don't play roulette.
    like
        Of the same rays with the same random numbers, but other scattering and absorption. Until their paths part, rays
        need not search what they hit. The result does not depend on it.
    """
    source_pos_m = np.asarray(source_pos_m, dtype=np.float64)
    scattering = np.asarray(scattering, dtype=np.float64)
    directions = sphere_directions(num_rays, rng)
    seed = np.uint64(rng.integers(2 ** 63))
    late_m = late_after_s(room.volume_m3, speed_m_s) * speed_m_s
    faces = room.walls or cast("MeshRoom", room)
    roulette = roulette_for(room, 0.0 if absorption is None else absorption, num_rays, faces.face_surface,
                            np.inf if absorption is None else late_m)
    how = source_pos_m, directions, scattering[faces.face_surface], max_length_m, roulette, seed
    known = like.reflections if like is not None else Reflections(
        np.empty((0, 4), np.float32), np.empty(0, _code_type(len(faces.normals))), np.zeros(num_rays, np.int64),
        np.zeros(num_rays, np.int32))
    mean_free_path_m = 4.0 * room.volume_m3 / float(room.surface_area_m2.sum())
    (hits, codes, first, counts), n_leaked = _trace_rays(room, mean_free_path_m, known, *how)
    return Paths(source_pos_m, directions, hits, codes, first, faces.normals, faces.face_surface, faces.curved, counts,
                 scattering, late_m, max_length_m, n_leaked, seed)


def play_roulette(paths: Paths, room: Room, absorption: ArrayLike, max_length_m: float) -> Paths:
    """Let rays that were traced without roulette play it.

    Parameters
    ----------
    paths
        Traced with the absorption None.
    room
    absorption
        That is expected of each surface, shape (n_surfaces,).
    max_length_m
        Length of path up to which rays are followed, at most that of `paths`.

    Returns
    -------
    Paths
        Those of `trace` with this absorption and length, among the reflections of `paths`.
    """
    if max_length_m > paths.max_length_m:
        raise ValueError(f"max_length_m={max_length_m} must be at most that of the paths, {paths.max_length_m}: trace "
                         "them further")
    roulette = roulette_for(room, absorption, len(paths.counts), paths.face_surface, paths.late_m)
    codes, counts = np.zeros_like(paths.codes), np.empty_like(paths.counts)
    n_leaked = for_chunks(len(counts), lambda chunk, low, high: _end_rays(
        paths.hits, paths.codes, paths.first, paths.counts, roulette, paths.seed, max_length_m, low, high, codes,
        counts))
    return replace(paths, codes=codes, counts=counts, max_length_m=max_length_m, n_leaked=sum(n_leaked))


def bytes_per_reflection(room: Room) -> int:
    """Return the memory of a reflection that was traced without roulette, with its code after roulette."""
    faces = room.walls or cast("MeshRoom", room)
    return 16 + 2 * np.dtype(_code_type(len(faces.normals))).itemsize


def late_after_s(volume_m3: float, speed_m_s: float) -> float:
    """Return when reflections become so dense that single ones no longer matter, at any sample rate [s]."""
    return dense_after_s(volume_m3, speed_m_s, _LATE_RATE_HZ)


def dense_after_s(volume_m3: float, speed_m_s: float, rate_hz: float) -> float:
    """Return when reflections, which arrive at ``4 pi c^3 t^2 / V`` (Kuttruff, eq. 4.6), reach a rate [s]."""
    return float(np.sqrt(rate_hz * volume_m3 / (4.0 * np.pi * speed_m_s ** 3)))


def _code_type(n_faces: int) -> type[np.uint8] | type[np.uint32]:
    return np.uint8 if n_faces < 64 else np.uint32


def _trace_rays(room: Room, mean_free_path_m: float, known: Reflections, source: FloatArray, directions: FloatArray,
                scattering: FloatArray, end_m: float, roulette: Roulette, seed: np.uint64
                ) -> tuple[Reflections, int]:
    walls, n_rays = room.walls, len(directions)
    code_type = _code_type(len(scattering))
    counts = np.empty(n_rays, dtype=np.int32)

    def trace_chunk(chunk: int, low: int, high: int) -> tuple[Array, Array, int]:
        # more than a specular ray can meet in a box; elsewhere, if more are met, there is another attempt
        box = None if walls is None else walls.box
        per_m = 1.0 / mean_free_path_m if box is None else np.sqrt(np.sum(1.0 / (box[1] - box[0]) ** 2))
        capacity = int(1.2 * end_m * per_m) + 40
        while True:
            hits = np.empty(((high - low) * capacity, 4), np.float32)
            codes = np.empty(len(hits), code_type)
            how = source, directions, scattering, end_m, roulette, seed, low, high
            if walls is None:
                mesh = cast("MeshRoom", room)
                n_stored, n_leaked = _trace_faces(mesh.tree, mesh.normals, mesh.offsets, known, *how, hits, codes,
                                                  counts)
            elif box is not None:
                low_m, high_m, wall_of_side = box
                n_stored, n_leaked = trace_box(low_m, high_m, wall_of_side, *how, capacity, hits, codes, counts), 0
            else:
                n_stored, n_leaked = _trace_planes(walls.normals, walls.offsets, *how, hits, codes, counts)
            if n_stored >= 0:  # the rest is memory for the next chunk, and fast
                return hits[:n_stored].copy(), codes[:n_stored].copy(), n_leaked
            capacity *= 2

    hits, codes, leaked = zip(*for_chunks(n_rays, trace_chunk), strict=True)
    return Reflections(np.concatenate(hits), np.concatenate(codes), _first_of_rays(counts), counts), sum(leaked)


def _first_of_rays(counts: Array) -> IntArray:
    return np.concatenate([[0], np.cumsum(counts[:-1], dtype=np.int64)])


@compiled
def reflect(normals: Array, face: Number, scattering: Number, stream: Number, n: Number, way: Array) -> bool:
    """Turn `way` at reflection `n` of a ray, specularly or diffusely; return whether diffusely.

    A diffuse direction is the normal plus a point on the unit sphere, which is Lambert's cosine distribution.
    """
    nx, ny, nz = normals[face, 0], normals[face, 1], normals[face, 2]
    if uniform(stream, 4 * n) >= scattering:
        twice = 2.0 * (way[0] * nx + way[1] * ny + way[2] * nz)
        way[0], way[1], way[2] = way[0] - twice * nx, way[1] - twice * ny, way[2] - twice * nz
        return False
    rise = 1.0 - 2.0 * uniform(stream, 4 * n + 1)
    radius = np.sqrt(max(0.0, 1.0 - rise * rise))
    angle = 2.0 * np.pi * uniform(stream, 4 * n + 2)
    x, y, z = nx + radius * np.cos(angle), ny + radius * np.sin(angle), nz + rise
    scale = 1.0 / np.sqrt(max(x * x + y * y + z * z, 1e-20))
    way[0], way[1], way[2] = x * scale, y * scale, z * scale
    return True


@inlined
def _store(hits: Array, codes: Array, stored: Number, position: Numbers, length: Number, face: Number, diffuse: Number,
           end_m: Number, roulette: Roulette, ray: Number, stream: Number, n: Number, log_energy: Number,
           plays: Number) -> Numbers:
    """Store reflection `n` of a ray, and let it play Russian roulette.

    Returns
    -------
    ends : bool
    log_energy, plays
        As of `roomeq.sim.roulette.play_at`.
    """
    hit = hits[stored]
    hit[0], hit[1], hit[2], hit[3] = position[0], position[1], position[2], length
    represents_two, ends, log_energy, plays = play_at(
        roulette, ray, stream, n, np.float64(hit[3]), log_energy + roulette.log_reflected[face], plays)
    codes[stored] = 4 * face + 2 * represents_two + diffuse
    return ends or hit[3] > end_m, log_energy, plays


@compiled
def _end_rays(hits: Array, codes: Array, first: Array, counts: Array, roulette: Roulette, seed: Number, end_m: Number,
              low: Number, high: Number, new_codes: Array, new_counts: Array) -> int:
    """Let rays `low` to `high` play roulette along their stored reflections; return how many have leaked."""
    n_leaked = 0
    for ray in range(low, high):
        stream = mix(seed + np.uint64(ray))
        log_energy, plays, at, end, ends = 0.0, 0, first[ray], first[ray] + counts[ray], False
        while at < end and not ends:
            length = np.float64(hits[at, 3])
            represents_two, ends, log_energy, plays = play_at(
                roulette, ray, stream, at - first[ray], length, log_energy + roulette.log_reflected[codes[at] >> 2],
                plays)
            new_codes[at] = codes[at] + 2 * represents_two
            ends = ends or length > end_m
            at += 1
        new_counts[ray] = at - first[ray]
        n_leaked += not ends
    return n_leaked


@inlined
def _nearest(reach: Array) -> int:
    nearest = 0
    for face in range(1, len(reach)):
        if reach[face] < reach[nearest]:
            nearest = face
    return nearest


@compiled
def _trace_planes(normals: Array, offsets: Array, source: Array, directions: Array, scattering: Array, end_m: Number,
                  roulette: Roulette, seed: Number, low: Number, high: Number, hits: Array, codes: Array,
                  counts: Array) -> Numbers:
    """Trace rays `low` to `high` between the walls of a convex room (see `roomeq.sim.walls.Walls`).

    Returns
    -------
    n_stored, n_leaked : int
        -1 if `hits` has too little room.
    """
    n_faces, stored, n_leaked = len(normals), 0, 0
    normal_x, normal_y, normal_z = normals[:, 0].copy(), normals[:, 1].copy(), normals[:, 2].copy()
    height, approach, reach, way = np.empty(n_faces), np.empty(n_faces), np.empty(n_faces), np.empty(3)
    for ray in range(low, high):
        stream = mix(seed + np.uint64(ray))
        x, y, z = source[0], source[1], source[2]
        way[0], way[1], way[2] = directions[ray, 0], directions[ray, 1], directions[ray, 2]
        for face in range(n_faces):
            height[face] = normal_x[face] * x + normal_y[face] * y + normal_z[face] * z - offsets[face]
        length, log_energy, plays, n, ends = 0.0, 0.0, 0, 0, False
        while not ends:
            if stored == len(hits):
                return -1, 0
            u, v, w = way[0], way[1], way[2]
            for face in range(n_faces):
                approach[face] = -(normal_x[face] * u + normal_y[face] * v + normal_z[face] * w)
            for face in range(n_faces):
                in_front = approach[face] > FRONTS and height[face] > -BEHIND_M
                reach[face] = height[face] / approach[face] if in_front else np.inf
            ahead = _nearest(reach)
            if reach[ahead] == np.inf:  # along a wall to within rounding
                n_leaked += 1
                break
            distance = max(reach[ahead], 0.0)
            x, y, z, length = x + distance * u, y + distance * v, z + distance * w, length + distance
            for face in range(n_faces):
                height[face] -= distance * approach[face]
            height[ahead] = 0.0
            diffuse = reflect(normals, ahead, scattering[ahead], stream, n, way)
            ends, log_energy, plays = _store(hits, codes, stored, (x, y, z), length, ahead, diffuse, end_m,
                                             roulette, ray, stream, n, log_energy, plays)
            stored += 1
            n += 1
        counts[ray] = n
    return stored, n_leaked


@compiled
def _trace_faces(tree: Tree, normals: Array, offsets: Array, known: Reflections, source: Array, directions: Array,
                 scattering: Array, end_m: Number, roulette: Roulette, seed: Number, low: Number, high: Number,
                 hits: Array, codes: Array, counts: Array) -> Numbers:
    """Trace rays `low` to `high` between many faces, as `_trace_planes` does between few."""
    stored, n_leaked, search = 0, 0, memory(tree)
    way = np.empty(3)
    for ray in range(low, high):
        stream = mix(seed + np.uint64(ray))
        x, y, z = source[0], source[1], source[2]
        way[0], way[1], way[2] = directions[ray, 0], directions[ray, 1], directions[ray, 2]
        length, log_energy, plays, n, ends = 0.0, 0.0, 0, 0, False
        n_known = known.counts[ray]
        while not ends:
            if stored == len(hits):
                return -1, 0
            u, v, w = way[0], way[1], way[2]
            if n < n_known:
                face = np.int64(known.codes[known.first[ray] + n] >> 2)
                nx, ny, nz = normals[face, 0], normals[face, 1], normals[face, 2]
                distance = max((nx * x + ny * y + nz * z - offsets[face]) / -(nx * u + ny * v + nz * w), 0.0)
            else:
                face, distance = first_hit(tree, search, (x, y, z), (u, v, w), FRONTS)
            if face < 0:  # between two faces to within rounding
                n_leaked += 1
                break
            x, y, z, length = x + distance * u, y + distance * v, z + distance * w, length + distance
            diffuse = reflect(normals, face, scattering[face], stream, n, way)
            if n < n_known and diffuse != (known.codes[known.first[ray] + n] & 1 == 1):
                n_known = 0  # here the ways part
            ends, log_energy, plays = _store(hits, codes, stored, (x, y, z), length, face, diffuse, end_m,
                                             roulette, ray, stream, n, log_energy, plays)
            stored += 1
            n += 1
        counts[ray] = n
    return stored, n_leaked
