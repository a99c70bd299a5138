"""Fit what is unknown of all rooms together.

Conventions
-----------
What is unknown of a room: its absorption per band ``x = ln(-ln(1 - alpha))``, by how much floor and ceiling absorb more
than the walls, gains (`roomeq.loop.packing`), and the vectors of effects whose scope is the room. These are Gaussian
about a mean that all rooms share, with a spread that is estimated from them (empirical Bayes): so absorption cannot
swallow what all rooms have in common, unless rooms differ so much that nothing is common. What is unknown of all: those
means, and the vectors of the other effects.

Features scatter by `sigma` from RIR to RIR and by `omega` from room to room; both are estimated from what a model leaves.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np

from roomeq.loop.features import HAS_GAIN, N_FEATURES
from roomeq.loop.linear import linearise, misfit, normal_equations, scatter
from roomeq.loop.packing import N_SURFACE, OWN, ParameterIndex
from roomeq.loop.predict import N_BANDS

ITERATIONS = 5
_SHARES = (1.0, 0.5, 0.2, 0.05)  # of a step that are tried
_DAMPING = 30.0
"""Of a step that does not help, in units of the prior's precision (Levenberg, Quart. Appl. Math. 2 (1944) 164): what
features hardly tell of, such as a parameter at its limit, moves little then, and holds nothing else up."""
START_X = np.log(0.2)
_WHOLE_GAIN_DB = 30.0  # spread of the gain of a chain or a room
_GAIN_DB = (0.3, _WHOLE_GAIN_DB)  # of what a source or a microphone has besides
_MEAN_SPREAD = 1.5  # of the mean absorption, natural logarithm
_CONTRAST = (0.4, 0.2, 0.1)  # spread of ln(absorption of floor and ceiling / of walls) over rooms, as `_SHAPES`
_MEAN_CONTRAST = 0.3
_SHAPES = tuple((level, bend, rough) for level in (0.15, 0.3, 0.6) for bend in (0.03, 0.1, 0.2, 0.4)
                for rough in (0.03, 0.1, 0.2))
_CORRELATED = 1.5  # bands over which absorption bends


def absorption_covariance(level, bend, rough):
    """Covariance of `x` over rooms: a common factor, smooth bends over bands, and roughness, shape (8, 8)."""
    lag = np.subtract.outer(np.arange(N_BANDS), np.arange(N_BANDS))
    return level ** 2 + bend ** 2 * np.exp(-0.5 * (lag / _CORRELATED) ** 2) + rough ** 2 * np.eye(N_BANDS)


@dataclass(frozen=True)
class Fit:
    """A model fitted to all rooms.

    Attributes
    ----------
    effects : tuple of types
    mean : ndarray, shape (n_shared,)
        Mean absorption, then for each effect the vectors of its units, or of a room on average.
    local : list of ndarray
        Per room: deviation of the absorption, gains, deviations of its effects.
    covariance : list of ndarray
        Of `local`, before the room's own RIRs are seen.
    sigma, omega : ndarray, shape (n_features,)
    predicted : ndarray, shape (n_rirs, n_features)
    normal : list of (ndarray, ndarray, ndarray, ndarray, ndarray, float)
        Per room, whitened: products of the derivatives by local and by shared unknowns with themselves, with each
        other and with the residual; and its density's constant.
    by_surface : ndarray, shape (n_rirs, n_features, 16)
        Derivatives of the features by the unknowns of the surfaces.
    gain_db : tuple of float
        Spread of each kind of gain (`roomeq.loop.packing.GAINS`).
    """

    effects: tuple
    mean: np.ndarray
    local: list
    covariance: list
    sigma: np.ndarray
    omega: np.ndarray
    predicted: np.ndarray
    normal: list
    by_surface: np.ndarray
    gain_db: tuple


def fit(data, correction, effects, start=None, like=None, iterations=ITERATIONS):
    """Fit a model.

    Parameters
    ----------
    data : roomeq.loop.data.Data
    correction : ndarray, shape (n_rirs, n_features)
        What features measured on rendered RIRs have over features predicted from tables.
    effects : sequence of types
    start : sequence of array_like, optional
        First vector of each effect; its own first `STARTS` if not given.
    like : Fit, optional
        Fit of the same or fewer effects to begin from; its derivatives by the surfaces are used again.
    iterations : int

    Returns
    -------
    Fit
    """
    packing = ParameterIndex(data, effects)
    start = [effect.STARTS[0] for effect in packing.effects] if start is None else start
    mean, prior_mean, prior = shared_prior(packing, start)
    local = [np.zeros(size) for _, size in packing.own_slices]
    shape, own_scale = (0.3, 0.2, 0.1), [1.0] * len(packing.effects)
    gain_db = (_WHOLE_GAIN_DB, 3.0, 3.0) if like is None else like.gain_db
    sigma, omega = np.full(N_FEATURES, 2.0), np.full(N_FEATURES, 1.0)
    if like is None:
        mean[:N_BANDS] = prior_mean[:N_BANDS] = START_X
        first_gains(packing, correction, mean, local)
    else:
        _continue(packing, like, mean, local)
        sigma, omega = like.sigma.copy(), like.omega.copy()
    known = None if like is None else like.by_surface
    for iteration in range(iterations):
        covariance = covariances(packing, shape, own_scale, gain_db)
        predicted, slopes = linearise(packing, mean, local, correction, known)
        residual, valid = data.residual(predicted)
        if iteration:
            sigma, omega = scatter(data, residual, valid)
        normal = [normal_equations(packing, r, residual, valid, slopes, sigma, omega)
                  for r in range(len(local))]
        cost = partial(_cost, packing, correction, sigma, omega, covariance, prior_mean, prior)
        limit, old = cost(mean, local, predicted), (mean, local)
        *new, spreads = _solve(normal, covariance, mean, local, prior_mean, prior)
        mean, local = _step(cost, limit, old, new, shares=_SHARES[:1])
        if mean is old[0]:
            *new, _ = _solve(normal, covariance, mean, local, prior_mean, prior, damping=_DAMPING)
            mean, local = _step(cost, limit, old, new)
        shape = _best_shape(local, spreads)
        own_scale = [_own_scale(packing, k, local, spreads) for k in range(len(packing.effects))]
        gain_db = (_WHOLE_GAIN_DB, *(_gain_db(packing, kind, local, spreads) for kind in (1, 2)))
    covariance = covariances(packing, shape, own_scale, gain_db)
    predicted, slopes = linearise(packing, mean, local, correction, known)
    residual, valid = data.residual(predicted)
    sigma, omega = scatter(data, residual, valid)
    normal = [normal_equations(packing, r, residual, valid, slopes, sigma, omega) for r in range(len(local))]
    return Fit(packing.effects, mean, local, covariance, sigma, omega, predicted, normal, slopes[0], gain_db)


def shared_prior(packing, start):
    """First value, mean and precision of the shared unknowns."""
    mean = np.zeros(packing.n_shared)
    precision = np.zeros((packing.n_shared, packing.n_shared))
    spread = np.repeat([_MEAN_SPREAD, _MEAN_CONTRAST], N_BANDS)
    precision[:N_SURFACE, :N_SURFACE] = np.diag(spread ** -2.0)
    for effect, first, (part, count, _, size) in zip(packing.effects, start, packing.shared, strict=True):
        if size:
            mean[part] = np.tile(first, count)
            inverse = np.linalg.inv(effect.prior_covariance())
            for u in range(count):
                at = slice(part.start + u * size, part.start + (u + 1) * size)
                precision[at, at] = inverse
    return mean, mean.copy(), precision


def first_gains(packing, correction, mean, local):
    predicted = packing.predict(packing.absorption(mean, local), packing.vectors(mean, local),
                               np.zeros(len(packing.data.rows)), correction)
    error = np.where(packing.data.valid & HAS_GAIN, packing.data.features - predicted, np.nan)
    for r, (members, parts) in enumerate(zip(packing.members, packing.gain_of, strict=True)):
        for n in np.flatnonzero(packing.gain_kind[r] == 0):
            found = error[members[parts[:, n] > 0.0]]
            local[r][N_SURFACE + n] = np.nanmedian(found) if np.isfinite(found).any() else 0.0


def _continue(packing, like, mean, local):
    """Take over what a fit of fewer effects found."""
    before = ParameterIndex(packing.data, like.effects)
    mean[:N_SURFACE] = like.mean[:N_SURFACE]
    for k, effect in enumerate(packing.effects):
        if effect in like.effects:
            mean[packing.shared[k][0]] = like.mean[before.shared[like.effects.index(effect)][0]]
    for r in range(len(local)):
        n = N_SURFACE + len(packing.gain_kind[r])
        local[r][:n] = like.local[r][:n]
        for k, effect in enumerate(packing.effects):
            if effect in like.effects:
                local[r][packing.own_slices[r][0][k]] = like.local[r][
                    before.own_slices[r][0][like.effects.index(effect)]]


def covariances(packing, shape, own_scale, gain_db):
    found = []
    for (slices, size), kinds in zip(packing.own_slices, packing.gain_kind, strict=True):
        covariance = np.zeros((size, size))
        covariance[:N_BANDS, :N_BANDS] = absorption_covariance(*shape)
        covariance[N_BANDS:N_SURFACE, N_BANDS:N_SURFACE] = absorption_covariance(*_CONTRAST)
        gains = np.arange(N_SURFACE, N_SURFACE + len(kinds))
        covariance[gains, gains] = np.square(gain_db)[kinds]
        for k, effect in enumerate(packing.effects):
            if slices[k].stop > slices[k].start:
                one = effect.prior_covariance()
                count = (slices[k].stop - slices[k].start) // len(one)
                covariance[slices[k], slices[k]] = own_scale[k] ** 2 * np.kron(np.eye(count), one)
        found.append(covariance)
    return found


def _solve(normal, covariance, mean, local, prior_mean, prior, damping=0.0):
    """One step of Gauss and Newton; returns new unknowns and the posterior covariance of each room's own."""
    total, right = (1.0 + damping) * prior, prior @ (prior_mean - mean)
    kept = []
    for (uu, ug, gg, ue, ge, *_), cov, u in zip(normal, covariance, local, strict=True):
        inverse = np.linalg.inv(cov)
        room = np.linalg.inv(uu + (1.0 + damping) * inverse)
        total += gg - ug.T @ room @ ug
        right += ge - ug.T @ room @ (ue - inverse @ u)
        kept.append((room, ug, ue - inverse @ u))
    step = np.linalg.solve(total, right)
    new = [u + room @ (b - ug @ step) for u, (room, ug, b) in zip(local, kept, strict=True)]
    return mean + step, new, [room for room, _, _ in kept]


