"""Recordings that cannot be of the room that their rows state: another room's decay, or a copy of another recording."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import chi2

from roomeq.core.arrays import FloatArray
from roomeq.core.constants import EXACT_BANDS_HZ
from roomeq.loop.doubtful_geometry import Doubt
from roomeq.loop.same_recordings import SAME, find_same
from roomeq.records.geometry import place_key

FALSE_ALARM = 1e-6
"""Probability with which an RIR of a diffuse room is taken for another room's."""
USUAL_SPREAD = 0.05
"""Of T20 in a room whose field is not diffuse: its just noticeable difference (ISO 3382-1)."""
FEWEST_RIRS = 5
"""Of a room, of different places, so that one of another room does not determine the median."""
OTHER_DECAY = "the decay is not that of the other RIRs of its room, but that of another room"
COPY = "the recording is that of another room as well"
COPY_IN_ROOM = "the recording is that of another RIR of its room as well"

_FIRST_OCTAVE = 2  # below 250 Hz, single modes determine the decay
_HZ = np.array(EXACT_BANDS_HZ)[_FIRST_OCTAVE:]
_OCTAVE = 2.0 ** 0.5 - 2.0 ** -0.5  # bandwidth over centre frequency
_STATED = ("room_dims_m", "mesh", "source_pos_m", "mic_pos_m", "source_dir")


def find_other_decays(rows: Sequence[Mapping[str, Any]], log_t20: FloatArray) -> list[Doubt | None]:
    """Find RIRs whose decay times are not those of their room, but those of another.

    T20 scatters within a room by ``0.88 sqrt((1 + 1.9 / n) / (B T))`` of itself, with n = 10 for an integrated impulse
    response (ISO 3382-2:2008, annex A; Davy, J. Sound Vib. 70 (1980)), or by more where the median absolute deviation
    in the room says so, and by `USUAL_SPREAD` in addition. The sum of squares over the octaves then follows a
    chi-squared distribution.

    Parameters
    ----------
    rows : sequence of mapping
        Rows of all rooms.
    log_t20 : ndarray, shape (n_rirs, 8)
        Logarithm of T20 [s] per octave, NaN where it is not valid.

    Returns
    -------
    list of Doubt or None
        For each RIR; None in rooms of fewer than `FEWEST_RIRS`.
    """
    doubts: list[Doubt | None] = [None] * len(rows)
    log_t20 = log_t20[:, _FIRST_OCTAVE:]
    rooms = {}
    for room_id in sorted({row["room_id"] for row in rows}):
        members = np.flatnonzero([row["room_id"] == room_id for row in rows])
        told = members[np.isfinite(log_t20[members]).any(axis=1)]
        if len({place_key(rows[n]) for n in told}) >= FEWEST_RIRS:
            rooms[room_id] = members, *_usual_decay(log_t20[members])
    for room_id, (members, median, sd) in rooms.items():
        for n in map(int, members):
            unusual, limit = _deviation(log_t20[n], median, sd)
            if unusual > limit:  # an object that rings, for one, changes a decay as well
                compared = np.isfinite(log_t20[n] - median)
                others = [other for other, (_, *usual) in rooms.items()
                          if other != room_id and np.all(np.isfinite(usual[0][compared]))
                          and np.less_equal(*_deviation(log_t20[n], *usual))]
                if others:
                    doubts[n] = Doubt(OTHER_DECAY, _describe(rows[n], log_t20[n], median, unusual, limit, others))
    return doubts


def _usual_decay(log_t20: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return median and standard deviation of the log of T20 in a room, shape (n_bands,), of bands that are enough."""
    enough = np.isfinite(log_t20).sum(axis=0) >= FEWEST_RIRS
    median, deviation = np.full(len(enough), np.nan), np.full(len(enough), np.nan)
    median[enough] = np.nanmedian(log_t20[:, enough], axis=0)
    deviation[enough] = 1.4826 * np.nanmedian(np.abs(log_t20[:, enough] - median[enough]), axis=0)
    expected = 0.88 * np.sqrt((1.0 + 1.9 / 10.0) / (_OCTAVE * _HZ * np.exp(median)))
    return median, np.hypot(np.fmax(deviation, expected), USUAL_SPREAD)


def _deviation(log_t20: FloatArray, median: FloatArray, sd: FloatArray) -> tuple[float, float]:
    """Return the sum of squared deviations in standard deviations, and what it exceeds with `FALSE_ALARM`."""
    deviations = (log_t20 - median) / sd
    known = np.isfinite(deviations)
    return float(np.sum(deviations[known] ** 2)), float(chi2.isf(FALSE_ALARM, known.sum())) if known.any() else 0.0


def _describe(row: Mapping[str, Any], log_t20: FloatArray, median: FloatArray, unusual: float, limit: float,
              others: Sequence[str]) -> str:
    at = int(np.nanargmax(np.abs(log_t20 - median)))
    return (f"RIR {row['id']} of room {row['room_id']}: T20={np.exp(log_t20[at]):.2f} s at {_HZ[at]:.0f} Hz, where the "
            f"room's median is {np.exp(median[at]):.2f} s; over the octaves, the squared deviations sum to "
            f"{unusual:.0f} variances, and {limit:.0f} may be chance; it fits room "
            f"{' or '.join(others[:3])}: correct room_id or wav")


def find_copies(rows: Sequence[Mapping[str, Any]], parts: FloatArray) -> list[Doubt | None]:
    """Find recordings that stand for two RIRs, of one room or of two.

    If the rows of the copies state the same geometry, the first is kept; otherwise nothing says which is right, and
    none is.

    Parameters
    ----------
    rows : sequence of mapping
    parts : ndarray, shape (n_rirs, n_samples)
        See `roomeq.loop.same_recordings.cut_parts`.
    """
    doubts: list[Doubt | None] = [None] * len(rows)
    for first, second, correlation in find_same(parts):
        stated_alike = all(rows[first].get(key) == rows[second].get(key) for key in _STATED)
        for n, m in ((second, first), *([] if stated_alike else [(first, second)])):
            doubts[n] = doubts[n] or _copy(rows[n], rows[m], correlation, stated_alike)
    return doubts


def _copy(row: Mapping[str, Any], other: Mapping[str, Any], correlation: float, stated_alike: bool) -> Doubt:
    in_room = row["room_id"] == other["room_id"]
    if stated_alike:
        remedy = "give each recording once" if in_room else "give each room once"
    else:
        remedy = "correct wav or the positions" if in_room else "correct wav, room_id or the positions"
    return Doubt(COPY_IN_ROOM if in_room else COPY, f"RIR {row['id']} of room {row['room_id']} is the recording of RIR "
                 f"{other['id']} of room {other['room_id']}: all parts of the response correlate by {correlation:.3f}, "
                 f"and {SAME:g} or more is a copy: {remedy}")
