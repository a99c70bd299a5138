"""Compiled kernels for decay curves (`roomeq.acoustics.iso3382`)."""

import numpy as np

from roomeq.core.arrays import FloatArray
from roomeq.core.jit import compiled


@compiled
def net_energy(remaining: FloatArray, noise_power: float) -> FloatArray:
    """Return the energy from each sample to the last one, less that of the noise.

    `remaining` is that of `roomeq.acoustics.noise_intersection.remaining_energy` up to and with the last one.
    """
    n_samples = len(remaining) - 1
    energy = np.empty(n_samples)
    for n in range(n_samples):
        energy[n] = remaining[n] - remaining[n_samples] - noise_power * (n_samples - n)
    return energy


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
def slope(level: FloatArray) -> float:
    """Return the slope per sample of a regression line."""
    n_samples = len(level)
    product = 0.0
    for n in range(n_samples):
        product += (n - 0.5 * (n_samples - 1)) * level[n]
    return product / (n_samples * (n_samples ** 2 - 1.0) / 12.0)
