"""Faces of a mesh that meet in an edge, and faces that lie in one plane."""

from typing import NamedTuple

import numpy as np
import scipy  # its submodules are slow to import and load themselves when first used

from roomeq.core.arrays import BoolArray, FloatArray, IntArray

_ON_LINE_M = 2e-5  # corners are rounded
_FLAT_RAD = np.radians(0.5)
_FLAT_M = 2e-3
"""Corners of one wall lie this close to its plane: files state them to a millimetre, or to less after a rotation."""
_FLUSH_M = 1e-4  # a corner this close to the plane of the adjacent face, however narrow the faces are
FACET_RAD = np.radians(10.0)
"""Angle up to which two faces in different planes may be facets of a curved surface."""
_PLANE_DIGITS = np.array([1e5, 1e5, 1e5, 1e4])  # of unit normals, and of offsets [m]


class Meetings(NamedTuple):
    """Pairs of faces that meet in an edge.

    Attributes
    ----------
    faces
        Shape (n, 2).
    start_m, end_m
        Ends of what the faces share, in the order of the first face's corners, shape (n, 3) each.
    opposite_m
        The corner of either face that is not on the edge, shape (n, 2, 3).
    """

    faces: IntArray
    start_m: FloatArray
    end_m: FloatArray
    opposite_m: FloatArray


class Planes(NamedTuple):
    """Planes that faces lie in.

    Attributes
    ----------
    of_face
        Index of each face's plane, shape (n_faces,).
    mirrors
        Unit normal into the air and offset [m] along it of each plane, shape (n_planes, 4).
    """

    of_face: IntArray
    mirrors: FloatArray


