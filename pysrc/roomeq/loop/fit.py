"""Fit what is unknown of all rooms together, and say how well rooms are predicted that took no part.

Conventions
-----------
What is unknown of a room: its absorption per band ``x = ln(-ln(1 - alpha))``, by how much floor and ceiling absorb more
than the walls, one gain per chain of source and microphone, and the vectors of effects whose scope is the room. These
are Gaussian about a mean that all rooms share,
with a spread that is estimated from them (empirical Bayes): so absorption cannot swallow what all rooms have in
common, unless rooms differ so much that nothing is common. What is unknown of all: those means, and the vectors of the
other effects.

Cells scatter by `sigma` from RIR to RIR and by `omega` from room to room; both are estimated from what a model leaves.
A model is judged by the probability density it gives to each room after it has been fitted to the others (Laplace's
approximation about the joint fit; Gelman et al., Bayesian Data Analysis, 3rd ed., sec. 5.4, 7.1 and 13.3).
"""

from dataclasses import dataclass

import numpy as np

from roomeq.loop.cells import HAS_GAIN, METRIC, N_CELLS
from roomeq.loop.predict import N_BANDS, base_state, predict, reflected_energy

_STEP = 0.03  # of numerical derivatives, in units of a vector's spread
_ITERATIONS = 5
_GAIN_SPREAD_DB = 30.0
_HUBER = 3.0
_SIGMA = (0.7, 12.0)
_OMEGA = (0.2, 12.0)
_START_X = np.log(0.2)
_MEAN_SPREAD = 1.5  # of the mean absorption, natural logarithm
OWN = ("room", "rir")  # scopes whose vectors belong to one room alone
_CONTRAST = (0.4, 0.2, 0.1)  # spread of ln(absorption of floor and ceiling / of walls) over rooms, as `_SHAPES`
_MEAN_CONTRAST = 0.3
PEEKED = (METRIC == "direct") & (np.arange(N_CELLS) % 2 == 0)
"""Cells of scored RIRs that tell whether their direct sound is obstructed, and are not scored."""
N_SURFACE = 2 * N_BANDS  # unknowns of the surfaces
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
        Per room: deviation of the absorption, gains of its chains, deviations of its effects.
    covariance : list of ndarray
        Of `local`, before the room's own RIRs are seen.
    sigma, omega : ndarray, shape (n_cells,)
    predicted : ndarray, shape (n_rirs, n_cells)
    normal : list of (ndarray, ndarray, ndarray, ndarray, ndarray, float)
        Per room, whitened: products of the derivatives by local and by shared unknowns with themselves, with each
        other and with the residual; and its density's constant.
    by_surface : ndarray, shape (n_rirs, n_cells, 16)
        Derivatives of the cells by the unknowns of the surfaces.
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


