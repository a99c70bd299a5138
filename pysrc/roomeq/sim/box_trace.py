"""Rays in a box along the axes, traced side by side.

Each reflection of a ray waits for the one before. So many rays are traced together, reflection by reflection, and the
processor works on several at once, most of the time with vector instructions. Rays that have ended leave the arrays.
"""

from typing import NamedTuple

import numpy as np

from roomeq.core.arrays import Array, Number, Numbers
from roomeq.core.jit import compiled, inlined, mix, uniform
from roomeq.sim.roulette import Roulette, play_at, plays_at

_SIDE_BY_SIDE = 128  # rays that are traced at a time in a box


class _Rays(NamedTuple):
    """Rays in a box that are traced side by side; those that have not ended come first in each array.

    Attributes
    ----------
    state, numbers
        What a ray takes to its next reflection: `x` to `log_energy`, shape (14, n), and `ray` to `plays`, shape (3, n).
    x, y, z, u, v, w
        Position [m] and direction.
    to_x, to_y, to_z
        Distance along the ray to the wall ahead along each axis [m].
    per_x, per_y, per_z
        Length of the ray for each metre along each axis.
    length, log_energy, plays
        See `roomeq.sim.roulette.play_at`.
    ray, stream
        Number of the ray, and its stream of random numbers.
    side
        That the ray has met: 0 and 1 for the low and high wall along x, 2 and 3 along y, 4 and 5 along z.
    code
        See `roomeq.sim.trace.Paths`, before roulette.
    may_end
        1 where the ray plays roulette or is long enough to end, else 0.
    """

    state: Array
    numbers: Array
    x: Array
    y: Array
    z: Array
    u: Array
    v: Array
    w: Array
    to_x: Array
    to_y: Array
    to_z: Array
    per_x: Array
    per_y: Array
    per_z: Array
    length: Array
    log_energy: Array
    ray: Array
    stream: Array
    plays: Array
    side: Array
    code: Array
    may_end: Array


class _Turns(NamedTuple):
    """Which rays continue diffusely, and what they continue with; see `_Rays`."""

    which: Array
    stream: Array
    u: Array
    v: Array
    w: Array
    radius: Array
    angle: Array
    per_x: Array
    per_y: Array
    per_z: Array


@inlined
def _per_m(way: Number) -> Number:
    """Return the length of a ray for each metre along one axis."""
    return 1.0 / max(abs(way), 1e-30)


@inlined
def _to_wall(position: Number, way: Number, per_m: Number, walls: Numbers) -> Number:
    """Return the distance along a ray to the wall ahead along one axis [m]."""
    return (walls[1] - position if way > 0.0 else position - walls[0]) * per_m


@inlined
def _start_in_box(rays: _Rays, i: Number, ray: Number, source: Array, directions: Array, seed: Number,
                  box: Numbers) -> None:
    """Let ray number `ray` leave the source as the ray at `i`."""
    rays.x[i], rays.y[i], rays.z[i] = x, y, z = source[0], source[1], source[2]
    rays.u[i], rays.v[i], rays.w[i] = u, v, w = directions[ray, 0], directions[ray, 1], directions[ray, 2]
    rays.per_x[i], rays.per_y[i], rays.per_z[i] = per_x, per_y, per_z = _per_m(u), _per_m(v), _per_m(w)
    rays.to_x[i], rays.to_y[i] = _to_wall(x, u, per_x, box[0]), _to_wall(y, v, per_y, box[1])
    rays.to_z[i] = _to_wall(z, w, per_z, box[2])
    rays.length[i], rays.log_energy[i], rays.plays[i] = 0.0, 0.0, 0
    rays.ray[i], rays.stream[i] = ray, mix(seed + np.uint64(ray))


@inlined
def _of_side(before_y: Number, along_z: Number, up: Numbers, of_sides: Numbers) -> Number:
    """Return what belongs to the side that a ray meets, of what belongs to the low and high side of each axis."""
    (low_x, high_x), (low_y, high_y), (low_z, high_z) = of_sides
    of_x, of_y, of_z = high_x if up[0] else low_x, high_y if up[1] else low_y, high_z if up[2] else low_z
    of_nearer = of_x if before_y else of_y
    return of_z if along_z else of_nearer


