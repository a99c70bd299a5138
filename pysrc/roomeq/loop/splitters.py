"""Leave rooms out, and leave positions out: splits of the data, and parameters that do not use what is held out.

Leave-room-out
    The shared parameters are fitted to all rooms but one (`leave_rooms_out`). The probability density that this fit
    gives to the held-out room is its score (Laplace's approximation about the joint fit; Gelman et al., Bayesian Data
    Analysis, 3rd ed., sec. 5.4, 7.1 and 13.3).
Leave-positions-out
    One half of a held-out room's RIRs (`split_positions`) calibrates the room's own parameters (`calibrate`, or
    `solve_rooms` for data that the fit has not seen); the other half is scored.
"""

import logging
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse.csgraph import connected_components

from roomeq.core.arrays import Array, BoolArray, FloatArray, IntArray
from roomeq.core.constants import BAND_1KHZ
from roomeq.loop.data import Data
from roomeq.loop.features import CALIBRATION_FEATURES, HAS_GAIN, N_FEATURES
from roomeq.loop.fit import (
    CONVERGED,
    Fit,
    SharedPrior,
    cost,
    covariances,
    estimate_gains,
    inverted,
    shared_prior,
    start_from_measured,
    take_step,
)
from roomeq.loop.likelihood import NormalEquations, add_block, all_normal_equations, huber_root, normal_equations
from roomeq.loop.packing import GAIN_KINDS, LEVEL_KINDS, N_SURFACE, OWN_SCOPES, Linearization, ParameterIndex
from roomeq.loop.predict import N_BANDS, ReflectedEnergy
from roomeq.loop.session import Session
from roomeq.records.schema import session_name

logger = logging.getLogger(__name__)

Cholesky = tuple[FloatArray, bool]
"""From `scipy.linalg.cho_factor`."""
_WIDEST, _GRID_POINTS = 3.0, 41
"""Grid of the vector of a single RIR about its mean over RIRs: its end, in standard deviations, and its size."""
COMMON_SPECTRUM = np.array([-0.28, -0.19, -0.19, -0.03, 0.0, 0.02, 0.01, -0.08])
"""Logarithm of ``-ln(1 - alpha)`` per octave, relative to 1 kHz: mean of 174 rooms of `conf/room_types.toml` with the
materials of `conf/materials.toml`, from T20 less air absorption (`roomeq simulate --rooms 240 --num-rays 3000`)."""
_MOST_ITERATIONS = 40  # to estimate the parameters of rooms that a fit has not seen


@dataclass(frozen=True)
class HeldOutRoom:
    """Result of fitting all other rooms.

    Attributes
    ----------
    mean : ndarray, shape (n_shared,)
        Shared parameters.
    of_all : ndarray, shape (n_shared, n_shared)
        Precision of their posterior with all rooms.
    of_room : ndarray, shape (n_columns, n_columns)
        What the room itself adds to it.
    columns : ndarray of int
        Of the shared parameters on which the room depends.
    log_density : float
        Log density of the room's RIRs.
    """

    mean: FloatArray
    of_all: FloatArray
    of_room: FloatArray
    columns: IntArray
    log_density: float

    @property
    def precision(self) -> FloatArray:
        """Of the posterior of the shared parameters, shape (n_shared, n_shared)."""
        return _less(self.of_all, self.of_room, self.columns)


class Usable(NamedTuple):
    """Features that a calibration may use, shape (n_features,).

    Attributes
    ----------
    features : ndarray of bool
    of_surfaces : ndarray of bool
        Those of them that tell about the surfaces of the room. The others calibrate all else, given the surfaces
        (cut feedback; Plummer, Stat. Comput. 25 (2015) 37).
    """

    features: BoolArray
    of_surfaces: BoolArray

    @property
    def stages(self) -> list[BoolArray]:
        """The features for the surfaces, and then those for all else; one stage if they are the same."""
        return [self.of_surfaces, *([] if np.array_equal(self.features, self.of_surfaces) else [self.features])]


EVERY_FEATURE = Usable(np.ones(N_FEATURES, dtype=bool), np.ones(N_FEATURES, dtype=bool))


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


