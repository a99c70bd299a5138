"""Confidence intervals of word error rates that account for the choice of rooms and of seeds.

Errors are counted in a table of seeds by rooms; a seed is one training with its own draws of RIRs, noises and initial
weights. A word error rate is the sum of errors over the sum of words. To first order, its sampling error is the mean
over the cells of the influence ``z = (errors - wer words) / mean words of a cell``. The influence of a difference of
two rates is the difference of their influences. Comparisons are therefore paired: effects of rooms and seeds that are
common to both rates cancel.

Seeds and rooms are crossed random factors: the rate of a cell is ``wer + seed + room + residual``, and a room or a seed
weighs as its share of the words. The variance of the mean is therefore ``seed sum(g^2) + room sum(h^2) + residual
sum(g^2) sum(h^2)`` with the shares g of the seeds and h of the rooms: ``1 / sum(h^2)`` is the effective number of rooms
(Kish, Survey Sampling, 1965). The components are estimated by analysis of variance with unequal numbers (method of
moments with weighted sums of squares, negative estimates set to zero: Searle, Casella & McCulloch, Variance Components,
1992, ch. 3), and the variance has Satterthwaite's degrees of freedom. The variance over rooms is taken to be the same
whatever their size; where small rooms vary more, since they have fewer words, the intervals are too wide. A component
that is estimated as zero keeps its degrees of freedom: two or three seeds cannot show that seeds do not matter.

The intervals are the estimate plus or minus the standard error times the quantile of Student's t. In simulations,
intervals with the shape of a bootstrap over seeds and rooms (McCullagh, Bernoulli 2000; Owen, Ann. Appl. Stat. 2007),
scaled to these, cover no better, also where the effects of rooms are skewed, and too little with two rooms, of which a
bootstrap has three different resamples. Corrections for skewness (Hall, J. R. Stat. Soc. B 1992; BCa) cover up to 3 %
more where it is strong and the rooms are of equal size, and up to 2 % less elsewhere.
`tests/bench/wer_intervals.py` measures how often these intervals contain the true value.

A difference in points is largely that of the rooms with most errors: where each room changes by the same share of its
errors, a room with 70 % errors changes by ten times as many points as one with 7 %. The geometric mean over rooms of
the ratios of two rates, computed as the mean of their logarithms, weighs each room by its words alone.
"""

import math
from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.stats import t

from roomeq.core.arrays import FloatArray

LEVEL = 0.95
POWER = 0.8
_MANY = 10 ** 6  # seeds or rooms, about as good as any number


@dataclass(frozen=True)
class Levels:
    """Seeds or rooms, by the shares h of the words that they have.

    Attributes
    ----------
    squares, cubes : float
        ``sum(h^2)`` and ``sum(h^3)``.
    """

    squares: float
    cubes: float

    @classmethod
    def of(cls, shares: FloatArray) -> "Levels":
        """Return the levels of shares that sum to 1."""
        return cls(float((shares ** 2).sum()), float((shares ** 3).sum()))

    def times(self, factor: float) -> "Levels":
        """Return so many times as many levels whose sizes are distributed alike."""
        return Levels(self.squares / factor, self.cubes / factor ** 2)

    @property
    def df(self) -> float:
        """Satterthwaite's degrees of freedom of ``sum(h deviation^2)``, n - 1 for n levels of equal size."""
        return (1.0 - self.squares) ** 2 / (self.squares - 2.0 * self.cubes + self.squares ** 2)


@dataclass(frozen=True)
class RoomComponents:
    """Variance components over the rooms of a set, in per cent squared.

    Attributes
    ----------
    room, residual : float
        Variance over rooms, and of the residual of a cell. With a single seed, the residual is part of `room`.
    """

    rooms: Levels
    room: float
    residual: float


