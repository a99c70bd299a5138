"""The walk along a traced ray: which of its segments and reflections contribute to a receiver, and how much.

Every path counts once. There are two kinds of contribution:

- A path whose last reflection is diffuse counts at every reflection by its expected value (next-event estimation): a
  Lambert reflector of scattering s sends ``s (1 - alpha) cos(theta) / (pi d^2)`` to a receiver at distance d,
  whichever way the ray itself continues.
- A path whose last reflection is specular counts by the length of its last segment inside a sphere around the
  receiver that the receiver sees: energy density is ``power * length / volume``. Purely specular paths up to the
  image-source order are left to `roomeq.sim.images`, except those that a curved surface reflects.

Once reflections are denser than samples (`roomeq.sim.trace.dense_after_s`), rays play Russian roulette, and next-event
estimation uses only the reflections at which the ray did continue diffusely, weighted by 1 / s: the expected value is
the same, and there are enough of them.

These rules stand in `segment_counts` and `follow`. Three kernels walk along rays by them and accumulate what
contributes: echograms (`roomeq.sim.echogram`), path samples (`roomeq.sim.path_sample`) and the loop's tables
(`roomeq.loop.tables`). Each kernel owns its loop over rays, because numba caches a kernel by the file that it stands
in: a loop shared by all of them would be taken from the cache although the code that it calls back had changed.
"""

from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np

from roomeq.core.arrays import Array, BoolArray, FloatArray, Number, Numbers
from roomeq.core.jit import compiled, for_chunks, inlined
from roomeq.sim.room import Room
from roomeq.sim.trace import Paths
from roomeq.sim.tree import Tree, crosses, memory

if TYPE_CHECKING:
    from roomeq.sim.mesh import MeshRoom

SPHERE_RADII_M = (0.35, 1.0)  # of receivers: as large as the room lets the late field be uniform inside
SHADOW_RAY_OFFSET_M = 1e-4  # shadow rays start this far off the surface
SEEN, BEHIND = 1, 2
"""Bits of `reflection_visibility`: the microphone sees the reflection; a surface hides the segment that leads to it."""


class Rules(NamedTuple):
    """Which contributions count. An array here would cost kernels an atomic operation at each reflection.

    Attributes
    ----------
    ism_order
        Purely specular paths with at most this many reflections don't count; -1 counts all of them.
    late_m
        Path length [m] beyond which reflections are dense.
    """

    ism_order: int
    late_m: Number


class Step(NamedTuple):
    """State of the walk after a reflection.

    Attributes
    ----------
    represents_two
        Whether the ray counts twice as much from here on, because another one has ended.
    scattered
        Share of the reflected energy that contributes by next-event estimation.
    diffuse
        Whether the ray continues diffusely.
    purely_specular
        Whether all reflections so far are specular, and at flat surfaces.
    """

    represents_two: bool
    scattered: Number
    diffuse: bool
    purely_specular: bool


class Spheres(NamedTuple):
    """The receiver spheres around microphones: radius [m] and the volume inside the room [m3], shape (n_mics,) each."""

    radius_m: FloatArray
    volume_m3: FloatArray


def receiver_spheres(room: Room, mics_m: FloatArray) -> Spheres:
    """Return the receiver spheres around microphones, shape (n_mics, 3)."""
    wanted_m = float(np.clip(0.11 * room.volume_m3 ** (1.0 / 3.0), *SPHERE_RADII_M))
    radius_m = np.array([room.sphere_radius_m(mic_m, wanted_m) for mic_m in mics_m])
    volume_m3 = np.array([room.sphere_volume_m3(*sphere) for sphere in zip(mics_m, radius_m, strict=True)])
    return Spheres(radius_m, volume_m3)


