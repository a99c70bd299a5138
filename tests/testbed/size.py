"""How large an effect is, in just noticeable differences."""

import numpy as np

from roomeq.acoustics.iso3382 import all_metrics
from roomeq.acoustics.octaves import octave_bands
from testbed.draws import C0, FS_HZ

TOUCHED_JND = 0.25  # a smaller change doesn't count as one
FLOOR_DB = -55.0  # an octave's noise below it, in 5 ms and relative to the whole response, is nobody's concern
FRAME_S = 5e-3
NOISE_SAMPLES = 1600  # at the end of the response
DIRECT_S = 2.5e-3
DIRECT_FROM = 3  # first octave (500 Hz) that the direct sound can be told in
AHEAD_S = (20e-3, 2.5e-3)  # part ahead of the direct sound, and of a sinc's tail
JND = dict(eq=1.0, edt=0.05, t20=0.05, t30=0.05, c50=1.1, drr=2.0, direct=1.0, arrival=1e-4, floor=1.0, ahead=1.0)
"""EQ, C50, DRR and levels in dB, decay times relative, arrival in seconds."""


def cells(rir, field):
    """Measure one response.

    Returns
    -------
    dict
        Per name of `JND` an array over octaves (one value for `drr` and `arrival`), NaN where it can't be told; and
        `total`, the level of the whole response [dB].
    """
    expected = field.images.length_m[0] / C0 * FS_HZ
    try:
        measured, heard = all_metrics(rir, FS_HZ, expected), True
    except ValueError:  # drowned behind an obstacle
        measured, heard = all_metrics(rir, FS_HZ, expected, 1), False
    power = octave_bands(rir, FS_HZ) ** 2
    start = measured["direct_sample"]
    noise = power[:, -NOISE_SAMPLES:].mean(axis=1)
    knees = np.minimum(start + np.array(measured["band_noise_intersection_s"]) * FS_HZ, len(rir))
    inside = np.arange(len(rir)) < knees[:, None]
    signal = np.sum(power * inside, axis=1) - noise * inside.sum(axis=1)
    direct = _between(power, start - DIRECT_S * FS_HZ, start + DIRECT_S * FS_HZ)
    direct[:DIRECT_FROM] = np.nan  # where an octave filter rings as long itself
    # cut out before it is filtered, so that filters bring no direct sound into it
    first, last = (max(0, round(start - s * FS_HZ)) for s in AHEAD_S)
    ahead = np.sum(octave_bands(np.pad(rir[first:last], 512), FS_HZ) ** 2, axis=1)
    result = dict(eq=_db(signal) - _db(signal[4]), direct=_db(direct),
                  arrival=np.array([start / FS_HZ if heard else np.nan]),
                  floor=_db(noise * FRAME_S * FS_HZ), ahead=_db(ahead), total=_db(signal.sum()),
                  drr=_numbers([measured["drr_db"]]))
    for name in ("edt", "t20", "t30"):
        result[name] = np.where(measured[f"{name}_valid"], _numbers(measured[f"{name}_s"]), np.nan)
    result["c50"] = np.where(measured["c50_valid"], _numbers(measured["c50_db"]), np.nan)
    return result


def changes(clean, changed):
    """Change of every cell from one list of measured responses to another, in JND.

    Returns
    -------
    dict of ndarray, shape (n_rirs, n)
        NaN where one of the two can't be told.
    """
    result = {}
    for name, unit in JND.items():
        a, b = np.array([one[name] for one in clean]), np.array([one[name] for one in changed])
        if name in ("floor", "ahead"):
            lowest = FLOOR_DB + np.array([one["total"] for one in clean])[:, None]
            a, b = np.maximum(a, lowest), np.maximum(b, lowest)
        if name in ("edt", "t20", "t30"):
            b = b / a
            a = np.ones_like(b)
        result[name] = (b - a) / unit
    return result


def mean_size(found, only=tuple(JND)):
    """Mean absolute change over the cells that are touched; 0 where none is [JND]."""
    sizes = np.abs(np.concatenate([found[name].ravel() for name in only]))
    touched = sizes[sizes > TOUCHED_JND]
    return float(touched.mean()) if len(touched) else 0.0


def summary(found):
    """Per metric and octave: share of cells touched and their mean absolute size [JND]."""
    result = {}
    for name, values in found.items():
        sizes = np.abs(values)
        with np.errstate(invalid="ignore"):
            touched = sizes > TOUCHED_JND
        count = touched.sum(axis=0)
        mean = np.where(touched, sizes, 0.0).sum(axis=0) / np.maximum(count, 1)
        result[name] = dict(touched=[round(float(x), 3) for x in count / len(values)],
                            mean_jnd=[round(float(x), 3) for x in mean])
    return result


def _between(power, first, last):
    return power[:, max(0, round(first)):max(0, round(last))].sum(axis=1)


def _numbers(values):
    return np.array(values, dtype=float)  # None becomes NaN


def _db(power):
    return 10.0 * np.log10(np.maximum(power, 1e-20))
