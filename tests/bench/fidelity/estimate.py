"""Decay times, from energy curves and impulse responses alike, by one piece of code."""

import numpy as np


def decay_time_s(power, step_s, *, top_db=-5.0, bottom_db=-25.0):
    """Reverberation time from the backward-integrated power (ISO 3382-1, 5.3.3), in seconds for 60 dB.

    Parameters
    ----------
    power : ndarray, shape (n,)
        Squared impulse response from the direct sound on, or energy left in the room.
    step_s : float
    top_db, bottom_db : float
        Fitting range, relative to the whole.

    Returns
    -------
    time_s : float
        Minus 60 dB over the slope of the regression line; NaN where the curve doesn't reach `bottom_db`.
    """
    left = np.cumsum(np.asarray(power, dtype=float)[::-1])[::-1]
    level_db = 10.0 * np.log10(np.maximum(left / left[0], 1e-30))
    first, last = np.searchsorted(-level_db, [-top_db, -bottom_db])
    if last >= len(level_db) or last - first < 3:
        return float("nan")
    time_s = np.arange(first, last) * step_s
    return -60.0 / float(np.polyfit(time_s, level_db[first:last], 1)[0])


def rir_decay_time_s(rir, fs_hz, direct_sample, **ranges):
    """`decay_time_s` of an impulse response from its direct sound on.

    Parameters
    ----------
    rir : ndarray, shape (n_samples,)
    fs_hz : float
    direct_sample : float
    """
    first = max(0, int(np.floor(direct_sample)) - 8)  # the direct sound's interpolation kernel starts before it
    return decay_time_s(np.asarray(rir, dtype=float)[first:] ** 2, 1.0 / fs_hz, **ranges)
