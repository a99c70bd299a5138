"""Find a fade-out at the end of a response, whose falling noise is neither noise nor decay.

The level of a decay that meets noise falls ever more slowly: noise, a second decay and air absorption all bend it that
way. That of a fade falls ever faster, by 12 or 24 dB each time the rest of it halves (a linear or a Hann window).
"""

import numpy as np

from roomeq.acoustics.decay_kernels import strongest_power
from roomeq.acoustics.decibels import power_db
from roomeq.core.arrays import FloatArray

_SHORTEST_PART_S = 0.02
_FADED_DB, _WHOLE_DB = 4.5, 1.0
"""Bend from which on a response ends in a fade, and that of a response without one. Linear fades over the last fifth to
half of a response bend it by 5.3 dB or more, one over its last tenth by 4.8 dB, and Hann windows by more but for the
last tenth, by 4.3 dB. None of 600 measured responses without a fade is bent by more than 2.5 dB."""
_DECAYED_DB = 80.0
"""Level below the strongest 5 ms of what no microphone records: a response that has fallen so far ahead of its last
tenth is simulated, and a fade there cannot change T30."""
_STEP = 0.95  # by which a response is shortened until no bend is left
_LEAST = 0.4  # of a response is kept


def length_before_fade(rir: FloatArray, fs_hz: float, direct_sample: float) -> int:
    """Return the number of samples ahead of a fade-out, or of the whole response if it does not end in one.

    A fade over less than about the last tenth of the response is left: it hardly changes the noise of that tenth.

    Parameters
    ----------
    rir
        Without zeros at its end, shape (n_samples,).
    fs_hz
        Sample rate.
    direct_sample
        Arrival time of the direct sound in samples.
    """
    start = max(0, round(direct_sample))
    power = np.square(np.diff(rir[start:]))  # the difference takes out rumble, whose level scatters
    n_samples = len(power)
    if n_samples < 10.0 * _SHORTEST_PART_S * fs_hz or _bend_db(power) < _FADED_DB:
        return len(rir)
    before_db = power_db(power[-(n_samples // 10 * 2):-(n_samples // 10)].mean())
    if before_db < power_db(strongest_power(power, round(0.005 * fs_hz))) - _DECAYED_DB:
        return len(rir)
    while n_samples > _LEAST * len(power) and _bend_db(power[:n_samples]) > _WHOLE_DB:
        n_samples = int(_STEP * n_samples)
    return start + n_samples


def _bend_db(power: FloatArray) -> float:
    """Return by how much more the level falls into the last tenth than from tenth to tenth of the four before."""
    edges = len(power) - len(power) // 10 * np.arange(5, -1, -1)
    first, _, _, before, last = power_db(np.array([power[a:b].mean() for a, b in zip(edges, edges[1:], strict=False)]))
    return float((before - last) - (first - before) / 3.0)