@dataclass(frozen=True)
class Components:
    """Variance components of the rates of cells, in per cent squared.

    Attributes
    ----------
    seed : float or None
        Variance over seeds; None with a single seed, from which it cannot be estimated.
    of_sets : tuple of RoomComponents
        Of each of the sets that share no room, e.g. two for a difference of test and dev.
    """

    seeds: Levels
    seed: float | None
    of_sets: tuple[RoomComponents, ...]

    def variance_with(self, seeds: float = 1.0, rooms: float = 1.0) -> float:
        """Return the variance of the mean with `seeds` times as many seeds and `rooms` times as many rooms."""
        of_seeds, of_rooms, residuals = self._mean_squares(seeds, rooms)
        return of_seeds + sum(of_rooms) - sum(residuals)

    def df_with(self, seeds: float = 1.0, rooms: float = 1.0) -> float:
        """Return Satterthwaite's degrees of freedom of `variance_with`, from the expected mean squares."""
        of_seeds, of_rooms, residuals = self._mean_squares(seeds, rooms)
        df_rooms = [one.rooms.times(rooms).df for one in self.of_sets]
        sum_of_squares = sum(mean_square ** 2 / df for mean_square, df in zip(of_rooms, df_rooms, strict=True))
        if self.seed is not None:
            df_seeds = self.seeds.times(seeds).df
            sum_of_squares += of_seeds ** 2 / df_seeds + sum(
                residual ** 2 / (df_seeds * df) for residual, df in zip(residuals, df_rooms, strict=True))
        return self.variance_with(seeds, rooms) ** 2 / sum_of_squares if sum_of_squares > 0.0 else min(df_rooms)

    def _mean_squares(self, seeds: float, rooms: float) -> tuple[float, list[float], list[float]]:
        """Return the parts of the variance: mean squares of seeds, and of rooms and residual of each set."""
        share = self.seeds.squares / seeds
        shares = [one.rooms.squares / rooms for one in self.of_sets]
        residuals = [share * of_set * one.residual for of_set, one in zip(shares, self.of_sets, strict=True)]
        return (share * (self.seed or 0.0) + sum(residuals),
                [of_set * one.room + residual
                 for of_set, one, residual in zip(shares, self.of_sets, residuals, strict=True)], residuals)

    @property
    def variance(self) -> float:
        """Variance of the mean over all cells."""
        return self.variance_with()

    @property
    def df(self) -> float:
        """Satterthwaite's degrees of freedom of `variance`."""
        return self.df_with()


def influence(errors: FloatArray, words: FloatArray) -> tuple[float, FloatArray]:
    """Return a word error rate [%] and the influence of each cell on it [%].

    Parameters
    ----------
    errors, words : ndarray, shape (n_seeds, n_rooms)
        Cells may have 0 words.
    """
    wer = 100.0 * errors.sum() / words.sum()
    return float(wer), (100.0 * errors - wer * words) / words.mean()


def variance_components(z: FloatArray, shares: Sequence[FloatArray]) -> Components:
    """Estimate the variance components of a table of influences.

    Parameters
    ----------
    z : ndarray, shape (n_seeds, n_rooms)
        Those of each set sum to 0.
    shares : sequence of ndarray, shape (n_seeds, n_rooms)
        See `Statistic`; of two rooms or more each.
    """
    of_cells = z / z.size
    of_seeds = np.mean([table.sum(axis=1) for table in shares], axis=0)
    of_sets = tuple(_room_components(of_cells, of_seeds, table.sum(axis=0)) for table in shares)
    levels = Levels.of(of_seeds)
    if len(z) == 1:
        return Components(levels, None, of_sets)
    residual = sum(one.residual * one.rooms.squares for one in of_sets)
    return Components(levels, max(0.0, _variance(of_cells.sum(axis=1) / of_seeds, of_seeds) - residual), of_sets)


