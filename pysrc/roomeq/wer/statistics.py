"""Confidence intervals of word error rates that hold for other rooms and for other seeds.

Errors are counted in a table of seeds by rooms; a seed is one training with its own draws of RIRs, noises and initial
weights. A word error rate is the sum of errors over the sum of words. To first order its error is the mean over the
cells of the influence ``z = (errors - wer words) / mean words of a cell``. The influence of a difference of two rates
is the difference of their influences. This pairs the rates: effects of rooms and seeds that both share cancel.

Seeds and rooms are crossed: ``z = seed + room + residual``. A bootstrap resamples seeds and rooms, each with
replacement (McCullagh, Bernoulli 2000; Owen, Ann. Appl. Stat. 2007). It counts a dominating residual three times, and
with few seeds it is too narrow. Its replicates are therefore stretched about the estimate: to the standard error of the
variance components (two-way analysis of variance, method of moments, none below zero), and to the tails of Student's t
with Satterthwaite's degrees of freedom. `tests/bench/wer_intervals.py` measures how often these intervals contain the
truth.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.stats import norm, t

from roomeq.core.arrays import FloatArray
from roomeq.core.rng import rng_for

REPLICATES = 10_000
LEVEL = 0.95
POWER = 0.8


@dataclass(frozen=True)
class Components:
    """Variance components of one cell, in the unit of z squared.

    Attributes
    ----------
    seed : float or None
        None with a single seed: the spread over seeds is unknown.
    room, residual : float
        With a single seed the residual is part of `room`.
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
        """Variance of the mean over all cells."""
        return self.variance_with(self.n_seeds, self.n_rooms)


def influence(errors: FloatArray, words: FloatArray) -> tuple[float, FloatArray]:
    """Return a word error rate [%] and the influence of each cell on it [%].

    Parameters
    ----------
    errors, words : ndarray, shape (n_seeds, n_rooms)
        Cells may hold no words.
    """
    wer = 100.0 * errors.sum() / words.sum()
    return float(wer), (100.0 * errors - wer * words) / words.mean()


def variance_components(z: FloatArray) -> Components:
    """Estimate the variance components of a table of influences, shape (n_seeds, n_rooms >= 2)."""
    n_seeds, n_rooms = z.shape
    seed_mean, room_mean = z.mean(axis=1), z.mean(axis=0)
    ms_room = n_seeds * room_mean.var(ddof=1)
    if n_seeds == 1:
        return Components(1, n_rooms, None, ms_room, 0.0, n_rooms - 1.0)
    residuals = z - seed_mean[:, None] - room_mean + z.mean()
    ms_seed = n_rooms * seed_mean.var(ddof=1)
    df_residual = (n_seeds - 1) * (n_rooms - 1)
    ms_residual = (residuals ** 2).sum() / df_residual
    seed, room = max(0.0, ms_seed - ms_residual), max(0.0, ms_room - ms_residual)
    # the variance is a weighted sum of mean squares; a component that was set to zero drops out with its mean square
    terms = ((ms_seed * (seed > 0), n_seeds - 1), (ms_room * (room > 0), n_rooms - 1),
             (ms_residual * (1 - (seed > 0) - (room > 0)), df_residual))
    spread = sum(ms ** 2 / df for ms, df in terms)
    total = seed + room + ms_residual
    df = total ** 2 / spread if spread > 0 else float(df_residual)
    return Components(n_seeds, n_rooms, seed / n_rooms, room / n_seeds, ms_residual, df)


class Resampling:
    """Bootstrap weights of seeds and rooms; statistics that share them are resampled together.

    Parameters
    ----------
    name
        Name of the evaluation sets: draws for different names are independent.
    """

    def __init__(self, n_seeds: int, n_rooms: int, name: str) -> None:
        rng = rng_for(0, "wer", name)
        self._seeds = rng.multinomial(n_seeds, [1 / n_seeds] * n_seeds, size=REPLICATES) / n_seeds
        self._rooms = rng.multinomial(n_rooms, [1 / n_rooms] * n_rooms, size=REPLICATES) / n_rooms

    def deviations(self, z: FloatArray) -> FloatArray:
        """Return the deviations of the replicates from a statistic before stretching, shape (REPLICATES,)."""
        return np.einsum("bs,bs->b", self._seeds, self._rooms @ z.T)


