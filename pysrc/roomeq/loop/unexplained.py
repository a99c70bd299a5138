"""Significant residuals that no effect of the catalogue explains: their metric, bands, and what they vary with."""

from dataclasses import asdict, dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import stdtr

from roomeq.acoustics.octaves import OCTAVE_WIDTH_HZ
from roomeq.core.arrays import BoolArray, FloatArray, IntArray
from roomeq.core.constants import BAND_1KHZ, BANDS_HZ
from roomeq.loop.data import Data
from roomeq.loop.features import BAND_OF_FEATURE, METRIC, REGION
from roomeq.loop.likelihood import scatter
from roomeq.loop.misnamed_devices import robust_deviation
from roomeq.loop.session import Session

MIN_SIZE_JND = 1.0
MIN_ROOM_SIZE_JND = 2.0  # of a residual that varies with the room, since rooms differ in more than absorption
LEVEL = 0.05
_KINDS = 5  # of tests
_CLIP = 8.0
_MIN_BANDS = 4  # among which one can be outlying
_FREEDOM = 8  # degrees of freedom that the shrinkage over a metric adds to the scatter of a feature
_MIN_CURVATURES = 16  # rooms and octaves from which on their scatter is known


@dataclass(frozen=True)
class Unexplained:
    """An unexplained residual.

    Attributes
    ----------
    metric, time_region : str
        As in `roomeq.loop.features`.
    bands_hz : list of floats
        Octave bands in which it is significant; empty if only their mean is, or if the metric has no bands.
    varies_with : str
        ``"nothing"`` if it is the same in all rooms, else ``"room"``, ``"source"`` or ``"mic"``.
    size_jnd : float
        Mean of measured minus simulated features; over the rooms where it is significant if it varies with the room.
    p : float
        Corrected for the number of tests.
    """

    metric: str
    time_region: str
    bands_hz: list[float]
    varies_with: str
    size_jnd: float
    p: float

    def as_dict(self) -> dict:
        return asdict(self)


class _Test(NamedTuple):
    """A tested residual: `band` is -1 for the whole band."""

    metric: str
    band: int
    varies_with: str
    size_jnd: float
    p: float


def find_unexplained(session: Session) -> list[Unexplained]:
    """Return the significant residuals of a model, the largest first."""
    data, residual = session.data, session.residual
    metrics = list(dict.fromkeys(METRIC.tolist()))
    blocks = [(metric, band) for metric in metrics for band in range(-1, len(BANDS_HZ))
              if np.any((METRIC == metric) & (BAND_OF_FEATURE == band))]
    of_blocks = [_Test(metric, band, *test) for metric, band in blocks
                 for test in _block_tests(residual[:, (METRIC == metric) & (BAND_OF_FEATURE == band)], data)]
    of_metrics, of_bands = [], []
    for metric in metrics:
        of_metric = residual[:, METRIC == metric]
        if of_metric.shape[1] > 1:  # what touches all bands shows in their mean, also where few rooms measure it
            of_metrics += [_Test(metric, -1, *test) for test in _block_tests(of_metric, data)[:1]]
        bands, size_jnd, p = _outlying_band_test(metric, residual, data)
        of_bands += [_Test(metric, band, "room", size_jnd, p) for band in bands]
    of_rooms = _outlying_rooms(residual, data)
    significant = (_significant(of_blocks, len(of_blocks)) + _significant(of_metrics, len(of_metrics))
                   + _significant(of_bands, len(metrics)) + _significant(of_rooms, len(of_rooms)))
    decays = {test.band for test in significant if test.metric in ("t20", "t30")}
    curvatures = _outlying_curvatures(residual, data)
    return _merged(significant + [test for test in _significant(curvatures, len(curvatures))
                                  if test.band not in decays])


def _significant(tests: list[_Test], n_tests: int) -> list[_Test]:
    """Return the significant ones of a kind of tests, corrected for their number and that of the kinds (Bonferroni)."""
    corrected = [test._replace(p=min(1.0, test.p * n_tests * _KINDS)) for test in tests]
    return [test for test in corrected if _is_significant(test)]


def _is_significant(test: _Test) -> bool:
    return test.p < LEVEL and abs(test.size_jnd) >= (
        MIN_ROOM_SIZE_JND if test.varies_with == "room" else MIN_SIZE_JND)


def _block_tests(block: FloatArray, data: Data) -> list[tuple[str, float, float]]:
    """Test the mean residual of a block of features: list of (varies_with, size in JND, uncorrected p).

    The first test is of a residual that is the same in all rooms.
    """
    measured = np.isfinite(block).any(axis=1)
    values = np.nanmean(block[measured], axis=1)
    names, room = np.unique(data.room[measured], return_inverse=True)
    if len(names) < 3 or len(values) < 6:
        return []
    varies_with, means = ["nothing"], [_room_means(values, room, np.ones(len(values), dtype=bool))]
    for scope in ("source", "mic"):
        units, number = data.units(scope)
        for u in range(len(units) if len(units) > 1 else 0):
            of_unit = number[measured] == u
            apart = _room_means(values, room, of_unit) - _room_means(values, room, ~of_unit)
            if np.isfinite(apart).sum() > 2:
                varies_with.append(scope)
                means.append(apart)
    p = _two_sided_p(np.array(means))
    return list(zip(varies_with, np.nanmean(means, axis=1).tolist(), p.tolist(), strict=True))


