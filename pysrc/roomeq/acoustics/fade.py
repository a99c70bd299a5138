"""Find the end of a response ahead of a fade-out, whose falling noise is neither noise nor decay, and of silence.

The level of a decay that meets noise falls ever more slowly: noise, a second decay and air absorption all bend it that
way. That of a fade falls ever faster, by 12 or 24 dB each time the rest of it halves (a linear or a Hann window). That
of a response that was cut off falls at once, to digital silence or to what a later conversion adds to it: dither, the
ringing and the rounding of a resampler, or a codec's noise. What a response falls to in the last bit of its samples is
no noise either: it follows the sign of the response, and so decays in one band while another holds it up.
"""

import numpy as np

from roomeq.acoustics.decay_kernels import strongest_power
from roomeq.acoustics.decibels import power_db
from roomeq.core.arrays import FloatArray
from roomeq.core.jit import compiled

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
_BLOCKS_S = (0.005, 0.01, 0.02, 0.04)  # a cut may be softened by a short fade
_N_BEFORE, _N_AFTER = 8, 4  # least number of blocks ahead of a cut and behind it
_CUT_DB = 8.0
"""Fall within two blocks, beyond what the level falls before and afterwards, from which on a response is cut off. That
of 600 measured responses is at most 4.5 dB; noise that falls by less than the 10 dB between an evaluated range and the
noise is harmless."""
_BIT_BLOCK_S = 0.02
_LAST_BIT = 0.5
"""RMS of the last bit's noise, in steps: of samples that take two neighbouring values, and of triangular dither with
the rounding that follows."""
_OVER_LAST_BIT = 2.0 ** 0.5  # 3 dB
_FEWEST_STEPS, _MOST_STEPS = 2.0 ** 4, 2.0 ** 32
"""From the lowest to the highest sample: a few pulses of equal height are not quantised, nor are floats."""


@compiled
def length_before_zeros(rir: FloatArray) -> int:
    """Return the number of samples ahead of digital silence at the end of a response; 0 if it is silent."""
    n_samples = len(rir)
    while n_samples > 0 and rir[n_samples - 1] == 0.0:
        n_samples -= 1
    return n_samples


@compiled
def _power_of_change(rir: FloatArray) -> FloatArray:
    """Return the squares of the differences between samples: these take out rumble, whose level scatters."""
    power = np.empty(max(0, len(rir) - 1))
    for n in range(len(power)):
        power[n] = (rir[n + 1] - rir[n]) ** 2
    return power


def length_before_silence(rir: FloatArray, fs_hz: float) -> int:
    """Return the number of samples ahead of the silence at the end of a response.

    Silence is digital silence, what the level of a response that was cut off falls to at once, and the last bit.

    Parameters
    ----------
    rir
        Shape (n_samples,).
    fs_hz
        Sample rate.
    """
    n_samples = length_before_zeros(rir)
    power = _power_of_change(rir[:n_samples])
    for block_s in _BLOCKS_S:
        n_block = round(block_s * fs_hz)
        n_blocks = min(n_samples, len(power)) // n_block
        if n_blocks > _N_BEFORE + _N_AFTER:
            block, fall_db = _largest_fall(power_db(power[:n_blocks * n_block].reshape(n_blocks, n_block).mean(axis=1)))
            if fall_db > _CUT_DB:
                n_samples = block * n_block
    return length_before_last_bit(rir[:n_samples], fs_hz)  # which tells the end of a cut less closely


def length_before_last_bit(rir: FloatArray, fs_hz: float) -> int:
    """Return the number of samples ahead of those in which only the last bit is left of a response.

    Above that, rounding errors are noise that does not depend on the response (Widrow and Kollar, Quantization Noise,
    2008). The step is that of the samples as they are: a resampled response shows none.

    Parameters
    ----------
    rir
        Shape (n_samples,).
    fs_hz
        Sample rate.
    """
    step = _quantisation_step(rir)
    if step == 0.0:
        return len(rir)
    values = (rir - rir[0]) / step
    blocks = np.array_split(values, max(1, len(rir) // round(_BIT_BLOCK_S * fs_hz)))
    ends = np.cumsum([len(block) for block in blocks])
    above = ends[[block.std() > _OVER_LAST_BIT * _LAST_BIT for block in blocks]]
    return int(above[-1]) if len(above) else len(rir)


@compiled
def _quantisation_step(rir: FloatArray) -> float:
    """Return the step of which all differences between samples are multiples; 0 where there is none."""
    step, lowest, highest = np.inf, np.inf, -np.inf
    for n in range(len(rir)):
        lowest, highest = min(lowest, rir[n]), max(highest, rir[n])
        difference = abs(rir[n] - rir[max(n - 1, 0)])
        if 0.0 < difference < step:
            step = difference
    if not _FEWEST_STEPS * step <= highest - lowest <= _MOST_STEPS * step:
        return 0.0
    for n in range(len(rir)):
        multiple = (rir[n] - rir[0]) / step
        if abs(multiple - np.rint(multiple)) > 0.01:
            return 0.0
    return step


@compiled
def _largest_fall(level_db: FloatArray) -> tuple[int, float]:
    """Return the block at which the level falls by most, beyond what it falls before and afterwards, and that fall.

    It falls from the least of `_N_BEFORE` blocks to the largest of all behind the block, of which there are `_N_AFTER`
    at least.
    """
    last = np.sort(level_db[-_N_AFTER:])
    end_db = 0.5 * (last[_N_AFTER // 2 - 1] + last[_N_AFTER // 2])  # the median
    after_db = np.max(level_db[-_N_AFTER:])
    block, largest_db = 0, -np.inf
    for n in range(len(level_db) - _N_AFTER - 1, _N_BEFORE - 1, -1):
        before = level_db[n - _N_BEFORE:n]
        falls_before_db = max(before[0] - before[-1], 0.0) * 2.0 / (_N_BEFORE - 1)  # within two blocks
        fall_db = before.min() - after_db - falls_before_db - (after_db - end_db)
        if fall_db >= largest_db:
            block, largest_db = n, fall_db
        after_db = max(after_db, level_db[n])
    return block, largest_db


def length_before_fade(rir: FloatArray, fs_hz: float, direct_sample: float) -> int:
    """Return the number of samples ahead of a fade-out, or of silence if the response does not end in one.

    A fade over less than about the last tenth of the response is left: it hardly changes the noise of that tenth.

    Parameters
    ----------
    rir
        Shape (n_samples,).
    fs_hz
        Sample rate.
    direct_sample
        Arrival time of the direct sound in samples.
    """
    rir, start = rir[:length_before_silence(rir, fs_hz)], max(0, round(direct_sample))
    power = _power_of_change(rir[start:])
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
    n_tenth = len(power) // 10
    first, _, _, before, last = power_db(power[len(power) - 5 * n_tenth:].reshape(5, n_tenth).mean(axis=1))
    return float((before - last) - (first - before) / 3.0)
