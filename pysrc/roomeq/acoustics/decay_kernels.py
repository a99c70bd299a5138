"""Compiled kernels for decay curves (`roomeq.acoustics.iso3382`)."""

import numpy as np

from roomeq.acoustics.decibels import TINY_POWER
from roomeq.core.arrays import Array, FloatArray
from roomeq.core.jit import compiled


@compiled
def decay_curve(before: Array, remaining: FloatArray, noise_power: float, rest_energy: float
                ) -> tuple[FloatArray, float]:
    """Return the energy from each sample on, less that of the noise, relative to the total; and the total.

    Parameters
    ----------
    before
        Response ahead of the first sample, whose energy counts towards the total alone.
    remaining
        `roomeq.acoustics.noise_intersection.remaining_energy` up to and with the last sample, shape (n_samples + 1,).
    noise_power
        Mean square of the noise.
    rest_energy
        Energy of the decay after the last sample.
    """
    n_samples, total = len(remaining) - 1, 0.0
    for n in range(len(before) - 1, -1, -1):
        total += np.float64(before[n]) ** 2
    total += remaining[0] - remaining[n_samples] - noise_power * n_samples + rest_energy
    curve, scale = np.empty(n_samples), 1.0 / max(total, TINY_POWER)
    for n in range(n_samples):
        curve[n] = (remaining[n] - remaining[n_samples] - noise_power * (n_samples - n) + rest_energy) * scale
    return curve, total


@compiled
def strongest_power(power: FloatArray, n_block: int) -> float:
    """Return the mean power of the strongest `n_block` consecutive samples."""
    energy = most = np.sum(power[:n_block])
    for n in range(n_block, len(power)):
        energy += power[n] - power[n - n_block]
        most = max(most, energy)
    return most / n_block


@compiled
def first_below(curve: FloatArray, level: float) -> int:
    """Return the first sample of a curve that is not above a level; its length if there is none."""
    for n in range(len(curve)):
        if curve[n] <= level:
            return n
    return len(curve)


@compiled
def slope_between(level_db: FloatArray, top_db: float, bottom_db: float) -> float:
    """Return the slope per sample of a regression line from one level down to another; 0 if there are no 3 samples.

    It is 0, too, if the level does not fall that far.
    """
    first, last = first_below(level_db, top_db), first_below(level_db, bottom_db)
    return slope(level_db[first:last + 1]) if last < len(level_db) and last - first >= 2 else 0.0


@compiled
def slope(level: FloatArray) -> float:
    """Return the slope per sample of a regression line."""
    n_samples = len(level)
    product = 0.0
    for n in range(n_samples):
        product += (n - 0.5 * (n_samples - 1)) * level[n]
    return product / (n_samples * (n_samples ** 2 - 1.0) / 12.0)
