"""Contributions of traced rays to microphones: when each arrives, after which reflections, and how much it is.

What a reflection sends by the rules of `roomeq.sim.paths` depends on its ray alone, and is found once for a source
(`walk_rays`). For each microphone only distances are needed (`add_contributions`).
"""

from typing import NamedTuple

import numpy as np

from roomeq.core.arrays import Array, BoolArray, FloatArray, IntArray, Number, Numbers
from roomeq.core.jit import compiled, inlined
from roomeq.sim.paths import BEHIND, SEEN, Rules, at_source, follow, segment_counts
from roomeq.sim.trace import Paths, Reflections

_ZERO, _ONE = np.float32(0.0), np.float32(1.0)
_INVERSE_PI = np.float32(1.0 / np.pi)


class Walk(NamedTuple):
    """What the stored reflections of the rays of one source send, whatever the microphone.

    Attributes
    ----------
    length_m : ndarray of float32, shape (n_stored,)
        Of the segment that leads to each reflection.
    crossing : ndarray of float32, shape (n_stored,)
        Energy of the ray on that segment; 0 where the segment does not count.
    scattered : ndarray of float32, shape (n_stored,)
        Energy that the reflection sends to each microphone in front of it, per square metre at 1 m along the normal.
    low : ndarray of uint8, shape (n_stored,)
        Share of floor and ceiling among the reflections up to this one, and with it: the point of a grid below it.
    high : ndarray of float32, shape (n_stored,)
        And its place from there to the next point, in [0, 1].
    offset_m : ndarray of float32, shape (n_faces,)
        Distance of the plane of each face from the origin, along its normal.
    """

    length_m: Array
    crossing: Array
    scattered: Array
    low: Array
    high: Array
    offset_m: Array


class Receiver(NamedTuple):
    """A microphone, the sphere around it, and the time axis of its table.

    Attributes
    ----------
    position_m : ndarray of float32, shape (3,)
    facing_m : ndarray of float32, shape (n_faces,)
        Its position along the normal of each face.
    visible : ndarray of uint8, shape (n_stored,)
        Which reflections it sees, by `roomeq.sim.paths.reflection_visibility`; empty if it sees all.
    radius_m, per_volume : float32
        Of the sphere [m, 1/m3].
    distance_m : float32
        From the source; contributions are counted from the direct sound on.
    ticks_per_m : float32
    place_of_tick : ndarray of int32, shape (n_ticks,)
        Number of the frame times that of the numbers of reflections: where its row begins in a table of both.
    """

    position_m: Array
    facing_m: Array
    visible: Array
    radius_m: Number
    per_volume: Number
    distance_m: Number
    ticks_per_m: Number
    place_of_tick: Array


def walk_rays(paths: Paths, level: BoolArray, n_shares: int) -> Walk:
    """Walk along all rays of a source by the rules of `roomeq.sim.paths`.

    `level` tells which faces are floor or ceiling, shape (n_faces,), and there are `n_shares` points in the grid of
    their share. All surfaces scatter alike.
    """
    length_m, crossing, scattered, high = (np.zeros(len(paths.codes), np.float32) for _ in range(4))
    walk = Walk(length_m, crossing, scattered, np.zeros(len(paths.codes), np.uint8), high,
                np.zeros(len(paths.normals), np.float32))
    _walk(Rules(-1, paths.late_m), paths.hits, paths.codes, paths.first, paths.counts,
          paths.source_pos_m.astype(np.float32), paths.normals, paths.curved, level, n_shares,
          np.float32(paths.scattering[0]), walk)
    return walk


@compiled
def _walk(rules: Rules, hits: Array, codes: Array, first: IntArray, n_hits: IntArray, source_m: Array,
          normals: FloatArray, curved: BoolArray, level: BoolArray, n_shares: int, scattering: Number, walk: Walk
          ) -> None:
    """Fill the arrays of a walk."""
    length_m, crossing, scattered, low, high, offset_m = walk  # counting references takes time in the loop
    n_steps = n_shares - 1
    for ray in range(len(first)):
        weight, met, step = _ONE, 0, at_source()
        x, y, z = source_m[0], source_m[1], source_m[2]
        for n in range(n_hits[ray]):
            at = first[ray] + n
            length_m[at] = _segment_length((x, y, z), hits[at])
            x, y, z = hits[at, 0], hits[at, 1], hits[at, 2]
            if segment_counts(step, rules, n):
                crossing[at] = weight
            if n + 1 == n_hits[ray]:
                break  # nothing is reflected there
            face = codes[at] >> 2
            offset_m[face] = x * normals[face, 0] + y * normals[face, 1] + z * normals[face, 2]
            step = follow(step, rules, codes[at], hits[at, 3], scattering, curved[face])
            if step.represents_two:
                weight += weight
            met += 1 if level[face] else 0
            node = n_steps * met / (n + 1)
            low[at] = min(int(node), n_steps - 1)
            high[at], scattered[at] = node - low[at], weight * step.scattered * _INVERSE_PI


