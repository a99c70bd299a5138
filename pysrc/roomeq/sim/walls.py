"""The walls of a convex room of few planes."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from roomeq.core.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class Walls:
    """The walls of a convex room. The air is in front of all of them, where ``normal . x > offset``.

    Attributes
    ----------
    normals
        Shape (n_walls, 3).
    offsets
        Shape (n_walls,).
    face_surface
        Surface of each wall, shape (n_walls,).
    curved
        Whether each wall is a facet of a curved surface, shape (n_walls,).
    size_m
        Of the box around the room, shape (3,).
    """

    normals: FloatArray
    offsets: FloatArray
    face_surface: IntArray
    curved: BoolArray
    size_m: FloatArray

    @cached_property
    def box(self) -> tuple[FloatArray, FloatArray, IntArray] | None:
        """Low and high corner [m], and the wall on the low and high side of each axis, shape (3, 2); None if no box.

        A box has six walls along the axes.
        """
        axis, up = np.argmax(np.abs(self.normals), axis=1), self.normals.sum(axis=1) < 0.0
        wall_of_side = np.full((3, 2), -1)
        wall_of_side[axis, up.astype(int)] = np.arange(len(axis))
        if len(axis) != 6 or wall_of_side.min() < 0 or np.count_nonzero(self.normals) != 6:
            return None
        return self.offsets[wall_of_side[:, 0]], -self.offsets[wall_of_side[:, 1]], wall_of_side