class Layout:
    """Where each unknown stands."""

    def __init__(self, data, effects):
        self.data, self.effects = data, tuple(effects)
        self.chains = [sorted(set(data.chain[data.room == r])) for r in range(len(data.room_names))]
        self.shared, start = [], N_SURFACE
        for effect in self.effects:
            names, unit = data.units(effect.SCOPE)
            size = len(effect.SPREAD)
            count = 1 if effect.SCOPE in OWN else len(names)
            self.shared.append((slice(start, start + count * size), count, unit, size))
            start += count * size
        self.n_shared = start
        self.own_slices = []
        self.members = [np.flatnonzero(data.room == r) for r in range(len(data.room_names))]
        for chains, members in zip(self.chains, self.members, strict=True):
            at, slices = N_SURFACE + len(chains), []
            for effect in self.effects:
                size = len(effect.SPREAD) * {"room": 1, "rir": len(members)}.get(effect.SCOPE, 0)
                slices.append(slice(at, at + size))
                at += size
            self.own_slices.append((slices, at))

    def vectors(self, mean, local):
        """Vector of each effect for each unit: list of arrays, shape (n_units, n)."""
        found = []
        for k, effect in enumerate(self.effects):
            part, count, _, size = self.shared[k]
            if effect.SCOPE == "room":
                found.append(np.array([mean[part] + local[r][self.own_slices[r][0][k]]
                                       for r in range(len(local))]).reshape(len(local), size))
            elif effect.SCOPE == "rir":
                vectors = np.empty((len(self.data.rows), size))
                for r, members in enumerate(self.members):
                    vectors[members] = mean[part] + local[r][self.own_slices[r][0][k]].reshape(len(members), size)
                found.append(vectors)
            else:
                found.append(mean[part].reshape(count, size))
        return found

    def absorption(self, mean, local):
        """``-ln(1 - alpha)`` of walls, and of floor and ceiling, shape (n_rooms, 2, 8)."""
        unknown = np.array([mean[:N_SURFACE] + one[:N_SURFACE] for one in local])
        middle, contrast = unknown[:, :N_BANDS], unknown[:, N_BANDS:]
        return np.exp(np.stack([middle - 0.5 * contrast, middle + 0.5 * contrast], axis=1))

    def gains(self, local):
        """Gain of each RIR [dB], shape (n_rirs,)."""
        return np.array([local[r][N_SURFACE + self.chains[r].index(chain)]
                         for r, chain in zip(self.data.room, self.data.chain, strict=True)])

    def state(self, absorption, vectors):
        """What is assumed of each RIR."""
        state = base_state(self.data, absorption)
        for k, effect in enumerate(self.effects):
            unit = self.shared[k][2]
            for u, vector in enumerate(vectors[k]):
                rows = np.flatnonzero(unit == u)
                if len(rows):
                    effect.from_vector(vector).act(state, self.data, rows)
        return state

    def predict(self, absorption, vectors, gains, offset, energy=None):
        """Cells, shape (n_rirs, n_cells); `energy` as for `roomeq.loop.predict.predict`."""
        return predict(self.data, self.state(absorption, vectors), energy) + offset + np.outer(gains, HAS_GAIN)