def find_meetings(triangles: FloatArray) -> Meetings:
    """Find the pairs of faces that meet in an edge, for triangles of shape (n_faces, 3, 3)."""
    corners = triangles.reshape(-1, 3)
    _, index = np.unique(np.round(corners, 5), axis=0, return_inverse=True)
    index = np.ravel(index).reshape(-1, 3)
    face = np.repeat(np.arange(len(index)), 3)
    ends = np.sort(np.stack([index, np.roll(index, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    start, end, opposite = (np.roll(triangles, -n, axis=1).reshape(-1, 3) for n in range(3))
    first, second, left_over = _equal_edges(ends)
    also_first, also_second, its_start, its_end = _overlapping_edges(start[left_over], end[left_over])
    start, end = np.concatenate([start[first], its_start]), np.concatenate([end[first], its_end])
    pair = np.stack([np.concatenate([first, left_over[also_first]]),
                     np.concatenate([second, left_over[also_second]])], axis=1)
    return Meetings(face[pair], start, end, opposite[pair])


def _equal_edges(ends: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Return pairs of edges of faces with the same ends, and those that are left over.

    A closed mesh has two faces at every edge, or four where two bodies touch. Edges are left over where a triangle
    without an area was left out: one side of it is as long as the two others.

    Parameters
    ----------
    ends
        Numbers of the corners, the smaller first, shape (n_edges, 2).
    """
    order = np.lexsort(ends.T)
    begins = np.flatnonzero(np.append(True, np.any(ends[order[1:]] != ends[order[:-1]], axis=1)))
    count = np.diff(np.append(begins, len(order)))
    paired = np.repeat(count % 2 == 0, count)
    return order[paired][0::2], order[paired][1::2], order[~paired]


def _overlapping_edges(start: FloatArray, end: FloatArray) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
    """Return pairs of edges that run along one line in opposite directions, and the ends of what they share."""
    first, second, shared = [], [], []
    length_m = np.linalg.norm(end - start, axis=1)
    for n, (begin, way) in enumerate(zip(start, (end - start) / length_m[:, None], strict=True)):
        low, high = (end[n + 1:] - begin) @ way, (start[n + 1:] - begin) @ way  # of those in the opposite direction
        off_m = [np.linalg.norm(points[n + 1:] - begin - place[:, None] * way, axis=1)
                 for points, place in ((end, low), (start, high))]
        low, high = np.maximum(low, 0.0), np.minimum(high, length_m[n])
        for other in np.flatnonzero((np.maximum(*off_m) < _ON_LINE_M) & (high - low > _ON_LINE_M)):
            first.append(n)
            second.append(n + 1 + other)
            shared.append([begin + low[other] * way, begin + high[other] * way])
    ends = np.reshape(shared, (-1, 2, 3))
    return np.array(first, dtype=np.int64), np.array(second, dtype=np.int64), ends[:, 0], ends[:, 1]


def find_planes(triangles: FloatArray, normals: FloatArray, area_m2: FloatArray, meetings: Meetings) -> Planes:
    """Find the planes of a mesh's faces.

    Coordinates are rounded, so that the faces of one wall differ in direction, the more the narrower they are. Faces
    that meet at a small angle are in one plane if all of them are flat together, to `_FLAT_M`; a curved surface is not.
    Where they do not meet, those with the same plane, but for rounding, are.

    Parameters
    ----------
    triangles
        Shape (n_faces, 3, 3).
    normals
        Unit normals into the air, shape (n_faces, 3).
    area_m2
        Shape (n_faces,).
    meetings
    """
    wall = _joined(len(triangles), meetings.faces[_are_flush(triangles, normals, meetings)])
    n_walls = int(wall.max()) + 1
    summed = np.stack([np.bincount(wall, area_m2 * axis, n_walls) for axis in normals.T], axis=1)
    of_wall = summed / np.maximum(np.linalg.norm(summed, axis=1, keepdims=True), np.finfo(float).tiny)
    height = np.einsum("ijk,ik->ij", triangles, of_wall[wall])  # of the corners, along the normal of their wall
    offset = np.bincount(wall, area_m2 * height.mean(axis=1), n_walls) / np.bincount(wall, area_m2, n_walls)
    off_m = np.zeros(n_walls)
    np.maximum.at(off_m, wall, np.abs(height - offset[wall, None]).max(axis=1))
    flat = off_m[wall] <= _FLAT_M
    mirror = np.where(flat[:, None], np.column_stack([of_wall, offset])[wall],
                      np.column_stack([normals, np.einsum("ij,ij->i", normals, triangles[:, 0])]))
    _, first, plane = np.unique(np.round(mirror * _PLANE_DIGITS).astype(np.int64), axis=0, return_index=True,
                                return_inverse=True)
    return Planes(np.ravel(plane), mirror[first])


def _are_flush(triangles: FloatArray, normals: FloatArray, meetings: Meetings) -> BoolArray:
    """Tell of which pairs of faces the angle is that of a rounded plane, shape (n,)."""
    first, second = meetings.faces.T
    turn = np.linalg.norm(np.cross(normals[first], normals[second]), axis=1)
    same_side = np.einsum("ij,ij->i", normals[first], normals[second]) > 0.0
    off_m = np.minimum(*(np.abs(np.einsum("ij,ij->i", meetings.opposite_m[:, n] - meetings.start_m, normals[other]))
                         for n, other in ((0, second), (1, first))))
    return same_side & ((turn < np.sin(_FLAT_RAD)) | (off_m <= _FLUSH_M))


def _joined(count: int, pairs: IntArray) -> IntArray:
    """Return the number of the connected component of each of `count` nodes, for pairs of shape (n, 2)."""
    graph = scipy.sparse.coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=(count, count))
    return np.asarray(scipy.sparse.csgraph.connected_components(graph, directed=False)[1])


def curved_faces(planes: Planes, meetings: Meetings, area_m2: FloatArray, size_m: float) -> BoolArray:
    """Tell which faces are facets of curved surfaces, shape (n_faces,).

    A facet meets its neighbour at a small angle, and its width over this angle, the radius of the curvature, is less
    than the size of the room: sound is focused there.

    Parameters
    ----------
    planes, meetings
        Of the faces.
    area_m2
        Shape (n_faces,).
    size_m
        Of the room.
    """
    region = joined_faces(planes, meetings)
    normals = planes.mirrors[planes.of_face[meetings.faces], :3]
    sine, cosine = np.linalg.norm(np.cross(*normals.transpose(1, 0, 2)), axis=1), np.prod(normals, axis=1).sum(axis=1)
    bent = (region[meetings.faces[:, 0]] != region[meetings.faces[:, 1]]) & (cosine > np.cos(FACET_RAD))
    sides, number = np.unique(np.sort(region[meetings.faces[bent]], axis=1), axis=0, return_inverse=True)
    length_m = np.linalg.norm(meetings.end_m - meetings.start_m, axis=1)[bent]
    turned_m = np.bincount(np.ravel(number), length_m * sine[bent], len(sides))
    radius_m = np.bincount(region, area_m2)[sides] / np.maximum(turned_m, np.finfo(float).tiny)[:, None]
    return np.isin(region, sides[radius_m < size_m])


def joined_faces(planes: Planes, meetings: Meetings) -> IntArray:
    """Return the number of the flat region, of faces in one plane that meet, of each face, shape (n_faces,)."""
    first, second = meetings.faces.T
    return _joined(len(planes.of_face), meetings.faces[planes.of_face[first] == planes.of_face[second]])
