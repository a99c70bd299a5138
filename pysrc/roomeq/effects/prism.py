"""Eigenmodes of a prism: a room with vertical walls between a level floor and a level ceiling.

They are the modes of the plan times cosines over the height, so a grid of one layer of voxels is enough.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from roomeq.core.arrays import FloatArray, IntArray
from roomeq.effects.voxels import VoxelShapes, plan_modes
from roomeq.sim.mesh import MeshRoom

PER_WAVELENGTH = 14.0  # voxels at the highest frequency
_ALIGNED = 1e-4  # largest deviation of a normal's component, and of a height [m]


@dataclass(frozen=True, eq=False)
class PrismShapes:
    """Shapes of the modes of a prism.

    Attributes
    ----------
    plan : VoxelShapes
    column : ndarray of int, shape (n_modes,)
        Mode of the plan, -1 for the constant one.
    index : ndarray of int, shape (n_modes,)
        Number of half-waves over the height.
    floor_m, height_m : float
    """

    plan: VoxelShapes
    column: IntArray
    index: IntArray
    floor_m: float
    height_m: float

    def __call__(self, position_m: ArrayLike) -> FloatArray:
        across = np.append(self.plan(position_m), 1.0)[self.column]
        z = (np.asarray(position_m, dtype=float)[2] - self.floor_m) / self.height_m
        return across * np.cos(np.pi * self.index * z) * np.where(self.index > 0, np.sqrt(2.0), 1.0)


def is_prism(room: MeshRoom) -> bool:
    """Tell whether all faces are vertical or lie in the lowest or the highest plane."""
    low, high = room.bounds_m
    vertical = np.abs(room.normals[:, 2]) < _ALIGNED
    z = room.triangles[:, :, 2]
    at_end = np.all(np.abs(z - low[2]) < _ALIGNED, axis=1) | np.all(np.abs(z - high[2]) < _ALIGNED, axis=1)
    return bool(np.all(vertical | at_end))


def prism_modes(room: MeshRoom, k_max: float) -> tuple[FloatArray, PrismShapes]:
    """Find the modes of a prism with rigid walls.

    Parameters
    ----------
    room : MeshRoom
        One for which `is_prism` holds.
    k_max : float
        Highest wave number [1/m].

    Returns
    -------
    k : ndarray, shape (n_modes,)
        Wave numbers [1/m], ascending, without the static mode.
    shapes : PrismShapes

    Raises
    ------
    ValueError
        See `roomeq.effects.voxels.voxel_modes`.
    """
    low, high = room.bounds_m
    height_m = float((high - low)[2])
    plan_k, plan = plan_modes(room, k_max, PER_WAVELENGTH)
    vertical_k = np.pi / height_m * np.arange(int(k_max * height_m / np.pi) + 1)
    k = np.hypot(np.append(plan_k, 0.0)[:, None], vertical_k)
    column, index = np.unravel_index(np.argsort(k, axis=None, kind="stable")[1:], k.shape)
    kept = k[column, index] <= k_max
    column, index = column[kept], index[kept]
    shapes = PrismShapes(plan, np.where(column < len(plan_k), column, -1), index, float(low[2]), height_m)
    return k[column, index], shapes
