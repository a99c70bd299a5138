"""Likelihood of residuals: features scatter within and between rooms, and outliers count linearly (Huber's loss)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from roomeq.core.arrays import Array, BoolArray, FloatArray, IntArray
from roomeq.core.jit import compiled, on_threads
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
                         sigma: FloatArray, omega: FloatArray, threads: int = 1) -> list[NormalEquations]:
    """Return the normal equations of all rooms (see `normal_equations`)."""
    return on_threads(lambda r: normal_equations(index, r, residual, valid, derivatives, sigma, omega),
                      [(r,) for r in range(len(index.members))], threads)


def normal_equations(index: ParameterIndex, r: int, residual: FloatArray, valid: BoolArray, derivatives: Derivatives,
                     sigma: FloatArray, omega: FloatArray) -> NormalEquations:
    """Return the normal equations of room `r`; large residuals are down-weighted (Huber)."""
    members, columns, own = index.members[r], index.columns[r], index.own_place[r]
    places, alike = index.room_places(r)
    ok = valid[members]
    error, slope = huber_root(residual[members], ok, sigma, omega)
    last = max(len(columns), own.max() + 1)  # place of the residual
    values = index.room_derivatives(r, derivatives, error)  # large: scaled in place
    values[:, :, :-1] *= (slope / sigma)[:, :, None]
    values[:, :, -1] /= sigma
    values[~ok] = 0.0
    product = _whitened_product(values, np.pad(places, ((0, 0), (0, 1)), constant_values=last), alike, ok, sigma, omega)
    n = len(columns)
    count = ok.sum(axis=0)
    log_scale = np.sum(np.maximum(count - 1, 0) * np.log(sigma)
                       + np.where(count > 0, 0.5 * np.log(sigma ** 2 + count * omega ** 2), 0.0))
    return NormalEquations(product[np.ix_(own, own)], product[own, :n], product[:n, :n], product[own, last],
                           product[:n, last], product[last, last], log_scale, columns)


def _whitened_product(values: FloatArray, places: IntArray, alike: Sequence[IntArray], valid: BoolArray,
                      sigma: FloatArray, omega: FloatArray) -> FloatArray:
    """Return ``white.T @ white`` of a room, where `_whiten` makes each column of `white` from that of a matrix.

    Parameters
    ----------
    values : ndarray, shape (n_rirs, n_features, n)
        What is not zero in the rows of the matrix, over `sigma`; 0 where invalid.
    places : ndarray of int, shape (n_rirs, n)
        Their columns in the matrix, the same for all features of an RIR.
    alike : sequence of ndarray of int
        Groups of RIRs with the same columns.
    valid : ndarray of bool, shape (n_rirs, n_features)
    sigma, omega : ndarray, shape (n_features,)
    """
    size, count = places.max() + 1, valid.sum(axis=0)
    product, total = np.zeros((size, size)), np.zeros((len(sigma), size))
    for rirs in alike:
        place, of_group = np.ascontiguousarray(places[rirs[0]]), values if len(alike) == 1 else values[rirs]
        stacked = of_group.reshape(-1, of_group.shape[2])
        add_block(product, place, stacked.T @ stacked, 1.0)
        total[:, place] += of_group.sum(axis=0)
    # sum over n RIRs of (x - p m)(x - p m)' = sum of x x' less n (1 - (1 - p)^2) m m', m being the mean of x
    kept = sigma ** 2 / (sigma ** 2 + count * omega ** 2)  # (1 - p)^2
    total *= np.sqrt((1.0 - kept) / np.maximum(count, 1))[:, None]
    return product - total.T @ total


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
