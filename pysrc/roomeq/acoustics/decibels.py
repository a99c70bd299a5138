"""Levels in decibels."""

import math

import numpy as np
from numpy.typing import ArrayLike

from roomeq.core.arrays import FloatArray

TINY_POWER = 1e-300
"""Keeps the logarithm of digital silence finite."""
FLOOR_POWER = 1e-30
"""-300 dB: a floor for levels whose differences must stay moderate."""


def power_db(power: ArrayLike, floor: float = TINY_POWER) -> FloatArray:
    """Return the level of a power, ``10 log10(max(power, floor))`` [dB]."""
    return 10.0 * np.log10(np.maximum(power, floor))


def ratio_db(power: float, reference: float) -> float:
    """Return the level of one power over that of another, ``power_db(power) - power_db(reference)`` [dB]."""
    return 10.0 * (math.log10(max(power, TINY_POWER)) - math.log10(max(reference, TINY_POWER)))
