"""Confidence intervals of word error rates that account for the choice of rooms and of seeds.

Errors are counted in a table of seeds by rooms; a seed is one training with its own draws of RIRs, noises and initial
weights. A word error rate is the sum of errors over the sum of words. To first order, its sampling error is the mean
over the cells of the influence ``z = (errors - wer words) / mean words of a cell``. The influence of a difference of
two rates is the difference of their influences. Comparisons are therefore paired: effects of rooms and seeds that are
common to both rates cancel.

Seeds and rooms are crossed random factors: ``z = seed + room + residual``. A bootstrap resamples seeds and rooms, each
with replacement (McCullagh, Bernoulli 2000; Owen, Ann. Appl. Stat. 2007). Its variance contains the residual variance
three times, and with few seeds it is too small. The deviations of the replicates from the estimate are therefore
scaled: to the standard error from the variance components (two-way analysis of variance, method of moments, negative
estimates set to zero), and to the quantiles of Student's t with Satterthwaite's degrees of freedom. A component that is
estimated as zero keeps its degrees of freedom: two or three seeds cannot show that seeds do not matter.
`tests/bench/wer_intervals.py` measures how often these intervals contain the true value.
"""

import math
from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.stats import norm, t

from roomeq.core.arrays import FloatArray
from roomeq.core.rng import rng_for

REPLICATES = 10_000
LEVEL = 0.95
POWER = 0.8
LEAST_P = 1e-4
"""Smallest p value that is stated: `REPLICATES` tell no smaller ones."""
_GREATEST_P = 0.999
_MANY = 10 ** 6  # seeds or rooms, about as good as any number


@dataclass(frozen=True)
class Components:
    """Variance components of the influence of a cell, in units of z squared.

    Attributes
    ----------
    seed : float or None
        Variance over seeds; None with a single seed, from which it cannot be estimated.
    room, residual : float
        Variance over rooms, and of the residual. With a single seed, the residual is part of `room`.
    """

    n_seeds: int
    n_rooms: int
    seed: float | None
    room: float
    residual: float

    def variance_with(self, n_seeds: float, n_rooms: float) -> float:
        """Return the variance of the mean with other numbers of seeds and rooms."""
        return (self.seed or 0.0) / n_seeds + self.room / n_rooms + self.residual / (n_seeds * n_rooms)

    def df_with(self, n_seeds: float, n_rooms: float) -> float:
        """Return Satterthwaite's degrees of freedom of `variance_with`, from the expected mean squares."""
        if self.seed is None:
            return n_rooms - 1.0
        of_seeds, of_rooms = self.residual + n_rooms * self.seed, self.residual + n_seeds * self.room
        sum_of_squares = (of_seeds ** 2 / (n_seeds - 1.0) + of_rooms ** 2 / (n_rooms - 1.0)
                          + self.residual ** 2 / ((n_seeds - 1.0) * (n_rooms - 1.0)))
        return (of_seeds + of_rooms - self.residual) ** 2 / sum_of_squares if sum_of_squares > 0.0 else n_rooms - 1.0

    @property
    def variance(self) -> float:
        """Variance of the mean over all cells."""
        return self.variance_with(self.n_seeds, self.n_rooms)

    @property
    def df(self) -> float:
        """Satterthwaite's degrees of freedom of `variance`."""
        return self.df_with(self.n_seeds, self.n_rooms)


def influence(errors: FloatArray, words: FloatArray) -> tuple[float, FloatArray]:
    """Return a word error rate [%] and the influence of each cell on it [%].

    Parameters
    ----------
    errors, words : ndarray, shape (n_seeds, n_rooms)
        Cells may have 0 words.
    """
    wer = 100.0 * errors.sum() / words.sum()
    return float(wer), (100.0 * errors - wer * words) / words.mean()


