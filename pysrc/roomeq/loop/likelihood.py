"""Likelihood of residuals: features scatter within and between rooms, and outliers count linearly (Huber's loss)."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from roomeq.core.arrays import Array, BoolArray, FloatArray, IntArray
from roomeq.core.jit import compiled
from roomeq.loop.data import Data
from roomeq.loop.features import METRIC, N_FEATURES
from roomeq.loop.packing import Derivatives, ParameterIndex

_HUBER = 3.0  # standard deviations from which on a residual counts linearly
_LARGEST = 15.0  # deviation that is no outlier [JND]
_SIGMA = (0.7, 12.0)  # limits of the scatter within rooms [JND]
_OMEGA = (0.2, 12.0)  # limits of the scatter between rooms [JND]
_OMEGA_FLOOR = 1.0
"""Largest scatter between rooms of the noise after the response [JND]. Noise is its only cause, so that another noise
in each room is a finding and not a scatter."""


@dataclass(frozen=True)
class NormalEquations:
    """A room's least squares problem about a point, whitened: products summed over its RIRs and features.

    Attributes
    ----------
    own_own : ndarray, shape (n_own, n_own)
        Derivatives by the room's own parameters with themselves.
    own_shared : ndarray, shape (n_own, n_columns)
        With the derivatives by the shared parameters on which the room depends.
    shared_shared : ndarray, shape (n_columns, n_columns)
    own_residual : ndarray, shape (n_own,)
        Derivatives by the room's own parameters with the residual.
    shared_residual : ndarray, shape (n_columns,)
    residual_residual : float
        Sum of the squares of the residual.
    log_scale : float
        Logarithm of the density's scale.
    columns : ndarray of int, shape (n_columns,)
        Of these parameters among all shared ones (`ParameterIndex.columns`).
    """

    own_own: FloatArray
    own_shared: FloatArray
    shared_shared: FloatArray
    own_residual: FloatArray
    shared_residual: FloatArray
    residual_residual: float
    log_scale: float
    columns: IntArray


@compiled
def add_block(matrix: FloatArray, place: IntArray, block: FloatArray, sign: float) -> None:
    """Add a block to a matrix in place, or subtract it; its rows and its columns lie at `place`, shape (n,)."""
    for row in range(len(place)):
        for column in range(len(place)):
            matrix[place[row], place[column]] += sign * block[row, column]


def all_normal_equations(index: ParameterIndex, residual: FloatArray, valid: BoolArray, derivatives: Derivatives,
                         sigma: FloatArray, omega: FloatArray) -> list[NormalEquations]:
    """Return the normal equations of all rooms (see `normal_equations`)."""
    return [normal_equations(index, r, residual, valid, derivatives, sigma, omega) for r in range(len(index.members))]


def normal_equations(index: ParameterIndex, r: int, residual: FloatArray, valid: BoolArray, derivatives: Derivatives,
                     sigma: FloatArray, omega: FloatArray) -> NormalEquations:
    """Return the normal equations of room `r`; large residuals are down-weighted (Huber)."""
    members, columns, own = index.members[r], index.columns[r], index.own_place[r]
    ok = valid[members]
    error, slope = huber_root(residual[members], ok, sigma, omega)
    last = max(len(columns), own.max() + 1)  # place of the residual
    places, weight = index.room_places(r), slope / sigma
    sparse = Sparse.empty(ok.shape, 1 + sum(part.shape[1] for part in places))
    for (part, rows), place in zip(index.room_derivatives(r, derivatives), places, strict=True):
        append_nonzero(part, rows, place, ok, weight, *sparse)
    append_nonzero((error / sigma).reshape(*ok.shape, 1), np.arange(len(members)), np.full((len(members), 1), last), ok,
                   np.ones(ok.shape), *sparse)
    n, count = len(columns), ok.sum(axis=0)
    # sum over m RIRs of (x - p a)(x - p a)' = sum of x x' less m (1 - (1 - p)^2) a a', a being the mean of x
    kept = sigma ** 2 / (sigma ** 2 + count * omega ** 2)  # (1 - p)^2
    product = whitened_product(*sparse, (1.0 - kept) / np.maximum(count, 1), last + 1)
    log_scale = np.sum(np.maximum(count - 1, 0) * np.log(sigma)
                       + np.where(count > 0, 0.5 * np.log(sigma ** 2 + count * omega ** 2), 0.0))
    return NormalEquations(product[np.ix_(own, own)], product[own, :n], product[:n, :n], product[own, last],
                           product[:n, last], product[last, last], log_scale, columns)


class Sparse(NamedTuple):
    """A matrix with a row for each RIR and feature: what is not zero in it, as most features depend on few parameters.

    Attributes
    ----------
    values : ndarray, shape (n_rirs, n_features, n)
    columns : ndarray of int32, shape (n_rirs, n_features, n)
    counts : ndarray of int, shape (n_rirs, n_features)
        Number of values in each row.
    """

    values: FloatArray
    columns: Array
    counts: IntArray

    @classmethod
    def empty(cls, shape: tuple[int, ...], most: int) -> "Sparse":
        """Return a matrix with rows of this shape, which may hold `most` values each."""
        return cls(np.empty((*shape, most)), np.empty((*shape, most), np.int32), np.zeros(shape, np.int64))


@compiled
def append_nonzero(part: FloatArray, rows: IntArray, place: IntArray, valid: BoolArray, weight: FloatArray,
                   values: FloatArray, columns: Array, counts: IntArray) -> None:
    """Append what is not zero in weighted columns to a sparse matrix, in place.

    Parameters
    ----------
    part : ndarray, shape (n, n_features, n_of_part)
    rows : ndarray of int, shape (n_rirs,)
        Of `part`, for each RIR.
    place : ndarray of int, shape (n_rirs, n_of_part)
        Columns in the matrix.
    valid : ndarray of bool, shape (n_rirs, n_features)
    weight : ndarray, shape (n_rirs, n_features)
    values, columns, counts
        Of `Sparse`.
    """
    for i in range(len(rows)):
        for feature in range(valid.shape[1]):
            if not valid[i, feature]:
                continue
            n, factor = counts[i, feature], weight[i, feature]
            for k in range(place.shape[1]):
                value = part[rows[i], feature, k]
                if value != 0.0:
                    values[i, feature, n], columns[i, feature, n] = factor * value, place[i, k]
                    n += 1
            counts[i, feature] = n


@compiled
def whitened_product(values: FloatArray, columns: Array, counts: IntArray, shared: FloatArray, size: int) -> FloatArray:
    """Return ``white.T @ white`` of a room, where `_whiten` makes each column of `white` from that of a matrix.

    Parameters
    ----------
    values, columns, counts
        Of a `Sparse` matrix over `sigma`; its rows are empty where they are invalid.
    shared : ndarray, shape (n_features,)
        What is taken off the square of the sum over RIRs of a feature.
    size : int
        Number of columns.

    Returns
    -------
    ndarray, shape (size, size)
    """
    product, total, filled = np.zeros((size, size)), np.zeros((len(shared), size)), np.empty(size, np.int64)
    for i in range(len(values)):
        for feature in range(len(shared)):
            n = counts[i, feature]
            row, place = values[i, feature, :n], columns[i, feature, :n]
            for k in range(n):
                value, of_column = row[k], product[place[k]]
                total[feature, place[k]] += value
                for other in range(k, n):  # each pair once
                    of_column[place[other]] += value * row[other]
    for feature in range(len(shared)):
        n = 0
        for column in range(size):
            if total[feature, column] != 0.0:
                filled[n] = column
                n += 1
        for k in range(n):
            value, of_column = shared[feature] * total[feature, filled[k]], product[filled[k]]
            for other in range(k, n):
                of_column[filled[other]] -= value * total[feature, filled[other]]
    for one in range(size):
        for other in range(one):
            product[one, other] += product[other, one]
            product[other, one] = product[one, other]
    return product


def misfit(residual: FloatArray, valid: BoolArray, sigma: FloatArray, omega: FloatArray) -> float:
    """Return the sum of squares of a room's whitened residual; large residuals count linearly (Huber)."""
    root, _ = huber_root(residual, valid, sigma, omega)
    return float(np.sum(_whiten(root, valid, sigma, omega) ** 2))


