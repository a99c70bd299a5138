"""Second-order diffraction: from the source to one edge of a face, along the face to another edge, to the microphone.

For a microphone behind a box, there may be no edge that both the source and the microphone see: sound arrives by
diffraction at two edges of the same face (Svensson, Fred and Vanderkooy, J. Acoust. Soc. Am. 106 (1999) 2331,
sec. III, with the factor 1/2 for edges that share a face). Each edge has the cylinder coordinates of
`roomeq.sim.diffraction`; m, l and n are the distances from the source to a point of the first edge, from there to a
point of the second edge, and from there to the microphone:

    h(t) = (nu_1 nu_2 / (2 (4 pi)^3)) integral of delta(t - (m + l + n) / c) beta_1 beta_2 / (m l n) dz_1 dz_2

``dz_1 dz_2 / (m l n)`` equals ``l / ((m + l) (l + n)) d eta_1 d eta_2``. The edges are divided into short steps. In
each step, beta is integrated exactly and the distances are those of the step's middle.

Near a shadow boundary, beta has a steep peak where the way over its edge is straight. Between edges that are close to
each other, the peaks of beta_1 and beta_2 lie along nearly the same line of (z_1, z_2), so that an integral over z_1 at
one z_2 times one over z_2 at one z_1 is not that of their product. There the second edge is divided more finely where
both peaks meet, and for each of its steps the first edge, more finely towards the peaks. The integral over z_1 of
beta_1 is exact in each step, and beta_2 is that of its middle.
"""

import logging
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from roomeq.core.arrays import Array, BoolArray, FloatArray, IntArray, Number, Numbers
from roomeq.core.jit import compiled, inlined

if TYPE_CHECKING:
    from roomeq.sim.diffraction import Edges
    from roomeq.sim.mesh import MeshRoom

logger = logging.getLogger(__name__)

MAX_PATHS = 15_000  # largest number of pairs of pieces
_STEP_SAMPLES = 1.0  # largest change of the arrival time within a step
_MIN_PRESSURE = 3e-4  # relative to the free-field direct sound; a weaker pair of pieces is integrated in one step
_MIN_RADIUS_M = 1e-6  # points closer to the line of an edge are skipped
_MIN_SEPARATION_M = 0.005  # closer edges are divided into steps as if they were this far apart
_FINENESS = 0.5  # length of the steps near a peak of beta, relative to its distance, or within it to its width
_SHORTEST = 1e-4  # length of the steps at a peak, relative to the longest ones
IN_PLANE_RAD = 1e-9
"""Angle from a face within which a point lies in its plane. The other edge of the face lights it then, in first order,
and second order is that of a point that is lit."""
_MIN_SINE = 5e-4  # of half the angle to a shadow boundary: closer to it, the peak is no higher and no narrower


class Pieces(NamedTuple):
    """Short pieces of edges; each array has n_pieces rows.

    Attributes
    ----------
    edge
        Index of the edge that the piece belongs to.
    low_m, high_m
        Positions of both ends along the edge.
    point_m
        A point in the air next to the middle, for visibility tests, shape (n_pieces, 3).
    clear
        Whether there is enough air before the piece for it to diffract.
    """

    edge: IntArray
    low_m: FloatArray
    high_m: FloatArray
    point_m: FloatArray
    clear: BoolArray


def find_double_paths(room: "MeshRoom", edges: "Edges", pieces: Pieces, source_pos_m: ArrayLike,
                      seen_by_source: BoolArray, mic_pos_m: ArrayLike, seen_by_mic: BoolArray) -> IntArray:
    """Find the paths that diffract at two edges of the same face.

    Of more than `MAX_PATHS`, those with the largest ``dz_1 dz_2 / (m l n)`` are found.

    Parameters
    ----------
    room
    edges
    pieces
        Pieces of all edges.
    source_pos_m, mic_pos_m
        Shape (3,).
    seen_by_source, seen_by_mic
        Whether the source and the microphone see each piece, shape (n_pieces,).

    Returns
    -------
    ndarray of int, shape (n_paths, 4)
        Index of the first piece, which the source sees, and of the second, which the microphone sees; then which face
        (0 or 1) of the first edge, and which of the second edge, is the common face.
    """
    point_m, length_m = pieces.point_m, pieces.high_m - pieces.low_m
    first, second = (_Ends(seen, _ranges(pieces.edge[seen], len(edges)),
                           length_m / np.linalg.norm(point_m - np.asarray(end_m), axis=1))
                     for seen, end_m in ((np.flatnonzero(seen_by_source), source_pos_m),
                                         (np.flatnonzero(seen_by_mic), mic_pos_m)))
    of_edges = _pairs_of_edges(first.of_edge, second.of_edge, edges.faces, *_sides_of_faces(edges.faces))
    weight = _weights(of_edges, first, second, point_m)
    limit, n_at_limit = 0.0, 0
    if len(weight) > MAX_PATHS:
        logger.debug("%d pairs of pieces of edges share a face: only the %d of the largest weight are computed",
                     len(weight), MAX_PATHS)
        limit = np.partition(weight, -MAX_PATHS)[-MAX_PATHS]
        n_at_limit = MAX_PATHS - int(np.count_nonzero(weight > limit))
    paths = _heaviest(of_edges, first, second, weight, limit, n_at_limit)
    return paths[room.sees(point_m[paths[:, 0]], point_m[paths[:, 1]])] if len(paths) else paths


