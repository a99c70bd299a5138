"""Fit the parameters of all rooms together (empirical Bayes, Gauss-Newton).

Conventions
-----------
Room-level parameters (`roomeq.loop.packing`: absorption per octave, the contrast of floor and ceiling, gains, the
vectors of effects whose scope is the room or the RIR) share a Gaussian prior whose mean and covariance are estimated
from all rooms. The common mean keeps absorption from explaining variance that all rooms share. Shared parameters are
those means and the vectors of all other effects.

Features scatter by `sigma` from RIR to RIR and by `omega` from room to room; both are estimated from the residual.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from roomeq.core.arrays import BoolArray, FloatArray
from roomeq.core.progress import progress
from roomeq.effects.base import Effect, correlation_of_bands
from roomeq.loop.data import Data
from roomeq.loop.features import HAS_GAIN, N_FEATURES
from roomeq.loop.likelihood import NormalEquations, add_block, all_normal_equations, misfit, scatter
from roomeq.loop.packing import LEVEL_KINDS, N_SURFACE, OWN_SCOPES, Derivatives, Linearization, ParameterIndex
from roomeq.loop.predict import N_BANDS

ITERATIONS = 5
CONVERGED = 0.05  # a step that lowers twice the negative log posterior density by less is the last
START_X = float(np.log(0.2))
"""Initial absorption ``x`` of all bands."""
STEP_FRACTIONS = (1.0, 0.5, 0.2, 0.05)  # of a step, tried in this order
DAMPING = 30.0
"""Damping of a step that does not lower the cost, in units of the prior's precision (Levenberg, Quart. Appl. Math. 2
(1944) 164). It freezes poorly determined parameters, such as one at its limit, so that the others can go on."""
_CHAIN_GAIN_DB = 30.0  # spread of the gain of a chain, a room or a single RIR
_GAIN_DB = (0.3, _CHAIN_GAIN_DB)  # limits of the spread of the gains of sources and of microphones
_MEAN_SPREAD = 1.5  # of the mean absorption, natural logarithm
_CONTRAST = (0.4, 0.2, 0.1)  # spread of ln(absorption of floor and ceiling / of walls) over rooms, as `_SHAPES`
_MEAN_CONTRAST = 0.3
_SHAPES = tuple((level, bend, rough) for level in (0.15, 0.2, 0.3, 0.45, 0.6, 0.8) for bend in (0.03, 0.1, 0.2, 0.4)
                for rough in (0.03, 0.1, 0.2))
_FIRST_SHAPE = (0.3, 0.2, 0.1)
_LEVEL_PRIOR = (8.0, 0.5)
"""Scaled inverse chi-squared prior of the variance of the level of absorption over rooms (Gelman et al., Bayesian Data
Analysis, 3rd ed., sec. 2.6): degrees of freedom, and spread. Mean absorption coefficients of rooms lie between about
0.05, a bare classroom, and 0.4, a studio: four spreads are ln(8). A few rooms of one or two laboratories, or states of
one room, may vary by chance much less in level than in spectrum. A new room would then get their level in all octaves
but the one in which its decay is known."""
_CORRELATED = 1.5  # correlation length of absorption [bands]


class SharedPrior(NamedTuple):
    """Gaussian prior of the shared parameters: mean, shape (n_shared,), and precision, shape (n_shared, n_shared)."""

    mean: FloatArray
    precision: FloatArray


@dataclass(frozen=True)
class Fit:
    """A model fitted to all rooms.

    Attributes
    ----------
    effects : tuple of types
    mean : ndarray, shape (n_shared,)
        Shared parameters.
    local : list of ndarray
        Own parameters of each room.
    covariance : list of ndarray
        Prior covariance of `local`.
    sigma, omega : ndarray, shape (n_features,)
        Scatter within and between rooms [JND].
    predicted : ndarray, shape (n_rirs, n_features)
    normal : list of NormalEquations
        Of each room, at the fitted parameters.
    derivatives : Derivatives
        Of the features.
    gain_db : tuple of float
        Spread of each kind of gain (`roomeq.loop.packing.GAIN_KINDS`).
    """

    effects: tuple[type[Effect], ...]
    mean: FloatArray
    local: list[FloatArray]
    covariance: list[FloatArray]
    sigma: FloatArray
    omega: FloatArray
    predicted: FloatArray
    normal: list[NormalEquations]
    derivatives: Derivatives
    gain_db: tuple[float, float, float, float]

    @cached_property
    def precision(self) -> list[FloatArray]:
        """Prior precision of `local`."""
        return [inverted(covariance) for covariance in self.covariance]

    def parameters(self) -> "Fit":
        """Return a fit to start another one from, without `predicted`, `normal` and `derivatives`, which are large."""
        return replace(self, predicted=np.empty((0, N_FEATURES)), normal=[],
                       derivatives=Derivatives(np.empty((0, N_FEATURES, N_SURFACE)), {}))


def fit(data: Data, correction: FloatArray, effects: Sequence[type[Effect]],
        start: Sequence[Any] | None = None, initial: Fit | None = None, known: Derivatives | None = None,
        iterations: int = ITERATIONS) -> Fit:
    """Fit a model.

    Parameters
    ----------
    data : Data
    correction : ndarray, shape (n_rirs, n_features)
        Rendering correction: features measured on rendered RIRs minus features predicted from tables.
    effects : sequence of types
    start : sequence of array_like, optional
        Initial vector of each effect; by default the first of its `STARTS`.
    initial : Fit, optional
        Fit of the same or fewer effects to start from.
    known : Derivatives, optional
        Derivatives that are not computed again in every iteration, such as those of a smaller model.
    iterations : int
    """
    index = ParameterIndex(data, effects)
    measured = [effect.measured_vectors(data) for effect in index.effects]
    start = [effect.STARTS[0] if vectors is None else vectors.mean(axis=0)
             for effect, vectors in zip(index.effects, measured, strict=True)] if start is None else start
    # a continued fit centres the prior of the mean absorption at x = 0 (alpha = 0.63), 1.1 of its spreads higher
    prior = shared_prior(index, start, START_X if initial is None else 0.0)
    mean, local = prior.mean.copy(), [np.zeros(part.size) for part in index.local]
    shape, own_scale = _FIRST_SHAPE, [1.0] * len(index.effects)
    if initial is None:
        gain_db = (_CHAIN_GAIN_DB, 3.0, 3.0, _CHAIN_GAIN_DB)
        sigma, omega = np.full(N_FEATURES, 2.0), np.full(N_FEATURES, 1.0)
        estimate_gains(index, correction, mean, local)
    else:
        gain_db = initial.gain_db
        sigma, omega = initial.sigma.copy(), initial.omega.copy()
        _continue(index, initial, mean, local)
    start_from_measured(index, mean, local, [None if initial is not None and effect in initial.effects else vectors
                                             for effect, vectors in zip(index.effects, measured, strict=True)])
    linearization = Linearization(index, correction, known)
    for iteration in progress(range(iterations), iterations, "fit: iterations"):
        precision = [inverted(of_room) for of_room in covariances(index, shape, own_scale, gain_db)]
        predicted, derivatives = linearization.at(mean, local)
        residual, valid = data.residual(predicted)
        if iteration:
            sigma, omega = scatter(data, residual, valid)
        normal = all_normal_equations(index, residual, valid, derivatives, sigma, omega)
        cost_at = partial(cost, linearization, sigma, omega, precision, prior)
        mean, local, posterior, fall = take_step(cost_at, normal, precision, mean, local, prior, STEP_FRACTIONS[:2])
        shape = _best_shape(local, posterior)
        own_scale = [_own_scale(index, k, local, posterior) for k in range(len(index.effects))]
        gain_db = (_CHAIN_GAIN_DB, _gain_spread_db(index, 1, local, posterior),
                   _gain_spread_db(index, 2, local, posterior), _CHAIN_GAIN_DB)
        if iteration and fall < CONVERGED:  # the scatter is known from the second iteration on
            break
    covariance = covariances(index, shape, own_scale, gain_db)
    predicted, derivatives = linearization.at(mean, local, same_jnd=0.0)  # densities of rooms need the right ones
    residual, valid = data.residual(predicted)
    sigma, omega = scatter(data, residual, valid)
    normal = all_normal_equations(index, residual, valid, derivatives, sigma, omega)
    return Fit(index.effects, mean, local, covariance, sigma, omega, predicted, normal, derivatives, gain_db)


def with_scatter(data: Data, fitted: Fit, sigma: FloatArray, omega: FloatArray) -> Fit:
    """Return a fit with its parameters and another scatter of the features, shape (n_features,) each."""
    residual, valid = data.residual(fitted.predicted)
    normal = all_normal_equations(ParameterIndex(data, fitted.effects), residual, valid, fitted.derivatives, sigma,
                                  omega)
    return replace(fitted, sigma=sigma, omega=omega, normal=normal)


def shared_prior(index: ParameterIndex, start: Sequence[Any] | None = None, x: float = START_X) -> SharedPrior:
    """Return the prior of the shared parameters: its mean is an absorption `x` in all bands, and `start`.

    By default, that is the first of each effect's `STARTS`.
    """
    start = [effect.STARTS[0] for effect in index.effects] if start is None else start
    mean = np.zeros(index.n_shared)
    mean[:N_BANDS] = x
    precision = np.zeros((index.n_shared, index.n_shared))
    spread = np.repeat([_MEAN_SPREAD, _MEAN_CONTRAST], N_BANDS)
    precision[:N_SURFACE, :N_SURFACE] = np.diag(spread ** -2.0)
    for effect, first, (part, n_vectors, _, size) in zip(index.effects, start, index.shared, strict=True):
        if size:
            mean[part] = np.tile(first, n_vectors)
            inverse = np.linalg.inv(effect.prior_covariance())
            for u in range(n_vectors):
                at = slice(part.start + u * size, part.start + (u + 1) * size)
                precision[at, at] = inverse
    return SharedPrior(mean, precision)


def estimate_gains(index: ParameterIndex, correction: FloatArray, mean: FloatArray, local: list[FloatArray],
                   valid: BoolArray | None = None) -> None:
    """Set the gains of chains, rooms and single RIRs in `local` to the median residual of features that have them.

    `valid`, shape (n_rirs, n_features), says which features count, by default those of the data. A gain without any is
    left as it is.
    """
    valid = index.data.valid if valid is None else valid
    predicted = index.predict(index.absorption(mean, local), index.vectors(mean, local), correction=correction)
    residual = np.where(valid & HAS_GAIN, index.data.features - predicted, np.nan)
    for r, (members, design) in enumerate(zip(index.members, index.gain_design, strict=True)):
        for n in np.flatnonzero(np.isin(index.gain_kind[r], LEVEL_KINDS)):
            of_gain = residual[members[design[:, n] > 0.0]]
            if np.isfinite(of_gain).any():
                local[r][N_SURFACE + n] = np.nanmedian(of_gain)


def start_from_measured(index: ParameterIndex, mean: FloatArray, local: list[FloatArray],
                        measured: Sequence[FloatArray | None]) -> None:
    """Set what was read off the recordings, of each effect (`Effect.measured_vectors`) or None, in `local`."""
    for k, vectors in enumerate(measured):
        if vectors is not None:
            for own, part, vector in zip(local, index.local, vectors, strict=True):
                own[part.slices[k]] = vector - mean[index.shared[k].part]


def _continue(index: ParameterIndex, initial: Fit, mean: FloatArray, local: list[FloatArray]) -> None:
    """Copy the parameters of a fit of the same or fewer effects into `mean` and `local`."""
    before = ParameterIndex(index.data, initial.effects)
    mean[:N_SURFACE] = initial.mean[:N_SURFACE]
    for k, effect in enumerate(index.effects):
        if effect in initial.effects:
            mean[index.shared[k].part] = initial.mean[before.shared[initial.effects.index(effect)].part]
    for r in range(len(local)):
        n = N_SURFACE + len(index.gain_kind[r])
        local[r][:n] = initial.local[r][:n]
        for k, effect in enumerate(index.effects):
            if effect in initial.effects:
                local[r][index.local[r].slices[k]] = initial.local[r][
                    before.local[r].slices[initial.effects.index(effect)]]


def absorption_covariance(level: float, bend: float, rough: float) -> FloatArray:
    """Return the covariance of `x` over rooms, shape (8, 8): common level, smooth bends over bands, and roughness."""
    return level ** 2 + bend ** 2 * correlation_of_bands(N_BANDS, _CORRELATED) + rough ** 2 * np.eye(N_BANDS)


def covariances(index: ParameterIndex, shape: tuple[float, float, float], own_scale: list[float],
                gain_db: tuple[float, float, float, float]) -> list[FloatArray]:
    """Return the prior covariance of each room's own parameters.

    Parameters
    ----------
    index : ParameterIndex
    shape : tuple of 3 floats
        Arguments of `absorption_covariance`.
    own_scale : list of float
        Of each effect: factor of its `SPREAD` over rooms.
    gain_db : tuple of 4 floats
        Spread of each kind of gain.
    """
    made = []
    for (slices, size), kinds in zip(index.local, index.gain_kind, strict=True):
        covariance = np.zeros((size, size))
        covariance[:N_BANDS, :N_BANDS] = absorption_covariance(*shape)
        covariance[N_BANDS:N_SURFACE, N_BANDS:N_SURFACE] = absorption_covariance(*_CONTRAST)
        gains = np.arange(N_SURFACE, N_SURFACE + len(kinds))
        covariance[gains, gains] = np.square(gain_db)[kinds]
        for k, effect in enumerate(index.effects):
            if slices[k].stop > slices[k].start:
                of_vector = effect.prior_covariance()
                count = (slices[k].stop - slices[k].start) // len(of_vector)
                covariance[slices[k], slices[k]] = own_scale[k] ** 2 * np.kron(np.eye(count), of_vector)
        made.append(covariance)
    return made


def inverted(matrix: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)


def solve_step(normal: list[NormalEquations], precision: list[FloatArray], mean: FloatArray, local: list[FloatArray],
               prior: SharedPrior, damping: float = 0.0) -> tuple[FloatArray, list[FloatArray], list[FloatArray]]:
    """Take one Gauss-Newton step; return new shared and own parameters and the own ones' posterior covariances.

    `precision` is that of the prior of each room's own parameters.
    """
    total, right = (1.0 + damping) * prior.precision, prior.precision @ (prior.mean - mean)
    rooms = []
    for room, of_prior, own in zip(normal, precision, local, strict=True):
        posterior = inverted(room.own_own + (1.0 + damping) * of_prior)
        own_right = room.own_residual - of_prior @ own
        add_block(total, room.columns, room.shared_shared - room.own_shared.T @ posterior @ room.own_shared, 1.0)
        right[room.columns] += room.shared_residual - room.own_shared.T @ posterior @ own_right
        rooms.append((posterior, room, own_right))
    step = np.linalg.solve(total, right)
    new = [own + posterior @ (own_right - room.own_shared @ step[room.columns])
           for own, (posterior, room, own_right) in zip(local, rooms, strict=True)]
    return mean + step, new, [posterior for posterior, _, _ in rooms]


def take_step(cost_at: Callable, normal: list[NormalEquations], precision: list[FloatArray], mean: FloatArray,
              local: list[FloatArray], prior: SharedPrior, fractions: Sequence[float] = STEP_FRACTIONS
              ) -> tuple[FloatArray, list[FloatArray], list[FloatArray], float]:
    """Take a step or one of its `fractions` that lowers the cost, else a damped one, else none.

    Returns the parameters, the posterior covariances of `solve_step` without damping, and by how much the cost falls.
    """
    limit, old = cost_at(mean, local), (mean, local)
    *new, posterior = solve_step(normal, precision, mean, local, prior)
    mean, local, reached = shortened_step(cost_at, limit, old, new, fractions)
    if mean is old[0]:
        *new, _ = solve_step(normal, precision, mean, local, prior, damping=DAMPING)
        mean, local, reached = shortened_step(cost_at, limit, old, new)
    return mean, local, posterior, limit - reached


def shortened_step(cost: Callable, limit: float, old: Sequence[Any], new: Sequence[Any],
                   fractions: Sequence[float] = STEP_FRACTIONS) -> tuple[FloatArray, list[FloatArray], float]:
    """Return the first fraction of a step that lowers the cost below `limit`, or `old`: parameters, and their cost."""
    for fraction in fractions:
        mean = old[0] + fraction * (new[0] - old[0])
        local = [a + fraction * (b - a) for a, b in zip(old[1], new[1], strict=True)]
        reached = cost(mean, local)
        if reached < limit:
            return mean, local, reached
    return old[0], old[1], limit


def cost(linearization: Linearization, sigma: FloatArray, omega: FloatArray, precision: list[FloatArray],
         prior: SharedPrior, mean: FloatArray, local: list[FloatArray], visible: BoolArray | None = None) -> float:
    """Return twice the negative log posterior density up to a constant, with Huber's loss for outliers.

    Only `visible` features count, shape (n_rirs, n_features), if they are given.
    """
    index = linearization.index
    residual, valid = index.data.residual(linearization.predicted(mean, local))
    valid = valid if visible is None else valid & visible
    total = (mean - prior.mean) @ prior.precision @ (mean - prior.mean)
    for members, own, of_prior in zip(index.members, local, precision, strict=True):
        total += own @ of_prior @ own + misfit(residual[members], valid[members], sigma, omega)
    return float(total)


def _best_shape(local: list[FloatArray], posterior: list[FloatArray]) -> tuple[float, float, float]:
    """Return the arguments of `absorption_covariance` of the highest expected posterior density, with `_LEVEL_PRIOR`.

    The expectation is that of the EM algorithm (Dempster, Laird and Rubin, J. R. Stat. Soc. B 39 (1977) 1): the second
    moment of a room's parameters is the square of their mean plus their posterior covariance.
    """
    absorption = np.array([own[:N_BANDS] for own in local])
    spread = np.array([covariance[:N_BANDS, :N_BANDS] for covariance in posterior])
    squares = np.einsum("ra,rb->ab", absorption, absorption) + spread.sum(axis=0)
    of_shapes = np.array([absorption_covariance(*shape) for shape in _SHAPES])
    (freedom, level), of_level = _LEVEL_PRIOR, np.array([shape[0] for shape in _SHAPES])
    log_prior = -(freedom + 2.0) * np.log(of_level) - 0.5 * freedom * (level / of_level) ** 2
    misfits = (len(local) * np.linalg.slogdet(of_shapes)[1]
               + np.trace(np.linalg.solve(of_shapes, np.broadcast_to(squares, of_shapes.shape)), axis1=1, axis2=2))
    return _SHAPES[int(np.argmax(log_prior - 0.5 * misfits))]


def _own_scale(index: ParameterIndex, k: int, local: list[FloatArray], posterior: list[FloatArray]) -> float:
    """Return the spread of an effect over rooms as a factor of its `SPREAD`."""
    effect = index.effects[k]
    if effect.SCOPE not in OWN_SCOPES or not effect.SPREAD:
        return 1.0
    variance = np.diag(effect.prior_covariance())
    squares = [(own[slices[k]] ** 2 + np.diag(covariance)[slices[k]]).reshape(-1, len(variance)) / variance
               for own, covariance, (slices, _) in zip(local, posterior, index.local, strict=True)]
    return float(np.clip(np.sqrt(np.mean(np.concatenate(squares))), 0.15, 1.5))


def _gain_spread_db(index: ParameterIndex, kind: int, local: list[FloatArray], posterior: list[FloatArray]) -> float:
    """Return the spread within rooms of the gains of sources or of microphones [dB]; the limit if there are none."""
    squares = []
    for own, covariance, kinds in zip(local, posterior, index.gain_kind, strict=True):
        at = N_SURFACE + np.flatnonzero(kinds == kind)
        squares.append(np.square(own[at]) + np.diag(covariance)[at])
    of_all = np.concatenate(squares)
    return float(np.clip(np.sqrt(of_all.mean()), *_GAIN_DB)) if len(of_all) else _GAIN_DB[1]
