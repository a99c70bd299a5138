"""The lowest eigenvalues of a Laplacian on a grid, by filtered subspace iteration.

They lie close together compared with its whole spectrum. A Chebyshev polynomial that is large on them and within
[-1, 1] on the rest separates their subspace from random vectors, without a factorisation (Zhou, Saad, Tiago and
Chelikowsky, J. Comput. Phys. 219 (2006) 172). It is applied in several passes, between which the vectors are made
orthogonal: in one pass, single precision would lose the higher modes.
"""

from typing import NamedTuple

import numpy as np
import scipy  # its submodules are slow to import and load themselves when first used

from roomeq.core.arrays import Array, FloatArray

CUT = 1.1
"""Wave number up to which the filter is large, relative to the highest that is wanted."""
_SPARE = 20  # vectors, more than eigenvalues are expected up to there
_GAIN = 2.8  # logarithm of the filter's gain at the highest wave number that is wanted, in each pass
_PASSES = 5
_COLUMNS = 32  # that are filtered at once, so that they stay in the cache


class Eigenpairs(NamedTuple):
    """Eigenvalues of a Laplacian, ascending, shape (n,) [1/m^2], and eigenvectors, shape (n_rows, n)."""

    squared_k: FloatArray
    vectors: FloatArray


def lowest_eigenpairs(laplacian: "scipy.sparse.csr_matrix", expected: float, k_max: float) -> Eigenpairs:
    """Find all eigenvalues up to ``k_max^2`` and their eigenvectors, ascending.

    Parameters
    ----------
    laplacian : csr_matrix, shape (n, n)
        Symmetric, without negative eigenvalues [1/m^2].
    expected : float
        Number of eigenvalues that is expected up to ``(CUT k_max)^2``; more are found where there are more.
    k_max : float
        Highest wave number [1/m].
    """
    n = laplacian.shape[0]
    highest, cut = float(abs(laplacian).sum(axis=1).max()), CUT * k_max
    wanted = int(expected) + _SPARE
    middle, half = 0.5 * (highest + cut ** 2), 0.5 * (highest - cut ** 2)
    single = laplacian.astype(np.float32)
    scaled = ((single - np.float32(middle) * scipy.sparse.eye_array(n, dtype=np.float32)) / np.float32(half)).tocsr()
    degree = int(np.ceil(_GAIN / np.arccosh((middle - k_max ** 2) / half)))
    rng = np.random.default_rng(0)
    while True:
        vectors = rng.standard_normal((n, min(wanted, n)), dtype=np.float32)
        for _ in range(_PASSES):
            for first in range(0, vectors.shape[1], _COLUMNS):
                columns = slice(first, first + _COLUMNS)
                vectors[:, columns] = _filtered(scaled, np.ascontiguousarray(vectors[:, columns]), degree)
            vectors = _orthogonal(vectors)
        squared, rotation = np.linalg.eigh((vectors.T @ (single @ vectors)).astype(np.float64))
        if squared[-1] > cut ** 2 or wanted >= n:
            lowest = squared <= k_max ** 2
            return Eigenpairs(squared[lowest], (vectors @ rotation[:, lowest].astype(np.float32)).astype(np.float64))
        wanted = int(1.3 * wanted)


def _filtered(scaled: "scipy.sparse.csr_matrix", vectors: Array, degree: int) -> Array:
    """Apply the Chebyshev polynomial of a degree."""
    previous, current = vectors, scaled @ vectors
    for _ in range(degree - 1):
        previous, current = current, 2.0 * (scaled @ current) - previous
    return current


def _orthogonal(vectors: Array) -> Array:
    """Return an orthonormal basis of the space of some vectors, from their Gram matrix."""
    vectors = vectors / np.linalg.norm(vectors, axis=0)
    weight, rotation = np.linalg.eigh((vectors.T @ vectors).astype(np.float64))
    kept = weight > 1e-6 * weight[-1]
    return vectors @ (rotation[:, kept] / np.sqrt(weight[kept])).astype(np.float32)
