"""Timing: medians of repeats, the first call apart."""

import gc
import time

import numpy as np


def repeated(work, repeats):
    """Time `work` once for the first call (compilation, caches), then `repeats` times.

    Parameters
    ----------
    work : callable
        ``work(n)`` with n = 0 for the first call; n may seed it.
    repeats : int

    Returns
    -------
    median_s, spread_s, first_s : float
        Spread: half the range between the quartiles.
    """
    times = []
    for n in range(repeats + 1):
        gc.collect()
        start = time.perf_counter()
        work(n)
        times.append(time.perf_counter() - start)
    low, median, high = np.percentile(times[1:], [25, 50, 75])
    return float(median), float(0.5 * (high - low)), times[0]