def fit(data, offset, effects, start=None, like=None, iterations=_ITERATIONS):
    """Fit a model.

    Parameters
    ----------
    data : roomeq.loop.data.Data
    offset : ndarray, shape (n_rirs, n_cells)
        What cells measured on rendered RIRs have over cells predicted from tables.
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
    layout = Layout(data, effects)
    start = [effect.STARTS[0] for effect in layout.effects] if start is None else start
    mean, prior_mean, prior = _shared_prior(layout, start)
    local = [np.zeros(size) for _, size in layout.own_slices]
    shape, own_scale = (0.3, 0.2, 0.1), [1.0] * len(layout.effects)
    sigma, omega = np.full(N_CELLS, 2.0), np.full(N_CELLS, 1.0)
    if like is None:
        mean[:N_BANDS] = prior_mean[:N_BANDS] = _START_X
        _first_gains(layout, offset, mean, local)
    else:
        _continue(layout, like, mean, local)
        sigma, omega = like.sigma.copy(), like.omega.copy()
    known = None if like is None else like.by_surface
    for iteration in range(iterations):
        covariance = _covariances(layout, shape, own_scale)
        predicted, slopes = _linearise(layout, mean, local, offset, known)
        residual = data.cells - predicted
        valid = data.valid & np.isfinite(residual)
        if iteration:
            sigma, omega = scatter(data, residual, valid)
        normal = [_normal(layout, r, residual, valid, slopes, sigma, omega)
                  for r in range(len(local))]
        mean, local, spreads = _solve(normal, covariance, mean, local, prior_mean, prior)
        shape = _best_shape(local, spreads)
        own_scale = [_own_scale(layout, k, local, spreads) for k in range(len(layout.effects))]
    covariance = _covariances(layout, shape, own_scale)
    predicted, slopes = _linearise(layout, mean, local, offset, known)
    residual = data.cells - predicted
    valid = data.valid & np.isfinite(residual)
    sigma, omega = scatter(data, residual, valid)
    normal = [_normal(layout, r, residual, valid, slopes, sigma, omega) for r in range(len(local))]
    return Fit(layout.effects, mean, local, covariance, sigma, omega, predicted, normal, slopes[0])


def _shared_prior(layout, start):
    """First value, mean and precision of the shared unknowns."""
    mean = np.zeros(layout.n_shared)
    precision = np.zeros((layout.n_shared, layout.n_shared))
    spread = np.repeat([_MEAN_SPREAD, _MEAN_CONTRAST], N_BANDS)
    precision[:N_SURFACE, :N_SURFACE] = np.diag(spread ** -2.0)
    for effect, first, (part, count, _, size) in zip(layout.effects, start, layout.shared, strict=True):
        if size:
            mean[part] = np.tile(first, count)
            inverse = np.linalg.inv(effect.prior_covariance())
            for u in range(count):
                at = slice(part.start + u * size, part.start + (u + 1) * size)
                precision[at, at] = inverse
    return mean, mean.copy(), precision


def _first_gains(layout, offset, mean, local):
    predicted = layout.predict(layout.absorption(mean, local), layout.vectors(mean, local),
                               np.zeros(len(layout.data.rows)), offset)
    error = np.where(layout.data.valid & HAS_GAIN, layout.data.cells - predicted, np.nan)
    for r, chains in enumerate(layout.chains):
        for n, chain in enumerate(chains):
            found = error[(layout.data.room == r) & (layout.data.chain == chain)]
            local[r][N_SURFACE + n] = np.nanmedian(found) if np.isfinite(found).any() else 0.0


def _continue(layout, like, mean, local):
    """Take over what a fit of fewer effects found."""
    before = Layout(layout.data, like.effects)
    mean[:N_SURFACE] = like.mean[:N_SURFACE]
    for k, effect in enumerate(layout.effects):
        if effect in like.effects:
            mean[layout.shared[k][0]] = like.mean[before.shared[like.effects.index(effect)][0]]
    for r in range(len(local)):
        n = N_SURFACE + len(layout.chains[r])
        local[r][:n] = like.local[r][:n]
        for k, effect in enumerate(layout.effects):
            if effect in like.effects:
                local[r][layout.own_slices[r][0][k]] = like.local[r][
                    before.own_slices[r][0][like.effects.index(effect)]]


def _covariances(layout, shape, own_scale):
    found = []
    for (slices, size), chains in zip(layout.own_slices, layout.chains, strict=True):
        covariance = np.zeros((size, size))
        covariance[:N_BANDS, :N_BANDS] = absorption_covariance(*shape)
        covariance[N_BANDS:N_SURFACE, N_BANDS:N_SURFACE] = absorption_covariance(*_CONTRAST)
        gains = np.arange(N_SURFACE, N_SURFACE + len(chains))
        covariance[gains, gains] = _GAIN_SPREAD_DB ** 2
        for k, effect in enumerate(layout.effects):
            if slices[k].stop > slices[k].start:
                one = effect.prior_covariance()
                count = (slices[k].stop - slices[k].start) // len(one)
                covariance[slices[k], slices[k]] = own_scale[k] ** 2 * np.kron(np.eye(count), one)
        found.append(covariance)
    return found


def _linearise(layout, mean, local, offset, by_band=None):
    """Predicted cells and their derivatives: by surfaces (n_rirs, n_cells, 16) and by each effect's vector."""
    absorption, vectors = layout.absorption(mean, local), layout.vectors(mean, local)
    gains = layout.gains(local)
    energy = reflected_energy(layout.data, layout.state(absorption, vectors))
    centre = layout.predict(absorption, vectors, gains, offset, energy)
    known = by_band is not None
    by_band = by_band if known else np.empty((*centre.shape, N_SURFACE))
    for n in range(0 if known else N_SURFACE):
        moved = absorption.copy()
        step = (1.0, 1.0) if n < N_BANDS else (-0.5, 0.5)
        moved[:, :, n % N_BANDS] *= np.exp(_STEP * np.array(step))
        by_band[:, :, n] = (layout.predict(moved, vectors, gains, offset) - centre) / _STEP
    by_effect = []
    for k, effect in enumerate(layout.effects):
        found = np.empty((*centre.shape, len(effect.SPREAD)))
        for p, spread in enumerate(effect.SPREAD):
            moved = [one.copy() for one in vectors]
            moved[k][:, p] += _STEP * spread
            same = None if effect.REFLECTIONS else energy
            found[:, :, p] = (layout.predict(absorption, moved, gains, offset, same) - centre) / (_STEP * spread)
        by_effect.append(found)
    return centre, (by_band, by_effect)


