"""Second-order diffraction: from the source to one edge of a face, along the face to another edge, to the microphone.

For a microphone behind a box, there may be no edge that both the source and the microphone see: sound arrives by
diffraction at two edges of the same face (Svensson, Fred and Vanderkooy, J. Acoust. Soc. Am. 106 (1999) 2331,
sec. III, with the factor 1/2 for edges that share a face). Each edge has the cylinder coordinates of
`roomeq.sim.diffraction`; m, l and n are the distances from the source to a point of the first edge, from there to a
point of the second edge, and from there to the microphone:

    h(t) = (nu_1 nu_2 / (2 (4 pi)^3)) integral of delta(t - (m + l + n) / c) beta_1 beta_2 / (m l n) dz_1 dz_2

``dz_1 dz_2 / (m l n)`` equals ``l / ((m + l) (l + n)) d eta_1 d eta_2``. The edges are divided into short steps. In
each step, beta is integrated exactly and the distances are those of the step's middle.
"""

import logging
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from roomeq.core.arrays import Array, BoolArray, FloatArray, IntArray, Number, Numbers
from roomeq.core.jit import compiled

if TYPE_CHECKING:
    from roomeq.sim.diffraction import Edges
    from roomeq.sim.mesh import MeshRoom

logger = logging.getLogger(__name__)

MAX_PATHS = 40_000  # largest number of pairs of pieces
MIN_EXCESS_RAD = np.radians(40.0)  # of the open angle over pi; blunter edges diffract too little in second order
_STEP_SAMPLES = 1.0  # largest change of the arrival time within a step
_MIN_PRESSURE = 3e-5  # relative to the free-field direct sound; a weaker pair of pieces is integrated in one step
_MIN_RADIUS_M = 1e-6  # points closer to the line of an edge are skipped
_MIN_SEPARATION_M = 0.005  # closer edges are divided into steps as if they were this far apart


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
    """

    edge: IntArray
    low_m: FloatArray
    high_m: FloatArray
    point_m: FloatArray


def find_double_paths(room: "MeshRoom", edges: "Edges", pieces: Pieces, seen_by_source: BoolArray,
                      seen_by_mic: BoolArray) -> IntArray:
    """Find the paths that diffract at two edges of the same face.

    Parameters
    ----------
    room
    edges
    pieces
        Pieces of all edges.
    seen_by_source, seen_by_mic
        Whether the source and the microphone see each piece, shape (n_pieces,).

    Returns
    -------
    ndarray of int, shape (n_paths, 4)
        Index of the first piece, which the source sees, and of the second, which the microphone sees; then which face
        (0 or 1) of the first edge, and which of the second edge, is the common face.
    """
    sharp = (edges.wedge_rad > np.pi + MIN_EXCESS_RAD)[pieces.edge]
    first_pieces, second_pieces = (_by_edge(pieces.edge, seen & sharp) for seen in (seen_by_source, seen_by_mic))
    edges_of_face: dict[int, list[tuple[int, int]]] = {}
    for edge in second_pieces:
        for side in (0, 1):
            edges_of_face.setdefault(edges.faces[edge, side], []).append((edge, side))
    parts = [_pairs(first_pieces[edge_1], second_pieces[edge_2], side_1, side_2)
             for edge_1 in first_pieces for side_1 in (0, 1)
             for edge_2, side_2 in edges_of_face.get(edges.faces[edge_1, side_1], ()) if edge_2 != edge_1]
    paths = np.concatenate(parts) if parts else np.empty((0, 4), dtype=int)
    point_m = pieces.point_m
    if len(paths) > MAX_PATHS:
        logger.debug("%d pairs of pieces of edges share a face: only the %d closest pairs are computed", len(paths),
                     MAX_PATHS)
        separation_m = np.linalg.norm(point_m[paths[:, 0]] - point_m[paths[:, 1]], axis=1)
        paths = paths[np.sort(np.argsort(separation_m, kind="stable")[:MAX_PATHS])]
    return paths[room.sees(point_m[paths[:, 0]], point_m[paths[:, 1]])] if len(paths) else paths


def _by_edge(edge: IntArray, seen: BoolArray) -> dict[int, IntArray]:
    """Return the indices of the visible pieces of each edge; edges without visible pieces are left out."""
    index = np.flatnonzero(seen)
    starts = np.flatnonzero(np.diff(edge[index], prepend=-1))
    return {int(edge[part[0]]): part for part in np.split(index, starts[1:]) if len(part)}


def _pairs(first: IntArray, second: IntArray, side_1: int, side_2: int) -> IntArray:
    result = np.empty((len(first) * len(second), 4), dtype=np.int64)
    result[:, 0], result[:, 1] = np.repeat(first, len(second)), np.tile(second, len(first))
    result[:, 2], result[:, 3] = side_1, side_2
    return result


def deposit_double_diffraction(fine: FloatArray, first_sample: int, paths: IntArray, edges: "Edges", pieces: Pieces,
                               source_pos_m: ArrayLike, mic_pos_m: ArrayLike, *, sample_m: float,
                               oversampling: int) -> None:
    """Add the second-order diffraction of some paths to a fine time grid, in place.

    Half of each contribution gets the weight 1 (row 0 of the grid), and half the reflection factor of the common face
    (row 1 + surface).

    Parameters
    ----------
    fine
        Grid of `oversampling` points per sample, shape (1 + n_surfaces, n_points).
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
    edge, low, high, _ = pieces
    geometry = np.stack([edges.start_m, edges.along, edges.across, edges.normal], axis=1)
    _deposit(fine, float(first_sample), paths, edge, low, high, geometry, edges.wedge_rad, edges.surfaces,
             np.asarray(source_pos_m, dtype=float), np.asarray(mic_pos_m, dtype=float), 1.0 / sample_m,
             float(oversampling))


