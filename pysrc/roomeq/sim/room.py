"""The interface that rooms of any shape share; see `roomeq.sim.scene.Shoebox` and `roomeq.sim.mesh.MeshRoom`."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from roomeq.core.arrays import FloatArray, IntArray


@dataclass(frozen=True)
class Walls:
    """The planes around a convex room: the air is where ``normal . x > offset`` for all of them.

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
    """

    normals: FloatArray
    offsets: FloatArray
    face_surface: IntArray
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


class Room(Protocol):
    """A room: its surfaces by name, and the geometry that all steps of the simulation ask for."""

    @property
    def surfaces(self) -> tuple[str, ...]:
        """Names of the surfaces."""

    @property
    def convex(self) -> bool:
        """Whether every point of the room is visible from every other point."""

    @property
    def volume_m3(self) -> float:
        """Volume of the air."""

    @property
    def surface_area_m2(self) -> FloatArray:
        """Area of each surface, shape (n_surfaces,)."""

    @property
    def walls(self) -> Walls | None:
        """The planes of a convex room of few; None where rays are traced through a mesh."""

    def require_inside(self, name: str, position_m: Sequence[float] | FloatArray) -> None:
        """Raise ValueError unless a position lies in the room and keeps a minimum distance from its surfaces."""

    def sphere_radius_m(self, center_m: ArrayLike, radius_m: float) -> float:
        """Radius of a receiver sphere, at most `radius_m`."""

    def sphere_volume_m3(self, center_m: ArrayLike, radius_m: float) -> float:
        """Volume of the part of a sphere that lies in the room."""
