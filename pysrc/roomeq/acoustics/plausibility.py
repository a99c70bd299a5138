"""Tell by its acoustics whether a recording is a room impulse response at all.

A response is silent, rises at once, and decays: no effect precedes its cause, and a room only absorbs. A band-limited
response touches its largest magnitude once. What breaks one of these is no RIR, whatever the corpus calls it. The
limits follow from that, from ISO 3382 or from a stated probability, not from recordings.

What cannot be seen: clipping that flattens one or two samples, a cut through the pause between the direct sound
and a reflection, and a mistake in the gain.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from roomeq.acoustics.decibels import TINY_POWER, power_db
from roomeq.acoustics.direct import CLIMB_S, NOISE_FACTOR, ONSET_FRACTION, find_direct, quietest_rms
from roomeq.acoustics.iso3382 import DIRECT_S
from roomeq.core.arrays import FloatArray

CHANCE = 1e-6
"""Probability up to which an event is not put down to chance."""
_PLATEAU = 2.0 ** -15  # a step of 16-bit samples at full scale: they are clipped at -32768 and 32767
_HALF_POWER = 0.5 ** 0.5
_SHORT_FRAME_S = 0.005
_FRAME_S = 0.05  # the average of a band of 1 kHz varies by 0.6 dB over such a frame
EARLY_DECAY_DB = 10.0
"""Fall that every RIR shows: the evaluation range of the EDT, the shortest of ISO 3382-1."""
SWELL_DB = 6.0
"""Rise, ten times the 0.6 dB by which a frame varies, that a decay cannot show after it has fallen."""
LONGEST_T60_S = 10.0
"""Reverberation time of a large cathedral; what decays more slowly is no room."""
SUSTAINED_RATIO = 3.0
"""An exponential decay takes as long for its first 10 dB as for the next; a sound that is held and stops does not."""
_LOCAL_S = 0.02
DENSE_CREST = 4.5
"""Peak over RMS that 20 ms of Gaussian noise, which late reverberation is, exceed once in 500 times."""
OFFSET_SHARE = 0.05
"""Energy of a constant offset, relative to the rest, from which on it is more than rounding."""
_OFFSET_S = 0.2
_NO_RISE_SAMPLES = 4
"""A start is no onset if these first samples are as loud as the response already."""


def find_implausibility(rir: ArrayLike, fs_hz: float) -> str | None:
    """Return why a recording cannot be an RIR, or None.

    Parameters
    ----------
    rir
        Recording of any scale, shape (n_samples,).
    fs_hz
        Sample rate.

    Returns
    -------
    str or None
        The kind of damage, a colon, the value and the rule.
    """
    try:
        find_direct(rir, fs_hz)
    except ValueError as error:
        return f"no direct sound: {error}"
    h = np.asarray(rir, dtype=np.float64)
    sounding = np.flatnonzero(h)
    h = h[sounding[0]:sounding[-1] + 1]  # digital silence before and after is padding
    h = h / np.max(np.abs(h))
    return (_with_offset(h, fs_hz) or _clipped(h) or _not_decaying(h, fs_hz) or _reversed(h, fs_hz)
            or _without_onset(h, fs_hz))


def _with_offset(h: FloatArray, fs_hz: float) -> str | None:
    """Find a constant offset: the means of the last quarters of the recording agree, and hold much of its energy."""
    if len(h) < _OFFSET_S * fs_hz:
        return None
    means = np.array([part.mean() for part in np.array_split(h[len(h) // 2:], 4)])
    offset = means.mean()
    share = offset ** 2 * len(h) / np.sum((h - offset) ** 2)
    if share < OFFSET_SHARE or np.any(np.abs(means - offset) > 0.5 * abs(offset)):
        return None
    return (f"offset: a constant holds {share:.0%} of the energy of the rest, and a room passes no constant on: "
            f"subtract the mean of the recording's end, {100.0 * offset:.2g} % of the peak")


def _clipped(h: FloatArray) -> str | None:
    """Find a plateau: more samples at the peak than a density of magnitudes that falls towards it would put there.

    Two samples are expected there, the peak and its mirror image where it lies between two samples. Each of the others
    within 3 dB of the peak stands there with a probability of at most the plateau's share of these 3 dB. A plateau is
    as wide as the samples' resolution; or, for 16-bit samples that were scaled, as theirs.
    """
    magnitude = np.unique(np.abs(h))
    resolution = float(np.diff(magnitude).min(initial=1.0))
    near = np.abs(h)[np.abs(h) > _HALF_POWER]
    for width in (resolution, max(resolution, _PLATEAU)):
        at_peak, share = int(np.sum(near > 1.0 - 1.5 * width)), min(1.0, 2.0 * width / (1.0 - _HALF_POWER))
        extra = at_peak - 2
        if extra > 0 and _log_binomial(len(near) - 2, extra) + extra * math.log(share) < math.log(CHANCE):
            return (f"clipped: {at_peak} of the {len(near)} samples within 3 dB of the peak stand at the peak itself, "
                    "where a response has one or two: record it at a lower level")
    return None


def _log_binomial(n: int, k: int) -> float:
    """Return the logarithm of the number of ways to choose `k` of `n`."""
    return math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)


def _not_decaying(h: FloatArray, fs_hz: float) -> str | None:
    """Find a level that does not fall, rises again, or is held."""
    n_frame = round(_FRAME_S * fs_hz)
    h = h[int(np.argmax(np.abs(h) >= ONSET_FRACTION)):]
    n_frames = len(h) // n_frame
    if n_frames < 3:
        return None
    level_db = _levels_db(h, n_frame)
    needed_db = min(EARLY_DECAY_DB, 60.0 * n_frames * _FRAME_S / LONGEST_T60_S)
    floor_db = float(np.percentile(level_db, 10))
    fall_db = float(level_db.max()) - floor_db
    if fall_db < needed_db and -floor_db < 20.0 * math.log10(2.0 * NOISE_FACTOR):  # modulation doubles noise at most
        return (f"no decay: its level falls by {fall_db:.1f} dB, and an RIR of {len(h) / fs_hz:.2f} s by "
                f"{needed_db:.1f} dB or more: record it again")
    after_db = level_db[int(np.argmax(level_db)):] - level_db.max()
    rise_db = after_db - np.minimum.accumulate(after_db)
    swells = np.flatnonzero((rise_db > SWELL_DB) & (after_db > -EARLY_DECAY_DB))
    if len(swells):
        at = int(swells[0])
        return (f"modulated: its level rises again by {rise_db[at]:.1f} dB, {at * _FRAME_S:.2f} s after its maximum, "
                f"and the level of a room may rise by {SWELL_DB:g} dB at most: record it again")
    first_s, both_s = (_FRAME_S * _first(after_db < fall) for fall in (-EARLY_DECAY_DB, -2.0 * EARLY_DECAY_DB))
    # each time is known to a frame
    if both_s < _FRAME_S * len(after_db) and first_s - _FRAME_S > SUSTAINED_RATIO * (both_s - first_s + _FRAME_S):
        return (f"held: its level takes {first_s:.2f} s for the first 10 dB and {both_s - first_s:.2f} s for the next, "
                "which are alike in a room: give the response, not the excitation")
    return None


def _levels_db(h: FloatArray, n_frame: int) -> FloatArray:
    """Return the level of each whole frame."""
    n_frames = len(h) // n_frame
    return power_db(np.mean(h[:n_frames * n_frame].reshape(n_frames, n_frame) ** 2, axis=1))


def _first(found: FloatArray) -> int:
    """Return the first index that holds, or the length."""
    return int(np.argmax(found)) if np.any(found) else len(found)


def _reversed(h: FloatArray, fs_hz: float) -> str | None:
    """Find a response whose energy comes before its strongest arrival, not after.

    Only what is within 30 dB of the loudest 5 ms and 10 dB above the noise counts, without the arrival itself.
    """
    n_frame = max(1, round(_SHORT_FRAME_S * fs_hz))
    n_used = len(h) // n_frame * n_frame
    noise = quietest_rms(h, fs_hz) ** 2
    power = h[:n_used] ** 2
    frames = power.reshape(-1, n_frame).mean(axis=1)
    if not len(frames):
        return None
    loud = np.repeat(frames > max(10.0 * noise, 1e-3 * frames.max()), n_frame)
    time_s = (np.arange(n_used) - int(np.argmax(np.abs(h)))) / fs_hz
    power = np.where(loud & (np.abs(time_s) > DIRECT_S), power, 0.0)
    if power.sum() < 1e-3 * np.sum(h ** 2):  # a loop-back: nothing but its direct sound
        return None
    mean_s = float(np.sum(power * time_s) / max(power.sum(), TINY_POWER))
    if mean_s > -DIRECT_S:
        return None
    return (f"time-reversed: its energy arrives {-1e3 * mean_s:.1f} ms before its strongest arrival on average, and "
            "that of a room after it: reverse it again")


def _without_onset(h: FloatArray, fs_hz: float) -> str | None:
    """Find a recording that starts within the response.

    It is loud from the start (within 20 dB of the maximum, ISO 3382-1:2009, 5.3.3), and no direct sound stands out
    there from what follows. Either there is no rise of 20 dB to the first arrival, or the first 20 ms are as dense as
    late reverberation, whose samples are Gaussian.
    """
    magnitude = np.abs(h)
    n_first, n_local = max(1, round(CLIMB_S * fs_hz)), round(_LOCAL_S * fs_hz)
    local, start = h[:n_first + n_local], magnitude[:_NO_RISE_SAMPLES].max()
    if start < NOISE_FACTOR * quietest_rms(h, fs_hz) or len(local) < n_first + n_local or start < ONSET_FRACTION:
        return None
    first, rest_rms = magnitude[:n_first].max(), float(np.sqrt(np.mean(local[n_first:] ** 2)))
    if first > DENSE_CREST * rest_rms:
        return None
    crest = float(np.max(np.abs(local)) / np.sqrt(np.mean(local ** 2)))
    if magnitude[0] < ONSET_FRACTION * first and crest > DENSE_CREST:
        return None
    return (f"no onset: it starts {-20.0 * math.log10(start):.0f} dB below its maximum, "
            f"and no direct sound stands out there: its first arrival is {first / rest_rms:.1f} times the RMS of the "
            f"next 20 ms, and {DENSE_CREST:g} times or more were seen: cut it before the direct sound")