def _two_sided_p(values: FloatArray) -> FloatArray:
    """Return the p value of a mean over the last axis other than zero (t test); NaN are left out."""
    count = np.isfinite(values).sum(axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):  # equal values
        ratio = np.nanmean(values, axis=-1) / (np.nanstd(values, axis=-1, ddof=1) / np.sqrt(count))
    return np.asarray(2.0 * stdtr(count - 1, -np.abs(ratio)))


def _room_means(values: FloatArray, room: IntArray, members: BoolArray) -> FloatArray:
    """Return the mean over some RIRs of each room, NaN for a room without any."""
    n_rooms = room.max() + 1
    count = np.bincount(room[members], minlength=n_rooms)
    total = np.bincount(room[members], values[members], minlength=n_rooms)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _outlying_band_test(metric: str, residual: FloatArray, data: Data) -> tuple[list[int], float, float]:
    """Test whether each room has a band that lies apart from its others, all in the same direction.

    Returns bands, size in JND, and uncorrected p. Scatter is symmetric, so that the largest residual of each room's
    bands is compared with its smallest. Rooms in which fewer than `_MIN_BANDS` bands were measured do not count.
    """
    of_metric = residual[:, METRIC == metric]
    of_rooms = [of_metric[data.room == r] for r in np.unique(data.room)]
    of_rooms = [room for room in of_rooms if np.isfinite(room).any(axis=0).sum() >= _MIN_BANDS]
    if len(of_rooms) < 3:
        return [], 0.0, 1.0
    means = np.array([_mean_of_known(room) for room in of_rooms])
    apart = means - np.nanmedian(means, axis=1, keepdims=True)
    # low bands scatter more, and a single room must not decide
    typical = np.array([np.median(np.abs(band[np.isfinite(band)])) if np.isfinite(band).any() else 0.0
                        for band in apart.T])
    standing = np.clip(apart / (typical + 0.2), -_CLIP, _CLIP)
    high, low = np.nanmax(standing, axis=1), np.nanmin(standing, axis=1)
    sign = 1.0 if np.mean(high + low) > 0.0 else -1.0
    at = np.nanargmax(sign * standing, axis=1)
    size = float(np.mean(means[np.arange(len(means)), at]))
    bands = sorted(set(BAND_OF_FEATURE[METRIC == metric][at].tolist()))
    return bands, size, float(_two_sided_p(high + low))


def _mean_of_known(values: FloatArray) -> FloatArray:
    """Return the mean over RIRs of the features of a room, NaN where none was measured."""
    known = np.isfinite(values)
    return np.where(known.any(axis=0), np.where(known, values, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1),
                    np.nan)


def _outlying_rooms(residual: FloatArray, data: Data) -> list[_Test]:
    """Test each room against the scatter of the others, feature by feature (uncorrected p)."""
    names = np.unique(data.room)
    if len(names) < 4:
        return []
    valid, tests = np.isfinite(residual), []
    for r in names:
        members = data.room == r
        sigma, omega = scatter(data, residual, valid & ~members[:, None])
        count = valid[members].sum(axis=0)
        mean = np.where(valid[members], residual[members], 0.0).sum(axis=0) / np.maximum(count, 1)
        ratio = np.where(count > 1, mean / np.sqrt(omega ** 2 + sigma ** 2 / np.maximum(count, 1)), 0.0)
        p = 2.0 * stdtr(len(names) - 2 + _FREEDOM, -np.abs(ratio))
        tests += [_Test(str(METRIC[n]), int(BAND_OF_FEATURE[n]), "room", float(mean[n]), float(p[n]))
                  for n in range(len(p))]
    return tests


def _outlying_curvatures(residual: FloatArray, data: Data) -> list[_Test]:
    """Test each room's residuals of T30 relative to T20 in each octave (uncorrected p).

    Both times scatter together, so that a late second slope shows in their ratio when neither stands out. The ratio
    scatters with the inverse square root of bandwidth and number of RIRs. The scale is the median over rooms and
    octaves, since an object that rings at the same octave in several rooms must not hide itself.
    """
    names = np.unique(data.room)
    relative = residual[:, METRIC == "t30"] - residual[:, METRIC == "t20"]
    count = np.array([np.isfinite(relative[data.room == r]).sum(axis=0) for r in names])
    mean = np.array([np.nansum(relative[data.room == r], axis=0) for r in names]) / np.maximum(count, 1)
    known = count > 1
    if len(names) < 3 or known.sum() < _MIN_CURVATURES:
        return []
    standard = mean * np.sqrt(count * OCTAVE_WIDTH_HZ / OCTAVE_WIDTH_HZ[BAND_1KHZ])
    scale = robust_deviation(standard[known]) + 1e-9
    p = 2.0 * stdtr(_FREEDOM, -np.abs(standard) / scale)
    return [_Test("curvature", int(band), "room", float(mean[r, band]), float(p[r, band]))
            for r, band in np.argwhere(known)]


def _merged(tests: list[_Test]) -> list[Unexplained]:
    """Merge the bands of a metric whose residuals vary with the same thing in the same direction."""
    groups: dict[tuple, list[_Test]] = {}
    for test in tests:
        groups.setdefault((test.metric, test.varies_with, np.sign(test.size_jnd)), []).append(test)
    merged = [Unexplained(metric, REGION[metric], [BANDS_HZ[band] for band in sorted({test.band for test in members})
                                                   if band >= 0], varies_with,
                          float(np.mean([test.size_jnd for test in members])), float(min(test.p for test in members)))
              for (metric, varies_with, _), members in groups.items()]
    return sorted(merged, key=lambda residual: -abs(residual.size_jnd))
