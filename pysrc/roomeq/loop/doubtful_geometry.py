"""Stated lengths that the recordings contradict: units other than metres, and distances that the sound cannot have.

Both checks state the largest probability of a false alarm, or follow from physics; neither was fitted to recordings.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from roomeq.acoustics.direct import NOISE_FACTOR, quietest_rms
from roomeq.core.arrays import FloatArray
from roomeq.core.constants import FS_HZ
from roomeq.loop.arrivals import Arrivals, early_images, heard_probability, log_likelihood
from roomeq.loop.unknown_geometry import INDEPENDENT, LATENCY_SD_MS, assumed_position, declared_speed_m_s
from roomeq.records.geometry import distance_between, least_distance_between
from roomeq.records.schema import RirRow, is_timed

UNITS_M = {"feet": 0.3048, "inches": 0.0254, "centimetres": 0.01, "millimetres": 0.001}
FALSE_ALARM = 1e-4
"""Largest probability with which a room in metres is taken for one in another unit."""
COORDINATE_SD_M = 0.1
"""Of a documented coordinate: the prior of the geometry's estimate."""
DEVIATIONS = 4.9
"""Standard deviations that are exceeded with a probability of 1e-6."""
SPEED_RANGE = 0.07
"""Largest relative error of the declared speed of sound: 40 degrees."""
MOST_HIDDEN_DB = 40.0
"""By which an obstructed direct sound may lie below the response's maximum: a barrier takes 25 dB at most (ISO
9613-2:1996, 7.4), and a loudspeaker that faces away 15 dB."""

_STATED, _POSITIONS = ("room_dims_m",), ("source_pos_m", "mic_pos_m")
_WHICH = {"room_dims_m": _STATED, "positions": _POSITIONS, "all lengths": _STATED + _POSITIONS}


class Doubt(NamedTuple):
    """What does not fit about an RIR: in a fixed phrase, to be counted, and with name, value, rule and remedy."""

    phrase: str
    detail: str


OTHER_UNIT = "the reflections of the room contradict its lengths, and fit them in another unit than metres"
TOO_EARLY = "the direct sound is earlier than the positions allow"
TOO_LATE = "the direct sound is later than the positions allow"


def find_other_unit(rows: Sequence[RirRow], arrivals: Sequence[Arrivals]) -> Doubt | None:
    """Find a shoebox whose reflections fit its lengths better if these are in another unit.

    The evidence is the likelihood of the early arrivals of all RIRs (`roomeq.loop.arrivals`), with each wall heard in
    half of them. If the lengths are in metres, the ratio of another unit's likelihood to theirs exceeds ``x`` with a
    probability of ``1 / x`` at most (Markov), for each of the units tried.

    Parameters
    ----------
    rows : sequence of RirRow
        RIRs of one shoebox; x and y of source and microphone are known.
    arrivals : sequence of Arrivals
    """
    stated = _evidence(rows, arrivals, {})
    tried = {(which, unit): _evidence(rows, arrivals, dict.fromkeys(keys, factor))
             for which, keys in _WHICH.items() for unit, factor in UNITS_M.items()}
    (which, unit), best = max(tried.items(), key=lambda item: item[1])
    # more likely than the stated lengths, and than recordings in which no reflection is heard
    gain, limit = INDEPENDENT * (best - max(stated, 0.0)), math.log(len(tried) / FALSE_ALARM)
    if gain < limit:
        return None
    dims_m = ", ".join(f"{size_m:g}" for size_m in rows[0]["room_dims_m"] or ())
    return Doubt(OTHER_UNIT, f"room {rows[0]['room_id']}: room_dims_m=[{dims_m}]: the reflections of its "
                 f"{len(rows)} RIRs fit {which} in {unit} better, by a likelihood ratio of {_power_of_ten(gain)}, and "
                 f"{_power_of_ten(limit)} may be chance: state lengths in metres")


def _power_of_ten(log: float) -> str:
    return f"1e{log / math.log(10.0):.0f}"


