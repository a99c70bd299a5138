"""Errors of a model on held-out RIRs, and whether one model has lower ones than another.

RIRs are rendered with the model, measured, and compared with the recordings, in JND, on two splits:

leave_positions_out
    One half of the room's RIRs calibrates its absorption and gains, the other half is scored, and vice versa. A room
    with RIRs of a single place is not scored.
leave_room_out
    The one half gives only the reverberation time at 1 kHz, the gains, and the noise of the recordings, which is no
    property of the room; all else comes from the other rooms. The direct sound tells the gains, or all levels where no
    direct sound is valid.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.special import stdtr, stdtrit

from roomeq.core.arrays import BoolArray, FloatArray, IntArray
from roomeq.core.constants import BAND_1KHZ
from roomeq.core.workers import share_out
from roomeq.effects.source_directivity import SourceDirectivity
from roomeq.loop.data import Data
from roomeq.loop.facing import estimate_facings, unknown_facings, without_facings
from roomeq.loop.features import BAND_OF_FEATURE, HAS_GAIN, LARGEST, METRIC, SCORED, with_noise_in_octaves
from roomeq.loop.packing import ParameterIndex
from roomeq.loop.rendered_model import change_by, clear_rendered_changes, effects_of_rows
from roomeq.loop.rendering import RowModel, rendered_features, row_models
from roomeq.loop.session import Session
from roomeq.loop.splitters import (
    EVERY_FEATURE,
    Usable,
    calibrate,
    leave_rooms_out,
    rooms_by_devices,
    solve_rooms,
    split_positions,
    transfer_shared,
)

SPLITS = ("leave_positions_out", "leave_room_out")
_T60_AT_1KHZ = np.isin(METRIC, ["t20", "t30"]) & (BAND_OF_FEATURE == BAND_1KHZ)
_USABLE = {
    "leave_positions_out": EVERY_FEATURE,
    "leave_room_out": Usable(_T60_AT_1KHZ | np.isin(METRIC, ["direct", "floor"]), of_surfaces=_T60_AT_1KHZ)}
"""Features that calibration may use on each split. Reflections that arrive in the window of the direct sound would tell
about the absorption of unseen rooms, but so little that errors of their phases decided."""
_METRICS = tuple(dict.fromkeys(METRIC.tolist()))
_EXACT, _SIGN_CHANGES = 18, 2 ** 16
"""Largest number of halves of which all changes of signs are tried, and the number of changes for more."""
_FACING_ROUNDS = 2  # with the mean parameters of the fit's devices, and with those calibrated with the first facings


@dataclass(frozen=True)
class HeldOutErrors:
    """Errors of held-out RIRs.

    Attributes
    ----------
    by_split : dict of ndarray, shape (n_rirs, n_features)
        Absolute errors on each of `SPLITS` [JND], NaN where nothing was measured.
    room, half : ndarray of int, shape (n_rirs,)
        Number of the room, and of the half of its RIRs (`split_positions`).
    """

    by_split: dict[str, FloatArray]
    room: IntArray
    half: IntArray

    def of_rooms(self, split: str, weights: FloatArray | None = None) -> FloatArray:
        """Mean error of each scored room, shape (n_scored_rooms,).

        Every metric has the same weight; or the features have `weights`, (n_rirs, n_features), and the mean of a room
        without any is NaN.
        """
        return np.array([self._mean(split, self.room == r, weights) for r in self._scored(split)])

    def of_halves(self, split: str, weights: FloatArray | None = None) -> FloatArray:
        """Mean error of each half of a room, as `of_rooms`, shape (n_halves,); NaN where nothing was scored."""
        pairs = np.stack([self.room, self.half])
        return np.array([self._mean(split, np.all(pairs == pair[:, None], axis=0), weights)
                         for pair in np.unique(pairs, axis=1).T])

    def _mean(self, split: str, rows: BoolArray, weights: FloatArray | None) -> float:
        errors = self.by_split[split][rows]
        if weights is None:
            return _mean_over_metrics(errors)
        known = np.isfinite(errors) & (weights[rows] > 0.0)
        return float(np.average(errors[known], weights=weights[rows][known])) if known.any() else np.nan

    def _scored(self, split: str) -> IntArray:
        return np.unique(self.room[np.isfinite(self.by_split[split]).any(axis=1)])

    def mean(self, split: str) -> float:
        """Mean error over rooms, NaN where no feature is valid."""
        of_rooms = self.of_rooms(split)
        return float(of_rooms.mean()) if len(of_rooms) else np.nan

    def interval(self, split: str) -> list[float] | None:
        """Confidence interval of 95 % of the mean over rooms (t); None for a single room."""
        return interval_of_mean(self.of_rooms(split))

    def fall_interval(self, after: "HeldOutErrors", split: str) -> list[float] | None:
        """Confidence interval of 95 % of the mean fall from these errors to later ones, paired over rooms (t)."""
        return interval_of_mean(self.of_rooms(split) - after.of_rooms(split))

    def by_metric(self, split: str) -> dict[str, float]:
        """Mean error of each metric, rooms with the same weight [JND]."""
        means = {metric: self._mean_in(split, METRIC == metric) for metric in _METRICS}
        return {metric: mean for metric, mean in means.items() if mean is not None}

    def by_band(self, split: str) -> list[float | None]:
        """Mean error of each octave band, rooms with the same weight, None where nothing was measured [JND]."""
        return [self._mean_in(split, BAND_OF_FEATURE == band) for band in range(8)]

    def of_rooms_in(self, split: str, features: BoolArray) -> FloatArray:
        """Mean error of some features, (n_features,), in each scored room; NaN where none was measured."""
        of_rooms = [self.by_split[split][self.room == r][:, features] for r in self._scored(split)]
        return np.array([np.nanmean(errors) if np.isfinite(errors).any() else np.nan for errors in of_rooms])

    def _mean_in(self, split: str, features: BoolArray) -> float | None:
        means = _known(self.of_rooms_in(split, features))
        return float(means.mean()) if len(means) else None


def interval_of_mean(values: FloatArray) -> list[float] | None:
    """Return the confidence interval of 95 % of a mean (t); None for a single value."""
    if len(values) < 2:
        return None
    half = stdtrit(len(values) - 1, 0.975) * values.std(ddof=1) / np.sqrt(len(values))
    return [float(values.mean() - half), float(values.mean() + half)]


def _mean_over_metrics(errors: FloatArray) -> float:
    metrics = [errors[:, METRIC == metric] for metric in _METRICS]
    means = [np.nanmean(of_metric) for of_metric in metrics if np.isfinite(of_metric).any()]
    return float(np.mean(means)) if means else np.nan


def one_sided_p(differences: FloatArray) -> float:
    """Return the p value of a mean above zero (t test); 1 for a single difference, or if all are 0."""
    if len(differences) < 2 or not np.any(differences):
        return 1.0
    spread = differences.std(ddof=1) / np.sqrt(len(differences))
    return float(stdtr(len(differences) - 1, -differences.mean() / max(spread, 1e-12)))


def p_lower(before: HeldOutErrors, after: HeldOutErrors, split: str, weights: FloatArray | None = None) -> float:
    """Return the one-sided p value of the second error being lower than the first, paired.

    The errors are those of all metrics, or those of features with `weights`, shape (n_rirs, n_features).

    Leave-positions-out: Fisher's randomisation test, which changes the signs of halves of rooms: one calibration serves
    all RIRs of a half, which therefore are one observation. An effect may be strong in some rooms and weak in others; a
    t test over rooms would count that as scatter. The test is discrete, and Fisher's method of combining p values
    assumes that they are continuous: the p value is the mid-p value, which counts half of the probability of the
    observed mean (Lancaster, JASA 56 (1961) 223). Of three rooms, with six halves, the smallest p value would otherwise
    be 0.016. Leave-room-out: a t test over rooms, since a few rooms have too few signs to change.
    """
    if split == "leave_room_out":
        # a room without such features shows no fall, and counts: two rooms say little about the next
        return one_sided_p(np.nan_to_num(before.of_rooms(split, weights) - after.of_rooms(split, weights)))
    change = _known(before.of_halves(split, weights) - after.of_halves(split, weights))
    return _mid_p_of_signs(change) if len(change) else 1.0


def _mid_p_of_signs(change: FloatArray) -> float:
    """Return the mid-p value of a mean above zero under changes of signs (`p_lower`)."""
    if len(change) > _EXACT:
        from scipy.stats import permutation_test  # takes 0.3 s

        test = permutation_test((change,), np.mean, permutation_type="samples", alternative="greater",
                                n_resamples=_SIGN_CHANGES, batch=_SIGN_CHANGES // 16, vectorized=True,
                                rng=np.random.default_rng(0))
        return float(test.pvalue - 0.5 * np.isclose(test.null_distribution, test.statistic, rtol=1e-9).mean())
    sums = np.zeros(1)
    for size in np.abs(change):
        sums = np.concatenate([sums + size, sums - size])
    above, rounding = sums - change.sum(), 1e-9 * np.abs(change).sum()
    return float(np.mean(above > rounding) + 0.5 * np.mean(np.abs(above) <= rounding))


def p_with_other_devices(before: Session, after: Session, weights: FloatArray) -> float:
    """Return the p value of an error being lower in rooms whose devices no other room of the fit has.

    The error is that of features with `weights`, shape (n_rirs, n_features), leave-room-out; a t test over groups of
    rooms that share devices (`roomeq.loop.splitters.rooms_by_devices`). 1 where all rooms share devices.
    """
    groups, (_, split) = rooms_by_devices(before.data), SPLITS
    first, second = (heldout_errors(session, (split,), groups) for session in (before, after))
    falls = np.nan_to_num(first.of_rooms(split, weights) - second.of_rooms(split, weights))
    group = groups[first._scored(split)]
    return one_sided_p(np.array([falls[group == g].mean() for g in np.unique(group)]))


def share_of_fall(before: HeldOutErrors, after: HeldOutErrors, split: str, weights: FloatArray) -> float:
    """Return the fall from one error to another of features with `weights`, as a share of the first, over all rooms."""
    first = before.of_rooms(split, weights)
    return float(_known(first - after.of_rooms(split, weights)).sum() / max(_known(first).sum(), 1e-12))


def _known(values: FloatArray) -> FloatArray:
    return values[np.isfinite(values)]


def measurable_rooms(data: Data) -> IntArray:
    """Return the numbers of the rooms that have an error: they are scored, and a feature that is scored is valid."""
    return np.unique(data.room[np.any(data.valid & SCORED, axis=1) & data.is_scored[data.room]])


def heldout_errors(session: Session, splits: Sequence[str] = SPLITS, groups: IntArray | None = None) -> HeldOutErrors:
    """Return the held-out errors of a session's model on its own data; `groups` as for `leave_rooms_out`."""
    data, held_out = session.data, leave_rooms_out(session.data, session.fit, groups)

    def calibrated(known: list[IntArray], usable: Usable) -> tuple[FloatArray, list, FloatArray]:
        absorption, vectors, gains = calibrate(session, held_out, known, usable)
        by_room = [effects_of_rows(data, session.effects, of_room) for of_room in vectors]
        return absorption, [by_room[r][n] for n, r in enumerate(data.room)], gains

    return _rendered_errors(data, calibrated, splits, seed=session.seed, nj=session.nj)