class _Ends(NamedTuple):
    """Pieces that one end of the paths sees.

    Attributes
    ----------
    pieces : ndarray of int
        Their numbers, ascending.
    of_edge : ndarray of int, shape (n_edges + 1,)
        Where those of each edge begin in `pieces`, and the length of `pieces`.
    angle : ndarray, shape (n_pieces,)
        Length of every piece over its distance from that end.
    """

    pieces: IntArray
    of_edge: IntArray
    angle: FloatArray


def _ranges(number: IntArray, count: int) -> IntArray:
    """Return where the entries of each number begin in a sorted array, and its length, shape (count + 1,)."""
    return np.searchsorted(number, np.arange(count + 1))


def _sides_of_faces(faces: IntArray) -> tuple[IntArray, IntArray]:
    """Return ``2 * edge + side`` of all edges face by face, and where those of each face begin."""
    of_face = np.argsort(faces.ravel(), kind="stable")
    return of_face, _ranges(faces.ravel()[of_face], int(faces.max(initial=-1)) + 1)


@compiled
def _pairs_of_edges(first_of_edge: IntArray, second_of_edge: IntArray, faces: IntArray, sides: IntArray,
                    sides_of_face: IntArray) -> IntArray:
    """Return the edges of the same face of which one end sees the first and the other the second, shape (n, 4).

    Each row has the first edge and which of its faces it is, and the same of the second one.
    """
    count = 0
    for fills in (False, True):
        pairs, count = np.empty((count if fills else 0, 4), np.int64), 0
        for edge_1 in range(len(faces)):
            if first_of_edge[edge_1] == first_of_edge[edge_1 + 1]:
                continue
            for side_1 in range(2):
                face = faces[edge_1, side_1]
                for n in range(sides_of_face[face], sides_of_face[face + 1]):
                    edge_2 = sides[n] // 2
                    if edge_2 == edge_1 or second_of_edge[edge_2] == second_of_edge[edge_2 + 1]:
                        continue
                    if fills:
                        pairs[count, 0], pairs[count, 1], pairs[count, 2] = edge_1, side_1, edge_2
                        pairs[count, 3] = sides[n] % 2
                    count += 1
    return pairs


@compiled
def _weights(of_edges: IntArray, first: _Ends, second: _Ends, point_m: FloatArray) -> FloatArray:
    """Return the weight of each path, those of `_pairs_of_edges` one after the other (see `find_double_paths`) [1/m].
    """
    count = 0
    for n in range(len(of_edges)):
        edge_1, edge_2 = of_edges[n, 0], of_edges[n, 2]
        count += ((first.of_edge[edge_1 + 1] - first.of_edge[edge_1])
                  * (second.of_edge[edge_2 + 1] - second.of_edge[edge_2]))
    weight, count = np.empty(count), 0
    for n in range(len(of_edges)):
        edge_1, edge_2 = of_edges[n, 0], of_edges[n, 2]
        for i in range(first.of_edge[edge_1], first.of_edge[edge_1 + 1]):
            p = first.pieces[i]
            for j in range(second.of_edge[edge_2], second.of_edge[edge_2 + 1]):
                q, squared = second.pieces[j], 0.0
                for axis in range(3):
                    squared += (point_m[p, axis] - point_m[q, axis]) ** 2
                weight[count] = first.angle[p] * second.angle[q] / np.sqrt(max(squared, 1e-12))
                count += 1
    return weight


