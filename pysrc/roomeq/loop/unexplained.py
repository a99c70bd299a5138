"""What is left when no effect of the catalogue helps any more: where it sits, never what it is called."""

from dataclasses import asdict, dataclass

import numpy as np
from scipy import stats

from roomeq.core.constants import BANDS_HZ
from roomeq.loop.features import METRIC, REGION
from roomeq.loop.linear import scatter
from roomeq.loop.predict import BAND_OF_FEATURE

MIN_SIZE_JND = 1.0
MIN_ROOM_SIZE_JND = 2.0  # rooms differ in more than absorption: what one has alone must be plain
LEVEL = 0.05
_CLIP = 8.0
_FREEDOM = 8  # degrees of it that other features lend to the scatter of one


@dataclass(frozen=True)
class Unexplained:
    """A residual that stays.

    Attributes
    ----------
    metric, time_region : str
        As in `roomeq.loop.features`.
    bands_hz : list of floats
        Octave bands in which it is found; empty for the whole band.
    varies_with : str
        ``"nothing"`` where it is the same in all rooms, else ``"room"``, ``"source"`` or ``"mic"``.
    size_jnd : float
        Mean residual, measured less simulated; of the rooms where it is found if it varies with the room.
    p : float
        That chance leaves so much in one of all features that were looked at.
    """

    metric: str
    time_region: str
    bands_hz: list
    varies_with: str
    size_jnd: float
    p: float

    def as_dict(self):
        return asdict(self)


def find_unexplained(session):
    """The residuals of a model that are no chance, the largest first.

    Returns
    -------
    list of Unexplained
    """
    data, residual = session.data, session.residual
    blocks = [(metric, band) for metric in dict.fromkeys(METRIC.tolist()) for band in range(-1, len(BANDS_HZ))
              if np.any((METRIC == metric) & (BAND_OF_FEATURE == band))]
    found = []
    for metric, band in blocks:
        features = residual[:, (METRIC == metric) & (BAND_OF_FEATURE == band)]
        seen = np.isfinite(features).any(axis=1)
        values = np.array([np.nanmean(one) for one in features[seen]])
        tests = _tests(values, data, seen)
        found += [(metric, band, varies, size, min(1.0, p * len(blocks))) for varies, size, p in tests]
    metrics = list(dict.fromkeys(METRIC.tolist()))
    for metric in metrics:
        single = _of_single_rooms(metric, residual, data)
        if single:
            bands, size, p = single
            found += [(metric, band, "room", size, min(1.0, p * len(metrics))) for band in bands]
    found += _of_one_room(residual, data)
    kept = [one for one in found if one[4] < LEVEL and abs(one[3]) >= (
        MIN_ROOM_SIZE_JND if one[2] == "room" else MIN_SIZE_JND)]
    return _merged(kept)


def _tests(values, data, seen):
    """What the values of one block vary with: list of (varies_with, size, p)."""
    rooms = data.room[seen]
    names = np.unique(rooms)
    if len(names) < 3 or len(values) < 6:
        return []
    means = np.array([values[rooms == r].mean() for r in names])
    tests = [("nothing", means.mean(), float(stats.ttest_1samp(means, 0.0).pvalue))]
    for scope in ("source", "mic"):
        units, number = data.units(scope)
        number = number[seen]
        for u in range(len(units) if len(units) > 1 else 0):
            apart = [values[(rooms == r) & (number == u)].mean() - values[(rooms == r) & (number != u)].mean()
                     for r in names if np.any((rooms == r) & (number == u)) and np.any((rooms == r) & (number != u))]
            if len(apart) > 2:
                tests.append((scope, float(np.mean(apart)), float(stats.ttest_1samp(apart, 0.0).pvalue)))
    return tests


def _of_single_rooms(metric, residual, data):
    """Whether rooms have one feature each that stands out in one direction: (bands, size, p), or None.

    Chance is as far out above as below. So the largest residual of each room's features is set against its smallest.
    """
    features, names = residual[:, METRIC == metric], np.unique(data.room)
    if features.shape[1] < 4 or len(names) < 3:
        return None
    seen = [np.isfinite(features[data.room == r]) for r in names]
    means = np.array([np.where(ok.any(axis=0), np.where(ok, features[data.room == r], 0.0).sum(axis=0)
                               / np.maximum(ok.sum(axis=0), 1), 0.0) for r, ok in zip(names, seen, strict=True)])
    # low bands scatter more; one room alone shall not decide
    standing = np.clip(means / (np.median(np.abs(means), axis=0) + 0.2), -_CLIP, _CLIP)
    high, low = standing.max(axis=1), standing.min(axis=1)
    sign = 1.0 if np.mean(high + low) > 0.0 else -1.0
    at = np.argmax(sign * standing, axis=1)
    size = float(np.mean(means[np.arange(len(names)), at]))
    return sorted(set(BAND_OF_FEATURE[METRIC == metric][at])), size, float(stats.ttest_1samp(high + low, 0.0).pvalue)


def _of_one_room(residual, data):
    """Features of one room that lie far outside what the others make likely: list of (metric, band, "room", size, p)."""
    names = np.unique(data.room)
    if len(names) < 4:
        return []
    valid, found = np.isfinite(residual), []
    for r in names:
        mine = data.room == r
        sigma, omega = scatter(data, residual, valid & ~mine[:, None])
        count = valid[mine].sum(axis=0)
        mean = np.where(valid[mine], residual[mine], 0.0).sum(axis=0) / np.maximum(count, 1)
        ratio = np.where(count > 1, mean / np.sqrt(omega ** 2 + sigma ** 2 / np.maximum(count, 1)), 0.0)
        p = 2.0 * stats.t.sf(np.abs(ratio), len(names) - 2 + _FREEDOM) * len(names) * residual.shape[1]
        found += [(str(METRIC[n]), int(BAND_OF_FEATURE[n]), "room", float(mean[n]), float(p[n]))
                  for n in np.flatnonzero(p < LEVEL)]
    return found


def _merged(found):
    """Join neighbouring bands of one metric that vary with the same thing in the same direction."""
    groups = {}
    for metric, band, varies, size, p in found:
        groups.setdefault((metric, varies, np.sign(size)), []).append((band, size, p))
    merged = [Unexplained(metric, REGION[metric], [BANDS_HZ[band] for band, *_ in sorted(members) if band >= 0], varies,
                          float(np.mean([size for _, size, _ in members])), float(min(p for *_, p in members)))
              for (metric, varies, _), members in groups.items()]
    return sorted(merged, key=lambda one: -abs(one.size_jnd))
