"""The intersection of a decay with its noise floor (Lundeby et al., Acustica 81 (1995) 344)."""

from dataclasses import dataclass

import numpy as np

from roomeq.acoustics.decibels import TINY_POWER, power_db
from roomeq.core.arrays import Array, FloatArray
from roomeq.core.jit import compiled

NOISE_MARGIN_DB = 10.0
"""The noise lies at least this far below the end of an evaluated range (ISO 3382-2, 7.2)."""

_LONGEST_GAP_S = 0.2
"""Between the direct sound and the first reflection: both are far from all surfaces of a large room."""
_AFTER_GAP_DB = 20.0
"""Level of reflections above that at which a decay ends; blocks of noise don't scatter so much."""
_SLOWEST_S = 5.0
"""Decay time that only cathedrals exceed."""
_FEWEST_BLOCKS, _MOST_BLOCKS = 4, 20  # that the slope of what may be noise is fitted to
_DEVIATIONS = 2.33  # by which it must be flatter than a decay's: chance exceeds them in 1 % of cases

_db = compiled(power_db)


@dataclass(frozen=True)
class NoiseIntersection:
    """The point where a decay meets its noise floor, and what lies beyond.

    Attributes
    ----------
    sample
        Samples from the direct sound to the intersection; the length of the response if its end still decays.
    noise_power
        Mean square of what the end has beyond the decay, which counts as noise; 0 if it is smaller than the decay.
    rest_energy
        Sum of the squared response that the late decay would contribute beyond the intersection.
    is_flat
        Whether the level beyond the intersection is constant, as that of a noise floor. If not, `noise_power` may be
        the scatter of a decay that goes on to the end.
    """

    sample: int
    noise_power: float
    rest_energy: float
    is_flat: bool


def find_noise_intersection(remaining: FloatArray, fs_hz: float, bandwidth_hz: float | None = None
                            ) -> NoiseIntersection:
    """Find where a decay meets the noise floor, by Lundeby's iteration.

    The noise is the power at the end of the response less the extrapolated decay. If it is smaller than the decay
    itself, the response ends before it reaches its noise floor. If it is larger, it may still be the scatter of a decay
    that goes on to the end. The level of a noise floor is constant: it falls by significantly less than half as fast as
    the decay before, since a late decay may be slower than an early one, or than the slowest decay of a room.

    Parameters
    ----------
    remaining
        `remaining_energy` of the squared response from the direct sound on, shape (n_samples + 1,).
    fs_hz
        Sample rate.
    bandwidth_hz
        Bandwidth of the response, which tells how much its level scatters; by default half the sample rate.
    """
    return NoiseIntersection(*_meet_noise(remaining, float(fs_hz), float(bandwidth_hz or 0.5 * fs_hz)))


@compiled
def remaining_energy(response: Array) -> FloatArray:
    """Return the energy of a response from each sample to the end and, last, 0, shape (n_samples + 1,).

    The energy of any block is a difference of two of them. Summed from the end, they are exact to a rounding of what is
    left at that time, however far the response has decayed.
    """
    remaining, total = np.zeros(len(response) + 1), 0.0
    for n in range(len(response) - 1, -1, -1):
        total += np.float64(response[n]) ** 2
        remaining[n] = total
    return remaining


@compiled
def _meet_noise(remaining: FloatArray, fs_hz: float, bandwidth_hz: float) -> tuple[int, float, float, bool]:
    """Return the fields of a `NoiseIntersection` from `remaining_energy`; see `find_noise_intersection`."""
    n_samples = len(remaining) - 1
    start = int(0.9 * n_samples)
    noise = tail = remaining[start] / (n_samples - start)
    n_block, span_db, intersection = max(1, round(0.01 * fs_hz)), np.inf, n_samples
    slope_db = offset_db = 0.0
    first = last = 0
    if noise <= TINY_POWER:
        return n_samples, 0.0, 0.0, False
    for iteration in range(8):
        fitted_slope_db, fitted_offset_db, fitted_first, fitted_last = _late_decay(remaining, noise, n_block, span_db,
                                                                                   fs_hz)
        if not fitted_slope_db < 0.0:
            if iteration == 0:
                start = _where_noise_begins(remaining, tail, n_block)
                return start, tail, 0.0, _is_flat(remaining, 0, 0, start, fs_hz, bandwidth_hz)
            break  # a few blocks of a sparse tail scatter by more than it decays: the fit before holds
        slope_db, offset_db, first, last = fitted_slope_db, fitted_offset_db, fitted_first, fitted_last
        previous = intersection
        intersection = int(min(max((float(_db(noise)) - offset_db) / slope_db, 1.0), n_samples))
        start = int(min(intersection - NOISE_MARGIN_DB / slope_db, 0.9 * n_samples))
        tail = remaining[start] / (n_samples - start)
        decay = _line_energy(slope_db, offset_db, start) - _line_energy(slope_db, offset_db, n_samples)
        noise = tail - decay / (n_samples - start)
        if noise < 0.5 * tail:
            return n_samples, 0.0, _line_energy(slope_db, offset_db, n_samples), False
        n_block = int(min(max(-NOISE_MARGIN_DB / slope_db / 4, 0.002 * fs_hz), 0.05 * fs_hz))
        span_db = 20.0
        if abs(intersection - previous) < 0.002 * fs_hz:
            break
    return (intersection, noise, _line_energy(slope_db, offset_db, intersection),
            _is_flat(remaining, first, last, intersection, fs_hz, bandwidth_hz))


