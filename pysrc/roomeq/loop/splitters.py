"""Leave rooms out, and leave positions out: splits of the data, and parameters that do not use what is held out.

Leave-room-out
    The shared parameters are fitted to all rooms but one (`leave_rooms_out`). The probability density that this fit
    gives to the held-out room is its score (Laplace's approximation about the joint fit; Gelman et al., Bayesian Data
    Analysis, 3rd ed., sec. 5.4, 7.1 and 13.3).
Leave-positions-out
    One half of a held-out room's RIRs (`split_positions`) calibrates the room's own parameters (`calibrate`, or
    `solve_rooms` for data that the fit has not seen); the other half is scored.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from roomeq.core.arrays import BoolArray, FloatArray, IntArray
from roomeq.loop.data import Data
from roomeq.loop.features import METRIC, N_FEATURES
from roomeq.loop.fit import ITERATIONS, START_X, Fit, covariances, estimate_gains, shared_prior
from roomeq.loop.likelihood import normal_equations
from roomeq.loop.packing import N_SURFACE, OWN_SCOPES, ParameterIndex
from roomeq.loop.predict import N_BANDS
from roomeq.loop.session import Session

CALIBRATION_FEATURES = (METRIC == "direct") & (np.arange(N_FEATURES) % 2 == 0)
"""Features of scored RIRs that calibration may use, and that are not scored: they show an obstructed direct sound."""


@dataclass(frozen=True)
class HeldOutRoom:
    """Result of fitting all other rooms.

    Attributes
    ----------
    mean : ndarray, shape (n_shared,)
        Shared parameters.
    log_density : float
        Log density of the room's RIRs.
    """

    mean: FloatArray
    log_density: float


class Calibration(NamedTuple):
    """Parameters of rooms of which some RIRs were used.

    Attributes
    ----------
    absorption : ndarray, shape (n_rooms, 2, 8)
        ``-ln(1 - alpha)`` of walls, and of floor and ceiling.
    vectors : list of list of ndarray
        Of each room: the vectors of each effect's units.
    gains : ndarray, shape (n_rirs,)
        [dB].
    """

    absorption: FloatArray
    vectors: list[list[FloatArray]]
    gains: FloatArray


def leave_rooms_out(data: Data, fitted: Fit) -> list[HeldOutRoom]:
    """Fit the shared parameters to all rooms but one, for each room."""
    index = ParameterIndex(data, fitted.effects)
    prior = shared_prior(index, [effect.STARTS[0] for effect in index.effects], START_X)
    rooms = []
    for room, covariance, own in zip(fitted.normal, fitted.covariance, fitted.local, strict=True):
        inverse = np.linalg.inv(covariance)
        posterior = np.linalg.inv(room.own_own + inverse)
        rooms.append((room.shared_shared - room.own_shared.T @ posterior @ room.own_shared,
                      room.shared_residual - room.own_shared.T @ posterior @ (room.own_residual - inverse @ own)))
    total = prior.precision + sum(precision for precision, _ in rooms)
    right = prior.precision @ (prior.mean - fitted.mean) + sum(right for _, right in rooms)
    # the step that remains from the fit: 0 at its optimum, not where a parameter of an effect is at its limit, and
    # there the fit has tried and rejected it
    rejected = np.linalg.solve(total, right)
    held_out = []
    for r, (room_precision, room_right) in enumerate(rooms):
        precision = total - room_precision
        step = np.linalg.solve(precision, right - room_right) - rejected
        held_out.append(HeldOutRoom(fitted.mean + step, _log_density(fitted, r, precision, step)))
    return held_out


def _log_density(fitted: Fit, r: int, precision: FloatArray, step: FloatArray) -> float:
    """Return the log density of a room's RIRs, its own and the shared parameters integrated out (Gaussian)."""
    room = fitted.normal[r]
    inverse = np.linalg.inv(fitted.covariance[r])
    back = -fitted.local[r]  # from the fitted parameters back to their prior mean
    quad = (room.residual_residual - 2.0 * (room.own_residual @ back + room.shared_residual @ step)
            + back @ room.own_own @ back + 2.0 * back @ room.own_shared @ step + step @ room.shared_shared @ step)
    right = np.concatenate([room.own_residual - room.own_own @ back - room.own_shared @ step,
                            room.shared_residual - room.own_shared.T @ back - room.shared_shared @ step])
    products = np.block([[room.own_own, room.own_shared], [room.own_shared.T, room.shared_shared]])
    prior = np.zeros_like(products)
    n = len(back)
    prior[:n, :n], prior[n:, n:] = inverse, precision
    posterior = products + prior
    return float(-0.5 * (quad - right @ np.linalg.solve(posterior, right))
                 - 0.5 * (np.linalg.slogdet(posterior)[1] - np.linalg.slogdet(prior)[1]) - room.log_scale)