def huber_root(residual: FloatArray, valid: BoolArray, sigma: FloatArray, omega: FloatArray
               ) -> tuple[FloatArray, FloatArray]:
    """Return the signed root of Huber's loss, whose square is the loss, and its derivative; 0 where invalid.

    With both, a Gauss-Newton step is a descent direction of `misfit`, also where rooms correlate the features.
    """
    limit = _HUBER * np.sqrt(sigma ** 2 + omega ** 2)
    size = np.abs(np.where(valid, residual, 0.0))
    root = np.where(size < limit, size, np.sqrt(limit * np.maximum(2.0 * size - limit, 0.0)))
    return np.where(valid, np.sign(residual) * root, 0.0), np.where(size < limit, 1.0, limit / np.maximum(root, 1e-9))


def _whiten(values: FloatArray, valid: BoolArray, sigma: FloatArray, omega: FloatArray) -> FloatArray:
    """Scale a room's features to independence and unit scatter, shape (n_rirs, n_features); invalid ones to 0."""
    count = valid.sum(axis=0)
    values = np.where(valid, values, 0.0)
    mean = values.sum(axis=0) / np.maximum(count, 1)
    part = 1.0 - sigma / np.sqrt(sigma ** 2 + count * omega ** 2)
    return np.where(valid, values - part * mean, 0.0) / sigma


