"""Second-order diffraction over a face: source, edge, along the face, another of its edges, microphone.

Behind a box, no edge may be visible from both sides: sound arrives over two edges of one face (Svensson, Fred
and Vanderkooy, J. Acoust. Soc. Am. 106 (1999) 2331, sec. III, with the half for edges that share a face). With the
coordinates of `roomeq.sim.diffraction` about either edge,

    h(t) = (nu_1 nu_2 / (2 (4 pi)^3)) integral of delta(t - (m + l + n) / c) beta_1 beta_2 / (m l n) dz_1 dz_2,

where ``dz_1 dz_2 / (m l n)`` is ``l / ((m + l) (l + n)) d eta_1 d eta_2``: over a short step of either edge each
beta is integrated exactly.
"""

import logging
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from roomeq.core.arrays import Array, BoolArray, FloatArray, IntArray, Number, Numbers
from roomeq.core.constants import FS_HZ
from roomeq.core.jit import compiled

if TYPE_CHECKING:
    from roomeq.sim.diffraction import Edges
    from roomeq.sim.mesh import MeshRoom

logger = logging.getLogger(__name__)

MAX_WAYS = 40_000  # pairs of pieces
MIN_EXCESS_RAD = np.radians(40.0)  # sound over two blunter edges is too faint
_STEP_SAMPLES = 1.0
_FAINT = 3e-5  # of the direct sound: fainter contributions are not resolved
_TINY_M = 1e-6
_NEAREST_M = 0.005  # closer edges are integrated as if they were this far apart


class Pieces(NamedTuple):
    """Short pieces of edges, each array of length n_pieces.

    Attributes
    ----------
    edge
        Index of the edge.
    low_m, high_m
        Ends of the piece along the edge.
    point_m
        A point just off the middle, shape (n_pieces, 3).
    """

    edge: IntArray
    low_m: FloatArray
    high_m: FloatArray
    point_m: FloatArray


def over_faces(room: "MeshRoom", edges: "Edges", pieces: Pieces, from_source: BoolArray,
               from_mic: BoolArray) -> IntArray:
    """Find the paths over two edges of one face.

    Parameters
    ----------
    room
    edges
    pieces
        Of all edges.
    from_source, from_mic
        Which pieces are seen from the source and the microphone.

    Returns
    -------
    ndarray of int, shape (n, 4)
        A piece that the source sees, one that the microphone sees, and the side (0 or 1) of the common face at either
        edge.
    """
    sharp = (edges.wedge_rad > np.pi + MIN_EXCESS_RAD)[pieces[0]]
    lit, heard = (_by_edge(pieces[0], seen & sharp) for seen in (from_source, from_mic))
    holders: dict[int, list[tuple[int, int]]] = {}
    for edge in heard:
        for side in (0, 1):
            holders.setdefault(edges.faces[edge, side], []).append((edge, side))
    parts = [_pairs(lit[one], heard[two], side, other) for one in lit for side in (0, 1)
             for two, other in holders.get(edges.faces[one, side], ()) if two != one]
    found = np.concatenate(parts) if parts else np.empty((0, 4), dtype=int)
    if len(found) > MAX_WAYS:
        logger.debug("%d pairs of pieces of edges share a face: the nearest %d count", len(found), MAX_WAYS)
        apart_m = np.linalg.norm(pieces[3][found[:, 0]] - pieces[3][found[:, 1]], axis=1)
        found = found[np.sort(np.argsort(apart_m, kind="stable")[:MAX_WAYS])]
    return found[room.sees(pieces[3][found[:, 0]], pieces[3][found[:, 1]])] if len(found) else found


def _by_edge(edge: IntArray, seen: BoolArray) -> dict[int, IntArray]:
    """Return the indices of the seen pieces of each edge that has some."""
    index = np.flatnonzero(seen)
    starts = np.flatnonzero(np.diff(edge[index], prepend=-1))
    return {int(edge[part[0]]): part for part in np.split(index, starts[1:]) if len(part)}


def _pairs(first: IntArray, second: IntArray, side: int, other: int) -> IntArray:
    result = np.empty((len(first) * len(second), 4), dtype=np.int64)
    result[:, 0], result[:, 1] = np.repeat(first, len(second)), np.tile(second, len(first))
    result[:, 2], result[:, 3] = side, other
    return result


def deposit_over_faces(fine: FloatArray, first_sample: int, ways: IntArray, edges: "Edges", pieces: Pieces,
                       source_pos_m: ArrayLike, mic_pos_m: ArrayLike, *, speed_m_s: float, oversampling: int) -> None:
    """Add the paths over faces to a fine grid of time; half of each is weighted as the common face reflects."""
    edge, low, high, _ = pieces
    geometry = np.stack([edges.start_m, edges.along, edges.across, edges.normal], axis=1)
    _deposit(fine, float(first_sample), ways, edge, low, high, geometry, edges.wedge_rad, edges.surfaces,
             np.asarray(source_pos_m, dtype=float), np.asarray(mic_pos_m, dtype=float), FS_HZ / speed_m_s,
             float(oversampling))


@compiled
def _cylinder(point: Array, frame: Number) -> Numbers:
    """Return cylinder coordinates about an edge: distance, angle, position along it."""
    x, y, z = 0.0, 0.0, 0.0
    for k in range(3):
        offset = point[k] - frame[0, k]
        z += offset * frame[1, k]
        x += offset * frame[2, k]
        y += offset * frame[3, k]
    angle = np.arctan2(y, x)
    return np.sqrt(x * x + y * y), angle if angle > -1e-9 else angle + 2.0 * np.pi, z


@compiled
def _along(frame: Number, z: Number, place: Array) -> None:
    for k in range(3):
        place[k] = frame[0, k] + z * frame[1, k]


