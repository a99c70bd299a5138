"""Image sources: early specular reflections with exact path lengths.

The image sources of a shoebox follow Allen and Berkley, J. Acoust. Soc. Am. 65 (1979) 943. For meshes,
`roomeq.sim.mesh` finds the sequences of reflecting planes. Each reflection multiplies the sound pressure by
``sqrt((1 - alpha) (1 - s))`` per octave band, independent of the angle of incidence, where alpha is the absorption and
s the scattering coefficient.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import ArrayLike

from roomeq.core.arrays import FloatArray, IntArray
from roomeq.sim.room import Room
from roomeq.sim.scene import Shoebox

if TYPE_CHECKING:
    from roomeq.sim.mesh import MeshRoom


@dataclass(frozen=True)
class SpecularPaths:
    """Specular paths from one source to one receiver, sorted by length.

    Attributes
    ----------
    distance_m
        Length of each path, shape (n_paths,).
    surface_counts
        Number of reflections of each path at each surface, shape (n_paths, n_surfaces).
    departure
        Direction in which each path leaves the source, unit vectors, shape (n_paths, 3).
    arrival
        Direction from the receiver in which each path arrives from, unit vectors, shape (n_paths, 3).
    """

    distance_m: FloatArray
    surface_counts: IntArray
    departure: FloatArray
    arrival: FloatArray

    @property
    def has_direct(self) -> bool:
        """Whether the direct path from source to receiver is unobstructed."""
        return bool(len(self.distance_m)) and not self.surface_counts[0].any()

    def gains(self, absorption: FloatArray, scattering: FloatArray, attenuation_per_m: FloatArray) -> FloatArray:
        """Return the sound pressure of each path in each band, shape (n_paths, n_bands).

        Without losses it is ``1 / (4 pi r)``.

        Parameters
        ----------
        absorption, scattering
            Shape (n_surfaces, n_bands).
        attenuation_per_m
            Energy attenuation of the air [1/m], shape (n_bands,).
        """
        log_reflected = np.log(np.maximum((1.0 - absorption) * (1.0 - scattering), 1e-200))
        exponent = self.surface_counts @ log_reflected - self.distance_m[:, None] * attenuation_per_m
        return np.exp(0.5 * exponent) / (4.0 * np.pi * self.distance_m[:, None])


def specular_paths(room: Room, source_pos_m: ArrayLike, mic_pos_m: ArrayLike, order: int) -> SpecularPaths:
    """Find the purely specular paths with at most `order` reflections, including the direct sound."""
    if not isinstance(room, Shoebox):
        return cast("MeshRoom", room).specular_paths(source_pos_m, mic_pos_m, order)
    lattice, surface_counts = image_lattice(order)
    dims_m = np.array(room.dims_m)
    source = np.asarray(source_pos_m, dtype=np.float64)
    images = lattice * dims_m + np.where(lattice % 2 == 0, source, dims_m - source)
    path = np.asarray(mic_pos_m, dtype=np.float64) - images
    distance_m = np.linalg.norm(path, axis=1)
    # the direction of departure is that at the image source, with the sign of each axis changed if the number of
    # reflections along the axis is odd
    departure = np.where(lattice % 2 == 0, path, -path) / distance_m[:, None]
    by_length = np.argsort(distance_m, kind="stable")
    arrival = -path / distance_m[:, None]
    return SpecularPaths(distance_m[by_length], surface_counts[by_length], departure[by_length], arrival[by_length])


@lru_cache(maxsize=8)
def image_lattice(order: int) -> tuple[IntArray, IntArray]:
    """Return the cells of the image lattice up to an order, and the number of reflections at each of the six walls."""
    axis = np.arange(-order, order + 1)
    cells = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    cells = cells[np.abs(cells).sum(axis=1) <= order]
    far = np.where(cells > 0, (cells + 1) // 2, -cells // 2)
    near = np.abs(cells) - far
    counts = np.stack([near, far], axis=-1).reshape(-1, 6)
    return cells, counts
