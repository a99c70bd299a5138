"""Intervals of word error rates that hold for other rooms and for other seeds.

An error count of one room at one seed (a training with its own draws of RIR, noise and weights) is a cell of a table,
seeds x rooms. A word error rate is the sum of errors over the sum of words, and its first-order error the mean over
cells of the influence ``z = (errors - wer words) / mean words of a cell``; any difference of rates is the same with
the difference of their `z`, which is what pairs them: what rooms or seeds do to all rows alike cancels.

Seeds and rooms are crossed: ``z = seed + room + residual``. A bootstrap resamples seeds and rooms, each with
replacement (McCullagh, Bernoulli 2000; Owen, Ann. Appl. Stat. 2007). Where the residual is the largest part it counts
it three times, and few seeds make it too narrow. Its replicates are therefore stretched about the estimate: to the
standard error of the variance components (two-way analysis of variance, method of moments, none below zero), and to
the tails of Student's t with Satterthwaite's degrees of freedom. `tests/bench/wer_intervals.py` measures how often
these intervals hold the truth.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.stats import norm, t

from roomeq.core.rng import rng_for

REPLICATES = 10_000
LEVEL = 0.95
POWER = 0.8
_CHUNK = 100
"""Replicates of the bootstrap over utterances that are drawn at a time."""


@dataclass(frozen=True)
class Components:
    """Variance of one cell by what it comes from, in the unit of z squared.

    Parameters
    ----------
    n_seeds, n_rooms : int
    seed : float or None
        None where there is one seed: the spread over seeds is not known.
    room, residual : float
        With one seed the residual is part of `room`.
    df : float
        Satterthwaite's degrees of freedom of `variance`.
    """

    n_seeds: int
    n_rooms: int
    seed: float | None
    room: float
    residual: float
    df: float

    def variance_with(self, n_seeds: float, n_rooms: float) -> float:
        """Return the variance of the mean with other numbers of seeds and rooms."""
        return (self.seed or 0.0) / n_seeds + self.room / n_rooms + self.residual / (n_seeds * n_rooms)

    @property
    def variance(self) -> float:
        """Of the mean over all cells."""
        return self.variance_with(self.n_seeds, self.n_rooms)


def influence(errors: np.ndarray, words: np.ndarray) -> tuple[float, np.ndarray]:
    """Return a word error rate [%] and the influence of each cell on it [%].

    Parameters
    ----------
    errors, words : ndarray, shape (n_seeds, n_rooms)
        Cells may hold no words.
    """
    wer = 100.0 * errors.sum() / words.sum()
    return float(wer), (100.0 * errors - wer * words) / words.mean()


def components(z: np.ndarray) -> Components:
    """Return the variance components of a table of influences, shape (n_seeds, n_rooms >= 2)."""
    n_seeds, n_rooms = z.shape
    of_seed, of_room = z.mean(axis=1), z.mean(axis=0)
    ms_room = n_seeds * of_room.var(ddof=1)
    if n_seeds == 1:
        return Components(1, n_rooms, None, ms_room, 0.0, n_rooms - 1.0)
    left = z - of_seed[:, None] - of_room + z.mean()
    ms_seed = n_rooms * of_seed.var(ddof=1)
    df_residual = (n_seeds - 1) * (n_rooms - 1)
    ms_residual = (left ** 2).sum() / df_residual
    seed, room = max(0.0, ms_seed - ms_residual), max(0.0, ms_room - ms_residual)
    # V = sum of w MS; a component that was set to zero takes its mean square with it
    terms = ((ms_seed * (seed > 0), n_seeds - 1), (ms_room * (room > 0), n_rooms - 1),
             (ms_residual * (1 - (seed > 0) - (room > 0)), df_residual))
    spread = sum(ms ** 2 / df for ms, df in terms)
    total = seed + room + ms_residual
    df = total ** 2 / spread if spread > 0 else float(df_residual)
    return Components(n_seeds, n_rooms, seed / n_rooms, room / n_seeds, ms_residual, df)


class Resampling:
    """Replicates of tables with the same seeds and rooms: all statistics of them are resampled together.

    Parameters
    ----------
    n_seeds, n_rooms : int
    what : str
        What is resampled, e.g. the name of the evaluation set: it decides the draws.
    """

    def __init__(self, n_seeds: int, n_rooms: int, what: str):
        self.shape = n_seeds, n_rooms
        rng = rng_for(0, "wer", what)
        self._seeds = rng.multinomial(n_seeds, [1 / n_seeds] * n_seeds, size=REPLICATES) / n_seeds
        self._rooms = rng.multinomial(n_rooms, [1 / n_rooms] * n_rooms, size=REPLICATES) / n_rooms

    def deviations(self, z: np.ndarray) -> np.ndarray:
        """Return how far replicates of a statistic lie from it, not stretched yet, shape (REPLICATES,)."""
        return np.einsum("bs,bs->b", self._seeds, self._rooms @ z.T)


@dataclass(frozen=True)
class Statistic:
    """A word error rate, or a sum of such with factors: value [%], influences, and its replicates' deviations."""

    value: float
    z: np.ndarray
    deviations: np.ndarray

    @classmethod
    def of(cls, errors: np.ndarray, words: np.ndarray, resampling: Resampling) -> "Statistic":
        """Return a word error rate from the tables of its errors and words."""
        value, z = influence(errors, words)
        return cls(value, z, resampling.deviations(z))

    def less(self, other: "Statistic", factor: float = 1.0) -> "Statistic":
        """Return this less so many times another of the same resampling."""
        return Statistic(self.value - factor * other.value, self.z - factor * other.z,
                         self.deviations - factor * other.deviations)

    def replicates(self) -> np.ndarray:
        """Return the stretched replicates."""
        found, spread = components(self.z), self.deviations.std()
        if spread == 0:
            return np.full(len(self.deviations), self.value)
        tail = (1 + LEVEL) / 2
        stretch = math.sqrt(found.variance) / spread * t.ppf(tail, found.df) / norm.ppf(tail)
        return self.value + stretch * self.deviations

    def interval(self) -> list[float] | None:
        """Return the 95 % interval, or None: of a single room there is none."""
        if self.z.shape[1] < 2:
            return None
        low, high = np.quantile(self.replicates(), [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
        return [float(low), float(high)]

    def p(self) -> float | None:
        """Return the probability, were there no difference from 0, of one as large, either way."""
        if self.z.shape[1] < 2:
            return None
        replicates = self.replicates()
        below, above = (replicates <= 0).sum(), (replicates >= 0).sum()
        return float(min(1.0, 2 * (min(below, above) + 1) / (len(replicates) + 1)))


def ratio_interval(over: Statistic, under: Statistic) -> list[float] | None:
    """Return the 95 % interval of ``over / under`` (Fieller, Q. J. R. Stat. Soc. 1940 and J. R. Stat. Soc. B 1954).

    It holds each ratio r for which the interval of ``over - r under`` holds 0. None where that of `under` is not
    above 0: any ratio may then be right.
    """
    certain = under.interval()
    if certain is None or certain[0] <= 0:
        return None
    middle = over.value / under.value

    def end(which: int) -> float:
        def edge(r: float) -> float:
            return over.less(under, r).interval()[which]

        step = 1.0 if which == 1 else -1.0
        if step * edge(middle) <= 0:  # nothing varies
            return middle
        while step * edge(middle + step) > 0:
            step *= 2
        return float(brentq(edge, *sorted((middle, middle + step)), xtol=1e-6))

    return [end(0), end(1)]


def detectable(difference: Statistic) -> dict | None:
    """Return the smallest difference found with 80 % power at 5 %, and what it would take to find half of it.

    That difference is ``t(0.975) + t(0.8)`` standard errors, 2.8 where there are many rooms and seeds.

    Returns
    -------
    dict or None
        `difference` [%]; `standard_errors`, so many of them; `seed, room, residual`: standard deviations [%] of a
        cell, `seed` None where it is not known; `for_half`: seeds or rooms needed where the other stays (None where
        no number is enough), and `factor`, by which both would have to grow. None with a single room, or where nothing
        varies.
    """
    if difference.z.shape[1] < 2 or not difference.deviations.any():
        return None
    found = components(difference.z)
    errors = float(t.ppf((1 + LEVEL) / 2, found.df) + t.ppf(POWER, found.df))
    quarter = found.variance / 4
    shared = found.residual / (found.n_seeds * found.n_rooms)
    main = found.variance - shared
    factor = (main + math.sqrt(main ** 2 + 4 * quarter * shared)) / (2 * quarter)
    seeds = None if found.seed is None else _needed(quarter, found.room / found.n_rooms,
                                                    found.seed + found.residual / found.n_rooms)
    rooms = _needed(quarter, (found.seed or 0.0) / found.n_seeds, found.room + found.residual / found.n_seeds)
    return dict(difference=errors * math.sqrt(found.variance), standard_errors=errors, df=found.df,
                seed=None if found.seed is None else math.sqrt(found.seed), room=math.sqrt(found.room),
                residual=math.sqrt(found.residual), for_half=dict(seeds=seeds, rooms=rooms, factor=factor))


def _needed(variance: float, fixed: float, per_one: float) -> int | None:
    """How many are needed for a variance, of which a part is fixed; None where no number is enough."""
    return None if fixed >= variance else math.ceil(per_one / (variance - fixed) - 1e-9)


def utterance_intervals(errors: np.ndarray, words: np.ndarray, what: str) -> list[list[float]]:
    """Return 95 % intervals [%] as Kaldi's `compute-wer-bootci` has them: mean and 1.96 standard deviations.

    It resamples utterances as if they were independent (Bisani and Ney, ICASSP 2004): not so within a room.

    Parameters
    ----------
    errors : ndarray, shape (n_systems, n_utterances)
    words : ndarray, shape (n_utterances,)
    what : str
        Name of the set: it decides the draws.
    """
    n_systems, n = errors.shape
    rng = rng_for(0, "wer utterances", what)
    sums = np.vstack([errors, words]).T.astype(np.float64)
    rates = np.empty((REPLICATES, n_systems))
    for start in range(0, REPLICATES, _CHUNK):
        drawn = rng.integers(n, size=(_CHUNK, n)) + np.arange(_CHUNK)[:, None] * n
        times = np.bincount(drawn.ravel(), minlength=_CHUNK * n).reshape(_CHUNK, n)
        totals = times.astype(np.float64) @ sums
        rates[start:start + _CHUNK] = 100.0 * totals[:, :-1] / totals[:, -1:]
    mean, spread = rates.mean(axis=0), rates.std(axis=0)
    return np.stack([mean - 1.96 * spread, mean + 1.96 * spread], axis=1).tolist()