def reflection_visibility(paths: Paths, room: Room, mics_m: Array, *, max_path_m: float) -> Array:
    """Tell which stored reflections microphones see, and which segments cross their spheres behind a surface.

    Parameters
    ----------
    paths
    room
    mics_m
        Shape (n_mics, 3).
    max_path_m
        Length of path beyond which reflections are not asked for.

    Returns
    -------
    ndarray of uint8, shape (n_mics, n_stored)
        `SEEN` and `BEHIND`. Of shape (0, 0) in a convex room, where everything is seen. Only reflections that
        contribute by `follow` to a microphone in front of the surface are tested; the others are not `SEEN`.
    """
    if room.convex:
        return np.zeros((0, 0), dtype=np.uint8)
    mics_m = np.atleast_2d(mics_m)
    visible = np.zeros((len(mics_m), len(paths.codes)), dtype=np.uint8)
    mesh = cast("MeshRoom", room)
    in_sight = mesh.faces_in_sight(mics_m)
    how = (mesh.tree, paths.hits, paths.codes, paths.normals, mics_m.astype(np.float64), in_sight, max_path_m,
           paths.late_m)
    for_chunks(len(paths.codes), lambda chunk, low, high: _see(*how, low, high, visible))
    for m, (mic_m, radius_m) in enumerate(zip(mics_m, receiver_spheres(room, mics_m).radius_m, strict=True)):
        if mesh.cuts_sphere(mic_m, radius_m):
            cut = mesh.tree, paths.hits, paths.first, paths.counts, mic_m.astype(np.float64), radius_m
            for_chunks(len(paths.counts), lambda chunk, low, high: _hide(*cut, low, high, visible[m]))  # noqa: B023
    return visible


@compiled
def _see(tree: Tree, hits: Array, codes: Array, normals: Array, mics_m: Array, in_sight: BoolArray, max_path_m: Number,
         late_m: Number, low: Number, high: Number, visible: Array) -> None:
    """Tell which microphones reflections `low` to `high` see; none lies behind the surface.

    No shadow ray is needed from faces that a microphone has `in_sight` as a whole, shape (n_mics, n_faces).
    """
    search = memory(tree)
    for at in range(low, high):
        if hits[at, 3] >= max_path_m or (hits[at, 3] > late_m and codes[at] & 1 == 0):
            continue
        face = codes[at] >> 2
        nx, ny, nz = normals[face, 0], normals[face, 1], normals[face, 2]
        x = hits[at, 0] + SHADOW_RAY_OFFSET_M * nx
        y = hits[at, 1] + SHADOW_RAY_OFFSET_M * ny
        z = hits[at, 2] + SHADOW_RAY_OFFSET_M * nz
        for m in range(len(mics_m)):
            u, v, w = mics_m[m, 0] - x, mics_m[m, 1] - y, mics_m[m, 2] - z
            if u * nx + v * ny + w * nz > -SHADOW_RAY_OFFSET_M:
                if in_sight[m, face] or not crosses(tree, search, (x, y, z), (u, v, w)):
                    visible[m, at] = SEEN


@compiled
def _hide(tree: Tree, hits: Array, first: Array, counts: Array, mic_m: Array, radius_m: Number, low: Number,
          high: Number, visible: Array) -> None:
    """Mark the segments of rays `low` to `high` that cross a sphere behind a surface, by the middle of their chord."""
    search = memory(tree)
    for ray in range(low, high):
        for at in range(first[ray] + 1, first[ray] + counts[ray]):
            px, py, pz = np.float64(hits[at - 1, 0]), np.float64(hits[at - 1, 1]), np.float64(hits[at - 1, 2])
            ux, uy, uz = hits[at, 0] - px, hits[at, 1] - py, hits[at, 2] - pz
            length = max(np.sqrt(ux * ux + uy * uy + uz * uz), 1e-9)
            ux, uy, uz = ux / length, uy / length, uz / length
            vx, vy, vz = mic_m[0] - px, mic_m[1] - py, mic_m[2] - pz
            along = ux * vx + uy * vy + uz * vz
            inside = radius_m * radius_m - (vx * vx + vy * vy + vz * vz - along * along)
            if inside > 0.0:
                enter, leave = chord(along, inside, length)
                middle = 0.5 * (enter + leave)
                x, y, z = px + middle * ux, py + middle * uy, pz + middle * uz
                if leave > enter and crosses(tree, search, (x, y, z), (mic_m[0] - x, mic_m[1] - y, mic_m[2] - z)):
                    visible[at] |= BEHIND


@inlined
def at_source() -> Step:
    """Return the state of the walk before the first reflection."""
    return Step(False, np.float32(0.0), True, True)