@compiled
def _heaviest(of_edges: IntArray, first: _Ends, second: _Ends, weight: FloatArray, limit: float, n_at_limit: int
              ) -> IntArray:
    """Return the paths whose weight is above a limit, and the first `n_at_limit` of those at it; see
    `find_double_paths`.
    """
    paths = np.empty((np.sum(weight > limit) + n_at_limit, 4), np.int64)
    count = at = 0
    for n in range(len(of_edges)):
        edge_1, edge_2 = of_edges[n, 0], of_edges[n, 2]
        for i in range(first.of_edge[edge_1], first.of_edge[edge_1 + 1]):
            for j in range(second.of_edge[edge_2], second.of_edge[edge_2 + 1]):
                at_limit = weight[at] == limit and n_at_limit > 0
                if weight[at] > limit or at_limit:
                    paths[count, 0], paths[count, 1] = first.pieces[i], second.pieces[j]
                    paths[count, 2], paths[count, 3] = of_edges[n, 1], of_edges[n, 3]
                    count += 1
                    n_at_limit -= 1 if at_limit else 0
                at += 1
    return paths


def deposit_double_diffraction(fine: FloatArray, ways: FloatArray, first_sample: int, paths: IntArray, edges: "Edges",
                               pieces: Pieces, source_pos_m: ArrayLike, mic_pos_m: ArrayLike, *, sample_m: float,
                               oversampling: int) -> None:
    """Add the second-order diffraction of some paths to a fine time grid, in place.

    Half of each contribution gets the weight 1 (row 0 of the grid), and half the reflection factor of the common face
    (row 1 + surface).

    Parameters
    ----------
    fine
        Grid of `oversampling` points per sample, shape (1 + n_surfaces, n_points).
    ways
        See `roomeq.sim.diffraction.Grid`.
    first_sample
        Sample of the grid's first point.
    paths
        From `find_double_paths`.
    edges
    pieces
    source_pos_m, mic_pos_m
        Shape (3,).
    sample_m
        Way of sound in one sample.
    oversampling
    """
    edge, low, high, _, _ = pieces
    geometry = np.stack([edges.start_m, edges.along], axis=1)
    source, mic = edges.coordinates(source_pos_m), edges.coordinates(mic_pos_m)
    way = np.empty((len(paths), 0))
    if len(ways):
        way = departures_and_arrivals(pieces.point_m[paths[:, 0]], pieces.point_m[paths[:, 1]], source_pos_m, mic_pos_m)
    _deposit(fine, ways, float(first_sample), paths, way, edge, low, high, geometry, np.pi / edges.wedge_rad,
             _ends(source, edges.wedge_rad), _ends(mic, edges.wedge_rad), edges.surfaces,
             float(np.linalg.norm(np.subtract(source_pos_m, mic_pos_m))), 1.0 / sample_m, float(oversampling))


def departures_and_arrivals(first_m: FloatArray, last_m: FloatArray, source_pos_m: ArrayLike,
                            mic_pos_m: ArrayLike) -> FloatArray:
    """Return unit vectors from the source to the first points of paths, and from the microphone to the last ones.

    Parameters
    ----------
    first_m, last_m
        Shape (n_paths, 3).
    source_pos_m, mic_pos_m
        Shape (3,).

    Returns
    -------
    ndarray, shape (n_paths, 6)
        Both side by side.
    """
    ways = first_m - np.asarray(source_pos_m), last_m - np.asarray(mic_pos_m)
    return np.hstack([way / np.linalg.norm(way, axis=1, keepdims=True) for way in ways])


def _ends(coordinates: FloatArray, wedge_rad: FloatArray) -> FloatArray:
    """Return what `_beta_integral` needs of the source or microphone about each edge, shape (n_edges, 2, 6).

    For either face: distance from the edge [m], 0 where there is none, position along it [m], and the sines and cosines
    of ``nu (pi +- angle to the face) / 2``, their signs such that the sines are positive.
    """
    distance, angle, position = coordinates
    reached = (angle <= wedge_rad) & (distance >= _MIN_RADIUS_M)
    result = np.empty((len(wedge_rad), 2, 6))
    result[:, :, 0], result[:, :, 1] = np.where(reached, distance, 0.0)[:, None], position[:, None]
    for side, face in enumerate((0.0, wedge_rad)):
        for sign, place in ((-1.0, 2), (1.0, 4)):
            half = 0.5 * np.pi / wedge_rad * (np.pi + sign * (angle - face))
            above = np.where(np.sin(half) < -IN_PLANE_RAD, -1.0, 1.0)
            result[:, side, place] = np.maximum(above * np.sin(half), _MIN_SINE)
            result[:, side, place + 1] = above * np.cos(half)
    return result


