"""Triangles of a mesh that a point sees as a whole: no shadow ray need be traced from their reflections.

Nothing hides a part of a triangle from a point if no other one reaches into the tetrahedron between both. One that some
plane separates from the tetrahedron does not. Of the planes that may, those of the two triangles and those through the
point and a side are tried. A triangle that none of them separates counts as one that hides: a few that are seen are
then not found, and never one that is not.
"""

import numpy as np

from roomeq.core.arrays import BoolArray, FloatArray
from roomeq.core.jit import compiled

MAX_TRIANGLES = 300
"""Of a mesh that is searched: the time grows with the square of their number, and small ones hide one another."""
_TOUCH_M = 1e-7  # up to which triangles touch, and none reaches into the space of another


def triangles_in_sight(triangles: FloatArray, normals: FloatArray, points_m: FloatArray) -> BoolArray:
    """Tell which triangles some points surely see as a whole, shape (n_points, n_triangles).

    Parameters
    ----------
    triangles : ndarray, shape (n_triangles, 3, 3)
    normals : ndarray, shape (n_triangles, 3)
        Unit normals into the air.
    points_m : ndarray, shape (n_points, 3)
    """
    seen = np.zeros((len(points_m), len(triangles)), dtype=bool)
    if len(triangles) <= MAX_TRIANGLES:
        _search(np.ascontiguousarray(triangles), np.ascontiguousarray(normals), points_m.astype(np.float64), seen)
    return seen


@compiled
def _search(triangles: FloatArray, normals: FloatArray, points_m: FloatArray, seen: BoolArray) -> None:
    sides, heights = np.empty((3, 3)), np.empty(3)
    for point in range(len(points_m)):
        apex = points_m[point]
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
            hidden = flat
            for other in range(len(triangles)):
                if hidden or other == face:
                    continue
                corner = triangles[other]
                apart = max(_dot(normal, corner[0], corners[0]), _dot(normal, corner[1], corners[0]),
                            _dot(normal, corner[2], corners[0])) <= _TOUCH_M
                for side in range(3):
                    apart = apart or min(_dot(sides[side], corner[0], apex), _dot(sides[side], corner[1], apex),
                                         _dot(sides[side], corner[2], apex)) >= -_TOUCH_M
                for k in range(3):
                    heights[k] = _dot(normals[other], corners[k], corner[0])
                height = _dot(normals[other], apex, corner[0])
                hidden = not (apart or min(height, heights.min()) >= -_TOUCH_M
                              or max(height, heights.max()) <= _TOUCH_M)
            seen[point, face] = not hidden


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