def _room_components(of_cells: FloatArray, seeds: FloatArray, rooms: FloatArray) -> RoomComponents:
    """Estimate the components over the rooms of one set, from the contributions of the cells to the statistic.

    Parameters
    ----------
    of_cells : ndarray, shape (n_seeds, n_rooms)
    seeds, rooms : ndarray
        Shares of the words; 0 in rooms of other sets. A cell counts as the product of those of its seed and room: an
        empty one deviates by 0.
    """
    of_cells, rooms = of_cells[:, rooms > 0], rooms[rooms > 0]
    of_rooms, levels = of_cells.sum(axis=0) / rooms, Levels.of(rooms)
    if len(seeds) == 1:
        return RoomComponents(levels, _variance(of_rooms, rooms), 0.0)
    weights = np.outer(seeds, rooms)
    residuals = of_cells / weights - (of_cells.sum(axis=1) / seeds)[:, None] - of_rooms
    squares = Levels.of(seeds).squares
    residual = float((weights * residuals ** 2).sum() / ((1.0 - squares) * (1.0 - levels.squares)))
    return RoomComponents(levels, max(0.0, _variance(of_rooms, rooms) - residual * squares), residual)


def _variance(deviations: FloatArray, shares: FloatArray) -> float:
    """Return the unbiased estimate of a variance from deviations from the weighted mean."""
    return float((shares * deviations ** 2).sum() / (1.0 - (shares ** 2).sum()))


def _of_distinct_sets(shares: Sequence[FloatArray]) -> tuple[FloatArray, ...]:
    """Return shares of sets that have no room in common: of sets that have, the mean."""
    distinct: list[FloatArray] = []
    for table in shares:
        common = [other for other in distinct if (table.any(axis=0) & other.any(axis=0)).any()]
        if not any(np.array_equal(table, other) for other in common):
            distinct = [other for other in distinct if not any(other is one for one in common)]
            distinct.append(np.mean([table, *common], axis=0))
    return tuple(distinct)


@dataclass(frozen=True)
class Statistic:
    """A word error rate or a linear combination of word error rates [%], or the mean logarithm of a ratio of two.

    Attributes
    ----------
    z : ndarray, shape (n_seeds, n_rooms)
        Influence of each cell, in the unit of `value`.
    shares : tuple of ndarray, shape (n_seeds, n_rooms)
        Share of each cell in the words of a set. Statistics of the same sets are paired over rooms and seeds, those of
        sets without a common room over seeds.
    """

    value: float
    z: FloatArray
    shares: tuple[FloatArray, ...]

    @classmethod
    def of(cls, errors: FloatArray, words: FloatArray) -> "Statistic":
        """Return the word error rate of tables of errors and words, shape (n_seeds, n_rooms)."""
        return cls(*influence(errors, words), (words / words.sum(),))

    @classmethod
    def of_log_ratio(cls, errors: FloatArray, base: FloatArray, words: FloatArray) -> "Statistic":
        """Return the mean over rooms of the natural logarithm of the ratio of two rates on one set.

        The rate of a room is that over all seeds, and a room weighs as its share of the words. To the errors of each
        room 0.5 is added: the bias of the logarithm of a count is then of second order, and rooms without errors have
        one (Gart & Zweifel, Biometrika 54 (1967) 181).

        Parameters
        ----------
        errors, base, words : ndarray, shape (n_seeds, n_rooms)
        """
        of_rooms, shares = words.sum(axis=0), words / words.sum()
        within = words / np.maximum(of_rooms, 1.0)
        log_rates, deviations = [], []
        for table in (errors, base):
            total = table.sum(axis=0)
            log_rates.append(np.log(total + 0.5))
            deviations.append((table - within * total) / (total + 0.5))
        log_ratio, weight = log_rates[0] - log_rates[1], shares.sum(axis=0)
        value = float(weight @ log_ratio)
        of_cells = weight * (within * (log_ratio - value) + deviations[0] - deviations[1])
        return cls(value, of_cells * words.size, (shares,))

    def minus(self, other: "Statistic", factor: float = 1.0) -> "Statistic":
        """Return this statistic minus `factor` times another statistic of the same seeds and rooms."""
        return Statistic(self.value - factor * other.value, self.z - factor * other.z,
                         _of_distinct_sets((*self.shares, *other.shares)))

    @property
    def n_rooms(self) -> int:
        """Number of rooms of the set that has the fewest."""
        return min(int(table.any(axis=0).sum()) for table in self.shares)

    @property
    def components(self) -> Components:
        """Variance components; there must be two rooms or more."""
        return variance_components(self.z, self.shares)

    def interval(self) -> list[float] | None:
        """Return the 95 % interval; None where a set has a single room."""
        return None if self.n_rooms < 2 else self._limits()

    def _limits(self) -> list[float]:
        components = self.components
        half = float(t.ppf((1 + LEVEL) / 2, components.df)) * math.sqrt(components.variance)
        return [self.value - half, self.value + half]

    def p_value(self) -> float | None:
        """Return the two-sided p value of the hypothesis that the value is 0; None where a set has a single room."""
        if self.n_rooms < 2:
            return None
        components = self.components
        if components.variance == 0.0:
            return 1.0 if self.value == 0.0 else 0.0
        return float(2.0 * t.sf(abs(self.value) / math.sqrt(components.variance), components.df))


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

        if step * contrast(estimate) <= 0:  # rooms and seeds do not vary
            return estimate
        while step * contrast(estimate + step) > 0:
            step *= 2
        return float(brentq(contrast, *sorted((estimate, estimate + step)), xtol=1e-6))

    return [find_limit(0, -1.0), find_limit(1, 1.0)]