def split_positions(data: Data) -> tuple[list[IntArray], list[IntArray]]:
    """Split each room's RIRs into two halves: two lists of arrays of RIRs.

    Each RIR joins the half with fewer RIRs of its chain, then the half with fewer of its source and its microphone.
    The second half of a room with a single RIR is empty.
    """
    (_, source), (_, mic) = data.units("source"), data.units("mic")
    first, second = [], []
    for r in range(len(data.room_names)):
        members = np.flatnonzero(data.room == r)
        halves: tuple[list[int], list[int]] = [], []
        chains = list(np.unique(data.chain[members]))
        for n in members[np.argsort(data.chain[members], kind="stable")]:
            load = [(np.sum(data.chain[half] == data.chain[n]),
                     np.sum(source[half] == source[n]) + np.sum(mic[half] == mic[n]), len(half))
                    for half in (np.array(rirs, dtype=int) for rirs in halves)]
            fewer = chains.index(data.chain[n]) % 2 if load[0] == load[1] else int(load[1] < load[0])
            halves[fewer].append(n)
        first.append(np.array(sorted(halves[0]), dtype=int))
        second.append(np.array(sorted(halves[1]), dtype=int))
    return first, second


def _visible(index: ParameterIndex, r: int, valid: BoolArray, known: IntArray) -> BoolArray:
    """Return the features that a room's calibration may use: `CALIBRATION_FEATURES` only of the RIRs to be scored."""
    visible = valid.copy()
    visible[np.setdiff1d(index.members[r], known)] &= CALIBRATION_FEATURES
    return visible


def calibrate(session: Session, held_out: list[HeldOutRoom], known: list[IntArray],
              usable: BoolArray | None = None) -> Calibration:
    """Estimate each room's own parameters from some of its RIRs, the shared ones being fitted to the other rooms.

    Parameters
    ----------
    session : Session
    held_out : list of HeldOutRoom
    known : list of ndarray of int
        Of each room: the RIRs that may be used.
    usable : ndarray of bool, shape (n_features,), optional
        The features that may be used; by default all.
    """
    data, fitted, index = session.data, session.fit, session.index
    predicted, derivatives = index.linearize(fitted.mean, fitted.local, session.correction, fitted.by_surface)
    residual, valid = data.residual(predicted)
    if usable is not None:
        valid = valid & usable
    absorption, vectors, gains = np.empty((len(fitted.local), 2, N_BANDS)), [], np.empty(len(data.rows))
    for r, (local, room) in enumerate(zip(fitted.local, held_out, strict=True)):
        equations = normal_equations(index, r, residual, _visible(index, r, valid, known[r]), derivatives,
                                     fitted.sigma, fitted.omega)
        inverse = np.linalg.inv(fitted.covariance[r])
        right = equations.own_residual - equations.own_shared @ (room.mean - fitted.mean) - inverse @ local
        own = local + np.linalg.solve(equations.own_own + inverse, right)
        all_local = [own if s == r else of_other for s, of_other in enumerate(fitted.local)]
        absorption[r] = index.absorption(room.mean, all_local)[r]
        vectors.append(index.vectors(room.mean, all_local))
        members = data.room == r
        gains[members] = index.gains(all_local)[members]
    return Calibration(absorption, vectors, gains)


def transfer_shared(session: Session, index: ParameterIndex) -> FloatArray:
    """Return a session's shared parameters for the units of other data; unknown units get the mean."""
    before = session.index
    mean = np.zeros(index.n_shared)
    mean[:N_SURFACE] = session.fit.mean[:N_SURFACE]
    for k, effect in enumerate(index.effects):
        part, _, _, size = index.shared[k]
        vectors = session.fit.mean[before.shared[k].part].reshape(before.shared[k].n_vectors, size)
        if effect.SCOPE in OWN_SCOPES:
            mean[part] = vectors[0]
            continue
        names = session.data.units(effect.SCOPE)[0]
        mean[part] = np.concatenate([vectors[names.index(name)] if name in names else vectors.mean(axis=0)
                                     for name in index.data.units(effect.SCOPE)[0]])
    return mean


def solve_rooms(index: ParameterIndex, fitted: Fit, mean: FloatArray, correction: FloatArray, known: list[IntArray],
                usable: BoolArray | None = None, iterations: int = ITERATIONS) -> list[FloatArray]:
    """Estimate the own parameters of rooms that a fit has not seen, from some of their RIRs.

    Parameters
    ----------
    index : ParameterIndex
        Of the new data.
    fitted : Fit
        Gives the spread over rooms and the scatter of features.
    mean : ndarray, shape (n_shared,)
        Shared parameters (`transfer_shared`).
    correction : ndarray, shape (n_rirs, n_features)
    known : list of ndarray of int
        Of each room: the RIRs that may be used.
    usable : ndarray of bool, shape (n_features,), optional
        The features that may be used; by default all.
    iterations : int

    Returns
    -------
    list of ndarray
        As `Fit.local`.
    """
    priors = covariances(index, (0.3, 0.2, 0.1), [1.0] * len(index.effects), fitted.gain_db)
    for covariance in priors:
        covariance[:N_SURFACE, :N_SURFACE] = fitted.covariance[0][:N_SURFACE, :N_SURFACE]
    local = [np.zeros(part.size) for part in index.local]
    estimate_gains(index, correction, mean, local)
    for _ in range(iterations):
        predicted, derivatives = index.linearize(mean, local, correction)
        residual, valid = index.data.residual(predicted)
        if usable is not None:
            valid = valid & usable
        for r, covariance in enumerate(priors):
            equations = normal_equations(index, r, residual, _visible(index, r, valid, known[r]), derivatives,
                                         fitted.sigma, fitted.omega)
            inverse = np.linalg.inv(covariance)
            local[r] = local[r] + np.linalg.solve(equations.own_own + inverse,
                                                  equations.own_residual - inverse @ local[r])
    return local