@compiled
def add_contributions(rays: Reflections, walk: Walk, receiver: Receiver, counts: FloatArray
                      ) -> tuple[Array, Array, IntArray]:
    """Add the contributions of all rays to `counts`, and list them.

    Parameters
    ----------
    rays : roomeq.sim.trace.Reflections
    walk : Walk
    receiver : Receiver
    counts : ndarray, shape (n_frames, n_reflections, n_shares)
        Energy per frame, number of reflections, and share of floor and ceiling among these; in place.

    Returns
    -------
    place : ndarray of int32, shape (n_contributions,)
        In the first two axes of `counts`, ray by ray.
    amount : ndarray of float32, shape (n_contributions,)
    end : ndarray of int, shape (n_rays,)
        After the last contribution of each ray.
    """
    hits, codes, first, n_hits = rays
    mic, visible, distance_m = receiver.position_m, receiver.visible, receiver.distance_m
    ticks_per_m, place_of_tick, n_ticks = receiver.ticks_per_m, receiver.place_of_tick, len(receiver.place_of_tick)
    radius2, per_volume = receiver.radius_m * receiver.radius_m, receiver.per_volume
    flat, all_visible, most, found = counts.reshape(-1, counts.shape[2]), len(visible) == 0, n_hits.max(), 0
    square_m2, sent, to_mic_m = np.empty(most + 1, np.float32), np.empty(most, np.float32), np.empty(most, np.float32)
    inside_m, to_middle_m = np.empty(most, np.float32), np.empty(most, np.float32)
    place, amount = np.empty(2 * len(hits), np.int32), np.empty(2 * len(hits), np.float32)
    end = np.empty(len(first), np.int64)
    square_m2[0] = distance_m * distance_m
    for ray in range(len(first)):
        stored = slice(first[ray], first[ray] + n_hits[ray])
        hit, crossing, low, high = hits[stored], walk.crossing[stored], walk.low[stored], walk.high[stored]
        sight = visible[stored]
        _squared_distances(hit, (mic[0], mic[1], mic[2]), square_m2)
        _next_events(hit, codes[stored], walk.scattered[stored], receiver.facing_m, walk.offset_m, square_m2, sent,
                     to_mic_m)
        _chords(hit, walk.length_m[stored], square_m2, radius2, inside_m, to_middle_m)
        for n in range(len(hit)):
            left, tick = crossing[n] * per_volume * inside_m[n], int((to_middle_m[n] - distance_m) * ticks_per_m)
            if left > _ZERO and tick < n_ticks and (all_visible or sight[n] & BEHIND == 0):
                place[found], amount[found] = place_of_tick[max(tick, 0)] + n, left
                _put(flat[place[found]], low[n - 1], high[n - 1], left)
                found += 1
        for n in range(len(hit)):
            tick = int((to_mic_m[n] - distance_m) * ticks_per_m)
            if sent[n] > _ZERO and tick < n_ticks and (all_visible or sight[n] & SEEN):
                place[found], amount[found] = place_of_tick[max(tick, 0)] + n + 1, sent[n]
                _put(flat[place[found]], low[n], high[n], sent[n])
                found += 1
        end[ray] = found
    return place[:found], amount[:found], end


@inlined
def _squared_distances(hits: Array, mic: Numbers, square_m2: Array) -> None:
    """Compute the squared distance of each reflection of a ray from a microphone, in a loop that is vectorised.

    Parameters
    ----------
    hits : ndarray of float32, shape (n_hits, 4)
        As `roomeq.sim.trace.Paths.hits`.
    mic : tuple of 3 float32
    square_m2 : ndarray of float32, shape (n_hits + 1,)
        Receives them from its second place on. The first is that of the source.
    """
    x, y, z = mic
    for n in range(len(hits)):
        u, v, w = x - hits[n, 0], y - hits[n, 1], z - hits[n, 2]
        square_m2[n + 1] = u * u + v * v + w * w


@inlined
def _next_events(hits: Array, codes: Array, scattered: Array, facing: Array, offset: Array, square_m2: Array,
                 sent: Array, path_m: Array) -> None:
    """Compute what each reflection of a ray sends to a microphone by next-event estimation.

    Parameters
    ----------
    hits : ndarray of float32, shape (n_hits, 4)
    codes : ndarray of int, shape (n_hits,)
        As `roomeq.sim.trace.Paths.codes`.
    scattered : ndarray of float32, shape (n_hits,)
        Of a `Walk`.
    facing, offset : ndarray of float32, shape (n_faces,)
        Position of the microphone along the normal of each face, and that of the face itself [m].
    square_m2 : ndarray of float32, shape (n_hits + 1,)
        From `_squared_distances`.
    sent : ndarray of float32, shape (n_hits,)
        Receives what is sent [1/m2]; negative behind the surface.
    path_m : ndarray of float32, shape (n_hits,)
        Receives the length of the path to the microphone.
    """
    for n in range(len(hits)):
        distance_m, face = np.sqrt(square_m2[n + 1]), codes[n] >> 2
        sent[n] = scattered[n] * (facing[face] - offset[face]) / (square_m2[n + 1] * distance_m)
        path_m[n] = hits[n, 3] + distance_m


