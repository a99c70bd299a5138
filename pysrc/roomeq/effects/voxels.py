"""Eigenmodes of a mesh room on a grid of voxels."""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy  # its submodules are slow to import and load themselves when first used
from numpy.typing import ArrayLike

from roomeq.core.arrays import Array, BoolArray, FloatArray, IntArray
from roomeq.effects.eigenpairs import CUT, lowest_eigenpairs
from roomeq.sim.mesh import MeshRoom
from roomeq.sim.room import Room

PER_WAVELENGTH = 7.0  # voxels at the highest frequency
MAX_VOXELS = 200_000
MIN_JOINED = 0.9  # share of the air that the largest connected part must hold
_PARTS = 4  # of a voxel's edge, where a surface cuts the voxel
_LEAST_SHARE = 0.5  # of air in a voxel; one with less joins a neighbour
_DIRECTIONS = np.array([[0.36, 0.48, 0.80], [-0.62, 0.71, -0.33], [0.19, -0.87, -0.46]])  # along no wall
_K_STEP = 1.05  # ratio of the wave numbers up to which a room is solved: rows with other air and decay share a solution


class _Grid(NamedTuple):
    """Voxels that hold air."""

    number: IntArray
    """Row of each voxel, -1 without air, shape (nx, ny, nz); a voxel with little air has the row of a neighbour."""
    share: FloatArray
    """Air of each row, relative to the volume of a voxel, shape (n_rows,)."""
    flux: tuple["scipy.sparse.csr_matrix", ...]
    """Positive Laplacian of each axis, integrated over the air of a row [1/m^2]."""


class _Openings(NamedTuple):
    """Faces between neighbouring voxels: flat indices of both, and the open share of each, shape (n,)."""

    here: IntArray
    there: IntArray
    share: FloatArray


def mode_count(room: Room, k_max: float) -> float:
    """Return the expected number of modes up to a wave number: ``V k^3 / (6 pi^2) + S k^2 / (16 pi)``.

    Kuttruff, Room Acoustics, eq. 3.20, without the term of the edges.

    Parameters
    ----------
    room : Shoebox or MeshRoom
    k_max : float
        [1/m]
    """
    return room.volume_m3 * k_max ** 3 / (6.0 * np.pi ** 2) + room.surface_area_m2.sum() * k_max ** 2 / (16.0 * np.pi)


def voxel_modes(room: MeshRoom, k_max: float,
                per_wavelength: float = PER_WAVELENGTH) -> tuple[FloatArray, "VoxelShapes"]:
    """Find eigenmodes of the Laplacian with rigid walls, by finite volumes on a grid of voxels.

    Where a surface cuts a voxel, the voxel counts with the share of its volume that is air, and sound passes to a
    neighbour through the share of their common face that is open. Sound does not pass between neighbours whose centres
    are in the air and do not see each other, so that walls thinner than a voxel separate them. Waves on a grid are
    slow, ``k_grid^2 = k^2 - h^2 (kx^4 + ky^4 + kz^4) / 12`` for voxels of size h; this is corrected for each mode by
    perturbation of first order, with its own fourth derivatives.

    Parameters
    ----------
    room : MeshRoom
    k_max : float
        Highest wave number [1/m].
    per_wavelength : float
        Voxels per wavelength at `k_max`.

    Returns
    -------
    k : ndarray, shape (n_modes,)
        Wave numbers [1/m], ascending, without the static mode.
    shapes : VoxelShapes

    Raises
    ------
    ValueError
        More than `MAX_VOXELS` are needed, or voxels are so large that they close openings of the room.
    """
    k, shapes = _solve(room, k_step(k_max), per_wavelength, mode_count(room, CUT * k_step(k_max)), False)
    n_modes = np.searchsorted(k, k_max, side="right")
    return k[:n_modes], replace(shapes, values=shapes.values[:, :n_modes])


def plan_modes(room: MeshRoom, k_max: float, per_wavelength: float) -> tuple[FloatArray, "VoxelShapes"]:
    """Find the eigenmodes of a prism that do not depend on height; as `voxel_modes`, with one layer of voxels."""
    low, high = room.bounds_m
    area_m2 = room.volume_m3 / (high - low)[2]
    around_m = (room.surface_area_m2.sum() - 2.0 * area_m2) / (high - low)[2]
    cut = CUT * k_step(k_max)
    return _solve(room, k_step(k_max), per_wavelength, (area_m2 * cut ** 2 + around_m * cut) / (4.0 * np.pi), True)


def k_step(k_max: float) -> float:
    """Return the wave number up to which a room is solved."""
    return float(_K_STEP ** np.ceil(np.log(k_max) / np.log(_K_STEP)))