@inlined
def _reflect_in_box(rays: _Rays, n_rays: Number, n: Number, box: Numbers, faces: Numbers, scattering: Numbers,
                    log_reflected: Numbers, end_m: Number, roulette: Roulette) -> None:
    """Take rays to the wall ahead, their reflection `n`, and turn them specularly.

    The loop has no branches and no look-ups, so that it is compiled to vector instructions.
    """
    (x0, x1), (y0, y1), (z0, z1) = box
    for i in range(n_rays):
        x, y, z, u, v, w = rays.x[i], rays.y[i], rays.z[i], rays.u[i], rays.v[i], rays.w[i]
        to_x, to_y, to_z = rays.to_x[i], rays.to_y[i], rays.to_z[i]
        across_x, across_y, across_z = (x1 - x0) * rays.per_x[i], (y1 - y0) * rays.per_y[i], (z1 - z0) * rays.per_z[i]
        up_x, up_y, up_z = up = u > 0.0, v > 0.0, w > 0.0
        before_y = to_x < to_y
        nearer = to_x if before_y else to_y
        along_z = to_z < nearer
        along_x, along_y = before_y & (not along_z), (not before_y) & (not along_z)
        distance = max(to_z if along_z else nearer, 0.0)

        x, y, z, length = x + distance * u, y + distance * v, z + distance * w, rays.length[i] + distance
        wall_x, wall_y, wall_z = x1 if up_x else x0, y1 if up_y else y0, z1 if up_z else z0
        rays.x[i], rays.y[i], rays.z[i] = wall_x if along_x else x, wall_y if along_y else y, wall_z if along_z else z
        rays.u[i], rays.v[i], rays.w[i] = -u if along_x else u, -v if along_y else v, -w if along_z else w
        to_x, to_y, to_z = to_x - distance, to_y - distance, to_z - distance
        rays.to_x[i], rays.to_y[i] = across_x if along_x else to_x, across_y if along_y else to_y
        rays.to_z[i], rays.length[i] = across_z if along_z else to_z, length

        diffuse = uniform(rays.stream[i], 4 * n) < _of_side(before_y, along_z, up, scattering)
        rays.code[i] = 4 * _of_side(before_y, along_z, up, faces) + diffuse
        rays.side[i] = _of_side(before_y, along_z, up, ((0, 1), (2, 3), (4, 5)))
        log_energy = rays.log_energy[i] + _of_side(before_y, along_z, up, log_reflected)
        rays.log_energy[i] = log_energy
        stored_m = np.float64(np.float32(length))
        rays.may_end[i] = (stored_m > end_m) | plays_at(roulette, stored_m, log_energy)


@inlined
def _turn_diffusely(rays: _Rays, turns: _Turns, n_turns: Number, n: Number, box: Numbers) -> None:
    """Turn rays diffusely at their reflection `n`, as `roomeq.sim.trace.reflect` does.

    The loops are apart so that those without sines and look-ups are compiled to vector instructions.
    """
    for k in range(n_turns):
        rise = 1.0 - 2.0 * uniform(turns.stream[k], 4 * n + 1)
        turns.w[k], turns.radius[k] = rise, np.sqrt(max(0.0, 1.0 - rise * rise))
        turns.angle[k] = 2.0 * np.pi * uniform(turns.stream[k], 4 * n + 2)
    for k in range(n_turns):
        side, angle = rays.side[turns.which[k]], turns.angle[k]
        a, b, rise = turns.radius[k] * np.cos(angle), turns.radius[k] * np.sin(angle), turns.w[k]
        axis, sign = side >> 1, -1.0 if side & 1 else 1.0
        turns.u[k], turns.v[k] = sign + a if axis == 0 else a, sign + b if axis == 1 else b
        turns.w[k] = sign + rise if axis == 2 else rise
    for k in range(n_turns):
        u, v, w = turns.u[k], turns.v[k], turns.w[k]
        scale = 1.0 / np.sqrt(max(u * u + v * v + w * w, 1e-20))
        turns.u[k], turns.v[k], turns.w[k] = u, v, w = u * scale, v * scale, w * scale
        turns.per_x[k], turns.per_y[k], turns.per_z[k] = _per_m(u), _per_m(v), _per_m(w)
    for k in range(n_turns):
        i, u, v, w = turns.which[k], turns.u[k], turns.v[k], turns.w[k]
        per_x, per_y, per_z = turns.per_x[k], turns.per_y[k], turns.per_z[k]
        rays.u[i], rays.v[i], rays.w[i] = u, v, w
        rays.per_x[i], rays.per_y[i], rays.per_z[i] = per_x, per_y, per_z
        rays.to_x[i], rays.to_y[i] = _to_wall(rays.x[i], u, per_x, box[0]), _to_wall(rays.y[i], v, per_y, box[1])
        rays.to_z[i] = _to_wall(rays.z[i], w, per_z, box[2])


