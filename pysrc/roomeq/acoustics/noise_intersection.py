"""The intersection of a decay with its noise floor (Lundeby et al., Acustica 81 (1995) 344)."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from roomeq.acoustics.decibels import TINY_POWER, power_db
from roomeq.core.arrays import Array, FloatArray

NOISE_MARGIN_DB = 10.0
"""The noise lies at least this far below the end of an evaluated range (ISO 3382-2, 7.2)."""


class DecayLine(NamedTuple):
    """Regression line of a decay, in samples from the direct sound: ``slope_db n + offset_db``."""

    slope_db: float
    offset_db: float

    def energy(self, start: int, stop: int | None = None) -> float:
        """Return the sum of the line's power over samples `start` to `stop`, or to infinity."""
        rate = -self.slope_db * np.log(10.0) / 10.0
        energy = 10.0 ** ((self.offset_db + self.slope_db * start) / 10.0) / rate
        return energy if stop is None else energy * -np.expm1(-rate * (stop - start))


@dataclass(frozen=True)
class NoiseIntersection:
    """The point where a decay meets its noise floor, and what lies beyond.

    Attributes
    ----------
    sample
        Samples from the direct sound to the intersection; the length of the response if its end still decays.
    noise_power
        Mean square of the noise; 0 if no floor is seen.
    rest_energy
        Sum of the squared response that the late decay would contribute beyond the intersection.
    """

    sample: int
    noise_power: float
    rest_energy: float


def dot(first: Array, second: Array) -> float:
    """Return an inner product without BLAS, whose threads wait for each other longer than so little work takes."""
    return float(np.einsum("i,i->", first, second))


def find_noise_intersection(power: FloatArray, fs_hz: float) -> NoiseIntersection:
    """Find where a decay meets the noise floor, by Lundeby's iteration.

    The noise is the power at the end of the response less the extrapolated decay. If it is smaller than the decay
    itself, the response ends before it reaches its noise floor.

    Parameters
    ----------
    power
        Squared response from the direct sound on, shape (n_samples,).
    fs_hz
        Sample rate.

    Returns
    -------
    NoiseIntersection
    """
    n_samples = len(power)
    noise = tail = float(np.mean(power[int(0.9 * n_samples):]))
    n_block, span_db, intersection = max(1, round(0.01 * fs_hz)), np.inf, n_samples
    if noise <= TINY_POWER:
        return NoiseIntersection(n_samples, 0.0, 0.0)
    for _ in range(8):
        line = _late_decay(power, noise, n_block, span_db)
        if line is None:
            return _where_noise_begins(power, tail, n_block)
        slope_db, offset_db = line
        previous, intersection = intersection, int(np.clip((power_db(noise) - offset_db) / slope_db, 1, n_samples))
        start = int(min(intersection - NOISE_MARGIN_DB / slope_db, 0.9 * n_samples))
        tail = float(np.mean(power[start:]))
        noise = tail - line.energy(start, n_samples) / (n_samples - start)
        if noise < 0.5 * tail:
            return NoiseIntersection(n_samples, 0.0, line.energy(n_samples))
        n_block = int(np.clip(-NOISE_MARGIN_DB / slope_db / 4, 0.002 * fs_hz, 0.05 * fs_hz))
        span_db = 20.0
        if abs(intersection - previous) < 0.002 * fs_hz:
            break
    assert line is not None
    return NoiseIntersection(intersection, noise, line.energy(intersection))


def _late_decay(power: FloatArray, noise: float, n_block: int, span_db: float) -> DecayLine | None:
    """Fit a line to the decay from `span_db` above the noise margin down to it; None if there is no such decay."""
    n_blocks = len(power) // n_block
    level_db = power_db(np.mean(power[:n_blocks * n_block].reshape(n_blocks, n_block), axis=1))
    below = np.flatnonzero(level_db < power_db(noise) + 7.0)
    stop = int(below[0]) if len(below) else n_blocks
    if stop < 2:
        return None
    start = int(np.argmax(level_db[:stop]))
    above = np.flatnonzero(level_db[:stop] > power_db(noise) + 7.0 + span_db)
    start = max(start, min(int(above[-1]) if len(above) else 0, stop - 4))
    if stop - start < 2:
        return None
    centre = (np.arange(start, stop) + 0.5) * n_block
    mean, level_db = centre.mean(), level_db[start:stop]
    slope_db = dot(centre - mean, level_db) / dot(centre - mean, centre - mean)
    offset_db = level_db.mean() - slope_db * mean
    return DecayLine(slope_db, offset_db) if slope_db < 0.0 else None


def _where_noise_begins(power: FloatArray, noise: float, n_block: int) -> NoiseIntersection:
    """Return the intersection of a response without a decay to fit: where it first falls to the noise."""
    n_blocks = len(power) // n_block
    level = np.mean(power[:n_blocks * n_block].reshape(n_blocks, n_block), axis=1) if n_blocks else power[:1]
    below = np.flatnonzero(level < 2.0 * noise)
    return NoiseIntersection(max(1, int(below[0]) * n_block) if len(below) else len(power), noise, 0.0)