@inlined
def segment_counts(step: Step, rules: Rules, n: Number) -> bool:
    """Tell whether the segment that leads to reflection `n` (from 0) contributes to the spheres that it crosses."""
    return not step.diffuse and (n > rules.ism_order or not step.purely_specular)


@inlined
def follow(step: Step, rules: Rules, code: Number, path_m: Number, scattering: Number, curved: Number) -> Step:
    """Advance the walk by a reflection.

    Parameters
    ----------
    step : Step
        State before the reflection.
    rules : Rules
    code : int
        Stored code of the reflection, see `roomeq.sim.trace.Paths`.
    path_m : float
        Length of the path up to the reflection.
    scattering : float
        Scattering coefficient of the surface.
    curved : bool
        Whether the face is a facet of a curved surface, which has no image sources.
    """
    diffuse, late = (code & 1) == 1, path_m > rules.late_m
    scattered = np.float32(code & 1) if late else np.float32(scattering)
    return Step((code & 2) == 2, scattered, diffuse, step.purely_specular and not (diffuse or curved))


@inlined
def cross_spheres(start: Numbers, end: Numbers, mics: Array, radius2: Array, n_mics: Number, along: Array,
                  inside: Array) -> Number:
    """Intersect the line through a segment with the spheres around microphones.

    Parameters
    ----------
    start, end : tuple of 4 float32
        Ends of the segment: x, y, z, and the length of the path up to there [m].
    mics : ndarray of float32, shape (3, n)
    radius2 : ndarray of float32, shape (n,)
        Squared radii of the spheres [m2].
    n_mics : int
        Microphones to compute.
    along : ndarray of float32, shape (n,)
        Receives the place on the line that is nearest to each microphone, from the start of the segment [m].
    inside : ndarray of float32, shape (n,)
        Receives the square of half the chord [m2]; negative where the line misses the sphere.

    Returns
    -------
    float32
        Length of the segment [m].
    """
    px, py, pz, path = start
    hx, hy, hz, new_path = end
    length = new_path - path
    scale = np.float32(1.0) / max(length, np.float32(1e-9))
    ux, uy, uz = (hx - px) * scale, (hy - py) * scale, (hz - pz) * scale
    for m in range(n_mics):
        vx, vy, vz = mics[0, m] - px, mics[1, m] - py, mics[2, m] - pz
        along[m] = ux * vx + uy * vy + uz * vz
        inside[m] = radius2[m] - (vx * vx + vy * vy + vz * vz - along[m] * along[m])
    return length


@inlined
def chord(along: Number, inside: Number, length: Number) -> Numbers:
    """Return where a segment enters and leaves a sphere, from its start [m]; see `cross_spheres`."""
    half = np.sqrt(inside)
    return max(np.float32(0.0), along - half), min(length, along + half)


@inlined
def scatter(hit: Numbers, normals: Array, face: Number, scattered: Number, mics: Array, frames_per_m: Number,
            n_mics: Number, weight: Array, frame: Array) -> None:
    """Compute what a reflection contributes to microphones by next-event estimation.

    Parameters
    ----------
    hit : tuple of 4 float32
        Place of the reflection: x, y, z, and the length of the path up to there [m].
    normals : ndarray of float32, shape (n_faces, 3)
    face : int
    scattered : float32
        See `Step`.
    mics : ndarray of float32, shape (3, n)
    frames_per_m : float32
    n_mics : int
        Microphones to compute.
    weight : ndarray of float32, shape (n,)
        Receives the contribution per reflected energy [1/m2]; negative behind the surface.
    frame : ndarray of float32, shape (n,)
        Receives the time of arrival [frames].
    """
    hx, hy, hz, path = hit
    nx, ny, nz = normals[face, 0], normals[face, 1], normals[face, 2]
    for m in range(n_mics):
        vx, vy, vz = mics[0, m] - hx, mics[1, m] - hy, mics[2, m] - hz
        d2 = vx * vx + vy * vy + vz * vz
        d = np.sqrt(d2)
        weight[m] = scattered * (vx * nx + vy * ny + vz * nz) / (np.float32(np.pi) * d2 * d)
        frame[m] = (path + d) * frames_per_m