def _clipped(room: FloatArray) -> FloatArray:
    """Return the residual of a room without outliers: deviations from its median are clipped, and then its median."""
    median = np.nanmedian(np.where(np.isfinite(room).any(axis=0), room, 0.0), axis=0)
    return np.clip(median, -_LARGEST, _LARGEST) + np.clip(room - median, -_LARGEST, _LARGEST)


def scatter(data: Data, residual: FloatArray, valid: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return the scatter of features within and between rooms [JND], shape (n_features,) each.

    Both are shrunk to the mean over the features of their metric. Outliers are clipped about the median of their room:
    a room that is far off as a whole would otherwise seem to have no scatter.
    """
    values = np.where(valid, residual, np.nan)
    rooms = [_clipped(values[data.room == r]) for r in range(len(data.room_names)) if np.any(data.room == r)]
    count: IntArray = np.array([np.isfinite(room).sum(axis=0) for room in rooms])
    total = np.array([np.nansum(room, axis=0) for room in rooms])
    square = np.array([np.nansum(room ** 2, axis=0) for room in rooms])
    mean = total / np.maximum(count, 1)
    within = np.maximum(np.sum(square - count * mean ** 2, axis=0), 0.0)  # rounding of equal values may be negative
    freedom = np.sum(np.maximum(count - 1, 0), axis=0)
    between = np.sum(count * mean ** 2, axis=0) - np.sum(count > 0, axis=0) * within / np.maximum(freedom, 1)
    sigma2, omega2 = np.empty(N_FEATURES), np.empty(N_FEATURES)
    for metric in np.unique(METRIC):
        at: Array = METRIC == metric
        typical = within[at].sum() / max(freedom[at].sum(), 1.0)
        sigma2[at] = (within[at] + 8.0 * typical) / (freedom[at] + 8.0)
        usual = max(between[at].sum(), 0.0) / max(count[:, at].sum(), 1.0)
        omega2[at] = (np.maximum(between[at], 0.0) + 16.0 * usual) / (count[:, at].sum(axis=0) + 16.0)
    most = np.where(METRIC == "floor", _OMEGA_FLOOR, _OMEGA[1])
    return np.clip(np.sqrt(sigma2), *_SIGMA), np.clip(np.sqrt(omega2), _OMEGA[0], most)