@inlined
def _close_gaps(hits: Array, codes: Array, counts: Array, stored: Number, low: Number, high: Number,
                capacity: Number) -> int:
    """Move the reflections of rays `low` to `high` together, each of which has `capacity` places from `stored` on.

    Returns
    -------
    stored : int
        The place after them.
    """
    start = stored
    for ray in range(low, high):
        for at in range(start, start + counts[ray]):
            x, y, z, length = hits[at, 0], hits[at, 1], hits[at, 2], hits[at, 3]
            hits[stored, 0], hits[stored, 1], hits[stored, 2], hits[stored, 3] = x, y, z, length
            codes[stored] = codes[at]
            stored += 1
        start += capacity
    return stored


@inlined
def _pairs(a: Array) -> Numbers:
    """Return an array of shape (3, 2) as numbers, which the compiler keeps in registers."""
    return (a[0, 0], a[0, 1]), (a[1, 0], a[1, 1]), (a[2, 0], a[2, 1])


@compiled
def trace_box(low_m: Array, high_m: Array, face_of_side: Array, source: Array, directions: Array, scattering: Array,
               end_m: Number, roulette: Roulette, seed: Number, low: Number, high: Number, capacity: Number,
               hits: Array, codes: Array, counts: Array) -> int:
    """Trace rays `low` to `high` of a source, each up to `capacity` reflections; return how many there are in all.

    Parameters
    ----------
    low_m, high_m : ndarray, shape (3,)
        Corners of the box.
    face_of_side : ndarray of int, shape (3, 2)
        Of the low and the high wall along each axis.
    source : ndarray, shape (3,)
    directions : ndarray, shape (n_rays, 3)
    scattering : ndarray, shape (n_faces,)
    end_m : float
        Rays end with the first reflection beyond this length of path.
    roulette : Roulette
    seed : uint64
    low, high, capacity : int
    hits, codes, counts
        Of `roomeq.sim.trace.Paths`. The first two receive the reflections ray by ray, and have `capacity` places for
        each ray.
    """
    box = (low_m[0], high_m[0]), (low_m[1], high_m[1]), (low_m[2], high_m[2])
    faces, of_sides = _pairs(face_of_side), face_of_side.ravel()
    scatterings = _pairs(scattering[of_sides].reshape(3, 2))
    log_reflected = _pairs(roulette.log_reflected[of_sides].reshape(3, 2))
    s, t = np.empty((14, _SIDE_BY_SIDE)), np.empty((8, _SIDE_BY_SIDE))
    m, c, d = (np.empty((3, _SIDE_BY_SIDE), np.int64), np.empty((3, _SIDE_BY_SIDE), np.int64),
               np.empty((3, _SIDE_BY_SIDE), np.int64))
    rays = _Rays(s, m, s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7], s[8], s[9], s[10], s[11], s[12], s[13],
                 m[0], m[1], m[2], c[0], c[1], c[2])
    turns, ending = _Turns(d[0], d[1], t[0], t[1], t[2], t[3], t[4], t[5], t[6], t[7]), d[2]
    stored = 0
    for first in range(low, high, _SIDE_BY_SIDE):
        last = min(first + _SIDE_BY_SIDE, high)
        n, n_rays = 0, last - first
        for i in range(n_rays):
            _start_in_box(rays, i, first + i, source, directions, seed, box)
        while n_rays > 0 and n < capacity:
            _reflect_in_box(rays, n_rays, n, box, faces, scatterings, log_reflected, end_m, roulette)
            n_turns, n_ending = 0, 0
            for i in range(n_rays):
                at = stored + (rays.ray[i] - first) * capacity + n
                hits[at, 0], hits[at, 1], hits[at, 2], hits[at, 3] = rays.x[i], rays.y[i], rays.z[i], rays.length[i]
                codes[at] = rays.code[i]
                turns.which[n_turns], turns.stream[n_turns], ending[n_ending] = i, rays.stream[i], i
                n_turns += rays.code[i] & 1
                n_ending += rays.may_end[i]
            _turn_diffusely(rays, turns, n_turns, n, box)
            for k in range(n_ending - 1, -1, -1):  # backwards, as the last ray takes the place of one that ends
                i = ending[k]
                ray = rays.ray[i]
                at = stored + (ray - first) * capacity + n
                represents_two, ends, rays.log_energy[i], rays.plays[i] = play_at(
                    roulette, ray, rays.stream[i], n, np.float64(hits[at, 3]), rays.log_energy[i], rays.plays[i])
                codes[at] += 2 * represents_two
                if ends or hits[at, 3] > end_m:
                    counts[ray] = n + 1
                    n_rays -= 1
                    for row in range(len(rays.state)):
                        rays.state[row, i] = rays.state[row, n_rays]
                    for row in range(len(rays.numbers)):
                        rays.numbers[row, i] = rays.numbers[row, n_rays]
            n += 1
        for i in range(n_rays):
            counts[rays.ray[i]] = n
        stored = _close_gaps(hits, codes, counts, stored, first, last, capacity)
    return stored