@inlined
def _about(point: Numbers, frame: Array) -> Numbers:
    """Return the distance of a point from an edge [m] and its position along it [m].

    `frame`, shape (2, 3), holds `start_m` and `along` of the edge (`roomeq.sim.diffraction.Edges`).
    """
    x, y, z = point[0] - frame[0, 0], point[1] - frame[0, 1], point[2] - frame[0, 2]
    along = x * frame[1, 0] + y * frame[1, 1] + z * frame[1, 2]
    x, y, z = x - along * frame[1, 0], y - along * frame[1, 1], z - along * frame[1, 2]
    return np.sqrt(x * x + y * y + z * z), along


@inlined
def _point_on_edge(frame: Array, z: Number) -> Numbers:
    """Return the point at position z [m] along an edge."""
    return frame[0, 0] + z * frame[1, 0], frame[0, 1] + z * frame[1, 1], frame[0, 2] + z * frame[1, 2]


@inlined
def _exp_arcsinh(x: Number) -> Number:
    """Return ``exp(arcsinh(x))``."""
    root = np.sqrt(1.0 + x * x)
    return root + x if x >= 0.0 else 1.0 / (root - x)


@inlined
def arc(y: Number, x: Number) -> Number:
    """Return ``arctan2(y, x)``, where it is small from its series, to 1e-10 of it."""
    if abs(y) < 0.03 * x:
        slope = y / x
        squared = slope * slope
        return slope * (1.0 - squared * (1.0 / 3.0 - 0.2 * squared))
    return np.arctan2(y, x)


@inlined
def _beta_integral(z: Number, half: Number, end: Array, other_edge: Numbers, nu: Number) -> Number:
    """Return nu times half the integral of beta over eta, over the step from z - half to z + half [m] of an edge.

    `end` is that of `_ends` for the common face, in which the other edge lies; `other_edge` the distance and position
    about the edge of the point on the other edge. With the other edge in a face, the four terms of beta are equal in
    pairs, and one of each pair is summed. With ``q = exp(nu eta)``, ``tanh(nu eta / 2)`` is ``(q - 1) / (q + 1)``, and
    the difference of two arcs is one arc.
    """
    q0 = (_exp_arcsinh((z - half - end[1]) / end[0]) * _exp_arcsinh((z - half - other_edge[1]) / other_edge[0])) ** nu
    q1 = (_exp_arcsinh((z + half - end[1]) / end[0]) * _exp_arcsinh((z + half - other_edge[1]) / other_edge[0])) ** nu
    rise, sums, differences = 2.0 * (q1 - q0), (q1 + 1.0) * (q0 + 1.0), (q1 - 1.0) * (q0 - 1.0)
    return 2.0 * (arc(rise * end[2] * end[3], sums * end[2] * end[2] + differences * end[3] * end[3])
                  + arc(rise * end[4] * end[5], sums * end[4] * end[4] + differences * end[5] * end[5]))


@inlined
def _beta(z: Number, end: Array, other_edge: Numbers, nu: Number) -> Number:
    """Return nu times half of beta at the position z [m]; see `_beta_integral`."""
    q = (_exp_arcsinh((z - end[1]) / end[0]) * _exp_arcsinh((z - other_edge[1]) / other_edge[0])) ** nu
    rise = (q - 1.0) ** 2 / (2.0 * q)  # cosh(nu eta) - 1
    return nu * (2.0 * end[2] * end[3] / (rise + 2.0 * end[2] * end[2])
                 + 2.0 * end[4] * end[5] / (rise + 2.0 * end[4] * end[4]))


@inlined
def _peak(end: Array, other_edge: Numbers, nu: Number) -> Numbers:
    """Return where on an edge beta has its peak, on the straight way to the point on the other edge, and its width [m].
    """
    place = (end[1] * other_edge[0] + other_edge[1] * end[0]) / (end[0] + other_edge[0])
    here, there = np.hypot(end[0], place - end[1]), np.hypot(other_edge[0], place - other_edge[1])
    return place, 2.0 * min(end[2], end[4]) / nu * here * there / (here + there)