def leave_rooms_out(data: Data, fitted: Fit, groups: IntArray | None = None) -> list[HeldOutRoom]:
    """Fit the shared parameters to all rooms but one, for each room; all rooms of its group are left out, if given.

    Groups are numbers of rooms, shape (n_rooms,).
    """
    index = ParameterIndex(data, fitted.effects)
    prior = shared_prior(index)
    alone = [_without_own(*of_room) for of_room in zip(fitted.normal, fitted.precision, fitted.local, strict=True)]
    total, right = prior.precision.copy(), prior.precision @ (prior.mean - fitted.mean)
    for room, (of_room, right_of_room) in zip(fitted.normal, alone, strict=True):
        add_block(total, room.columns, of_room, 1.0)
        right[room.columns] += right_of_room
    of_all = cho_factor(total)
    # the step that remains from the fit: 0 at its optimum, not where a parameter of an effect is at its limit, and
    # there the fit has tried and rejected it
    rejected = cho_solve(of_all, right)
    groups = np.arange(len(alone)) if groups is None else groups
    held_out = []
    for r, (room, (of_room, right_of_room)) in enumerate(zip(fitted.normal, alone, strict=True)):
        with_room, right_with_room = total, right.copy()
        mates = np.flatnonzero((groups == groups[r]) & (np.arange(len(alone)) != r))
        for s in mates:
            with_room = _less(with_room, alone[s][0], fitted.normal[s].columns)
            right_with_room[fitted.normal[s].columns] -= alone[s][1]
        of_all_left = cho_factor(with_room) if len(mates) else of_all
        of_others = cho_factor(_less(with_room, of_room, room.columns))
        right_with_room[room.columns] -= right_of_room
        step = cho_solve(of_others, right_with_room) - rejected
        held_out.append(HeldOutRoom(fitted.mean + step, with_room, of_room, room.columns,
                                    _log_density(fitted, r, of_all_left, of_others, step)))
    return held_out


def rooms_by_devices(data: Data) -> IntArray:
    """Return the number of each room's group, shape (n_rooms,): rooms of two groups share no source or microphone."""
    units = [data.units(scope) for scope in ("source", "mic")]
    size = len(data.room_names) + sum(len(names) for names, _ in units)
    shared, first = np.zeros((size, size), dtype=bool), len(data.room_names)
    for names, unit in units:
        shared[data.room, first + unit] = True
        first += len(names)
    return connected_components(shared, directed=False)[1][:len(data.room_names)]


def _less(whole: FloatArray, part: FloatArray, columns: IntArray) -> FloatArray:
    """Return a matrix from which a block is subtracted, whose rows and columns are `columns`."""
    rest = whole.copy()
    add_block(rest, columns, part, -1.0)
    return rest


