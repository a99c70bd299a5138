"""The walls of a room of few planes, and whether they obstruct a line."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from roomeq.core.arrays import Array, BoolArray, FloatArray, IntArray, Number
from roomeq.core.jit import compiled, for_chunks, inlined

_EDGE_M = 1e-6  # by which walls overlap, so that no ray passes between two of them
_TOUCH_M = 1e-4  # from its end, where a line may touch a wall


@dataclass(frozen=True)
class Walls:
    """The walls of a room of few planes. The air is in front of a wall, where ``normal . x > offset``.

    Attributes
    ----------
    normals
        Shape (n_walls, 3).
    offsets
        Shape (n_walls,).
    face_surface
        Surface of each wall, shape (n_walls,).
    size_m
        Of the box around the room, shape (3,).
    edges
        Edges of the triangles that a wall consists of, wall by wall, shape (n_triangles, 3, 4): a point of the plane is
        in a triangle if ``edge[:3] . x >= edge[3]`` for its three edges. None are needed where the air is in front of
        all walls.
    first
        Index of each wall's first triangle, and their number, shape (n_walls + 1,).
    """

    normals: FloatArray
    offsets: FloatArray
    face_surface: IntArray
    size_m: FloatArray
    edges: FloatArray
    first: IntArray

    @classmethod
    def around(cls, normals: FloatArray, offsets: FloatArray, face_surface: IntArray, size_m: FloatArray) -> "Walls":
        """Return the walls of a convex room, whose air is in front of all of them."""
        return cls(normals, offsets, face_surface, size_m, np.empty((0, 3, 4)), np.zeros(len(normals) + 1, np.int64))

    @cached_property
    def box(self) -> tuple[FloatArray, FloatArray, IntArray] | None:
        """Low and high corner [m], and the wall on the low and high side of each axis, shape (3, 2); None if no box.

        A box has six walls along the axes.
        """
        axis, up = np.argmax(np.abs(self.normals), axis=1), self.normals.sum(axis=1) < 0.0
        wall_of_side = np.full((3, 2), -1)
        wall_of_side[axis, up.astype(int)] = np.arange(len(axis))
        if len(self.edges) or len(axis) != 6 or wall_of_side.min() < 0 or np.count_nonzero(self.normals) != 6:
            return None
        return self.offsets[wall_of_side[:, 0]], -self.offsets[wall_of_side[:, 1]], wall_of_side

    def sees(self, from_m: FloatArray, to_m: FloatArray) -> BoolArray:
        """Return whether each line from one point in the air to another, or on a wall, is unobstructed.

        Parameters
        ----------
        from_m, to_m : ndarray, shape (n, 3)
        """
        result = np.empty(len(from_m), np.bool_)

        def of_chunk(chunk: int, low: int, high: int) -> None:
            _sees(self.normals, self.offsets, self.edges, self.first, from_m[low:high], to_m[low:high],
                  result[low:high])

        for_chunks(len(from_m), of_chunk)
        return result


@inlined
def holds(edges: Array, first: Array, wall: Number, x: Number, y: Number, z: Number) -> bool:
    """Tell whether a wall holds a point of its plane."""
    for n in range(first[wall], first[wall + 1]):
        if (edges[n, 0, 0] * x + edges[n, 0, 1] * y + edges[n, 0, 2] * z > edges[n, 0, 3] - _EDGE_M
                and edges[n, 1, 0] * x + edges[n, 1, 1] * y + edges[n, 1, 2] * z > edges[n, 1, 3] - _EDGE_M
                and edges[n, 2, 0] * x + edges[n, 2, 1] * y + edges[n, 2, 2] * z > edges[n, 2, 3] - _EDGE_M):
            return True
    return first[wall] == first[wall + 1]


@compiled
def _sees(normals: Array, offsets: Array, edges: Array, first: Array, from_m: Array, to_m: Array,
          result: Array) -> None:
    """Tell which lines cross no wall from the front: a line that begins in the air leaves it first through a front."""
    for n in range(len(from_m)):
        x, y, z = from_m[n, 0], from_m[n, 1], from_m[n, 2]
        u, v, w = to_m[n, 0] - x, to_m[n, 1] - y, to_m[n, 2] - z
        most = 1.0 - _TOUCH_M / np.sqrt(u * u + v * v + w * w)
        result[n] = True
        for wall in range(len(normals)):
            height = normals[wall, 0] * x + normals[wall, 1] * y + normals[wall, 2] * z - offsets[wall]
            fall = -(normals[wall, 0] * u + normals[wall, 1] * v + normals[wall, 2] * w)
            if 0.0 < height < most * fall:
                share = height / fall
                if holds(edges, first, wall, x + share * u, y + share * v, z + share * w):
                    result[n] = False
                    break