@compiled
def _cylinder(point: Array, frame: Number) -> Numbers:
    """Return cylinder coordinates about an edge: distance [m], angle [rad], position along it [m].

    `frame`, shape (4, 3), holds `start_m`, `along`, `across` and `normal` of the edge (`roomeq.sim.diffraction.Edges`).
    """
    x, y, z = 0.0, 0.0, 0.0
    for k in range(3):
        offset = point[k] - frame[0, k]
        z += offset * frame[1, k]
        x += offset * frame[2, k]
        y += offset * frame[3, k]
    angle = np.arctan2(y, x)
    return np.sqrt(x * x + y * y), angle if angle > -1e-9 else angle + 2.0 * np.pi, z


@compiled
def _point_on_edge(frame: Number, z: Number, point: Array) -> None:
    """Write the point at position z [m] along an edge to `point`, shape (3,)."""
    for k in range(3):
        point[k] = frame[0, k] + z * frame[1, k]


@compiled
def _beta_integral(z: Number, half: Number, end: Numbers, other_edge: Numbers, wedge: Number,
                   face: Number) -> Number:
    """Return nu times half the integral of beta over eta, over the step from z - half to z + half [m] of an edge.

    `end` and `other_edge` are the cylinder coordinates about the edge of the source or microphone, and of the point on
    the other edge. `face` is the angle of the common face, in which the other edge lies: 0 or `wedge`;
    there the four terms of beta are equal in pairs, and one of each pair is summed.
    """
    nu, total = np.pi / wedge, 0.0
    eta_0 = np.arcsinh((z - half - end[2]) / end[0]) + np.arcsinh((z - half - other_edge[2]) / other_edge[0])
    eta_1 = np.arcsinh((z + half - end[2]) / end[0]) + np.arcsinh((z + half - other_edge[2]) / other_edge[0])
    tanh_0, tanh_1 = np.tanh(0.5 * nu * eta_0), np.tanh(0.5 * nu * eta_1)
    for sign in (-1.0, 1.0):
        angle = 0.5 * nu * (np.pi + sign * (end[1] - face))
        sine, cosine = np.sin(angle), np.cos(angle)
        if sine < 0.0:
            sine, cosine = -sine, -cosine
        total += 2.0 * (np.arctan2(tanh_1 * cosine, sine) - np.arctan2(tanh_0 * cosine, sine))
    return total


@compiled
def _n_steps(low: Number, high: Number, end: Numbers, other_edge: Numbers, other_half_m: Number,
             to_samples: Number) -> Number:
    """Return the number of steps into which a piece is divided.

    `end` and `other_edge` are the cylinder coordinates about its edge of the source or microphone, and of the middle
    of the other piece, whose half length is `other_half_m`. Within a step, the arrival time changes by at most about
    `_STEP_SAMPLES`; no step is longer than the distance to the other piece.
    """
    change = (np.sqrt(end[0] ** 2 + (high - end[2]) ** 2) + np.sqrt(other_edge[0] ** 2 + (high - other_edge[2]) ** 2)
              - np.sqrt(end[0] ** 2 + (low - end[2]) ** 2) - np.sqrt(other_edge[0] ** 2 + (low - other_edge[2]) ** 2))
    separation = (np.sqrt(other_edge[0] ** 2 + (0.5 * (low + high) - other_edge[2]) ** 2)
                  - other_half_m - 0.5 * (high - low))
    return 1 + int(max(abs(change) * to_samples / _STEP_SAMPLES,
                       (high - low) / max(other_edge[0], separation, _MIN_SEPARATION_M)))