def predicted_errors(session: Session) -> HeldOutErrors:
    """Return about the errors of `heldout_errors`, without rendering.

    What half of a room, or the other rooms, calibrate differently changes the features as tables predict it. The
    difference between rendered and predicted features (`Session.difference`) is taken to be that of the whole model.
    """
    data, index, held_out = session.data, session.index, leave_rooms_out(session.data, session.fit)
    halves = _halves(data, SPLITS)

    def predict(half: _Half) -> tuple[FloatArray, FloatArray]:
        absorption, vectors, gains = calibrate(session, held_out, half.known, _USABLE[half.split])
        features = index.predict_rooms(absorption, vectors) + session.difference
        return gains[half.rows], features[half.rows]

    predicted = share_out(predict, halves, session.nj, first_here=False, label="predict held-out RIRs")
    gains, features = (np.concatenate(parts) for parts in zip(*predicted, strict=True))
    return _errors(data, SPLITS, np.concatenate([half.rows for half in halves]), gains, features)


def score_test_set(data: Data, session: Session) -> HeldOutErrors:
    """Return the errors of a session's model on rooms that were held out of every fit.

    What is shared comes from the session. Half of each room's RIRs gives the room's own parameters and those of devices
    that the session does not know.

    Parameters
    ----------
    data : Data
        Rooms, and possibly loudspeakers and microphones, that the session has not seen.
    session : Session
    """
    data, calibrated = transferred(data, session)
    return _rendered_errors(data, calibrated, SPLITS, seed=session.seed, nj=session.nj)