def _without_own(room: NormalEquations, inverse: Array, own: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what a room says about the shared parameters on which it depends, its own integrated out.

    Returns precision and right-hand side, of its `columns`.
    """
    posterior = np.linalg.inv(room.own_own + inverse)
    return (room.shared_shared - room.own_shared.T @ posterior @ room.own_shared,
            room.shared_residual - room.own_shared.T @ posterior @ (room.own_residual - inverse @ own))


def _log_density(fitted: Fit, r: int, of_all: Cholesky, of_others: Cholesky, step: FloatArray) -> float:
    """Return the log density of a room's RIRs, its own and the shared parameters integrated out (Gaussian).

    The precision of the shared parameters is given as Cholesky factors: of all rooms, and of the others. Once the
    room's own parameters are integrated out, the posterior of the shared ones is that of all rooms.
    """
    room = fitted.normal[r]
    inverse = fitted.precision[r]
    back = -fitted.local[r]  # from the fitted parameters back to their prior mean
    step = step[room.columns]
    quad = (room.residual_residual - 2.0 * (room.own_residual @ back + room.shared_residual @ step)
            + back @ room.own_own @ back + 2.0 * back @ room.own_shared @ step + step @ room.shared_shared @ step)
    own = cho_factor(room.own_own + inverse)
    own_right = room.own_residual - room.own_own @ back - room.own_shared @ step
    right = np.zeros(len(of_all[0]))
    right[room.columns] = (room.shared_residual - room.own_shared.T @ back - room.shared_shared @ step
                           - room.own_shared.T @ cho_solve(own, own_right))
    explained = own_right @ cho_solve(own, own_right) + right @ cho_solve(of_all, right)
    log_posterior = _log_determinant(own) + _log_determinant(of_all)
    log_prior = np.linalg.slogdet(inverse)[1] + _log_determinant(of_others)
    return float(-0.5 * (quad - explained) - 0.5 * (log_posterior - log_prior) - room.log_scale)


def _log_determinant(factor: Cholesky) -> float:
    return 2.0 * float(np.sum(np.log(np.diag(factor[0]))))


def split_positions(data: Data) -> tuple[list[IntArray], list[IntArray]]:
    """Split each room's RIRs into two halves: two lists of arrays of RIRs.

    All RIRs of one place, such as the channels of an array, join the same half: one calibrated by another would be no
    held-out position. It is the half with fewer RIRs of their chains, then the half with fewer of their sources and
    microphones, then of their sessions. The second half of a room with a single place is empty.
    """
    (_, source), (_, mic) = data.units("source"), data.units("mic")
    session: Any = np.array([session_name(row) for row in data.rows])
    first, second = [], []
    for r in range(len(data.room_names)):
        members = np.flatnonzero(data.room == r)
        halves: tuple[list[int], list[int]] = [], []
        chains = list(np.unique(data.chain[members]))
        by_chain = members[np.argsort(data.chain[members], kind="stable")]
        for place in dict.fromkeys(data.place_number[by_chain]):
            here = by_chain[data.place_number[by_chain] == place]
            load = [(np.isin(data.chain[half], data.chain[here]).sum(),
                     np.isin(source[half], source[here]).sum() + np.isin(mic[half], mic[here]).sum(),
                     np.isin(session[half], session[here]).sum(), len(half))
                    for half in (np.array(rirs, dtype=int) for rirs in halves)]
            fewer = chains.index(data.chain[here[0]]) % 2 if load[0] == load[1] else int(load[1] < load[0])
            halves[fewer].extend(here)
        first.append(np.array(sorted(halves[0]), dtype=int))
        second.append(np.array(sorted(halves[1]), dtype=int))
    return first, second


def _visible(index: ParameterIndex, known: list[IntArray], features: BoolArray) -> BoolArray:
    """Return what a calibration sees: of RIRs to be scored only `CALIBRATION_FEATURES`; (n_rirs, n_features)."""
    mask = np.tile(features, (len(index.data.rows), 1))
    for members, of_room in zip(index.members, known, strict=True):
        mask[np.setdiff1d(members, of_room)] &= CALIBRATION_FEATURES
    return mask


def _levels_for_gains(index: ParameterIndex, known: list[IntArray], visible: BoolArray) -> BoolArray:
    """Return the valid levels that set gains which no visible level tells, shape (n_rirs, n_features).

    They are those of the known RIRs with that gain, or those of the RIR itself where the gain is its own: such an RIR
    says nothing of its level anyway. Without them, RIRs whose direct sound is hidden or lost in the noise would have a
    gain of 0 dB, and errors that depend on the gain of the recording.
    """
    valid = index.data.valid & HAS_GAIN
    told: BoolArray = np.any(valid & visible, axis=1)
    levels = np.zeros_like(valid)
    for r, (members, of_room) in enumerate(zip(index.members, known, strict=True)):
        for n in np.flatnonzero(np.isin(index.gain_kind[r], LEVEL_KINDS)):
            with_gain = members[index.gain_design[r][:, n] > 0.0]
            if not told[with_gain].any():
                rirs = with_gain if GAIN_KINDS[index.gain_kind[r][n]] == "rir" else np.intersect1d(with_gain, of_room)
                levels[rirs] = valid[rirs]
    return levels


def calibrate(session: Session, held_out: list[HeldOutRoom], known: list[IntArray],
              usable: Usable = EVERY_FEATURE) -> Calibration:
    """Estimate the parameters of each room from some of its RIRs, given what the other rooms say about the shared ones.

    A loudspeaker that is in one room only is unknown to the other rooms: the RIRs of that room tell its parameters. A
    shared parameter that many rooms determine hardly changes. Gains of which no usable feature tells follow last, from
    other levels (`_levels_for_gains`), which change nothing else.

    Parameters
    ----------
    session : Session
    held_out : list of HeldOutRoom
    known : list of ndarray of int
        Of each room: the RIRs that may be used.
    usable : Usable, optional
    """
    data, fitted, index = session.data, session.fit, session.index
    residual, valid = data.residual(fitted.predicted)
    visibles = [_visible(index, known, features) for features in usable.stages]
    levels = _levels_for_gains(index, known, visibles[-1])
    absorption, vectors, gains = np.empty((len(fitted.local), 2, N_BANDS)), [], np.empty(len(data.rows))
    for r, (local, room) in enumerate(zip(fitted.local, held_out, strict=True)):
        n, n_all = len(local), len(local) + index.n_shared
        of_surfaces = np.isin(np.arange(n_all), np.concatenate([np.arange(N_SURFACE), n + np.arange(N_SURFACE)]))
        systems = [_calibration_system(index, fitted, r, room, residual, valid & visible) for visible in visibles]
        step, rest = np.linalg.solve(*systems[0]), ~of_surfaces
        for matrix, right in systems[1:]:
            step[rest] = np.linalg.solve(matrix[np.ix_(rest, rest)],
                                         right[rest] - matrix[np.ix_(rest, of_surfaces)] @ step[of_surfaces])
        mean = fitted.mean + step[n:]
        all_local = [local + step[:n] if s == r else of_other for s, of_other in enumerate(fitted.local)]
        absorption[r] = index.absorption(mean, all_local)[r]
        vectors.append(index.vectors(mean, all_local))
        members = data.room == r
        if levels[members].any():
            estimate_gains(index, session.correction, mean, all_local, levels & members[:, None])
        gains[members] = index.gains(all_local)[members]
    _search_rirs(session, held_out, known, usable, vectors, gains)
    return Calibration(absorption, vectors, gains)


def _calibration_system(index: ParameterIndex, fitted: Fit, r: int, room: HeldOutRoom, residual: FloatArray,
                        valid: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return matrix and right-hand side for a step of a held-out room's own and of the shared parameters."""
    equations = normal_equations(index, r, residual, valid, fitted.derivatives, fitted.sigma, fitted.omega)
    local, inverse, precision = fitted.local[r], fitted.precision[r], room.precision
    n = len(local)
    matrix = np.zeros((n + index.n_shared, n + index.n_shared))
    matrix[n:, n:] = precision
    right = np.concatenate([equations.own_residual - inverse @ local, precision @ (room.mean - fitted.mean)])
    columns = n + equations.columns
    matrix[:n, :n] = equations.own_own + inverse
    matrix[:n, columns], matrix[columns, :n] = equations.own_shared, equations.own_shared.T
    add_block(matrix, columns, np.ascontiguousarray(equations.shared_shared), 1.0)
    right[columns] += equations.shared_residual
    return matrix, right


def _search_rirs(session: Session, held_out: list[HeldOutRoom], known: list[IntArray], usable: Usable,
                 vectors: list[list[FloatArray]], gains: FloatArray) -> None:
    """Replace the vectors that belong to single RIRs, of the RIRs to be scored, by the most probable ones of a grid.

    Only the few features that calibration may use tell about such an RIR, and its vector can be far from the fitted
    one, which all of its features determine: a step of least squares does not reach it. All else is as fitted. The
    vectors have one component.
    """
    data, fitted, index = session.data, session.fit, session.index
    of_rirs = [k for k, effect in enumerate(index.effects) if effect.SCOPE == "rir"]
    if not of_rirs:
        return
    visible = _visible(index, known, usable.features)
    absorption, of_fit = index.absorption(fitted.mean, fitted.local), index.vectors(fitted.mean, fitted.local)
    reflected, spread = ReflectedEnergy(data, index.state(absorption, of_fit)), np.hypot(fitted.sigma, fitted.omega)
    for k in of_rirs:
        first = index.local[0].slices[k].start
        scale = np.sqrt(fitted.covariance[0][first, first])
        centre = np.array([held_out[r].mean[index.shared[k].part] for r in data.room])
        best, lowest = centre.copy(), np.full(len(centre), np.inf)
        for deviation in np.linspace(-_WIDEST, _WIDEST, _GRID_POINTS):
            moved = centre + deviation * scale
            of_grid = [*of_fit[:k], moved, *of_fit[k + 1:]]
            residual, valid = data.residual(index.predict(absorption, of_grid, gains, session.correction, reflected))
            error, _ = huber_root(residual, valid & visible, fitted.sigma, fitted.omega)
            value = deviation ** 2 + np.sum((error / spread) ** 2, axis=1)
            best[value < lowest], lowest = moved[value < lowest], np.minimum(value, lowest)
        for of_room, members, calibrating in zip(vectors, index.members, known, strict=True):
            scored = np.setdiff1d(members, calibrating)
            of_room[k][scored] = best[scored]


def transfer_shared(session: Session, index: ParameterIndex) -> SharedPrior:
    """Return what a session says about the shared parameters of other data, whose units it may not know.

    An unknown unit, such as another laboratory's loudspeaker, gets the mean of the known ones and the spread of real
    units (`Effect.SPREAD`). The mean spectrum of absorption is half that of the session's rooms and half that of rooms
    in general (`COMMON_SPECTRUM`): the rooms of a laboratory resemble each other, so that few laboratories say little
    about the next.
    """
    fitted, before = session.fit, session.index
    prior = shared_prior(before)
    precision: FloatArray = prior.precision.copy()
    for room, of_own, own in zip(fitted.normal, fitted.precision, fitted.local, strict=True):
        add_block(precision, room.columns, _without_own(room, of_own, own)[0], 1.0)
    covariance = np.linalg.inv(precision)
    mean, spread = np.zeros(index.n_shared), np.zeros((index.n_shared, index.n_shared))
    mean[:N_SURFACE], spread[:N_SURFACE, :N_SURFACE] = fitted.mean[:N_SURFACE], covariance[:N_SURFACE, :N_SURFACE]
    mean[:N_BANDS] = 0.5 * mean[:N_BANDS] + 0.5 * (mean[BAND_1KHZ] + COMMON_SPECTRUM)
    for effect, there, here in zip(index.effects, before.shared, index.shared, strict=True):
        vectors = fitted.mean[there.part].reshape(there.n_vectors, there.size)
        of_room = effect.SCOPE in OWN_SCOPES
        known = ["mean"] if of_room else session.data.units(effect.SCOPE)[0]
        for u, name in enumerate(["mean"] if of_room else index.data.units(effect.SCOPE)[0]):
            at = slice(here.part.start + u * here.size, here.part.start + (u + 1) * here.size)
            if name in known:
                k = known.index(name)
                source = slice(there.part.start + k * there.size, there.part.start + (k + 1) * there.size)
                mean[at], spread[at, at] = vectors[k], covariance[source, source]
            else:
                mean[at], spread[at, at] = vectors.mean(axis=0), effect.prior_covariance()
    return SharedPrior(mean, np.asarray(np.linalg.inv(spread), dtype=np.float64))


def solve_rooms(index: ParameterIndex, fitted: Fit, prior: SharedPrior, correction: FloatArray, known: list[IntArray],
                usable: Usable = EVERY_FEATURE) -> tuple[FloatArray, list[FloatArray]]:
    """Estimate the parameters of rooms that a fit has not seen, from some of their RIRs; gains as in `calibrate`.

    Parameters
    ----------
    index : ParameterIndex
        Of the new data.
    fitted : Fit
        Gives the spread over rooms and the scatter of features.
    prior : SharedPrior
        Shared parameters (`transfer_shared`).
    correction : ndarray, shape (n_rirs, n_features)
    known : list of ndarray of int
        Of each room: the RIRs that may be used.
    usable : Usable, optional

    Returns
    -------
    mean : ndarray, shape (n_shared,)
    local : list of ndarray
        As `Fit.local`.
    """
    precision = []
    for covariance in covariances(index, (0.3, 0.2, 0.1), [1.0] * len(index.effects), fitted.gain_db):
        covariance[:N_SURFACE, :N_SURFACE] = fitted.covariance[0][:N_SURFACE, :N_SURFACE]
        precision.append(inverted(covariance))
    mean, local = prior.mean.copy(), [np.zeros(part.size) for part in index.local]
    estimate_gains(index, correction, mean, local)
    visible = _visible(index, known, usable.features)
    usable_data = replace(index.data, valid=index.data.valid & visible)
    start_from_measured(index, mean, local, [effect.measured_vectors(usable_data) for effect in index.effects])
    for features in usable.stages:
        mean, local = _converged(index, fitted, prior, precision, correction, mean, local,
                                 _visible(index, known, features), usable.of_surfaces)
    levels = _levels_for_gains(index, known, visible)
    if levels.any():
        estimate_gains(index, correction, mean, local, levels)
    return mean, local


def _converged(index: ParameterIndex, fitted: Fit, prior: SharedPrior, precision: list[FloatArray],
               correction: FloatArray, mean: FloatArray, local: list[FloatArray], visible: BoolArray,
               of_surfaces: BoolArray) -> tuple[FloatArray, list[FloatArray]]:
    """Return the most probable parameters given the `visible` features, (n_rirs, n_features), as `solve_rooms` does.

    Only the features `of_surfaces`, (n_features,), move the surfaces. Nothing is known of the rooms at the start, so
    that it takes more iterations than to continue a fit.
    """
    linearization = Linearization(index, correction)
    for _ in range(_MOST_ITERATIONS):
        predicted, derivatives = linearization.at(mean, local)
        derivatives = derivatives._replace(by_surface=np.where(of_surfaces[:, None], derivatives.by_surface, 0.0))
        residual, valid = index.data.residual(predicted)
        normal = all_normal_equations(index, residual, valid & visible, derivatives, fitted.sigma, fitted.omega)
        cost_at = partial(cost, linearization, fitted.sigma, fitted.omega, precision, prior, visible=visible)
        mean, local, _, fall = take_step(cost_at, normal, precision, mean, local, prior)
        if fall < CONVERGED:
            break
    else:
        logger.warning("the parameters of rooms that the fit has not seen did not converge in %d iterations",
                       _MOST_ITERATIONS)
    return mean, local
