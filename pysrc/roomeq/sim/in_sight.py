"""Triangles of a mesh that a point sees as a whole: no shadow ray need be traced from their reflections.

Nothing hides a part of a triangle from a point if no other one reaches into the tetrahedron between both. One that some
plane separates from the tetrahedron does not. If there is such a plane, there is one that is parallel to a face of
either, or to an edge of both (Gottschalk, Lin and Manocha, SIGGRAPH 1996, 171). A triangle that none of them separates
hides.
"""

import numpy as np

from roomeq.core.arrays import BoolArray, FloatArray
from roomeq.core.jit import compiled

MAX_TRIANGLES = 300
"""Of a mesh that is searched: the time grows with the square of their number, and small ones hide one another."""
_PARALLEL = 1e-6  # sine of the angle between edges that have no plane of their own
_TOUCH_M = 1e-7  # up to which triangles touch, and none reaches into the space of another


def triangles_in_sight(triangles: FloatArray, normals: FloatArray, point_m: FloatArray) -> BoolArray:
    """Tell which triangles a point surely sees as a whole, shape (n_triangles,).

    Parameters
    ----------
    triangles : ndarray, shape (n_triangles, 3, 3)
    normals : ndarray, shape (n_triangles, 3)
        Unit normals into the air.
    point_m : ndarray, shape (3,)
    """
    seen = np.zeros(len(triangles), dtype=bool)
    if len(triangles) <= MAX_TRIANGLES:
        _search(np.ascontiguousarray(triangles), np.ascontiguousarray(normals), point_m.astype(np.float64), seen)
    return seen


@compiled
def _search(triangles: FloatArray, normals: FloatArray, apex: FloatArray, seen: BoolArray) -> None:
    sides, edges = np.empty((3, 3)), np.empty((6, 3))
    for face in range(len(triangles)):
        corners, normal = triangles[face], normals[face]
        if _dot(normal, apex, corners[0]) <= _TOUCH_M:
            continue
        flat = False
        for side in range(3):  # its plane, out of the tetrahedron
            one, other, third = corners[side], corners[(side + 1) % 3], corners[(side + 2) % 3]
            _cross(one, other, apex, sides[side])
            length = np.sqrt(np.sum(sides[side] ** 2))
            height = _dot(sides[side], third, apex)
            flat = flat or abs(height) <= _TOUCH_M * length
            sides[side] /= -length if height > 0.0 else length
            edges[side], edges[3 + side] = one - apex, other - one
        hidden = flat
        for other in range(len(triangles)):
            if hidden or other == face:
                continue
            corner = triangles[other]
            apart = _lie_apart(normal, apex, corners, corner) or _lie_apart(normals[other], apex, corners, corner)
            for side in range(3):
                apart = apart or _lie_apart(sides[side], apex, corners, corner)
            hidden = not (apart or _edges_lie_apart(edges, apex, corners, corner))
        seen[face] = not hidden


@compiled
def _lie_apart(axis: FloatArray, apex: FloatArray, corners: FloatArray, other: FloatArray) -> bool:
    """Tell whether a plane across a unit vector separates the tetrahedron over a triangle from another triangle."""
    a, b, c = _dot(axis, corners[0], apex), _dot(axis, corners[1], apex), _dot(axis, corners[2], apex)
    u, v, w = _dot(axis, other[0], apex), _dot(axis, other[1], apex), _dot(axis, other[2], apex)
    return (min(u, v, w) >= max(0.0, a, b, c) - _TOUCH_M) or (max(u, v, w) <= min(0.0, a, b, c) + _TOUCH_M)


@compiled
def _edges_lie_apart(edges: FloatArray, apex: FloatArray, corners: FloatArray, other: FloatArray) -> bool:
    """Tell whether a plane parallel to an edge of the tetrahedron and one of the other triangle separates them."""
    axis, origin = np.empty(3), np.zeros(3)
    for n in range(3):
        way = other[(n + 1) % 3] - other[n]
        for edge in edges:
            _cross(edge, way, origin, axis)
            length = np.sqrt(np.sum(axis ** 2))
            if length > _PARALLEL * np.sqrt(np.sum(edge ** 2) * np.sum(way ** 2)):
                axis /= length
                if _lie_apart(axis, apex, corners, other):
                    return True
    return False


@compiled
def _dot(direction: FloatArray, point: FloatArray, origin: FloatArray) -> float:
    """Return how far a point lies along a direction from an origin."""
    return (direction[0] * (point[0] - origin[0]) + direction[1] * (point[1] - origin[1])
            + direction[2] * (point[2] - origin[2]))


@compiled
def _cross(one: FloatArray, other: FloatArray, apex: FloatArray, product: FloatArray) -> None:
    """Compute the normal of a plane through three points, of any length."""
    a, b, c = one[0] - apex[0], one[1] - apex[1], one[2] - apex[2]
    u, v, w = other[0] - apex[0], other[1] - apex[1], other[2] - apex[2]
    product[0], product[1], product[2] = b * w - c * v, c * u - a * w, a * v - b * u