@inlined
def _chords(hits: Array, length_m: Array, square_m2: Array, radius2: Number, inside_m: Array, path_m: Array) -> None:
    """Compute how long each segment of a ray is inside the sphere around a microphone.

    The line's distance from the microphone follows from those of the segment's ends by the law of cosines.

    Parameters
    ----------
    hits : ndarray of float32, shape (n_hits, 4)
    length_m : ndarray of float32, shape (n_hits,)
        Of the segment that leads to each reflection, above 0.
    square_m2 : ndarray of float32, shape (n_hits + 1,)
        From `_squared_distances`.
    radius2 : float32
        Squared radius of the sphere [m2].
    inside_m : ndarray of float32, shape (n_hits,)
        Receives the length inside, at most 0 where the segment misses the sphere.
    path_m : ndarray of float32, shape (n_hits,)
        Receives the length of the path to the middle of that part.
    """
    zero, half = np.float32(0.0), np.float32(0.5)
    for n in range(len(hits)):
        along = half * (length_m[n] + (square_m2[n] - square_m2[n + 1]) / length_m[n])
        square = radius2 - square_m2[n] + along * along
        reach = np.sqrt(square if square > zero else zero)
        enter, leave = along - reach, along + reach
        enter, leave = enter if enter > zero else zero, leave if leave < length_m[n] else length_m[n]
        inside_m[n], path_m[n] = leave - enter, hits[n, 3] - length_m[n] + half * (enter + leave)


@inlined
def _segment_length(start: Numbers, hit: Array) -> Number:
    """Return the length of a segment between two places, x, y, z each; so that it can be divided by, at least 1 um."""
    u, v, w = hit[0] - start[0], hit[1] - start[1], hit[2] - start[2]
    return max(np.sqrt(u * u + v * v + w * w), np.float32(1e-6))


@inlined
def _put(shares: FloatArray, low: int, high: Number, weight: Number) -> None:
    """Distribute a weight over a point of a grid and the next one."""
    shares[low] += weight * (_ONE - high)
    shares[low + 1] += weight * high


@compiled
def by_direction(place: Array, amount: Array, end: IntArray, cell: IntArray, n_cells: int, filled: IntArray, size: int
                 ) -> Array:
    """Return which share of each entry departed in each cell of directions.

    Parameters
    ----------
    place, amount, end
        From `add_contributions`.
    cell : ndarray of int, shape (n_rays,)
        Of the direction in which each ray departs.
    n_cells : int
    filled : ndarray of int, shape (n_entries,)
        Places of the entries, of `size` in all.
    size : int

    Returns
    -------
    ndarray of uint16, shape (n_entries, n_cells)
        In units of 1 / 65535.
    """
    entry_at, departed, first = np.zeros(size, np.int64), np.zeros((len(filled), n_cells), np.float32), 0
    for entry in range(len(filled)):
        entry_at[filled[entry]] = entry
    for ray in range(len(end)):
        for n in range(first, end[ray]):
            departed[entry_at[place[n]], cell[ray]] += amount[n]
        first = end[ray]
    shares = np.empty(departed.shape, np.uint16)
    for entry in range(len(filled)):
        total = _ZERO
        for direction in range(n_cells):
            total += departed[entry, direction]
        scale = np.float32(65535.0) / total if total > _ZERO else _ZERO
        for direction in range(n_cells):
            shares[entry, direction] = np.uint16(departed[entry, direction] * scale + np.float32(0.5))
    return shares


@compiled
def nearest_directions(directions: FloatArray, cells: Array) -> IntArray:
    """Return the number of the nearest of some directions, shape (n_cells, 3), to each of others, shape (n, 3).

    All are unit vectors. Directions are compared in blocks, whose innermost loop is vectorised.
    """
    nearest, n_block = np.empty(len(directions), np.int64), 64
    x, y, z = np.zeros(n_block, np.float32), np.zeros(n_block, np.float32), np.zeros(n_block, np.float32)
    best = np.empty(n_block, np.float32)
    found = np.empty(n_block, np.int32)
    for first in range(0, len(directions), n_block):
        count = min(n_block, len(directions) - first)
        for n in range(count):
            x[n], y[n], z[n] = directions[first + n, 0], directions[first + n, 1], directions[first + n, 2]
            best[n], found[n] = np.float32(-2.0), 0
        for cell in range(len(cells)):
            u, v, w = cells[cell, 0], cells[cell, 1], cells[cell, 2]
            for n in range(n_block):
                cosine = x[n] * u + y[n] * v + z[n] * w
                found[n] = cell if cosine > best[n] else found[n]
                best[n] = cosine if cosine > best[n] else best[n]
        for n in range(count):
            nearest[first + n] = found[n]
    return nearest
