"""Arrival times of early reflections: how likely a measured RIR is under a geometry.

A reflection is heard where the envelope of the RIR above 1 kHz, relative to its local mean, ranks high among all times
of the early part. A rank is uniformly distributed where there is no reflection, so that the likelihood ratio of a
geometry needs no model of noise, loudspeaker or decay, and has mean one under a wrong geometry. Times are relative to
the direct sound: the latency of the measurement does not matter. They follow from the image sources of a shoebox (Allen
and Berkley, J. Acoust. Soc. Am. 65 (1979) 943), up to two reflections.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.fft import ifft, next_fast_len, rfft
from scipy.ndimage import gaussian_filter1d

from roomeq.acoustics.direct import find_direct
from roomeq.acoustics.high_pass import high_pass
from roomeq.core.arrays import FloatArray, IntArray
from roomeq.core.constants import FS_HZ
from roomeq.core.jit import compiled
from roomeq.sim.images import image_lattice

ORDER = 2
LOWEST_HZ = 1000.0
DEAD_S = 1e-3
"""After the direct sound, whose own decay hides what arrives."""
LENGTH_S = 0.045
LOCAL_MEAN_S = 8e-3
"""Width of the window in which the local mean is taken."""
SHARPNESS = 12.0
"""Of the ranks u of heard reflections, which have the density ``SHARPNESS u^(SHARPNESS - 1)``."""
TIMING_SD_S = 0.1e-3
"""Of an arrival around its prediction: positions known to 2 cm, and the onset of a loudspeaker."""

_N_DEAD, _N_TIMES = round(DEAD_S * FS_HZ), round(LENGTH_S * FS_HZ)
_MERGE = 3  # samples: arrivals closer than this are one


class Arrivals(NamedTuple):
    """What an RIR says about arrivals.

    Attributes
    ----------
    direct_s : float
        Time of the direct sound.
    ratio : ndarray, shape (n_times,)
        Likelihood ratio of a reflection being heard to none, per sample after the direct sound; 1 where unknown.
    """

    direct_s: float
    ratio: FloatArray


def measure_arrivals(rir: FloatArray, expected_sample: float | None = None) -> Arrivals:
    """Measure the arrivals of an RIR.

    Parameters
    ----------
    rir : ndarray, shape (n_samples,)
        At `FS_HZ`.
    expected_sample : float, optional
        Where the direct sound is looked for (`roomeq.acoustics.direct.find_direct`).

    Raises
    ------
    ValueError
        The RIR has no direct sound.
    """
    try:
        direct = find_direct(rir, FS_HZ, expected_sample).sample
    except ValueError:  # an obstacle hides it: times relative to it are unknown
        if expected_sample is None:
            raise
        find_direct(rir, FS_HZ)  # raises if there is no sound at all
        return Arrivals(expected_sample / FS_HZ, np.ones(_N_TIMES))
    # a fraction of a sample would blur less than TIMING_SD_S does
    return Arrivals(direct / FS_HZ, _likelihood_ratio(rir, round(direct)))


def _likelihood_ratio(rir: FloatArray, direct: int) -> FloatArray:
    power = np.convolve(_squared_envelope(rir[max(0, direct - _N_TIMES):direct + 2 * _N_TIMES]), [0.25, 0.5, 0.25],
                        mode="same")
    level = np.log(power[min(direct, _N_TIMES):][:_N_TIMES] + 1e-30)
    ratio = np.ones(_N_TIMES)
    if len(level) <= 2 * _N_DEAD:
        return ratio
    known = np.arange(len(level)) >= _N_DEAD
    window = np.hanning(2 * round(0.5 * LOCAL_MEAN_S * FS_HZ) + 3)[1:-1]
    mean = np.convolve(level * known, window)[len(window) // 2:][:len(level)]
    weight = np.convolve(known, window)[len(window) // 2:][:len(level)]
    contrast = (level - mean / np.maximum(weight, 1e-9))[_N_DEAD:]
    rank = (np.argsort(np.argsort(contrast, kind="stable"), kind="stable") + 0.5) / len(contrast)
    heard = SHARPNESS * rank ** (SHARPNESS - 1.0)
    ratio[_N_DEAD:len(level)] = gaussian_filter1d(heard, TIMING_SD_S * FS_HZ, mode="nearest")
    return ratio


def _squared_envelope(part: FloatArray) -> FloatArray:
    """Return the squared magnitude of the analytic signal of what is above `LOWEST_HZ`, shape of `part`."""
    n_fft = next_fast_len(len(part) + _N_DEAD)  # nothing rings for longer
    above: FloatArray = 2.0 * _high_pass(n_fft) * rfft(part, n_fft)
    return np.abs(ifft(above, n_fft)[:len(part)]) ** 2  # without negative frequencies


@cache
def _high_pass(n_fft: int) -> FloatArray:
    """Return the gain of a high-pass at `LOWEST_HZ` that runs forwards and backwards, shape (n_fft // 2 + 1,)."""
    return np.asarray(np.abs(high_pass(n_fft, FS_HZ, LOWEST_HZ)) ** 2)


@cache
def early_images() -> tuple[IntArray, FloatArray]:
    """Return the cells of the image sources of up to `ORDER` reflections, shape (n_images, 3), fewest first.

    And the number of reflections of each at the six walls, shape (n_images, 6).
    """
    cells, counts = image_lattice(ORDER)
    order = np.abs(cells).sum(axis=1)
    reflected = np.argsort(order, kind="stable")[1:]
    return np.ascontiguousarray(cells[reflected]), np.ascontiguousarray(counts[reflected], dtype=float)


def heard_probability(of_walls: FloatArray) -> FloatArray:
    """Return the probability that each early image is heard, the product of its walls', shape (n_points, n_images).

    Parameters
    ----------
    of_walls : ndarray, shape (n_points, 6)
        Probability that a reflection at each wall is heard, above 0.
    """
    return np.exp(np.log(of_walls) @ early_images()[1].T)


@compiled
def log_likelihood(ratio: FloatArray, dims_m: FloatArray, speed_m_s: FloatArray, source_m: FloatArray,
                   mic_m: FloatArray, cells: IntArray, probability: FloatArray) -> FloatArray:
    """Return the log-likelihood ratio of an RIR under each of some geometries to one without reflections.

    Parameters
    ----------
    ratio : ndarray, shape (n_times,)
        See `Arrivals`.
    dims_m, source_m, mic_m : ndarray, shape (n_points, 3)
        Room, source and microphone.
    speed_m_s : ndarray, shape (n_points,)
    cells : ndarray, shape (n_images, 3)
        See `early_images`.
    probability : ndarray, shape (n_points, n_images)
        See `heard_probability`.

    Returns
    -------
    ndarray, shape (n_points,)
    """
    n_points, n_times = len(speed_m_s), len(ratio)
    result = np.empty(n_points)
    taken = np.full(n_times // _MERGE + 2, -1)
    square = np.empty((3, 2 * ORDER + 1))
    for point in range(n_points):
        direct_m = 0.0
        for axis in range(3):
            size, source, mic = dims_m[point, axis], source_m[point, axis], mic_m[point, axis]
            direct_m += (source - mic) ** 2
            for cell in range(-ORDER, ORDER + 1):
                square[axis, cell + ORDER] = (cell * size + (source if cell % 2 == 0 else size - source) - mic) ** 2
        direct_m = np.sqrt(direct_m)
        samples_per_m = FS_HZ / speed_m_s[point]
        product = 1.0
        for image in range(len(cells)):
            path_m = np.sqrt(square[0, cells[image, 0] + ORDER] + square[1, cells[image, 1] + ORDER]
                             + square[2, cells[image, 2] + ORDER])
            sample = (path_m - direct_m) * samples_per_m
            first = int(sample)
            if first < 0 or first + 1 >= n_times or taken[first // _MERGE] == point:
                continue
            taken[first // _MERGE] = point  # arrivals that coincide count once, as the one of fewest reflections
            part = sample - first
            here = ratio[first] * (1.0 - part) + ratio[first + 1] * part
            product *= 1.0 + probability[point, image] * (here - 1.0)
        result[point] = np.log(product)
    return result
