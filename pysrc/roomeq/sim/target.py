"""Meet a target: scale absorption until the reverberation time of the rendered response is the one asked for."""

import numpy as np

from roomeq.acoustics.decibels import FLOOR_POWER, TINY_POWER, power_db
from roomeq.acoustics.iso3382 import decay_time, energy_decay, reverberation_time
from roomeq.acoustics.octaves import octave_bands
from roomeq.core.constants import BAND_1KHZ, BANDS_HZ, EXACT_BANDS_HZ, FS_HZ
from roomeq.sim.echogram import FRAME_S

TOLERANCE = 0.05
STRAIGHT = 0.3  # how much T20 and T30 may differ
_AIM = 0.015
_MAX_RENDERINGS = 8
_EXPONENT_RANGE = (1e-3, 1e3)


def scaled_absorption(absorption, exponent):
    """Scale absorption by an exponent on what is reflected: ``1 - (1 - alpha) ** exponent``.

    All surfaces and bands keep their order, and absorption stays in [0, 1].
    """
    return 1.0 - (1.0 - np.minimum(absorption, 0.999)) ** exponent


def t30_s(rir, direct_sample):
    """T30 at 1 kHz of a noiseless response, or None where it does not decay by 35 dB."""
    try:
        time_s = reverberation_time(rir, FS_HZ, BANDS_HZ[BAND_1KHZ], "t30", direct_sample=direct_sample)
    except ValueError:
        return None
    return time_s if time_s > 0.0 else None


def decays_straight(rir, direct_sample):
    """Tell whether T20 and T30 at 1 kHz of a noiseless response are about the same.

    Where the direct sound or a few reflections hold most of the energy, T30 jumps from one value to another as
    absorption grows, and may meet a target that nobody would hear.
    """
    (band,) = octave_bands(rir, FS_HZ, [EXACT_BANDS_HZ[BAND_1KHZ]])
    curve = energy_decay(band, FS_HZ, direct_sample).edc_db
    t20_s, t30_s = (decay_time(curve, FS_HZ, decay) for decay in ("t20", "t30"))
    return t20_s is not None and t30_s is not None and abs(t20_s / t30_s - 1.0) < STRAIGHT


def solve_exponent(measure, target_s, guess=1.0):
    """Find the exponent with which a measured reverberation time meets the target.

    Parameters
    ----------
    measure : callable
        ``measure(exponent) -> T30 [s] or None``; falls as the exponent grows, but for some noise.
    target_s : float
    guess : float
        First exponent to try.

    Returns
    -------
    exponent : float
    time_s : float or None
        What was measured with it: the closest found; the caller decides whether it is close enough.
    """
    tried = []
    exponent = guess
    for _ in range(_MAX_RENDERINGS):
        time_s = measure(exponent)
        tried.append((exponent, time_s))
        if time_s is not None and abs(time_s / target_s - 1.0) < _AIM:
            break
        exponent = _next_exponent(tried, target_s)
        if not _EXPONENT_RANGE[0] <= exponent <= _EXPONENT_RANGE[1]:
            break
    measured = [(x, t) for x, t in tried if t is not None]
    if not measured:
        return guess, None
    return min(measured, key=lambda pair: abs(np.log(pair[1] / target_s)))


def _next_exponent(tried, target_s):
    """Secant in log-log, kept inside the bracket that is known."""
    known = sorted((np.log(x), np.log(t / target_s)) for x, t in tried if t is not None)
    if len(known) < len(tried) and tried[-1][1] is None:  # too long to measure: absorb more
        return tried[-1][0] * 2.0
    above = [point for point in known if point[1] > 0.0]  # too long
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


def t30_of_echogram(energy):
    """T30 of an echogram of one band by backward integration, or None where it does not decay by 35 dB.

    Parameters
    ----------
    energy : ndarray, shape (n_frames,)
    """
    decay = np.cumsum(energy[::-1])[::-1]
    decay_db = power_db(decay / max(decay[0], TINY_POWER), FLOOR_POWER)
    chosen = np.flatnonzero((decay_db <= -5.0) & (decay_db >= -35.0))
    if decay_db[-1] > -35.0 or len(chosen) < 3:
        return None
    slope_db = np.polyfit(chosen * FRAME_S, decay_db[chosen], 1)[0]
    return float(-60.0 / slope_db) if slope_db < 0.0 else None