def _derivatives(layout, r, index, slopes):
    """Derivatives of some RIRs of a room by its own and by the shared unknowns."""
    by_band, by_effect = slopes
    slices, size = layout.own_slices[r]
    own = np.zeros((len(index), N_CELLS, size))
    shared = np.zeros((len(index), N_CELLS, layout.n_shared))
    own[:, :, :N_SURFACE] = shared[:, :, :N_SURFACE] = by_band[index]
    for i, n in enumerate(index):
        own[i, :, N_SURFACE + layout.chains[r].index(layout.data.chain[n])] = HAS_GAIN
    for k, effect in enumerate(layout.effects):
        part, _, unit, n = layout.shared[k]
        if effect.SCOPE == "room":
            own[:, :, slices[k]] = shared[:, :, part] = by_effect[k][index]
        elif effect.SCOPE == "rir":
            shared[:, :, part] = by_effect[k][index]
            for i, rir in enumerate(index):
                at = slices[k].start + n * int(np.searchsorted(layout.members[r], rir))
                own[i, :, at:at + n] = by_effect[k][rir]
        else:
            for i, rir in enumerate(index):
                at = part.start + unit[rir] * n
                shared[i, :, at:at + n] = by_effect[k][rir]
    return own, shared


def _whiten(columns, valid, sigma, omega):
    """Make cells of a room independent and of unit scatter, shape (n_rirs, n_cells, n); invalid ones 0."""
    count = valid.sum(axis=0)
    columns = np.where(valid[:, :, None], columns, 0.0)
    mean = columns.sum(axis=0) / np.maximum(count, 1)[:, None]
    part = 1.0 - sigma / np.sqrt(sigma ** 2 + count * omega ** 2)
    return np.where(valid[:, :, None], columns - part[:, None] * mean, 0.0) / sigma[:, None]


def _normal(layout, r, residual, valid, slopes, sigma, omega):
    index = layout.members[r]
    own, shared = _derivatives(layout, r, index, slopes)
    error, ok = residual[index], valid[index]
    spread = np.sqrt(sigma ** 2 + omega ** 2)
    weight = np.sqrt(np.minimum(1.0, _HUBER * spread / np.maximum(np.abs(np.where(ok, error, 0.0)), 1e-9)))
    stacked = np.concatenate([own, shared, np.where(ok, error, 0.0)[:, :, None]], axis=2) * weight[:, :, None]
    white = _whiten(stacked, ok, sigma, omega).reshape(-1, stacked.shape[2])
    product = white.T @ white
    n = own.shape[2]
    count = ok.sum(axis=0)
    log_scale = np.sum(np.maximum(count - 1, 0) * np.log(sigma)
                       + np.where(count > 0, 0.5 * np.log(sigma ** 2 + count * omega ** 2), 0.0))
    return (product[:n, :n], product[:n, n:-1], product[n:-1, n:-1], product[:n, -1], product[n:-1, -1],
            product[-1, -1], log_scale)


def _solve(normal, covariance, mean, local, prior_mean, prior):
    """One step of Gauss and Newton; returns new unknowns and the posterior covariance of each room's own."""
    total, right = prior.copy(), prior @ (prior_mean - mean)
    kept = []
    for (uu, ug, gg, ue, ge, *_), cov, u in zip(normal, covariance, local, strict=True):
        inverse = np.linalg.inv(cov)
        room = np.linalg.inv(uu + inverse)
        total += gg - ug.T @ room @ ug
        right += ge - ug.T @ room @ (ue - inverse @ u)
        kept.append((room, ug, ue - inverse @ u))
    step = np.linalg.solve(total, right)
    new = [u + room @ (b - ug @ step) for u, (room, ug, b) in zip(local, kept, strict=True)]
    return mean + step, new, [room for room, _, _ in kept]


