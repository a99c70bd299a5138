"""How far two sets of room EQs are apart, rooms counting equally."""

import numpy as np
from scipy.spatial.distance import cdist
from scipy.stats import wasserstein_distance

from roomeq.eq.gmm import room_weights

N_BOOTSTRAP = 500


def eq_distance(a_db, b_db, rooms_a, rooms_b, rng, *, n_bootstrap=N_BOOTSTRAP):
    """Distance between two distributions of EQs, with a bootstrap interval.

    Parameters
    ----------
    a_db, b_db : ndarray, shape (n, 7) and (m, 7)
        EQs at the free points; NaN where one was not measured.
    rooms_a, rooms_b : sequence of str
        Rooms count equally within each set.
    rng : numpy.random.Generator
    n_bootstrap : int

    Returns
    -------
    dict
        `wasserstein_db`: mean over bands of the 1-Wasserstein distance; `bands_db` (7,); `energy_db`: square
        root of the energy distance ``2 E|X-Y| - E|X-X'| - E|Y-Y'|`` of the 7-vectors (Székely & Rizzo 2013),
        without the vectors that are not complete; `interval_db`, `energy_interval_db`: 95 % basic bootstrap
        intervals (Davison & Hinkley 1997, eq. 5.6: resampled sets are farther apart than the sets themselves,
        which this turns round), not below 0; whole rooms are resampled, the same in both sets.

    Raises
    ------
    ValueError
        A set is empty, or its vectors and rooms don't match.
    """
    a, b = _Set(a_db, rooms_a, "first"), _Set(b_db, rooms_b, "second")
    bands_db = _bands(a.vectors, a.weights, b.vectors, b.weights)
    found = float(np.nanmean(bands_db)), _energy(a.vectors, a.weights, b.vectors, b.weights)
    boot = np.array([_both(*_resampled([a, b], rng)) for _ in range(n_bootstrap)])
    intervals = [_basic(value, boot[:, k]) for k, value in enumerate(found)]
    return dict(wasserstein_db=found[0], bands_db=[float(band) for band in bands_db], energy_db=found[1],
                interval_db=intervals[0], energy_interval_db=intervals[1])


def gap_closed(sim_db, comp_db, train_db, heldout_db, *, rooms_sim, rooms_comp, rooms_train, rooms_heldout, rng,
               n_bootstrap=N_BOOTSTRAP):
    """How much of the way from the simulation to the floor the compensation goes.

    ``(d_sim - d_comp) / (d_sim - d_floor)``, where d is the distance to held-out measured RIRs, and the
    floor that of the measured training set itself.

    Parameters
    ----------
    sim_db, comp_db, train_db, heldout_db : ndarray, shape (n, 7)
    rooms_sim, rooms_comp, rooms_train, rooms_heldout : sequence of str
    rng : numpy.random.Generator
    n_bootstrap : int

    Returns
    -------
    dict
        `sim`, `comp`, `floor` (see `eq_distance`), `closed` and `closed_energy`, None where the simulation is no
        farther than the floor; `closed_interval`: 95 % percentiles over resampled rooms, the same in all sets;
        `closed_undefined`: share of the resamples that had no gap to close and are not in it.
    """
    sets = [_Set(sim_db, rooms_sim, "simulated"), _Set(comp_db, rooms_comp, "compensated"),
            _Set(train_db, rooms_train, "training"), _Set(heldout_db, rooms_heldout, "held-out")]
    boot = []
    for _ in range(n_bootstrap):
        *models, heldout = _resampled(sets, rng)
        boot.append(_closed(*[_both(one, heldout)[0] for one in models]))
    defined = [value for value in boot if value is not None]
    others = ((sim_db, rooms_sim), (comp_db, rooms_comp), (train_db, rooms_train))
    sim, comp, floor = (eq_distance(vectors, heldout_db, rooms, rooms_heldout, rng, n_bootstrap=n_bootstrap)
                        for vectors, rooms in others)
    interval = [float(value) for value in np.percentile(defined, [2.5, 97.5])] if defined else None
    return dict(sim=sim, comp=comp, floor=floor, closed_interval=interval,
                closed_undefined=1.0 - len(defined) / max(len(boot), 1),
                closed=_closed(*[one["wasserstein_db"] for one in (sim, comp, floor)]),
                closed_energy=_closed(*[one["energy_db"] for one in (sim, comp, floor)]))


def _closed(sim, comp, floor):
    return float((sim - comp) / (sim - floor)) if sim > floor else None


class _Set:
    """EQ vectors with the weights that let rooms count equally."""

    def __init__(self, vectors_db, rooms, name):
        self.vectors = np.asarray(vectors_db, dtype=np.float64)
        self.rooms = np.asarray(rooms)
        if self.vectors.ndim != 2 or not len(self.vectors) or len(self.rooms) != len(self.vectors):
            raise ValueError(f"the {name} set has vectors {self.vectors.shape} and {len(self.rooms)} rooms: "
                             "there must be at least one vector, and a room for each")
        self.weights = room_weights(self.rooms)
        self.members = {str(room): np.flatnonzero(self.rooms == room) for room in np.unique(self.rooms)}

    def of_rooms(self, names, rng):
        """Vectors and weights of the rooms named, a room as often as it is named; None if it has none of them.

        The RIRs of a room are drawn anew, with replacement, so that a single room has a spread too.
        """
        drawn = [rng.choice(self.members[name], len(self.members[name])) for name in names if name in self.members]
        if not drawn:
            return None
        weights = np.concatenate([np.full(len(room), 1.0 / (len(room) * len(drawn))) for room in drawn])
        return self.vectors[np.concatenate(drawn)], weights


def _resampled(sets, rng):
    """Bootstrap samples of several sets: rooms drawn with replacement from all there are, the same for every set."""
    rooms = sorted({name for one in sets for name in one.members})
    while True:
        names = [rooms[k] for k in rng.integers(len(rooms), size=len(rooms))]
        samples = [one.of_rooms(names, rng) for one in sets]
        if all(sample is not None for sample in samples):
            return samples


def _basic(found, boot):
    """Basic bootstrap interval of a distance: twice what was found, less the percentiles of the resamples."""
    low, high = np.nanpercentile(boot, [2.5, 97.5])
    return [float(max(2.0 * found - high, 0.0)), float(max(2.0 * found - low, 0.0))]


def _both(a, b):
    return float(np.nanmean(_bands(*a, *b))), _energy(*a, *b)


def _bands(a, weights_a, b, weights_b):
    """1-Wasserstein distance per band; NaN where a set has no value."""
    distances = np.full(a.shape[1], np.nan)
    for k in range(a.shape[1]):
        has_a, has_b = ~np.isnan(a[:, k]), ~np.isnan(b[:, k])
        if has_a.any() and has_b.any():
            distances[k] = wasserstein_distance(a[has_a, k], b[has_b, k], weights_a[has_a], weights_b[has_b])
    return distances


def _energy(a, weights_a, b, weights_b):
    """Root of the energy distance of the complete vectors; NaN where a set has none."""
    whole_a, whole_b = ~np.isnan(a).any(axis=1), ~np.isnan(b).any(axis=1)
    if not whole_a.any() or not whole_b.any():
        return float("nan")
    a, b = a[whole_a], b[whole_b]
    u, v = weights_a[whole_a] / weights_a[whole_a].sum(), weights_b[whole_b] / weights_b[whole_b].sum()
    squared = 2 * u @ cdist(a, b) @ v - u @ cdist(a, a) @ u - v @ cdist(b, b) @ v
    return float(np.sqrt(max(squared, 0.0)))
