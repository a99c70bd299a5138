"""Distances between the EQs of two sets of RIRs, in which rooms weigh the same."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.distance import cdist
from scipy.stats import wasserstein_distance

from roomeq.core.arrays import FloatArray
from roomeq.eq.gmm import room_weights

N_BOOTSTRAP = 500
_PERCENTILES = (2.5, 97.5)


class _Weighted(NamedTuple):
    """EQ vectors, one a row, and their weights."""

    vectors_db: FloatArray
    weights: FloatArray

    def point(self, k: int) -> "_Weighted":
        """Return the measured values at one point."""
        known = ~np.isnan(self.vectors_db[:, k])
        return _Weighted(self.vectors_db[known, k], self.weights[known])

    def complete(self) -> "_Weighted":
        """Return the vectors without missing points; their weights sum to 1."""
        known = ~np.isnan(self.vectors_db).any(axis=1)
        return _Weighted(self.vectors_db[known], self.weights[known] / self.weights[known].sum())


class EqSet:
    """EQs of some RIRs and the rooms they were measured in.

    Parameters
    ----------
    vectors_db : array_like, shape (n, n_points)
        EQs at the free points; NaN where a point was not measured.
    rooms
        Room of each vector.

    Raises
    ------
    ValueError
        The set is empty, or vectors and rooms do not match.
    """

    def __init__(self, vectors_db: FloatArray, rooms: Sequence[str]) -> None:
        self.vectors_db = np.asarray(vectors_db, dtype=np.float64)
        room_of = np.asarray(rooms)
        if self.vectors_db.ndim != 2 or not len(self.vectors_db) or len(room_of) != len(self.vectors_db):
            raise ValueError(f"EQ vectors of shape {self.vectors_db.shape} and {len(room_of)} rooms: there must be at "
                             "least one vector, and a room for each")
        self.weights = room_weights(room_of)
        self.members = {str(room): np.flatnonzero(room_of == room) for room in np.unique(room_of)}

    def resample(self, rooms: Sequence[str], rng: np.random.Generator) -> _Weighted | None:
        """Return vectors of some rooms, of each as often as it is named; None if the set has none of these rooms.

        The RIRs of a room are drawn with replacement, so that a set of a single room varies too.
        """
        drawn = [rng.choice(self.members[room], len(self.members[room])) for room in rooms if room in self.members]
        if not drawn:
            return None
        weights = np.concatenate([np.full(len(members), 1.0 / (len(members) * len(drawn))) for members in drawn])
        return _Weighted(self.vectors_db[np.concatenate(drawn)], weights)

    def all(self) -> _Weighted:
        """Return all vectors with the weights that make rooms weigh the same."""
        return _Weighted(self.vectors_db, self.weights)


def eq_distance(first: EqSet, second: EqSet, rng: np.random.Generator, *, n_bootstrap: int = N_BOOTSTRAP) -> dict:
    """Return the distance between the EQs of two sets, with bootstrap intervals.

    Whole rooms are resampled, the same rooms in both sets. Intervals are basic bootstrap intervals (Davison & Hinkley
    1997, eq. 5.6), cut at 0: resampled sets lie farther apart than the sets themselves, and the basic interval
    corrects this bias.

    Returns
    -------
    dict
        `wasserstein_db`: mean over points of the 1-Wasserstein distance; `bands_db`: that distance per point;
        `energy_db`: root of the energy distance ``2 E|X-Y| - E|X-X'| - E|Y-Y'|`` of complete vectors (Székely & Rizzo
        2013); `interval_db`, `energy_interval_db`: their 95 % intervals.
    """
    bands_db = _point_distances(first.all(), second.all())
    wasserstein_db, energy_db = float(np.nanmean(bands_db)), _energy_distance(first.all(), second.all())
    resampled = []
    for _ in range(n_bootstrap):
        sample = _resample([first, second], rng)
        resampled.append((_mean_distance(*sample), _energy_distance(*sample)))
    mean_distances, energy_distances = zip(*resampled, strict=True)
    return dict(wasserstein_db=wasserstein_db, bands_db=[float(distance_db) for distance_db in bands_db],
                energy_db=energy_db,
                interval_db=_basic_interval(wasserstein_db, mean_distances),
                energy_interval_db=_basic_interval(energy_db, energy_distances))


def gap_closed(sim: EqSet, comp: EqSet, train: EqSet, heldout: EqSet, rng: np.random.Generator, *,
               n_bootstrap: int = N_BOOTSTRAP) -> dict:
    """Return how much of the distance between simulated and held-out measured RIRs the compensation removes.

    ``(d_sim - d_comp) / (d_sim - d_train)``, where d is the distance of simulated, compensated and measured training
    RIRs to held-out measured ones.

    Returns
    -------
    dict
        `sim`, `comp`, `floor` (of the training set): see `eq_distance`. `closed` and `closed_energy`: the share by
        either distance; None where the simulation is no farther away than the training set. `closed_interval`: 95 %
        percentile interval over resampled rooms, the same in all sets. `closed_undefined`: share of the resamples in
        which `closed` is None; the interval is that of the others.
    """
    shares = []
    for _ in range(n_bootstrap):
        *models, reference = _resample([sim, comp, train, heldout], rng)
        shares.append(_closed(*(_mean_distance(model, reference) for model in models)))
    defined = [share for share in shares if share is not None]
    distances = [eq_distance(model, heldout, rng, n_bootstrap=n_bootstrap) for model in (sim, comp, train)]
    interval = [float(end) for end in np.percentile(defined, _PERCENTILES)] if defined else None
    return dict(zip(("sim", "comp", "floor"), distances, strict=True)) | dict(
        closed_interval=interval, closed_undefined=1.0 - len(defined) / max(len(shares), 1),
        closed=_closed(*(distance["wasserstein_db"] for distance in distances)),
        closed_energy=_closed(*(distance["energy_db"] for distance in distances)))


def _closed(sim: float, comp: float, floor: float) -> float | None:
    return float((sim - comp) / (sim - floor)) if sim > floor else None


def _resample(sets: Sequence[EqSet], rng: np.random.Generator) -> list[_Weighted]:
    """Return bootstrap samples of several sets: rooms drawn with replacement, the same rooms for every set."""
    rooms = sorted({room for eq_set in sets for room in eq_set.members})
    while True:
        drawn_rooms = [rooms[k] for k in rng.integers(len(rooms), size=len(rooms))]
        samples = [eq_set.resample(drawn_rooms, rng) for eq_set in sets]
        complete = [sample for sample in samples if sample is not None]
        if len(complete) == len(sets):
            return complete


def _basic_interval(distance: float, resampled: Sequence[float]) -> list[float]:
    """Return the basic bootstrap interval of a distance: twice the distance, less the percentiles of the resamples."""
    low, high = np.nanpercentile(resampled, _PERCENTILES)
    return [float(max(2.0 * distance - high, 0.0)), float(max(2.0 * distance - low, 0.0))]


def _mean_distance(first: _Weighted, second: _Weighted) -> float:
    return float(np.nanmean(_point_distances(first, second)))


def _point_distances(first: _Weighted, second: _Weighted) -> FloatArray:
    """Return the 1-Wasserstein distance per point; NaN where a set has no value."""
    distances = np.full(first.vectors_db.shape[1], np.nan)
    for k in range(len(distances)):
        a, b = first.point(k), second.point(k)
        if len(a.weights) and len(b.weights):
            distances[k] = wasserstein_distance(a.vectors_db, b.vectors_db, a.weights, b.weights)
    return distances


def _energy_distance(first: _Weighted, second: _Weighted) -> float:
    """Return the root of the energy distance of the complete vectors; NaN where a set has none."""
    a, b = first.complete(), second.complete()
    if not len(a.weights) or not len(b.weights):
        return float("nan")
    squared = (2 * a.weights @ cdist(a.vectors_db, b.vectors_db) @ b.weights
               - a.weights @ cdist(a.vectors_db, a.vectors_db) @ a.weights
               - b.weights @ cdist(b.vectors_db, b.vectors_db) @ b.weights)
    return float(np.sqrt(max(squared, 0.0)))