@inlined
def _peak_from_beyond(z2: Number, frame_1: Array, frame_2: Array, end: Array, nu: Number, z1: Number) -> Numbers:
    """Return for which position on the first edge the beta of the second has its peak at z2, and its width there [m].

    Along the first edge, distance from the second and position about it change linearly: so does how far the way is
    from straight, from which the place follows. Where that does not change, the peak has no end.
    """
    distance, position = _about(_point_on_edge(frame_1, z1), frame_2)
    distance_1, position_1 = _about(_point_on_edge(frame_1, z1 + 0.01 * distance), frame_2)
    bend = (z2 - end[1]) * distance - end[0] * (position - z2)
    slope = ((z2 - end[1]) * (distance_1 - distance) - end[0] * (position_1 - position)) / (0.01 * distance)
    if slope == 0.0:
        return z1, np.inf
    width = 2.0 * min(end[2], end[4]) / nu * distance * np.hypot(end[0], z2 - end[1]) / abs(slope)
    return z1 - bend / slope, width


@inlined
def _n_steps(low: Number, high: Number, end: Array, other_edge: Numbers, other_half_m: Number,
             to_samples: Number) -> Number:
    """Return the number of steps into which a piece is divided.

    `end` and `other_edge` are the distance and position about its edge of the source or microphone, and of the middle
    of the other piece, whose half length is `other_half_m`. Within a step, the arrival time changes by at most about
    `_STEP_SAMPLES`; no step is longer than the distance to the other piece.
    """
    change = (np.sqrt(end[0] ** 2 + (high - end[1]) ** 2) + np.sqrt(other_edge[0] ** 2 + (high - other_edge[1]) ** 2)
              - np.sqrt(end[0] ** 2 + (low - end[1]) ** 2) - np.sqrt(other_edge[0] ** 2 + (low - other_edge[1]) ** 2))
    separation = (np.sqrt(other_edge[0] ** 2 + (0.5 * (low + high) - other_edge[1]) ** 2)
                  - other_half_m - 0.5 * (high - low))
    return 1 + int(max(abs(change) * to_samples / _STEP_SAMPLES,
                       (high - low) / max(other_edge[0], separation, _MIN_SEPARATION_M)))


@compiled
def _deposit(fine: Array, ways: Array, first: Number, paths: Array, way: Array, edge: Array, low: Array, high: Array,
             geometry: Array, nu: Array, source: Array, mic: Array, surfaces: Array, direct_m: Number,
             to_samples: Number, oversampling: Number) -> None:
    """See `deposit_double_diffraction`; `to_samples` is the number of samples per metre of path."""
    for n in range(len(paths)):
        p, q, side_1, side_2 = paths[n, 0], paths[n, 1], paths[n, 2], paths[n, 3]
        edge_1, edge_2 = edge[p], edge[q]
        frame_1, frame_2, nu_1, nu_2 = geometry[edge_1], geometry[edge_2], nu[edge_1], nu[edge_2]
        source_1, mic_2 = source[edge_1, side_1], mic[edge_2, side_2]
        if min(source_1[0], mic_2[0]) < _MIN_RADIUS_M:
            continue
        half_1, half_2 = 0.5 * (high[p] - low[p]), 0.5 * (high[q] - low[q])
        z1, z2 = low[p] + half_1, low[q] + half_2
        pressure, length_m = _step_contribution(z1, half_1, z2, half_2, source_1, mic_2, frame_1, frame_2, nu_1, nu_2)
        n_steps_1, n_steps_2 = 1, 1
        if 4.0 * np.pi * direct_m * abs(pressure) >= _MIN_PRESSURE:
            point_1, point_2 = _point_on_edge(frame_1, z1), _point_on_edge(frame_2, z2)
            n_steps_1 = _n_steps(low[p], high[p], source_1, _about(point_2, frame_1), half_2, to_samples)
            n_steps_2 = _n_steps(low[q], high[q], mic_2, _about(point_1, frame_2), half_1, to_samples)
            if _is_steep(low[p], high[p], z2, low[q], high[q], (high[p] - low[p]) / n_steps_1, frame_1, frame_2, mic_2,
                         nu_2):
                _deposit_steep(fine, ways, first, low[p], high[p], low[q], high[q], n_steps_1, source_1, mic_2,
                               frame_1, frame_2, nu_1, nu_2, 1 + surfaces[edge_1, side_1], way[n], to_samples,
                               oversampling)
                continue
        half_1, half_2 = half_1 / n_steps_1, half_2 / n_steps_2
        row = 1 + surfaces[edge_1, side_1]
        for i in range(n_steps_1):
            for j in range(n_steps_2):
                if n_steps_1 * n_steps_2 > 1:
                    z1, z2 = low[p] + (2 * i + 1) * half_1, low[q] + (2 * j + 1) * half_2
                    pressure, length_m = _step_contribution(z1, half_1, z2, half_2, source_1, mic_2, frame_1, frame_2,
                                                            nu_1, nu_2)
                _add(fine, ways, row, way[n], pressure, (length_m * to_samples - first) * oversampling)


