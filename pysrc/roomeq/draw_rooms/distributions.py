"""Distributions of one number, as a table of room types states them."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from roomeq.core.constants import is_number

if TYPE_CHECKING:
    import numpy as np

LARGEST = 1e6
"""Largest absolute value of a bound."""
RULE = "a number, [LOW, HIGH] or {median = M, spread = S, low = A, high = B}"


@dataclass(frozen=True)
class Distribution:
    """A constant, a uniform or a log-normal distribution, between two bounds.

    Attributes
    ----------
    low, high
        Bounds; a constant where they are equal.
    median
        Of a log-normal distribution, which is cut off at the bounds; None: uniform.
    spread
        Of a log-normal distribution: two thirds of its values lie between ``median / spread`` and ``median * spread``.
    """

    low: float
    high: float
    median: float | None = None
    spread: float = 1.0

    def draw(self, rng: "np.random.Generator") -> float:
        """Draw a value; any distribution takes one number of the generator."""
        u = float(rng.random())
        if self.median is None:
            return self.low + u * (self.high - self.low)
        from statistics import NormalDist

        normal = NormalDist(math.log(self.median), math.log(self.spread))
        below, above = normal.cdf(math.log(self.low)), normal.cdf(math.log(self.high))
        share = min(max(below + u * (above - below), 1e-9), 1.0 - 1e-9)
        return min(max(math.exp(normal.inv_cdf(share)), self.low), self.high)


def parse_distribution(value: Any, low: float, high: float) -> Distribution:
    """Return a distribution whose values lie in [low, high] from a number, a list of two, or a table.

    Raises
    ------
    ValueError
        It has another form, or exceeds these limits; the message is the rule.
    """
    rule = f"{RULE} with values in [{low:g}, {high:g}]"
    if _is_number(value):
        found = Distribution(value, value)
    elif isinstance(value, list) and len(value) == 2 and all(map(_is_number, value)):
        found = Distribution(*value)
    elif isinstance(value, dict) and set(value) == {"median", "spread", "low", "high"} and all(
            map(_is_number, value.values())):
        found = Distribution(**value)
        if not 0.0 < found.low < found.high or not found.low <= value["median"] <= found.high or not (
                1.0 < found.spread <= 10.0):
            raise ValueError(f"{rule}, 0 < A < B, M between them and S in (1, 10]")
    else:
        raise ValueError(rule)
    if not low <= found.low <= found.high <= high:
        raise ValueError(rule)
    return found


def _is_number(value: Any) -> bool:
    return is_number(value) and abs(value) <= LARGEST