def transferred(data: Data, session: Session) -> tuple[Data, Callable]:
    """Return data as a session's model predicts them, and how their rooms are calibrated (`_rendered_errors`)."""
    data = clear_rendered_changes(data, {*session.effects, *data.given_kinds})
    data = _with_facings(data, session)
    index = ParameterIndex(data, session.effects)
    prior = transfer_shared(session, index)
    correction = _transferred_correction(session, len(data.rows))

    def calibrated(known: list[IntArray], usable: Usable) -> tuple[FloatArray, list, FloatArray]:
        mean, local = solve_rooms(index, session.fit, prior, correction, known, usable)
        vectors = index.vectors(mean, local)
        return index.absorption(mean, local), effects_of_rows(data, session.effects, vectors), index.gains(local)

    return data, calibrated


def _transferred_correction(session: Session, n_rirs: int) -> FloatArray:
    """Return what is added to features that are predicted for other rooms, shape (n_rirs, n_features).

    It is the mean of the session's rendering correction, and of the changes by effects on waves: in other rooms, nobody
    has rendered those.
    """
    mean = session.correction.mean(axis=0)
    for effect in session.effects:
        if effect.INTERPOLATION_GRID:
            change = change_by(session.data, effect, session.fit)
            mean = mean + change.sum(axis=0) / np.maximum(session.data.valid.sum(axis=0), 1)
    return np.tile(mean, (n_rirs, 1))