@lru_cache(maxsize=8)
def _solve(room: MeshRoom, k_max: float, per_wavelength: float, expected: float,
           flat: bool) -> tuple[FloatArray, "VoxelShapes"]:
    low, high = room.bounds_m
    shape = _grid_shape(room, np.maximum(np.ceil((high - low) * k_max * per_wavelength / (2.0 * np.pi)), 2).astype(int))
    if flat:
        shape[2] = 1
    if np.prod(shape) > MAX_VOXELS:
        raise ValueError(f"modes up to {k_max:.3g} rad/m need a grid of {np.prod(shape)} voxels and may have "
                         f"{MAX_VOXELS}: ask for a lower frequency or leave the modes of this room out")
    size_m = (high - low) / shape
    grid = _grid(room, low, size_m, shape)
    root = scipy.sparse.diags_array(grid.share ** -0.5)
    axes = [(root @ flux @ root).tocsr() for flux in grid.flux]
    squared, vectors = lowest_eigenpairs(sum(axes[1:], axes[0]), expected, k_max)
    slow = sum(edge_m ** 2 / 12.0 * np.sum((axis @ vectors) ** 2, axis=0)
               for edge_m, axis in zip(size_m, axes, strict=True))
    k = np.sqrt(np.maximum(squared + slow, 0.0))
    order = np.argsort(k, kind="stable")[1:]  # the first is the static mode
    order = order[k[order] <= k_max]
    values = (np.sqrt(grid.share.sum()) * (root @ vectors[:, order])).astype(np.float32)
    return k[order], VoxelShapes(room, low, size_m, grid.number, values)


@dataclass(frozen=True, eq=False)
class VoxelShapes:
    """Shapes of modes on a grid.

    Attributes
    ----------
    room : MeshRoom
    origin_m, size_m : ndarray, shape (3,)
        Corner of the grid, edges of a voxel.
    number : ndarray of int, shape (nx, ny, nz)
        Row of each voxel in `values`, -1 where there is no air.
    values : ndarray, shape (n_rows, n_modes)
    """

    room: MeshRoom
    origin_m: FloatArray
    size_m: FloatArray
    number: IntArray
    values: Array

    def __call__(self, position_m: ArrayLike) -> FloatArray:
        """Interpolate linearly between the centres of those surrounding voxels that the position sees."""
        place = (np.asarray(position_m, dtype=float) - self.origin_m) / self.size_m - 0.5
        corner = np.stack(np.meshgrid(*[[0, 1]] * 3, indexing="ij"), axis=-1).reshape(8, 3)
        base = np.floor(place).astype(int)
        weight = np.prod(np.where(corner == 1, place - base, 1.0 - (place - base)), axis=1)
        # beyond the last centre the pressure is constant: its slope at a rigid wall is zero
        voxel = np.clip(base + corner, 0, np.array(self.number.shape) - 1)
        row = self.number[tuple(voxel.T)]
        usable = (row >= 0) & (weight > 1e-9)
        centre = self.origin_m + (voxel + 0.5) * self.size_m
        usable[usable] = self.room.sees(centre[usable] + 1e-6, np.asarray(position_m, dtype=float))
        if not usable.any():
            voxels = np.argwhere(self.number >= 0)
            distance = np.linalg.norm(self.origin_m + (voxels + 0.5) * self.size_m - np.asarray(position_m), axis=1)
            return self.values[self.number[tuple(voxels[np.argmin(distance)])]]
        return weight[usable] @ self.values[row[usable]] / weight[usable].sum()


def _grid_shape(room: MeshRoom, least: IntArray) -> IntArray:
    """Choose the number of voxels along each axis, at least `least`, so that walls lie between voxels."""
    low, high = room.bounds_m
    a, b, c = room.triangles.transpose(1, 0, 2)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    chosen = []
    for axis, first in enumerate(least):
        across = np.abs(room.normals[:, axis]) > 0.999
        place = (a[across, axis] - low[axis]) / (high[axis] - low[axis])
        numbers = np.arange(first, int(1.15 * first) + 2)
        off = np.abs(np.outer(numbers, place) - np.rint(np.outer(numbers, place)))
        chosen.append(numbers[np.argmin(np.round(off @ area[across] / numbers, 9))])
    return np.array(chosen)


def _grid(room: MeshRoom, low: FloatArray, size_m: FloatArray, shape: IntArray) -> _Grid:
    """Find the air of the voxels and set up the Laplacian between them, by finite volumes."""
    air = _air(room, low, size_m, shape)
    share = air.reshape(*np.column_stack([shape, [_PARTS] * 3]).ravel()).mean(axis=(1, 3, 5)).ravel()
    centre = (np.stack(np.meshgrid(*[np.arange(n) + 0.5 for n in shape], indexing="ij"), axis=-1) * size_m + low)
    openings = [_openings(room, air, centre.reshape(-1, 3), axis) for axis in range(3)]
    row = _rows(share, openings, size_m)
    n_rows = int(row.max()) + 1
    flux = []
    for (here, there, open_), edge_m in zip(openings, size_m, strict=True):
        between = (row[here] >= 0) & (row[there] >= 0) & (row[here] != row[there])
        half = scipy.sparse.coo_array((open_[between] / edge_m ** 2, (row[here[between]], row[there[between]])),
                                      shape=(n_rows, n_rows)).tocsr()
        whole = half + half.T
        flux.append((scipy.sparse.diags_array(np.asarray(whole.sum(axis=1)).ravel()) - whole).tocsr())
    held = np.zeros(n_rows)
    np.add.at(held, row[row >= 0], share[row >= 0])
    return _Grid(row.reshape(shape), held, tuple(flux))