def variance_components(z: FloatArray) -> Components:
    """Estimate the variance components of a table of influences, shape (n_seeds, n_rooms >= 2)."""
    n_seeds, n_rooms = z.shape
    seed_mean, room_mean = z.mean(axis=1), z.mean(axis=0)
    ms_room = n_seeds * room_mean.var(ddof=1)
    if n_seeds == 1:
        return Components(1, n_rooms, None, ms_room, 0.0)
    residuals = z - seed_mean[:, None] - room_mean + z.mean()
    ms_seed = n_rooms * seed_mean.var(ddof=1)
    ms_residual = (residuals ** 2).sum() / ((n_seeds - 1) * (n_rooms - 1))
    return Components(n_seeds, n_rooms, max(0.0, ms_seed - ms_residual) / n_rooms,
                      max(0.0, ms_room - ms_residual) / n_seeds, ms_residual)


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
        """Return the unscaled deviations of the replicates from a statistic, shape (REPLICATES,)."""
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

    def minus(self, other: "Statistic", factor: float = 1.0) -> "Statistic":
        """Return this statistic minus `factor` times another statistic of the same resampling."""
        return Statistic(self.value - factor * other.value, self.z - factor * other.z,
                         self.deviations - factor * other.deviations)

    def interval(self) -> list[float] | None:
        """Return the 95 % interval; None with a single room."""
        return None if self.z.shape[1] < 2 else self._limits()

    def _limits(self, level: float = LEVEL) -> list[float]:
        components, bootstrap_error = variance_components(self.z), self.deviations.std()
        if bootstrap_error == 0:
            return [self.value, self.value]
        upper = (1 + level) / 2
        scale = math.sqrt(components.variance) / bootstrap_error * t.ppf(upper, components.df) / norm.ppf(upper)
        low, high = self.value + scale * np.quantile(self.deviations, [1 - upper, upper])
        return [float(low), float(high)]

    def p_value(self) -> float | None:
        """Return the two-sided p value of the hypothesis that the value is 0; None with a single room.

        It is the level of the widest interval that does not contain 0, taken from 1; at least `LEAST_P`.
        """
        if self.z.shape[1] < 2:
            return None

        def clearance(p: float) -> float:  # of the interval from 0
            low, high = self._limits(1.0 - p)
            return low if self.value > 0 else -high

        if self.value == 0 or clearance(_GREATEST_P) <= 0:
            return 1.0
        if clearance(LEAST_P) > 0:
            return LEAST_P
        return float(brentq(clearance, LEAST_P, _GREATEST_P, xtol=1e-7))


def ratio_interval(numerator: Statistic, denominator: Statistic) -> list[float] | None:
    """Return the 95 % interval of a ratio (Fieller, Q. J. R. Stat. Soc. 1940 and J. R. Stat. Soc. B 1954).

    It contains every ratio r for which the interval of ``numerator - r denominator`` contains 0. None if the interval
    of the denominator is not above 0: any ratio is then possible.
    """
    interval = denominator.interval()
    if interval is None or interval[0] <= 0:
        return None
    estimate = numerator.value / denominator.value

    def find_limit(index: int, step: float) -> float:
        def contrast(ratio: float) -> float:
            return numerator.minus(denominator, ratio)._limits()[index]

        if step * contrast(estimate) <= 0:  # the replicates do not vary
            return estimate
        while step * contrast(estimate + step) > 0:
            step *= 2
        return float(brentq(contrast, *sorted((estimate, estimate + step)), xtol=1e-6))

    return [find_limit(0, -1.0), find_limit(1, 1.0)]


def detectable(difference: Statistic) -> dict | None:
    """Return the minimum detectable difference (80 % power, 5 % level), and the sample size that would halve it.

    The minimum detectable difference is ``t(0.975) + t(0.8)`` standard errors, 2.8 with many rooms and seeds.

    Returns
    -------
    dict or None
        `difference` [%]; `standard_errors`: the same in standard errors, with `df` degrees of freedom; `seed`, `room`,
        `residual`: standard deviations of a cell [%], `seed` None with a single seed; `for_half`: number of `seeds`
        that halves the difference with the same rooms, number of `rooms` that halves it with the same seeds (None if
        no number does), and `factor` on both numbers that halves it. None with a single room, or if rooms and seeds do
        not vary but for rounding.
    """
    if difference.z.shape[1] < 2 or np.allclose(difference.deviations, 0.0, atol=1e-9):
        return None
    fitted = variance_components(difference.z)
    n_seeds, n_rooms = fitted.n_seeds, fitted.n_rooms

    def detected(seeds: float, rooms: float) -> float:
        df = fitted.df_with(seeds, rooms)
        return float((t.ppf((1 + LEVEL) / 2, df) + t.ppf(POWER, df)) * math.sqrt(fitted.variance_with(seeds, rooms)))

    found = detected(n_seeds, n_rooms)
    of_seeds = None if fitted.seed is None else _first(lambda n: detected(n, n_rooms) <= found / 2, n_seeds)
    of_rooms = _first(lambda n: detected(n_seeds, n) <= found / 2, n_rooms)
    both = brentq(lambda factor: detected(n_seeds if fitted.seed is None else factor * n_seeds, factor * n_rooms)
                  - found / 2, 1.0, _MANY)
    return dict(difference=found, standard_errors=found / math.sqrt(fitted.variance), df=fitted.df,
                seed=None if fitted.seed is None else math.sqrt(fitted.seed), room=math.sqrt(fitted.room),
                residual=math.sqrt(fitted.residual), for_half=dict(seeds=of_seeds, rooms=of_rooms, factor=both))


def _first(holds: Callable[[int], bool], low: int) -> int | None:
    """Return the smallest number above `low` from which on a condition holds; None if it does not for `_MANY`."""
    first = low + 1 + bisect_left(range(low + 1, _MANY + 1), True, key=holds)
    return first if first <= _MANY else None