@inlined
def _add(fine: Array, ways: Array, row: Number, way: Array, pressure: Number, position: Number) -> None:
    """Add a contribution to the grid, shared by the two points next to its position."""
    index = int(position)
    if 0 <= index and index + 1 < fine.shape[1]:
        before, after = 0.5 * pressure * (1.0 - position + index), 0.5 * pressure * (position - index)
        fine[0, index] += before
        fine[0, index + 1] += after
        fine[row, index] += before
        fine[row, index + 1] += after
        for k in range(len(ways)):
            ways[k, index] += abs(pressure) * way[k]


@compiled
def _is_steep(low_1: Number, high_1: Number, z2: Number, low_2: Number, high_2: Number, step_1: Number, frame_1: Array,
              frame_2: Array, mic_2: Array, nu_2: Number) -> bool:
    """Tell whether the beta of the second edge changes much within a step of the first one."""
    middle = 0.5 * (low_1 + high_1)
    place, width = _peak_from_beyond(z2, frame_1, frame_2, mic_2, nu_2, middle)
    from_low, _ = _peak_from_beyond(low_2, frame_1, frame_2, mic_2, nu_2, middle)
    from_high, _ = _peak_from_beyond(high_2, frame_1, frame_2, mic_2, nu_2, middle)
    apart = max(low_1 - max(from_low, from_high), min(from_low, from_high) - high_1)
    return np.isfinite(apart + place) and _FINENESS * max(apart, width) < 2.0 * step_1


@compiled
def _deposit_steep(fine: Array, ways: Array, first: Number, low_1: Number, high_1: Number, low_2: Number,
                   high_2: Number, n_steps_1: Number, source_1: Array, mic_2: Array, frame_1: Array, frame_2: Array,
                   nu_1: Number, nu_2: Number, row: Number, way: Array, to_samples: Number,
                   oversampling: Number) -> None:
    """Add a pair of pieces where the beta of the second edge is steep along the first one; see `_deposit`.

    The steps of the second edge do not depend on the piece of the first one: the peaks pass from one to the next.
    """
    middle = 0.5 * (low_1 + high_1)
    from_low, apart_low = _straight_way(low_2, source_1, mic_2, frame_1, frame_2)
    from_high, apart_high = _straight_way(high_2, source_1, mic_2, frame_1, frame_2)
    longest_1 = (high_1 - low_1) / n_steps_1
    longest_2 = (high_2 - low_2) / (1 + int(max(abs(from_high - from_low) * to_samples / _STEP_SAMPLES, (high_2 - low_2)
                                                / max(min(apart_low, apart_high), _MIN_SEPARATION_M))))
    here_2 = low_2
    while here_2 < high_2:
        apart, width = _peaks_apart(here_2, middle, source_1, mic_2, frame_1, frame_2, nu_1, nu_2)
        ahead, _ = _peaks_apart(here_2 + 0.1 * longest_2, middle, source_1, mic_2, frame_1, frame_2, nu_1, nu_2)
        per_metre = max(abs(ahead - apart) / (0.1 * longest_2), 1e-9)
        step_2 = min(longest_2, max(_FINENESS * max(abs(apart), width) / per_metre, _SHORTEST * longest_2))
        z2, half_2, here_2 = _step(here_2, step_2, high_2)
        point_2_about_1 = _about(_point_on_edge(frame_2, z2), frame_1)
        if point_2_about_1[0] < _MIN_RADIUS_M:
            continue
        last = np.sqrt(mic_2[0] ** 2 + (z2 - mic_2[1]) ** 2)
        peak_1, width_1 = _peak(source_1, point_2_about_1, nu_1)
        peak_2, width_2 = _peak_from_beyond(z2, frame_1, frame_2, mic_2, nu_2, middle)
        here_1 = low_1
        while here_1 < high_1:
            to_peak = min(max(abs(here_1 - peak_1), width_1, width_2), max(abs(here_1 - peak_2), width_2))
            step_1 = min(longest_1, max(_FINENESS * to_peak, _SHORTEST * longest_1))
            z1, half_1, here_1 = _step(here_1, step_1, high_1)
            point_1_about_2 = _about(_point_on_edge(frame_1, z1), frame_2)
            if point_1_about_2[0] < _MIN_RADIUS_M:
                continue
            before = np.sqrt(source_1[0] ** 2 + (z1 - source_1[1]) ** 2)
            between = np.sqrt(point_1_about_2[0] ** 2 + (z2 - point_1_about_2[1]) ** 2)
            integrals = (_beta_integral(z1, half_1, source_1, point_2_about_1, nu_1) * 2.0 * half_2
                         * _beta(z2, mic_2, point_1_about_2, nu_2) * (1.0 / between + 1.0 / last))
            pressure = _pressure(integrals, before, between, last)
            _add(fine, ways, row, way, pressure, ((before + between + last) * to_samples - first) * oversampling)