def detectable(difference: Statistic) -> dict | None:
    """Return the minimum detectable difference (80 % power, 5 % level), and the sample size that would halve it.

    The minimum detectable difference is ``t(0.975) + t(0.8)`` standard errors, 2.8 with many rooms and seeds. More
    rooms are taken to be of sizes as unequal as those there are.

    Parameters
    ----------
    difference
        Of rates on one set, or `of_log_ratio`.

    Returns
    -------
    dict or None
        `difference`, in the unit of that given; `standard_errors`: the same in standard errors, with `df` degrees of
        freedom; `seed`, `room`, `residual`: standard deviations of a cell, `seed` None with a single seed; `for_half`:
        number of `seeds` that halves the difference with the same rooms, number of `rooms` that halves it with the same
        seeds (None if no number does), and `factor` on both numbers that halves it. None with a single room, or if
        rooms and seeds do not vary but for rounding.
    """
    if difference.n_rooms < 2 or np.allclose(difference.z, 0.0, atol=1e-9):
        return None
    fitted, n_seeds, n_rooms = difference.components, len(difference.z), difference.n_rooms
    of_rooms, = fitted.of_sets

    def detected(seeds: float, rooms: float) -> float:
        seeds, rooms = seeds / n_seeds, rooms / n_rooms
        df = fitted.df_with(seeds, rooms)
        return float((t.ppf((1 + LEVEL) / 2, df) + t.ppf(POWER, df)) * math.sqrt(fitted.variance_with(seeds, rooms)))

    found = detected(n_seeds, n_rooms)
    for_seeds = None if fitted.seed is None else _first(lambda n: detected(n, n_rooms) <= found / 2, n_seeds)
    for_rooms = _first(lambda n: detected(n_seeds, n) <= found / 2, n_rooms)
    both = brentq(lambda factor: detected(n_seeds if fitted.seed is None else factor * n_seeds, factor * n_rooms)
                  - found / 2, 1.0, _MANY)
    return dict(difference=found, standard_errors=found / math.sqrt(fitted.variance), df=fitted.df,
                seed=None if fitted.seed is None else math.sqrt(fitted.seed), room=math.sqrt(of_rooms.room),
                residual=math.sqrt(of_rooms.residual), for_half=dict(seeds=for_seeds, rooms=for_rooms, factor=both))


def _first(holds: Callable[[int], bool], low: int) -> int | None:
    """Return the smallest number above `low` from which on a condition holds; None if it does not for `_MANY`."""
    first = low + 1 + bisect_left(range(low + 1, _MANY + 1), True, key=holds)
    return first if first <= _MANY else None