def _step(cost, limit, old, new, shares=_SHARES):
    """As much of a step as brings the cost below a limit: a whole one where features are nearly linear, else a half."""
    for share in shares:
        mean = old[0] + share * (new[0] - old[0])
        local = [a + share * (b - a) for a, b in zip(old[1], new[1], strict=True)]
        if cost(mean, local) < limit:
            return mean, local
    return old


def _cost(packing, correction, sigma, omega, covariance, prior_mean, prior, mean, local, predicted=None):
    """Twice the negative logarithm of the posterior density, but for a constant (Huber's loss for outliers)."""
    data = packing.data
    if predicted is None:
        predicted = packing.predict(packing.absorption(mean, local), packing.vectors(mean, local), packing.gains(local),
                                   correction)
    residual, valid = data.residual(predicted)
    total = (mean - prior_mean) @ prior @ (mean - prior_mean)
    for members, one, cov in zip(packing.members, local, covariance, strict=True):
        total += one @ np.linalg.solve(cov, one) + misfit(residual[members], valid[members], sigma, omega)
    return total


def _best_shape(local, spreads):
    """Spread of the absorption over rooms that makes what was found most likely."""
    found, spread = np.array([u[:N_BANDS] for u in local]), np.array([one[:N_BANDS, :N_BANDS] for one in spreads])
    best, best_value = None, -np.inf
    for shape in _SHAPES:
        total = absorption_covariance(*shape) + spread
        solved = np.linalg.solve(total, found[:, :, None])[:, :, 0]
        value = 0.0
        for u, log_size, one in zip(found, np.linalg.slogdet(total)[1], solved, strict=True):
            value -= 0.5 * (log_size + u @ one)
        if value > best_value:
            best, best_value = shape, value
    return best


def _own_scale(packing, k, local, spreads):
    """Spread of a room's effect over rooms, as a factor of the effect's own `SPREAD`."""
    effect = packing.effects[k]
    if effect.SCOPE not in OWN or not effect.SPREAD:
        return 1.0
    variance = np.diag(effect.prior_covariance())
    found = [(u[part] ** 2 + np.diag(spread)[part]).reshape(-1, len(variance)) / variance
             for u, spread, part in zip(local, spreads, [slices[k] for slices, _ in packing.own_slices], strict=True)]
    return float(np.clip(np.sqrt(np.mean(np.concatenate(found))), 0.15, 1.5))


def _gain_db(packing, kind, local, spreads):
    """Spread of the gains of sources, or of microphones, within rooms [dB]; the widest where there are none."""
    found = [np.square(u[at]) + np.diag(spread)[at] for u, spread, at in zip(
        local, spreads, [N_SURFACE + np.flatnonzero(kinds == kind) for kinds in packing.gain_kind], strict=True)]
    found = np.concatenate(found)
    return float(np.clip(np.sqrt(found.mean()), *_GAIN_DB)) if len(found) else _GAIN_DB[1]