@inlined
def _step(low: Number, length: Number, high: Number) -> Numbers:
    """Return the middle, half the length and the end of a step along an edge [m]; what would be left joins the last."""
    end = high if low + 1.01 * length > high else low + length
    return 0.5 * (low + end), 0.5 * (end - low), end


@inlined
def _pressure(integrals: Number, before: Number, between: Number, after: Number) -> Number:
    """Return the pressure of a pair of steps [1/m], from the integrals over both and the parts of the path [m]."""
    return integrals * between / (32.0 * np.pi ** 3 * (before + between) * (between + after))


@inlined
def _straight_way(z2: Number, source_1: Array, mic_2: Array, frame_1: Array, frame_2: Array) -> Numbers:
    """Return the length of the path that is straight over the first edge, and how far z2 is from that edge [m]."""
    apart, place = _about(_point_on_edge(frame_2, z2), frame_1)
    return np.hypot(source_1[0] + apart, place - source_1[1]) + np.hypot(mic_2[0], z2 - mic_2[1]), apart


@inlined
def _peaks_apart(z2: Number, z1: Number, source_1: Array, mic_2: Array, frame_1: Array, frame_2: Array, nu_1: Number,
                 nu_2: Number) -> Numbers:
    """Return how far the peak of the second beta is from that of the first, along the first edge, and the sum of their
    widths [m].
    """
    peak_1, width_1 = _peak(source_1, _about(_point_on_edge(frame_2, z2), frame_1), nu_1)
    peak_2, width_2 = _peak_from_beyond(z2, frame_1, frame_2, mic_2, nu_2, z1)
    return peak_2 - peak_1, width_1 + width_2


@compiled
def _step_contribution(z1: Number, half_1: Number, z2: Number, half_2: Number, source_1: Array, mic_2: Array,
                       frame_1: Array, frame_2: Array, nu_1: Number, nu_2: Number) -> Numbers:
    """Return the pressure that a pair of steps contributes [1/m], and the length of its path [m].

    `source_1` and `mic_2` are those of `_ends`: the source about the first edge, the microphone about the second.
    """
    point_2_about_1 = _about(_point_on_edge(frame_2, z2), frame_1)
    point_1_about_2 = _about(_point_on_edge(frame_1, z1), frame_2)
    if min(point_2_about_1[0], point_1_about_2[0]) < _MIN_RADIUS_M:
        return 0.0, 0.0
    first = np.sqrt(source_1[0] ** 2 + (z1 - source_1[1]) ** 2)
    between = np.sqrt(point_1_about_2[0] ** 2 + (z2 - point_1_about_2[1]) ** 2)
    last = np.sqrt(mic_2[0] ** 2 + (z2 - mic_2[1]) ** 2)
    integrals = (_beta_integral(z1, half_1, source_1, point_2_about_1, nu_1)
                 * _beta_integral(z2, half_2, mic_2, point_1_about_2, nu_2))
    return _pressure(integrals, first, between, last), first + between + last
