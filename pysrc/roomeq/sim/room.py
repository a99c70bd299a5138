"""The interface that rooms of any shape share; see `roomeq.sim.scene.Shoebox` and `roomeq.sim.mesh.MeshRoom`."""

from collections.abc import Sequence
from typing import Protocol

from numpy.typing import ArrayLike

from roomeq.core.arrays import FloatArray
from roomeq.sim.walls import Walls


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
        """The walls of a convex room of few planes; None where rays search a tree of faces."""

    def require_inside(self, name: str, position_m: Sequence[float] | FloatArray) -> None:
        """Raise ValueError unless a position lies in the room and keeps a minimum distance from its surfaces."""

    def sphere_radius_m(self, center_m: ArrayLike, radius_m: float) -> float:
        """Radius of a receiver sphere, at most `radius_m`."""

    def sphere_volume_m3(self, center_m: ArrayLike, radius_m: float) -> float:
        """Volume of the part of a sphere that lies in the room."""
