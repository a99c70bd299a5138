"""How well rooms are predicted that took no part in a fit, and what some of their RIRs say of them.

A model is judged by the probability density it gives to each room after it has been fitted to the others (Laplace's
approximation about the joint fit; Gelman et al., Bayesian Data Analysis, 3rd ed., sec. 5.4, 7.1 and 13.3).
"""

from dataclasses import dataclass

import numpy as np

from roomeq.loop.features import METRIC, N_FEATURES
from roomeq.loop.fit import ITERATIONS, START_X, covariances, first_gains, shared_prior
from roomeq.loop.linear import linearise, normal_equations
from roomeq.loop.packing import N_SURFACE, ParameterIndex
from roomeq.loop.predict import N_BANDS

CALIBRATION_FEATURES = (METRIC == "direct") & (np.arange(N_FEATURES) % 2 == 0)
"""Features of scored RIRs that tell whether their direct sound is obstructed, and are not scored."""


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
    packing = ParameterIndex(data, found.effects)
    _, prior_mean, prior = shared_prior(packing, [effect.STARTS[0] for effect in packing.effects])
    prior_mean[:N_BANDS] = START_X
    parts = []
    for (uu, ug, gg, ue, ge, *_), cov, u in zip(found.normal, found.covariance, found.local, strict=True):
        inverse = np.linalg.inv(cov)
        room = np.linalg.inv(uu + inverse)
        parts.append((gg - ug.T @ room @ ug, ge - ug.T @ room @ (ue - inverse @ u)))
    total = prior + sum(part for part, _ in parts)
    right = prior @ (prior_mean - found.mean) + sum(part for _, part in parts)
    # nothing is left to do where the fit came to its end; at a limit of an effect there is, and it had been tried
    rejected = np.linalg.solve(total, right)
    result = []
    for r, (own, own_right) in enumerate(parts):
        precision = total - own
        step = np.linalg.solve(precision, right - own_right) - rejected
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


def _looked_at(packing, r, valid, known):
    """Features that a room's calibration may look at: of RIRs to be scored only what tells what is theirs alone."""
    looked_at = valid.copy()
    looked_at[np.setdiff1d(packing.members[r], known)] &= CALIBRATION_FEATURES
    return looked_at


def calibrate(data, found, left_out, index, correction, *, chosen=None):
    """What some RIRs of each room say of the room, the shared unknowns being as fitted to the other rooms.

    Parameters
    ----------
    data : roomeq.loop.data.Data
    found : Fit
    left_out : list of LeftOut
    index : list of ndarray
        For each room, the RIRs that may be looked at.
    correction : ndarray, shape (n_rirs, n_features)
    chosen : ndarray of bool, shape (n_features,), optional
        The features that may be looked at; all by default.

    Returns
    -------
    absorption : ndarray, shape (n_rooms, 2, 8)
        ``-ln(1 - alpha)`` of walls, and of floor and ceiling.
    vectors : list of list of ndarray
        For each room, the vectors of each effect's units.
    gains : ndarray, shape (n_rirs,)
    """
    packing = ParameterIndex(data, found.effects)
    predicted, slopes = linearise(packing, found.mean, found.local, correction, found.by_surface)
    residual, valid = data.residual(predicted)
    if chosen is not None:
        valid = valid & chosen
    absorption, vectors, gains = np.empty((len(found.local), 2, N_BANDS)), [], np.empty(len(data.rows))
    for r, (u, one) in enumerate(zip(found.local, left_out, strict=True)):
        looked_at = _looked_at(packing, r, valid, index[r])
        uu, ug, _, ue, *_ = normal_equations(packing, r, residual, looked_at, slopes, found.sigma, found.omega)
        inverse = np.linalg.inv(found.covariance[r])
        own = u + np.linalg.solve(uu + inverse, ue - ug @ (one.mean - found.mean) - inverse @ u)
        local = [own if s == r else other for s, other in enumerate(found.local)]
        absorption[r] = packing.absorption(one.mean, local)[r]
        vectors.append(packing.vectors(one.mean, local))
        mine = data.room == r
        gains[mine] = packing.gains(local)[mine]
    return absorption, vectors, gains


def solve_rooms(packing, like, mean, correction, index, chosen=None, iterations=ITERATIONS):
    """What is unknown of each room of new data, given what all rooms share.

    Parameters
    ----------
    packing : ParameterIndex
        Of the new data.
    like : Fit
        Gives the spread over rooms and the scatter of features.
    mean : ndarray, shape (n_shared,)
    correction : ndarray, shape (n_rirs, n_features)
    index : list of ndarray
        For each room, the RIRs that may be looked at.
    chosen : ndarray of bool, shape (n_features,), optional
        The features that may be looked at.
    iterations : int

    Returns
    -------
    list of ndarray
        As `Fit.local`.
    """
    data = packing.data
    own_scale = [1.0] * len(packing.effects)
    spreads = covariances(packing, (0.3, 0.2, 0.1), own_scale, like.gain_db)
    for covariance in spreads:
        covariance[:N_SURFACE, :N_SURFACE] = like.covariance[0][:N_SURFACE, :N_SURFACE]
    local = [np.zeros(size) for _, size in packing.own_slices]
    first_gains(packing, correction, mean, local)
    for _ in range(iterations):
        predicted, slopes = linearise(packing, mean, local, correction)
        residual, valid = data.residual(predicted)
        if chosen is not None:
            valid = valid & chosen
        for r, covariance in enumerate(spreads):
            looked_at = _looked_at(packing, r, valid, index[r])
            uu, _, _, ue, *_ = normal_equations(packing, r, residual, looked_at, slopes, like.sigma, like.omega)
            inverse = np.linalg.inv(covariance)
            local[r] = local[r] + np.linalg.solve(uu + inverse, ue - inverse @ local[r])
    return local