def scatter(data, residual, valid):
    """Scatter of cells within and between rooms, shape (n_cells,) each, shrunk to what their metric has."""
    clipped = np.where(valid, np.clip(residual, -15.0, 15.0), np.nan)
    rooms = [clipped[data.room == r] for r in range(len(data.room_names)) if np.any(data.room == r)]
    count = np.array([np.isfinite(one).sum(axis=0) for one in rooms])
    total = np.array([np.nansum(one, axis=0) for one in rooms])
    square = np.array([np.nansum(one ** 2, axis=0) for one in rooms])
    mean = total / np.maximum(count, 1)
    within = np.maximum(np.sum(square - count * mean ** 2, axis=0), 0.0)  # rounding may take equal cells below 0
    freedom = np.sum(np.maximum(count - 1, 0), axis=0)
    between = np.sum(count * mean ** 2, axis=0) - np.sum(count > 0, axis=0) * within / np.maximum(freedom, 1)
    sigma2, omega2 = np.empty(N_CELLS), np.empty(N_CELLS)
    for metric in np.unique(METRIC):
        at = METRIC == metric
        typical = within[at].sum() / max(freedom[at].sum(), 1.0)
        sigma2[at] = (within[at] + 8.0 * typical) / (freedom[at] + 8.0)
        usual = max(between[at].sum(), 0.0) / max(count[:, at].sum(), 1.0)
        omega2[at] = (np.maximum(between[at], 0.0) + 16.0 * usual) / (count[:, at].sum(axis=0) + 16.0)
    return np.clip(np.sqrt(sigma2), *_SIGMA), np.clip(np.sqrt(omega2), *_OMEGA)


def _best_shape(local, spreads):
    """Spread of the absorption over rooms that makes what was found most likely."""
    best, best_value = None, -np.inf
    for shape in _SHAPES:
        covariance, value = absorption_covariance(*shape), 0.0
        for u, spread in zip(local, spreads, strict=True):
            total = covariance + spread[:N_BANDS, :N_BANDS]
            value -= 0.5 * (np.linalg.slogdet(total)[1] + u[:N_BANDS] @ np.linalg.solve(total, u[:N_BANDS]))
        if value > best_value:
            best, best_value = shape, value
    return best


def _own_scale(layout, k, local, spreads):
    """Spread of a room's effect over rooms, as a factor of the effect's own `SPREAD`."""
    effect = layout.effects[k]
    if effect.SCOPE not in OWN or not effect.SPREAD:
        return 1.0
    variance = np.diag(effect.prior_covariance())
    found = [(u[part] ** 2 + np.diag(spread)[part]).reshape(-1, len(variance)) / variance
             for u, spread, part in zip(local, spreads, [slices[k] for slices, _ in layout.own_slices], strict=True)]
    return float(np.clip(np.sqrt(np.mean(np.concatenate(found))), 0.15, 1.5))


@dataclass(frozen=True)
class LeftOut:
    """What the other rooms say of one room.

    Attributes
    ----------
    mean : ndarray, shape (n_shared,)
        The shared unknowns as fitted to the others.
    log_density : float
        That they give to the room's RIRs.
    """

    mean: np.ndarray
    log_density: float


def leave_rooms_out(data, found):
    """Fit each model to all rooms but one and judge it by that one; a LeftOut per room."""
    layout = Layout(data, found.effects)
    _, prior_mean, prior = _shared_prior(layout, [effect.STARTS[0] for effect in layout.effects])
    prior_mean[:N_BANDS] = _START_X
    parts = []
    for (uu, ug, gg, ue, ge, *_), cov, u in zip(found.normal, found.covariance, found.local, strict=True):
        inverse = np.linalg.inv(cov)
        room = np.linalg.inv(uu + inverse)
        parts.append((gg - ug.T @ room @ ug, ge - ug.T @ room @ (ue - inverse @ u)))
    total = prior + sum(part for part, _ in parts)
    right = prior @ (prior_mean - found.mean) + sum(part for _, part in parts)
    result = []
    for r, (own, own_right) in enumerate(parts):
        precision = total - own
        step = np.linalg.solve(precision, right - own_right)
        result.append(LeftOut(found.mean + step, _log_density(found, r, precision, step)))
    return result


def _log_density(found, r, precision, step):
    """Density of a room's RIRs, its own unknowns and the shared ones integrated over (Gaussian)."""
    uu, ug, gg, ue, ge, ee, log_scale = found.normal[r]
    inverse = np.linalg.inv(found.covariance[r])
    u0 = -found.local[r]  # from the fitted unknowns back to their prior mean
    quad = ee - 2.0 * (ue @ u0 + ge @ step) + u0 @ uu @ u0 + 2.0 * u0 @ ug @ step + step @ gg @ step
    right = np.concatenate([ue - uu @ u0 - ug @ step, ge - ug.T @ u0 - gg @ step])
    products = np.block([[uu, ug], [ug.T, gg]])
    prior = np.zeros_like(products)
    n = len(u0)
    prior[:n, :n], prior[n:, n:] = inverse, precision
    posterior = products + prior
    return float(-0.5 * (quad - right @ np.linalg.solve(posterior, right))
                 - 0.5 * (np.linalg.slogdet(posterior)[1] - np.linalg.slogdet(prior)[1]) - log_scale)