def _with_facings(data: Data, session: Session) -> Data:
    """Return data of a test set with estimated facings.

    They are first those with the mean parameters of the session's devices, and then those with what is calibrated with
    these facings.
    """
    unknown = unknown_facings(data)
    if SourceDirectivity not in {*session.effects, *data.given_kinds} or not len(unknown):
        return data
    correction = _transferred_correction(session, len(data.rows))
    for _ in range(_FACING_ROUNDS):
        index = ParameterIndex(data, session.effects)
        mean, local = solve_rooms(index, session.fit, transfer_shared(session, index), correction,
                                  split_positions(data)[0])
        residual, valid = data.residual(index.predict(index.absorption(mean, local), index.vectors(mean, local),
                                                      index.gains(local), correction))
        data = estimate_facings(without_facings(data, unknown), index, mean, local, np.where(valid, residual, np.nan),
                                np.hypot(session.fit.sigma, session.fit.omega), nj=session.nj)
    return data


def _rendered_errors(data: Data, calibrated: Callable, splits: Sequence[str], *, seed: int, nj: int) -> HeldOutErrors:
    """Render each half of the RIRs as the other half calibrates its rooms, and compare it with the recordings.

    Parameters
    ----------
    data : Data
    calibrated : callable
        Takes the RIRs of each room that may be used and their features that may be used (see `_USABLE`); returns
        the absorption of rooms, the effects of each RIR and the gains of RIRs.
    splits : sequence of str
        Of `SPLITS`.
    seed, nj : int
    """
    halves = _halves(data, splits)
    calibrations = share_out(lambda half: calibrated(half.known, _USABLE[half.split]), halves, nj, first_here=False,
                             label="calibrate rooms")
    gains: list[FloatArray] = []
    models: list[RowModel] = []
    for half, (absorption, by_row, of_rirs) in zip(halves, calibrations, strict=True):
        gains.append(of_rirs[half.rows])
        models += row_models(data, absorption, by_row, half.rows)
    rows = np.concatenate([half.rows for half in halves])
    return _errors(data, splits, rows, np.concatenate(gains), rendered_features(data, models, seed=seed, nj=nj))


class _Half(NamedTuple):
    """One half of the RIRs, which calibrates the rooms, and the other one, which is scored.

    Attributes
    ----------
    split : str
        Of `SPLITS`.
    known : list of ndarray of int
        RIRs of each room that calibrate it.
    rows : ndarray of int
        RIRs to score.
    """

    split: str
    known: list[IntArray]
    rows: IntArray


def _halves(data: Data, splits: Sequence[str]) -> list[_Half]:
    """Return the halves of the RIRs for each split: each of them calibrates once and is scored once.

    A room with RIRs of a single place has nothing that calibrates it, and is not scored: its half is empty.
    """
    first, second = split_positions(data)
    return [_Half(split, known, np.concatenate([to_score if len(calibrating) else calibrating
                                                for calibrating, to_score in zip(known, scored, strict=True)]))
            for split, (known, scored) in product(splits, ((first, second), (second, first)))]


def _errors(data: Data, splits: Sequence[str], rows: IntArray, gains: FloatArray, features: FloatArray
            ) -> HeldOutErrors:
    """Return the errors of RIRs to score, those of `_halves` one after the other.

    Parameters
    ----------
    data : Data
    splits : sequence of str
    rows : ndarray of int, shape (n,)
    gains : ndarray, shape (n,)
        Of the recordings [dB].
    features : ndarray, shape (n, n_features)
    """
    error = np.abs(with_noise_in_octaves(data.features[rows]) - np.outer(gains, HAS_GAIN)
                   - with_noise_in_octaves(features))
    error = np.where(np.isfinite(error), np.minimum(error, LARGEST), LARGEST)
    error = np.where(data.valid[rows] & SCORED, error, np.nan)
    by_split = {}
    for split, of_rows, of_split in zip(splits, np.split(rows, len(splits)), np.split(error, len(splits)), strict=True):
        by_split[split] = np.full(data.features.shape, np.nan)
        by_split[split][of_rows] = of_split
    half = np.zeros(len(data.rows), dtype=int)
    half[np.concatenate(split_positions(data)[1])] = 1
    return HeldOutErrors(by_split, data.room, half)