@compiled
def _swept(z: Number, half: Number, far: Numbers, near: Numbers, wedge: Number, face: Number) -> Number:
    """Return half of nu times the integral of beta over a step of an edge, from point `far` to `near` in a face."""
    nu, total = np.pi / wedge, 0.0
    eta_0 = np.arcsinh((z - half - far[2]) / far[0]) + np.arcsinh((z - half - near[2]) / near[0])
    eta_1 = np.arcsinh((z + half - far[2]) / far[0]) + np.arcsinh((z + half - near[2]) / near[0])
    steep_0, steep_1 = np.tanh(0.5 * nu * eta_0), np.tanh(0.5 * nu * eta_1)
    for sign in (-1.0, 1.0):
        angle = 0.5 * nu * (np.pi + sign * (far[1] - face))
        sine, cosine = np.sin(angle), np.cos(angle)
        if sine < 0.0:
            sine, cosine = -sine, -cosine
        total += 2.0 * (np.arctan2(steep_1 * cosine, sine) - np.arctan2(steep_0 * cosine, sine))
    return total


@compiled
def _count(low: Number, high: Number, far: Numbers, near: Numbers, other_half_m: Number, to_samples: Number) -> Number:
    """Return the number of steps of a piece.

    `far` and `near` are the coordinates about its edge of the source or microphone and of the other piece's middle.
    The path changes by at most `_STEP_SAMPLES` in a step, and no step is longer than the distance of the other piece.
    """
    change = (np.sqrt(far[0] ** 2 + (high - far[2]) ** 2) + np.sqrt(near[0] ** 2 + (high - near[2]) ** 2)
              - np.sqrt(far[0] ** 2 + (low - far[2]) ** 2) - np.sqrt(near[0] ** 2 + (low - near[2]) ** 2))
    apart = np.sqrt(near[0] ** 2 + (0.5 * (low + high) - near[2]) ** 2) - other_half_m - 0.5 * (high - low)
    return 1 + int(max(abs(change) * to_samples / _STEP_SAMPLES, (high - low) / max(near[0], apart, _NEAREST_M)))


@compiled
def _deposit(fine: Array, first: Number, ways: Array, edge: Array, low: Array, high: Array, geometry: Array,
             wedge: Array, surfaces: Array, source: Array, mic: Array, to_samples: Number,
             oversampling: Number) -> None:
    place_1, place_2 = np.empty(3), np.empty(3)
    direct_m = np.sqrt(np.sum((source - mic) ** 2))
    for n in range(len(ways)):
        p, q, side, other = ways[n]
        one, two = edge[p], edge[q]
        frame_1, frame_2 = geometry[one], geometry[two]
        about_1, about_2 = _cylinder(source, frame_1), _cylinder(mic, frame_2)
        if about_1[1] > wedge[one] or about_2[1] > wedge[two] or min(about_1[0], about_2[0]) < _TINY_M:
            continue
        grazing = (0.0 if side == 0 else wedge[one]), (0.0 if other == 0 else wedge[two])
        half_1, half_2 = 0.5 * (high[p] - low[p]), 0.5 * (high[q] - low[q])
        _along(frame_1, low[p] + half_1, place_1)
        _along(frame_2, low[q] + half_2, place_2)
        count_1 = _count(low[p], high[p], about_1, _cylinder(place_2, frame_1), half_2, to_samples)
        count_2 = _count(low[q], high[q], about_2, _cylinder(place_1, frame_2), half_1, to_samples)
        whole, _ = _way(low[p] + half_1, half_1, low[q] + half_2, half_2, about_1, about_2, frame_1, frame_2,
                        wedge[one], wedge[two], grazing, place_1, place_2)
        if 4.0 * np.pi * direct_m * abs(whole) < _FAINT:
            count_1, count_2 = 1, 1
        half_1, half_2 = half_1 / count_1, half_2 / count_2
        for i in range(count_1):
            for j in range(count_2):
                z1, z2 = low[p] + (2 * i + 1) * half_1, low[q] + (2 * j + 1) * half_2
                _along(frame_1, z1, place_1)
                _along(frame_2, z2, place_2)
                weight, length_m = _way(z1, half_1, z2, half_2, about_1, about_2, frame_1, frame_2,
                                        wedge[one], wedge[two], grazing, place_1, place_2)
                place = (length_m * to_samples - first) * oversampling
                index = int(place)
                if index + 1 < fine.shape[1]:
                    for row in (0, 1 + surfaces[one, side]):
                        fine[row, index] += 0.5 * weight * (1.0 - place + index)
                        fine[row, index + 1] += 0.5 * weight * (place - index)


@compiled
def _way(z1: Number, half_1: Number, z2: Number, half_2: Number, about_1: Numbers, about_2: Numbers, frame_1: Array,
         frame_2: Array, wedge_1: Number, wedge_2: Number, grazing: Numbers, place_1: Array, place_2: Array) -> Numbers:
    """Return the contribution of a step of either edge, and the length of its path [m]."""
    near_1, near_2 = _cylinder(place_2, frame_1), _cylinder(place_1, frame_2)
    if min(near_1[0], near_2[0]) < _TINY_M:
        return 0.0, 0.0
    first = np.sqrt(about_1[0] ** 2 + (z1 - about_1[2]) ** 2)
    between = np.sqrt(near_2[0] ** 2 + (z2 - near_2[2]) ** 2)
    last = np.sqrt(about_2[0] ** 2 + (z2 - about_2[2]) ** 2)
    swept = _swept(z1, half_1, about_1, near_1, wedge_1, grazing[0]) * _swept(z2, half_2, about_2, near_2, wedge_2,
                                                                             grazing[1])
    return swept * between / (32.0 * np.pi ** 3 * (first + between) * (between + last)), first + between + last