@compiled
def _deposit(fine: Array, first: Number, paths: Array, edge: Array, low: Array, high: Array, geometry: Array,
             wedge: Array, surfaces: Array, source: Array, mic: Array, to_samples: Number,
             oversampling: Number) -> None:
    """See `deposit_double_diffraction`; `to_samples` is the number of samples per metre of path."""
    point_1, point_2 = np.empty(3), np.empty(3)
    direct_m = np.sqrt(np.sum((source - mic) ** 2))  # straight-line distance, whether or not it is obstructed
    for n in range(len(paths)):
        p, q, side_1, side_2 = paths[n]
        edge_1, edge_2 = edge[p], edge[q]
        frame_1, frame_2 = geometry[edge_1], geometry[edge_2]
        source_1, mic_2 = _cylinder(source, frame_1), _cylinder(mic, frame_2)
        if source_1[1] > wedge[edge_1] or mic_2[1] > wedge[edge_2] or min(source_1[0], mic_2[0]) < _MIN_RADIUS_M:
            continue
        face_angles = (0.0 if side_1 == 0 else wedge[edge_1]), (0.0 if side_2 == 0 else wedge[edge_2])
        half_1, half_2 = 0.5 * (high[p] - low[p]), 0.5 * (high[q] - low[q])
        _point_on_edge(frame_1, low[p] + half_1, point_1)
        _point_on_edge(frame_2, low[q] + half_2, point_2)
        n_steps_1 = _n_steps(low[p], high[p], source_1, _cylinder(point_2, frame_1), half_2, to_samples)
        n_steps_2 = _n_steps(low[q], high[q], mic_2, _cylinder(point_1, frame_2), half_1, to_samples)
        pressure, _ = _step_contribution(low[p] + half_1, half_1, low[q] + half_2, half_2, source_1, mic_2, frame_1,
                                         frame_2, wedge[edge_1], wedge[edge_2], face_angles, point_1, point_2)
        if 4.0 * np.pi * direct_m * abs(pressure) < _MIN_PRESSURE:
            n_steps_1, n_steps_2 = 1, 1
        half_1, half_2 = half_1 / n_steps_1, half_2 / n_steps_2
        for i in range(n_steps_1):
            for j in range(n_steps_2):
                z1, z2 = low[p] + (2 * i + 1) * half_1, low[q] + (2 * j + 1) * half_2
                _point_on_edge(frame_1, z1, point_1)
                _point_on_edge(frame_2, z2, point_2)
                weight, length_m = _step_contribution(z1, half_1, z2, half_2, source_1, mic_2, frame_1, frame_2,
                                                      wedge[edge_1], wedge[edge_2], face_angles, point_1, point_2)
                position = (length_m * to_samples - first) * oversampling
                index = int(position)
                if index + 1 < fine.shape[1]:
                    for row in (0, 1 + surfaces[edge_1, side_1]):
                        fine[row, index] += 0.5 * weight * (1.0 - position + index)
                        fine[row, index + 1] += 0.5 * weight * (position - index)


@compiled
def _step_contribution(z1: Number, half_1: Number, z2: Number, half_2: Number, source_1: Numbers, mic_2: Numbers,
                       frame_1: Array, frame_2: Array, wedge_1: Number, wedge_2: Number, face_angles: Numbers,
                       point_1: Array, point_2: Array) -> Numbers:
    """Return the pressure that a pair of steps contributes [1/m], and the length of its path [m].

    `source_1` and `mic_2` are the cylinder coordinates of the source about the first edge, and of the microphone about
    the second.
    """
    point_2_about_1, point_1_about_2 = _cylinder(point_2, frame_1), _cylinder(point_1, frame_2)
    if min(point_2_about_1[0], point_1_about_2[0]) < _MIN_RADIUS_M:
        return 0.0, 0.0
    first = np.sqrt(source_1[0] ** 2 + (z1 - source_1[2]) ** 2)
    between = np.sqrt(point_1_about_2[0] ** 2 + (z2 - point_1_about_2[2]) ** 2)
    last = np.sqrt(mic_2[0] ** 2 + (z2 - mic_2[2]) ** 2)
    integrals = (_beta_integral(z1, half_1, source_1, point_2_about_1, wedge_1, face_angles[0])
                 * _beta_integral(z2, half_2, mic_2, point_1_about_2, wedge_2, face_angles[1]))
    return integrals * between / (32.0 * np.pi ** 3 * (first + between) * (between + last)), first + between + last
