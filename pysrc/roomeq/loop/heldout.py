"""The error of a model on what took no part in its fit: simulated again, measured again, in JND.

Every room is left out once: what all rooms share is fitted to the others. Then the room is met in two ways:

positions
    half of its RIRs calibrate its absorption and gains, the other half is scored, and the other way round (of a room
    with a single RIR, nothing is)
rooms
    only its reverberation time at 1 kHz and the gains are known from the one half; the rest must come from what other
    rooms have taught
"""

from dataclasses import dataclass

import numpy as np
from scipy import stats

from roomeq.core.constants import BAND_1KHZ
from roomeq.loop.attribute import one_sided_p
from roomeq.loop.features import HAS_GAIN, LARGEST, METRIC
from roomeq.loop.leftout import CALIBRATION_FEATURES, calibrate, leave_rooms_out
from roomeq.loop.predict import BAND_OF_FEATURE
from roomeq.loop.rendered_model import effects_of_rows
from roomeq.loop.rendering import render_rows

_METRICS = tuple(dict.fromkeys(METRIC.tolist()))
KNOWN = {"positions": None,
         "rooms": (np.isin(METRIC, ["t20", "t30"]) & (BAND_OF_FEATURE == BAND_1KHZ)) | (METRIC == "direct")}
"""Features that calibration may look at, for each way of meeting a room; None for all."""
_SIGNS = 2 ** 16  # of the halves of eight rooms all, of more a part


@dataclass(frozen=True)
class Errors:
    """Errors of left-out RIRs.

    Attributes
    ----------
    features : dict
        {"positions" or "rooms": ndarray, shape (n_rirs, n_features)}: absolute errors [JND], NaN where nothing was
        measured.
    room, half : ndarray of int, shape (n_rirs,)
        Number of the room, and of its half.
    """

    features: dict
    room: np.ndarray
    half: np.ndarray

    def of_rooms(self, way):
        """Mean error of each room that has one, every metric with the same weight, shape (n_rooms,)."""
        return np.array([_mean_of_metrics(self.features[way][self.room == r]) for r in self._scored(way)])

    def of_halves(self, way):
        """The same for each half of each room, shape (n_rooms, 2)."""
        return np.array([[_mean_of_metrics(self.features[way][(self.room == r) & (self.half == half)])
                          for half in (0, 1)] for r in self._scored(way)])

    def _scored(self, way):
        return np.unique(self.room[np.isfinite(self.features[way]).any(axis=1)])

    def mean(self, way):
        return float(self.of_rooms(way).mean())

    def interval(self, way):
        """Interval of 95 % of the mean over rooms (t); None where there is but one."""
        rooms = self.of_rooms(way)
        if len(rooms) < 2:
            return None
        half = stats.t.ppf(0.975, len(rooms) - 1) * rooms.std(ddof=1) / np.sqrt(len(rooms))
        return [float(rooms.mean() - half), float(rooms.mean() + half)]

    def by_metric(self, way):
        """Mean error per metric [JND]."""
        return {metric: float(np.nanmean(self.features[way][:, METRIC == metric])) for metric in _METRICS
                if np.isfinite(self.features[way][:, METRIC == metric]).any()}

    def by_band(self, way):
        """Mean error per octave band, None where nothing was measured [JND]."""
        found = [self.features[way][:, BAND_OF_FEATURE == band] for band in range(8)]
        return [float(np.nanmean(one)) if np.isfinite(one).any() else None for one in found]


def _mean_of_metrics(features):
    metrics = [features[:, METRIC == metric] for metric in _METRICS]
    means = [np.nanmean(one) for one in metrics if np.isfinite(one).any()]
    return np.mean(means) if means else np.nan


def p_lower(before, after, way):
    """p value of the second error being lower than the first on what a way leaves out, one-sided, paired.

    Unseen positions: the halves of rooms, each calibrated by the other, change their signs (Fisher's randomisation
    test). An effect that is strong in some rooms and weak in others is no chance, and a t test over rooms would take
    it for some. Unseen rooms: a t test over them, for a few rooms have too few signs to change.
    """
    if way == "rooms":
        return one_sided_p(before.of_rooms(way) - after.of_rooms(way))
    change = (before.of_halves(way) - after.of_halves(way)).ravel()
    return float(stats.permutation_test((change[np.isfinite(change)],), np.mean, permutation_type="samples",
                                        alternative="greater", n_resamples=_SIGNS, batch=_SIGNS // 16,
                                        vectorized=True, rng=np.random.default_rng(0)).pvalue)


def halves(data):
    """Two halves of each room's RIRs: two lists of index arrays.

    Each RIR goes where fewer are of its chain, then where fewer are of its source and its microphone. Of a room with a
    single RIR the second half is empty.
    """
    (_, source), (_, mic) = data.units("source"), data.units("mic")
    first, second = [], []
    for r in range(len(data.room_names)):
        members, parts = np.flatnonzero(data.room == r), ([], [])
        begun = list(np.unique(data.chain[members]))
        for n in members[np.argsort(data.chain[members], kind="stable")]:
            load = [(np.sum(data.chain[part] == data.chain[n]), np.sum(source[part] == source[n]) + np.sum(
                mic[part] == mic[n]), len(part)) for part in (np.array(one, dtype=int) for one in parts)]
            fewer = begun.index(data.chain[n]) % 2 if load[0] == load[1] else int(load[1] < load[0])
            parts[fewer].append(n)
        first.append(np.array(sorted(parts[0]), dtype=int))
        second.append(np.array(sorted(parts[1]), dtype=int))
    return first, second


def heldout_errors(session):
    """Score a session's model; see the module.

    Returns
    -------
    Errors
    """
    data, left_out = session.data, leave_rooms_out(session.data, session.fit)

    def calibrated(known, chosen):
        absorption, vectors, gains = calibrate(data, session.fit, left_out, known, session.correction, chosen=chosen)
        by_room = [effects_of_rows(data, session.effects, one) for one in vectors]
        return absorption, [by_room[r][n] for n, r in enumerate(data.room)], gains

    return scored_errors(data, calibrated, seed=session.seed, nj=session.nj)


def scored_errors(data, calibrated, *, seed, nj):
    """Simulate each half of the RIRs as the other half calibrates its rooms, and compare it with what was measured.

    Parameters
    ----------
    data : roomeq.loop.data.Data
    calibrated : callable
        Takes the RIRs of each room that may be looked at, and which of their features; gives the absorption of rooms,
        the effects of each RIR and their gains.
    seed, nj : int

    Returns
    -------
    Errors
    """
    first, second = halves(data)
    result, half = {}, np.zeros(len(data.rows), dtype=int)
    half[np.concatenate(second)] = 1
    for way, chosen in KNOWN.items():
        features = np.full(data.features.shape, np.nan)
        for known, scored in ((first, second), (second, first)):
            # a room with a single RIR has nothing to calibrate it, and no error
            rows = np.concatenate([of_room if len(others) else others for others, of_room in zip(known, scored,
                                                                                                strict=True)])
            absorption, by_row, gains = calibrated(known, chosen)
            _, rendered = render_rows(data, absorption[data.room], by_row, seed=seed, nj=nj, rows=rows)
            error = np.abs(data.features[rows] - rendered - np.outer(gains[rows], HAS_GAIN))
            error = np.where(np.isfinite(error), np.minimum(error, LARGEST), LARGEST)
            features[rows] = np.where(data.valid[rows] & ~CALIBRATION_FEATURES, error, np.nan)
        result[way] = features
    return Errors(result, data.room, half)