def calibrate(data, found, left_out, index, offset, *, chosen=None):
    """What some RIRs of each room say of the room, the shared unknowns being as fitted to the other rooms.

    Parameters
    ----------
    data : roomeq.loop.data.Data
    found : Fit
    left_out : list of LeftOut
    index : list of ndarray
        For each room, the RIRs that may be looked at.
    offset : ndarray, shape (n_rirs, n_cells)
    chosen : ndarray of bool, shape (n_cells,), optional
        The cells that may be looked at; all by default.

    Returns
    -------
    absorption : ndarray, shape (n_rooms, 2, 8)
        ``-ln(1 - alpha)`` of walls, and of floor and ceiling.
    vectors : list of list of ndarray
        For each room, the vectors of each effect's units.
    gains : ndarray, shape (n_rirs,)
    """
    layout = Layout(data, found.effects)
    predicted, slopes = _linearise(layout, found.mean, found.local, offset, found.by_surface)
    residual = data.cells - predicted
    valid = data.valid & np.isfinite(residual)
    if chosen is not None:
        valid = valid & chosen
    absorption, vectors, gains = np.empty((len(found.local), 2, N_BANDS)), [], np.empty(len(data.rows))
    for r, (u, one) in enumerate(zip(found.local, left_out, strict=True)):
        looked_at = valid.copy()
        unknown = np.setdiff1d(layout.members[r], index[r])
        looked_at[unknown] &= PEEKED  # at as much of the others as tells what is theirs alone
        uu, ug, _, ue, *_ = _normal(layout, r, residual, looked_at, slopes, found.sigma, found.omega)
        inverse = np.linalg.inv(found.covariance[r])
        own = u + np.linalg.solve(uu + inverse, ue - ug @ (one.mean - found.mean) - inverse @ u)
        local = [own if s == r else other for s, other in enumerate(found.local)]
        absorption[r] = layout.absorption(one.mean, local)[r]
        vectors.append(layout.vectors(one.mean, local))
        mine = data.room == r
        gains[mine] = layout.gains(local)[mine]
    return absorption, vectors, gains


def solve_rooms(layout, like, mean, offset, index, chosen=None, iterations=_ITERATIONS):
    """What is unknown of each room of new data, given what all rooms share.

    Parameters
    ----------
    layout : Layout
        Of the new data.
    like : Fit
        Gives the spread over rooms and the scatter of cells.
    mean : ndarray, shape (n_shared,)
    offset : ndarray, shape (n_rirs, n_cells)
    index : list of ndarray
        For each room, the RIRs that may be looked at.
    chosen : ndarray of bool, shape (n_cells,), optional
        The cells that may be looked at.
    iterations : int

    Returns
    -------
    list of ndarray
        As `Fit.local`.
    """
    data = layout.data
    own_scale = [1.0] * len(layout.effects)
    covariances = _covariances(layout, (0.3, 0.2, 0.1), own_scale)
    for covariance in covariances:
        covariance[:N_SURFACE, :N_SURFACE] = like.covariance[0][:N_SURFACE, :N_SURFACE]
    local = [np.zeros(size) for _, size in layout.own_slices]
    _first_gains(layout, offset, mean, local)
    for _ in range(iterations):
        predicted, slopes = _linearise(layout, mean, local, offset)
        residual = data.cells - predicted
        valid = data.valid & np.isfinite(residual)
        if chosen is not None:
            valid = valid & chosen
        for r, covariance in enumerate(covariances):
            looked_at = valid.copy()
            looked_at[np.setdiff1d(layout.members[r], index[r])] &= PEEKED
            uu, _, _, ue, *_ = _normal(layout, r, residual, looked_at, slopes, like.sigma, like.omega)
            inverse = np.linalg.inv(covariance)
            local[r] = local[r] + np.linalg.solve(uu + inverse, ue - inverse @ local[r])
    return local
