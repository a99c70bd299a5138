"""Image sources: the early specular reflections, exact in time and level.

Allen and Berkley, J. Acoust. Soc. Am. 65 (1979) 943, for boxes; meshes find their plane sequences in
`roomeq.sim.mesh`. A reflection keeps the amplitude ``sqrt((1 - alpha) (1 - s))`` per band.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np


@dataclass(frozen=True)
class SpecularPaths:
    """Specular paths from one source to one receiver, sorted by length.

    Attributes
    ----------
    distance_m : ndarray, shape (n_paths,)
        Length of each path.
    surface_counts : ndarray of int, shape (n_paths, n_surfaces)
        How often it is reflected by each surface.
    departure : ndarray, shape (n_paths, 3)
        Unit vector in which it leaves the source.
    """

    distance_m: np.ndarray
    surface_counts: np.ndarray
    departure: np.ndarray

    @property
    def has_direct(self):
        """Whether the source is seen from the receiver."""
        return bool(len(self.distance_m)) and not self.surface_counts[0].any()

    def gains(self, absorption, scattering, attenuation_per_m):
        """Pressure per band relative to 1 m from a source of unit strength over 4 pi, shape (n_paths, 8).

        Parameters
        ----------
        absorption, scattering : ndarray, shape (n_surfaces, 8)
        attenuation_per_m : ndarray, shape (8,)
        """
        log_kept = np.log(np.maximum((1.0 - absorption) * (1.0 - scattering), 1e-200))
        exponent = self.surface_counts @ log_kept - self.distance_m[:, None] * attenuation_per_m
        return np.exp(0.5 * exponent) / (4.0 * np.pi * self.distance_m[:, None])


def specular_paths(room, source_pos_m, mic_pos_m, order):
    """Find the purely specular paths with at most `order` reflections, the direct sound among them.

    Parameters
    ----------
    room : Shoebox or MeshRoom
    source_pos_m, mic_pos_m : array_like, shape (3,)
    order : int

    Returns
    -------
    SpecularPaths
    """
    if hasattr(room, "specular_paths"):
        return room.specular_paths(source_pos_m, mic_pos_m, order)
    lattice, surface_counts = _lattice(order)
    dims_m = np.array(room.dims_m)
    source = np.asarray(source_pos_m, dtype=np.float64)
    images = lattice * dims_m + np.where(lattice % 2 == 0, source, dims_m - source)
    way = np.asarray(mic_pos_m, dtype=np.float64) - images
    distance_m = np.linalg.norm(way, axis=1)
    # what leaves an image leaves the source mirrored along each axis with an odd number of reflections
    departure = np.where(lattice % 2 == 0, way, -way) / distance_m[:, None]
    by_length = np.argsort(distance_m, kind="stable")
    return SpecularPaths(distance_m[by_length], surface_counts[by_length], departure[by_length])


@lru_cache(maxsize=8)
def _lattice(order):
    """Cells of the image lattice up to an order, and how often a path to each meets the six walls."""
    axis = np.arange(-order, order + 1)
    cells = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    cells = cells[np.abs(cells).sum(axis=1) <= order]
    far = np.where(cells > 0, (cells + 1) // 2, -cells // 2)
    near = np.abs(cells) - far
    counts = np.stack([near, far], axis=-1).reshape(-1, 6)
    return cells, counts