def _evidence(rows: Sequence[RirRow], arrivals: Sequence[Arrivals], factors: dict[str, float]) -> float:
    """Return the log-likelihood of the arrivals of a room, some of whose lengths are multiplied by a factor."""
    cells, _ = early_images()
    heard = heard_probability(np.full((1, 6), 0.5))
    total = 0.0
    for row, of_rir in zip(rows, arrivals, strict=True):
        dims_m, source_m, mic_m = (assumed_position(dict(row)[key], factors.get(key, 1.0))
                                   for key in _STATED + _POSITIONS)
        if np.any(np.maximum(source_m, mic_m) > dims_m):
            return -math.inf
        total += log_likelihood(of_rir.ratio, dims_m[None], np.array([declared_speed_m_s(row)]), source_m[None],
                                mic_m[None], cells, heard)[0]
    return total


class DirectLimits(NamedTuple):
    """Between which times of a recording the direct sound arrives.

    Attributes
    ----------
    first_s : float
        The first sound that an obstacle could leave of it; 0 in a recording whose noise hides such a sound.
    strongest_s : float
        The strongest arrival, which is the direct sound or a later one; what precedes it may be distortion of a sweep.
    """

    first_s: float
    strongest_s: float


def direct_limits(rir: FloatArray) -> DirectLimits:
    """Measure the limits of the direct sound's arrival."""
    magnitude = np.abs(rir)
    threshold = magnitude.max() * 10.0 ** (-MOST_HIDDEN_DB / 20.0)
    noisy = NOISE_FACTOR * quietest_rms(rir, FS_HZ) > threshold
    return DirectLimits(0.0 if noisy else int(np.argmax(magnitude >= threshold)) / FS_HZ,
                        int(np.argmax(magnitude)) / FS_HZ)


def find_wrong_distance(row: RirRow, limits: DirectLimits, latency_s: float = 0.0) -> Doubt | None:
    """Find a direct sound that cannot come from the stated position; only where sample 0 is the emission.

    Coordinates, latency and declared speed of sound have the errors that the loop reckons with elsewhere. Where a
    height is unknown, the distance in plan is the least that there can be, so that the sound can only be too early.

    Parameters
    ----------
    row : RirRow
    limits : DirectLimits
    latency_s : float
        Known latency of the recording (`roomeq.loop.latency`).
    """
    if not is_timed(row):
        return None
    distance_m = least_distance_between(row["source_pos_m"], row["mic_pos_m"])
    speed_m_s = declared_speed_m_s(row)
    sd_m = math.hypot(math.sqrt(2.0) * COORDINATE_SD_M, 1e-3 * LATENCY_SD_MS * speed_m_s)
    slack_m = DEVIATIONS * sd_m + SPEED_RANGE * distance_m
    first_m, strongest_m = ((at_s - latency_s) * speed_m_s for at_s in limits)
    if strongest_m < distance_m - slack_m:
        return Doubt(TOO_EARLY, _wrong_distance(row, distance_m, strongest_m, slack_m))
    is_known = distance_between(row["source_pos_m"], row["mic_pos_m"]) is not None
    if is_known and first_m > distance_m + slack_m:
        return Doubt(TOO_LATE, _wrong_distance(row, distance_m, first_m, slack_m))
    return None


def _wrong_distance(row: RirRow, distance_m: float, found_m: float, slack_m: float) -> str:
    at_least = "" if distance_between(row["source_pos_m"], row["mic_pos_m"]) is not None else "at least "
    return (f"RIR {row['id']} of room {row['room_id']}: source_pos_m={row['source_pos_m']} and mic_pos_m="
            f"{row['mic_pos_m']} are {at_least}{distance_m:.2f} m apart, but the direct sound arrives after "
            f"{found_m:.2f} m, and they may differ by {slack_m:.2f} m: correct room_id, the positions or wav, or set "
            "tof_removed to null if sample 0 is not the emission")