@dataclass(frozen=True)
class Statistic:
    """A word error rate, or a linear combination of word error rates [%], with its bootstrap replicates.

    Attributes
    ----------
    z : ndarray, shape (n_seeds, n_rooms)
        Influence of each cell [%].
    deviations : ndarray, shape (REPLICATES,)
        See `Resampling.deviations`.
    """

    value: float
    z: FloatArray
    deviations: FloatArray

    @classmethod
    def of(cls, errors: FloatArray, words: FloatArray, resampling: Resampling) -> "Statistic":
        """Return the word error rate of tables of errors and words, shape (n_seeds, n_rooms)."""
        value, z = influence(errors, words)
        return cls(value, z, resampling.deviations(z))

    def less(self, other: "Statistic", factor: float = 1.0) -> "Statistic":
        """Return this minus `factor` times another statistic of the same resampling."""
        return Statistic(self.value - factor * other.value, self.z - factor * other.z,
                         self.deviations - factor * other.deviations)

    def replicates(self) -> FloatArray:
        """Return the stretched replicates."""
        parts, spread = variance_components(self.z), self.deviations.std()
        if spread == 0:
            return np.full(len(self.deviations), self.value)
        tail = (1 + LEVEL) / 2
        stretch = math.sqrt(parts.variance) / spread * t.ppf(tail, parts.df) / norm.ppf(tail)
        return self.value + stretch * self.deviations

    def interval(self) -> list[float] | None:
        """Return the 95 % interval; None with a single room."""
        return None if self.z.shape[1] < 2 else self._ends()

    def _ends(self) -> list[float]:
        low, high = np.quantile(self.replicates(), [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
        return [float(low), float(high)]

    def p(self) -> float | None:
        """Return the two-sided p-value of the hypothesis that the value is 0; None with a single room."""
        if self.z.shape[1] < 2:
            return None
        replicates = self.replicates()
        below, above = (replicates <= 0).sum(), (replicates >= 0).sum()
        return float(min(1.0, 2 * (min(below, above) + 1) / (len(replicates) + 1)))


def ratio_interval(numerator: Statistic, denominator: Statistic) -> list[float] | None:
    """Return the 95 % interval of a ratio (Fieller, Q. J. R. Stat. Soc. 1940 and J. R. Stat. Soc. B 1954).

    It contains each ratio r for which the interval of ``numerator - r denominator`` contains 0. None if the interval
    of the denominator is not above 0: any ratio is then possible.
    """
    interval = denominator.interval()
    if interval is None or interval[0] <= 0:
        return None
    estimate = numerator.value / denominator.value

    def find_end(end: int, step: float) -> float:
        def contrast(ratio: float) -> float:
            return numerator.less(denominator, ratio)._ends()[end]

        if step * contrast(estimate) <= 0:  # nothing varies
            return estimate
        while step * contrast(estimate + step) > 0:
            step *= 2
        return float(brentq(contrast, *sorted((estimate, estimate + step)), xtol=1e-6))

    return [find_end(0, -1.0), find_end(1, 1.0)]


def detectable(difference: Statistic) -> dict | None:
    """Return the difference that is detected with 80 % power at the 5 % level, and how to detect half of it.

    The difference is ``t(0.975) + t(0.8)`` standard errors, 2.8 with many rooms and seeds.

    Returns
    -------
    dict or None
        `difference` [%]; `standard_errors`: the same in standard errors, with `df` degrees of freedom; `seed`, `room`,
        `residual`: standard deviations of a cell [%], `seed` None with a single seed; `for_half`: number of `seeds`
        or `rooms` that detects half of the difference while the other number stays (None if no number does), and
        `factor` by which both would have to grow. None with a single room, or if nothing varies.
    """
    if difference.z.shape[1] < 2 or not difference.deviations.any():
        return None
    parts = variance_components(difference.z)
    standard_errors = float(t.ppf((1 + LEVEL) / 2, parts.df) + t.ppf(POWER, parts.df))
    quarter = parts.variance / 4
    shared = parts.residual / (parts.n_seeds * parts.n_rooms)
    main = parts.variance - shared
    factor = (main + math.sqrt(main ** 2 + 4 * quarter * shared)) / (2 * quarter)
    seeds = None if parts.seed is None else _needed(quarter, parts.room / parts.n_rooms,
                                                    parts.seed + parts.residual / parts.n_rooms)
    rooms = _needed(quarter, (parts.seed or 0.0) / parts.n_seeds, parts.room + parts.residual / parts.n_seeds)
    return dict(difference=standard_errors * math.sqrt(parts.variance), standard_errors=standard_errors, df=parts.df,
                seed=None if parts.seed is None else math.sqrt(parts.seed), room=math.sqrt(parts.room),
                residual=math.sqrt(parts.residual), for_half=dict(seeds=seeds, rooms=rooms, factor=factor))


def _needed(variance: float, fixed: float, variance_of_one: float) -> int | None:
    """Return the number of seeds or rooms that reaches a variance with a fixed part; None if no number does."""
    return None if fixed >= variance else math.ceil(variance_of_one / (variance - fixed) - 1e-9)
