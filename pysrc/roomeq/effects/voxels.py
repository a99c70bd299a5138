"""Eigenmodes of a mesh room on a grid of voxels."""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy  # its submodules are slow to import and load themselves when first used
from numpy.typing import ArrayLike

from roomeq.core.arrays import Array, FloatArray, IntArray
from roomeq.sim.mesh import MeshRoom
from roomeq.sim.room import Room

PER_WAVELENGTH = 7.0  # voxels at the highest frequency
MAX_VOXELS = 200_000
MIN_JOINED = 0.9  # share of the air that the largest connected part must hold
_DIRECTIONS = np.array([[0.36, 0.48, 0.80], [-0.62, 0.71, -0.33], [0.19, -0.87, -0.46]])  # along no wall
_DEGREE = 16  # of the Chebyshev filter; even
_TOLERANCE = 1e-4
_K_STEP = 1.05  # ratio of the wave numbers up to which a room is solved: rows with other air and decay share a solution


class _Grid(NamedTuple):
    """Voxels in the air."""

    number: IntArray
    """Number of each voxel, -1 outside the air, shape (nx, ny, nz)."""
    laplacian: "scipy.sparse.csr_matrix"
    """Positive Laplacian between them [1/m^2]."""


class _Eigenpairs(NamedTuple):
    """Eigenvalues of a Laplacian, ascending, shape (n,) [1/m^2], and eigenvectors, shape (n_voxels, n)."""

    squared_k: FloatArray
    vectors: FloatArray


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

    A voxel belongs to the air if its centre does. Sound passes between neighbours whose centres see each other, so
    that walls thinner than a voxel separate them. Waves on a grid are slow,
    ``k_grid^2 = k^2 - h^2 (kx^4 + ky^4 + kz^4) / 12`` for voxels of size h; this is corrected by the mean over
    directions, ``k^4 / 5`` for each axis.

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
    k, shapes = _solve(room, _K_STEP ** np.ceil(np.log(k_max) / np.log(_K_STEP)), per_wavelength)
    n_modes = np.searchsorted(k, k_max, side="right")
    return k[:n_modes], replace(shapes, values=shapes.values[:, :n_modes])


@lru_cache(maxsize=8)
def _solve(room: MeshRoom, k_max: float, per_wavelength: float) -> tuple[FloatArray, "VoxelShapes"]:
    low, high = room.bounds_m
    shape = _grid_shape(room, np.maximum(np.ceil((high - low) * k_max * per_wavelength / (2.0 * np.pi)), 2).astype(int))
    if np.prod(shape) > MAX_VOXELS:
        raise ValueError(f"modes up to {k_max:.3g} rad/m need a grid of {np.prod(shape)} voxels and may have "
                         f"{MAX_VOXELS}: ask for a lower frequency or leave the modes of this room out")
    size_m = (high - low) / shape
    grid = _grid(room, low, size_m, shape)
    squared, values = _lowest(grid.laplacian, room, k_max)
    squared = np.maximum(squared, 0.0)
    k = np.sqrt(squared * (1.0 + np.mean(size_m ** 2) * squared / 20.0))
    kept = np.flatnonzero(k <= k_max)[1:]  # the first is the static mode
    values = (np.sqrt(len(values)) * values[:, kept]).astype(np.float32)
    return k[kept], VoxelShapes(room, low, size_m, grid.number, values)