def _openings(room: MeshRoom, air: BoolArray, centre: FloatArray, axis: int) -> _Openings:
    """Find the open share of the faces between voxels that are neighbours along an axis."""
    shape = np.array(air.shape) // _PARTS
    last, first = (np.moveaxis(air, axis, 0)[start::_PARTS] for start in (_PARTS - 1, _PARTS))
    across = np.delete(shape, axis)
    both = (last[:len(first)] & first).reshape(len(first), across[0], _PARTS, across[1], _PARTS)
    share = np.moveaxis(both.mean(axis=(2, 4)), 0, axis).ravel()
    index = np.arange(shape.prod()).reshape(shape)
    here, there = (np.delete(index, end, axis=axis).ravel() for end in (-1, 0))
    here, there, share = here[share > 0.0], there[share > 0.0], share[share > 0.0]
    parts = air.reshape(*np.column_stack([shape, [_PARTS] * 3]).ravel())
    middle = slice(_PARTS // 2 - 1, _PARTS // 2 + 1)
    centre_air = parts[:, middle, :, middle, :, middle].all(axis=(1, 3, 5)).ravel()
    tested = np.flatnonzero(centre_air[here] & centre_air[there])
    share[tested] *= room.sees(centre[here[tested]], centre[there[tested]])
    return _Openings(here[share > 0.0], there[share > 0.0], share[share > 0.0])


def _air(room: MeshRoom, low: FloatArray, size_m: FloatArray, shape: IntArray) -> BoolArray:
    """Tell which of the `_PARTS` parts of the voxels along each axis are in the air, shape ``_PARTS * shape``.

    All parts of a voxel are as its corners, where these are the same.
    """
    corner = np.stack(np.meshgrid(*[np.clip(np.arange(n + 1), 1e-3, n - 1e-3) for n in shape], indexing="ij"), axis=-1)
    solid = ~_inside(room, (corner * size_m + low).reshape(-1, 3)).reshape(shape + 1)
    count = sum(solid[x:x + shape[0], y:y + shape[1], z:z + shape[2]].astype(int)
                for x in (0, 1) for y in (0, 1) for z in (0, 1))
    air = np.repeat(np.repeat(np.repeat(count == 0, _PARTS, axis=0), _PARTS, axis=1), _PARTS, axis=2)
    cut = np.argwhere((count > 0) & (count < 8))
    step = np.stack(np.meshgrid(*[np.arange(_PARTS)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    part = (_PARTS * cut[:, None] + step).reshape(-1, 3)
    air[tuple(part.T)] = _inside(room, (part + 0.5) / _PARTS * size_m + low)
    return air


def _inside(room: MeshRoom, points_m: FloatArray) -> BoolArray:
    """Tell which points, shape (n, 3), are in the air: there rays meet the front of a face, in two of three directions.

    A ray that passes exactly through an edge may err.
    """
    hits = [room.first_hits(points_m, np.tile(direction / np.linalg.norm(direction), (len(points_m), 1)))[0] >= 0
            for direction in _DIRECTIONS]
    return np.sum(hits, axis=0) >= 2


def _rows(share: FloatArray, openings: list[_Openings], size_m: FloatArray) -> IntArray:
    """Number the voxels of the largest connected part of the air, -1 elsewhere.

    A voxel with little air would make the Laplacian stiff. It joins the neighbour to which it is most open.
    """
    here, there, open_ = (np.concatenate(parts) for parts in zip(*openings, strict=True))
    joined = scipy.sparse.csr_array(scipy.sparse.coo_array((open_, (here, there)), shape=(len(share),) * 2))
    _, label = scipy.sparse.csgraph.connected_components(joined, directed=False)
    air = np.bincount(label, share)
    if air.sum() == 0.0 or air.max() < MIN_JOINED * air.sum():
        raise ValueError(f"voxels of {np.round(size_m, 3).tolist()} m close openings of the room: its largest part "
                         f"that hangs together must hold {MIN_JOINED:.0%} of the air: leave its modes out or ask "
                         "for a higher frequency")
    large = (share >= _LEAST_SHARE) & (label == np.argmax(air))
    row = np.where(large, np.cumsum(large) - 1, -1)
    little, neighbour = np.append(here, there), np.append(there, here)
    usable = ~large[little] & large[neighbour]
    order = np.argsort(np.append(open_, open_)[usable], kind="stable")  # the widest opening is assigned last
    row[little[usable][order]] = row[neighbour[usable][order]]
    return row
