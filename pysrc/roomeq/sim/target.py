"""Scaling absorption until the reverberation time of the rendered response meets a target."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from roomeq.acoustics.decibels import FLOOR_POWER, TINY_POWER, power_db
from roomeq.acoustics.iso3382 import LOWEST_DB, decay_time, octave_decays
from roomeq.acoustics.octaves import octave_bands
from roomeq.core.arrays import Array, FloatArray
from roomeq.core.constants import BAND_1KHZ, EXACT_BANDS_HZ
from roomeq.sim.echogram import FRAME_S

TOLERANCE = 0.05
STRAIGHT = 0.3  # largest relative difference of T20 and T30
_AIM = 0.015
_MAX_TRIALS = 8
_EXPONENT_RANGE = (1e-3, 1e3)


class Trial(NamedTuple):
    """An exponent, and the reverberation time that was measured with it [s]."""

    exponent: float
    time_s: float


def scaled_absorption(absorption: FloatArray, exponent: float) -> FloatArray:
    """Raise the reflected share to an exponent: ``1 - (1 - alpha) ** exponent``.

    The order of surfaces and bands is kept, and absorption stays in [0, 1].
    """
    return 1.0 - (1.0 - np.minimum(absorption, 0.999)) ** exponent


def decay_times_s(rir: FloatArray, direct_sample: float, fs_hz: float, *, is_cut: bool = False
                  ) -> tuple[float | None, float | None]:
    """Return T20 and T30 at 1 kHz of a response without noise; None where it does not decay so far.

    Of a response that is cut off, what lies beyond its end is estimated.
    """
    (decay,) = octave_decays(rir, fs_hz, direct_sample, [EXACT_BANDS_HZ[BAND_1KHZ]], noiseless=not is_cut)
    curve = decay.down_to_db(LOWEST_DB)
    return decay_time(curve, fs_hz, "t20"), decay_time(curve, fs_hz, "t30")


def decays_straight(t20_s: float | None, t30_s: float | None) -> bool:
    """Tell whether T20 and T30 are about the same.

    If the direct sound or a few reflections hold most of the energy, T30 jumps between values as absorption grows, and
    may meet a target without an audible decay of that time.
    """
    return t20_s is not None and t30_s is not None and abs(t20_s / t30_s - 1.0) < STRAIGHT


def solve_exponent(measure: Callable[[float], float | None], target_s: float, guess: float = 1.0) -> Trial | None:
    """Find the exponent with which a measured reverberation time meets the target.

    Parameters
    ----------
    measure
        From an exponent to T30 [s]; except for noise, T30 falls as the exponent grows.
    target_s
    guess
        First exponent to try.

    Returns
    -------
    Trial or None
        The closest one; the caller decides whether it is close enough. None if no time could be measured.
    """
    trials: list[Trial] = []
    exponent = guess
    for _ in range(_MAX_TRIALS):
        time_s = measure(exponent)
        if time_s is None:  # too long to measure: absorb more
            exponent *= 2.0
        else:
            trials.append(Trial(exponent, time_s))
            if abs(time_s / target_s - 1.0) < _AIM:
                break
            exponent = next_exponent(trials, target_s)
        if not _EXPONENT_RANGE[0] <= exponent <= _EXPONENT_RANGE[1]:
            break
    return closest(trials, target_s)


def closest(trials: list[Trial], target_s: float) -> Trial | None:
    """Return the trial whose time is closest to the target, the first of several; None if there is none."""
    return min(trials, key=lambda trial: abs(np.log(trial.time_s / target_s)), default=None)


def bracketed(trials: list[Trial], target_s: float) -> bool:
    """Tell whether some times are longer than the target and others are not."""
    return len({trial.time_s > target_s for trial in trials}) == 2


def next_exponent(trials: list[Trial], target_s: float) -> float:
    """Take a secant step in log-log, kept inside the known bracket."""
    known = sorted((np.log(x), np.log(t / target_s)) for x, t in trials)
    above = [point for point in known if point[1] > 0.0]  # longer than the target
    below = [point for point in known if point[1] <= 0.0]
    if above and below:
        low, high = max(above), min(below)
        step = low[0] + (high[0] - low[0]) * float(np.clip(low[1] / (low[1] - high[1]), 0.1, 0.9))
        return float(np.exp(step))
    x, error = max(known) if above else min(known)
    slope = -1.0
    if len(known) > 1:
        (x0, e0), (x1, e1) = known[-2:] if above else known[:2]
        slope = min(-0.3, (e1 - e0) / (x1 - x0)) if x1 > x0 else -1.0
    return float(np.exp(x - 1.1 * error / slope))


def noise_per_frame(noise: Array, n_frames: int, fs_hz: float) -> FloatArray:
    """Return the power of a tail's noise in the octave at 1 kHz, relative to its mean, shape (n_frames,)."""
    (band,) = octave_bands(noise, fs_hz, [EXACT_BANDS_HZ[BAND_1KHZ]])
    edges = np.round(np.arange(n_frames) * FRAME_S * fs_hz).astype(int)
    power = np.add.reduceat(np.square(band), np.minimum(edges, len(band) - 1))
    return power / power.mean()


def t30_of_echogram(energy: FloatArray) -> float | None:
    """Return T30 of an echogram of one band, shape (n_frames,), or None if it does not decay by 35 dB."""
    return fitted_time_s(np.cumsum(energy[::-1])[::-1], np.arange(len(energy)) * FRAME_S)


def fitted_time_s(left: Array, time_s: Array) -> float | None:
    """Return T30 of the energy that is left after some times, shape (n,) both, or None if it does not fall by 35 dB."""
    left_db = power_db(left / max(left[0], TINY_POWER), FLOOR_POWER)
    chosen = np.flatnonzero((left_db <= -5.0) & (left_db >= -35.0))
    if left_db[-1] > -35.0 or len(chosen) < 3:
        return None
    slope_db = np.polyfit(time_s[chosen], left_db[chosen], 1)[0]
    return float(-60.0 / slope_db) if slope_db < 0.0 else None