@dataclass(frozen=True, eq=False)
class VoxelShapes:
    """Shapes of modes on a grid.

    Attributes
    ----------
    room : MeshRoom
    origin_m, size_m : ndarray, shape (3,)
        Corner of the grid, edges of a voxel.
    number : ndarray of int, shape (nx, ny, nz)
        Row of each voxel in `values`, -1 outside the air.
    values : ndarray, shape (n_voxels, n_modes)
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
    """Number the voxels in the air and set up the Laplacian between them."""
    centre = np.stack(np.meshgrid(*[np.arange(n) + 0.5 for n in shape], indexing="ij"), axis=-1) * size_m + low
    flat = centre.reshape(-1, 3)
    hits = [room.first_hits(flat, np.tile(direction / np.linalg.norm(direction), (len(flat), 1)))[0] >= 0
            for direction in _DIRECTIONS]
    inside = np.sum(hits, axis=0) >= 2
    index = np.arange(len(flat)).reshape(shape)
    pairs = []
    for axis in range(3):
        here = np.delete(index, -1, axis=axis).ravel()
        there = np.delete(index, 0, axis=axis).ravel()
        both = inside[here] & inside[there]
        here, there = here[both], there[both]
        open_ = room.sees(flat[here], flat[there])
        pairs.append((here[open_], there[open_], np.full(open_.sum(), size_m[axis] ** -2)))
    first, second, weight = (np.concatenate(part) for part in zip(*pairs, strict=True))
    joined = scipy.sparse.csr_array(scipy.sparse.coo_array((weight, (first, second)), shape=(len(flat), len(flat))))
    _, label = scipy.sparse.csgraph.connected_components(joined, directed=False)
    size = np.bincount(label[inside])
    if not inside.any() or size.max() < MIN_JOINED * inside.sum():
        raise ValueError(f"voxels of {np.round(size_m, 3).tolist()} m close openings of the room: its largest part "
                         f"that hangs together must hold {MIN_JOINED:.0%} of the air: leave its modes out or ask "
                         "for a higher frequency")
    kept = inside & (label == np.argmax(size))
    number = np.where(kept, np.cumsum(kept) - 1, -1)
    between = kept[first]
    first, second, weight = number[first[between]], number[second[between]], weight[between]
    n = kept.sum()
    half = scipy.sparse.coo_array((weight, (first, second)), shape=(n, n)).tocsr()
    whole = half + half.T
    diagonal = scipy.sparse.diags_array(np.asarray(whole.sum(axis=1)).ravel())
    return _Grid(number.reshape(shape), (diagonal - whole).tocsr())


def _lowest(laplacian: "scipy.sparse.csr_matrix", room: MeshRoom, k_max: float) -> _Eigenpairs:
    """Find all eigenvalues up to ``k_max^2`` and their eigenvectors, ascending.

    The lowest eigenvalues of a grid lie close together compared with its whole spectrum. A Chebyshev polynomial that
    is large on them and within [-1, 1] on the rest spreads them (Zhou and Saad, SIAM J. Matrix Anal. 29, 2007). This
    needs no factorisation of a three-dimensional matrix.
    """
    n = laplacian.shape[0]
    highest = 2.0 * laplacian.diagonal().max()
    start = np.random.default_rng(0).standard_normal(n).astype(np.float32)
    cut, wanted = 1.15 * k_max, int(mode_count(room, 1.05 * k_max)) + 8
    while True:
        wanted = min(wanted, n - 2)
        middle, half = 0.5 * (highest + cut ** 2), 0.5 * (highest - cut ** 2)
        scaled = ((laplacian - middle * scipy.sparse.diags_array(np.ones(n))) / half).tocsr().astype(np.float32)

        def filtered(vector: Array, scaled: "scipy.sparse.csr_matrix" = scaled) -> Array:
            previous, current = vector, scaled @ vector
            for _ in range(_DEGREE - 1):
                previous, current = current, 2.0 * (scaled @ current) - previous
            return current

        operator = scipy.sparse.linalg.LinearOperator((n, n), matvec=filtered, dtype=np.float32)
        _, vectors = scipy.sparse.linalg.eigsh(operator, k=wanted, which="LA", tol=_TOLERANCE, v0=start,
                                               ncv=min(n - 1, int(1.3 * wanted) + 20))
        vectors = vectors.astype(np.float64)
        squared = np.einsum("ij,ij->j", vectors, laplacian @ vectors)
        order = np.argsort(squared, kind="stable")
        if squared.max() > k_max ** 2 or wanted == n - 2:
            return _Eigenpairs(squared[order], vectors[:, order])
        cut, wanted = 1.1 * cut, int(1.3 * wanted)