@compiled
def _is_flat(remaining: FloatArray, first: int, last: int, start: int, fs_hz: float, bandwidth_hz: float) -> bool:
    """Tell whether the level of a response is constant from sample `start` on, after a decay from `first` to `last`.

    It is if it falls by significantly less than the slowest decay. That of a decay would also fall on as fast as it
    fell from the middle of the part before to the middle of the rest: it is constant if it falls by significantly less
    than half as fast. `last` is 0 if no decay is seen.
    """
    n_rest = len(remaining) - 1 - start
    n_block = max(int(np.ceil(fs_hz / bandwidth_hz)), n_rest // _MOST_BLOCKS)
    level_db = _db(_block_power(remaining[start:], n_block))
    if len(level_db) < _FEWEST_BLOCKS:
        return False
    slope_db, _, variance = _line(level_db, 0, n_block, _level_variance(n_block, fs_hz, bandwidth_hz))
    if slope_db + 60.0 / (_SLOWEST_S * fs_hz) > _DEVIATIONS * np.sqrt(variance):
        return True
    if last == 0:
        return False
    distance = max(1.0, start + 0.5 * n_rest - 0.5 * (first + last))
    fall_db = float(_db((remaining[first] - remaining[last]) / (last - first))) - float(_db(remaining[start] / n_rest))
    fall_variance = _level_variance(last - first, fs_hz, bandwidth_hz) + _level_variance(n_rest, fs_hz, bandwidth_hz)
    return slope_db + 0.5 * fall_db / distance > _DEVIATIONS * np.sqrt(variance + 0.25 * fall_variance / distance ** 2)


@compiled
def _line(level_db: FloatArray, first: int, n_block: int, level_variance: float) -> tuple[float, float, float]:
    """Fit the line ``slope_db n + offset_db`` to the levels of blocks, the first of which has the number `first`.

    Returns
    -------
    slope_db, offset_db, variance
        The variance is that of the slope. Levels may scatter about the line by more than their expected variance.
    """
    centre = (np.arange(first, first + len(level_db)) + 0.5) * n_block
    mean = centre.mean()
    spread = np.sum((centre - mean) ** 2)
    slope_db = np.sum((centre - mean) * level_db) / spread
    scatter = np.sum((level_db - level_db.mean() - slope_db * (centre - mean)) ** 2) / max(1, len(level_db) - 2)
    return slope_db, level_db.mean() - slope_db * mean, max(scatter, level_variance) / spread


@compiled
def _level_variance(n_samples: int, fs_hz: float, bandwidth_hz: float) -> float:
    """Return the variance of the level of Gaussian noise [dB^2].

    In a bandwidth B and a time T, its energy is distributed as chi-squared with ``2 B T`` degrees of freedom; the
    variance of the logarithm is the trigamma function of B T, here its expansion. Of blocks shorter than 1 / B, which
    depend on each other, it is that of independent blocks whose means scatter by as much.
    """
    half_freedom = bandwidth_hz * n_samples / fs_hz
    whole = max(1.0, half_freedom)
    return (10.0 / np.log(10.0)) ** 2 * (1.0 + 0.5 / whole + 1.0 / (6.0 * whole ** 2)) / half_freedom


@compiled
def _line_energy(slope_db: float, offset_db: float, start: int) -> float:
    """Return the sum of the power of the line ``slope_db n + offset_db`` from sample `start` to infinity."""
    return 10.0 ** ((offset_db + slope_db * start) / 10.0) / (-slope_db * np.log(10.0) / 10.0)


@compiled
def _block_power(remaining: FloatArray, n_block: int) -> FloatArray:
    """Return the mean power of each whole block of `n_block` samples."""
    edges = remaining[:(len(remaining) - 1) // n_block * n_block + 1:n_block]
    return (edges[:-1] - edges[1:]) / n_block


@compiled
def _late_decay(remaining: FloatArray, noise: float, n_block: int, span_db: float, fs_hz: float
                ) -> tuple[float, float, int, int]:
    """Fit the line ``slope_db n + offset_db`` to the decay from `span_db` above the noise margin down to it.

    The loudest block, which holds the direct sound as a rule, is no part of the first line, from any level down. No
    line begins before a gap that separates the direct sound from the first reflections.

    Returns
    -------
    slope_db, offset_db, first, last
        The slope is not negative if there is no such decay. The line is fitted to samples `first` up to `last`.
    """
    level_db = _db(_block_power(remaining, n_block))
    stop = begin = 0
    for block in range(min(len(level_db), int(_LONGEST_GAP_S * fs_hz / n_block))):
        if level_db[block] > _db(noise) + 7.0 + _AFTER_GAP_DB:
            stop = block  # what lies before is the direct sound and a gap, not the end of the decay
    for block in range(stop):
        if level_db[block] < _db(noise) + 7.0:
            begin = block + 1
    while stop < len(level_db) and not level_db[stop] < _db(noise) + 7.0:
        stop += 1
    if stop < 2:
        return 0.0, 0.0, 0, 0
    last_above = 0
    for block in range(stop):
        if level_db[block] > _db(noise) + 7.0 + span_db:
            last_above = block
    loudest = begin + int(np.argmax(level_db[begin:stop]))
    start = max(loudest + (1 if np.isinf(span_db) and begin == 0 else 0), min(last_above, stop - 4))
    if stop - start < 2:
        return 0.0, 0.0, 0, 0
    slope_db, offset_db, _ = _line(level_db[start:stop], start, n_block, 0.0)
    return slope_db, offset_db, start * n_block, stop * n_block


@compiled
def _where_noise_begins(remaining: FloatArray, noise: float, n_block: int) -> int:
    """Return the intersection of a response without a decay to fit: where it first falls to the noise."""
    n_samples = len(remaining) - 1
    power = _block_power(remaining, n_block) if n_block <= n_samples else remaining[:1] - remaining[1:2]
    for block in range(len(power)):
        if power[block] < 2.0 * noise:
            return max(1, block * n_block)
    return n_samples
