"""Recordings that cannot be of the room that their rows state: another room's decay, or a copy of another recording."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtri, fdtri

from roomeq.acoustics.same_recordings import SAME, find_same
from roomeq.core.arrays import FloatArray, IntArray
from roomeq.core.constants import EXACT_BANDS_HZ
from roomeq.loop.doubtful_geometry import Doubt
from roomeq.records.geometry import place_key

FALSE_ALARM = 1e-6
"""Probability with which an RIR of a diffuse room is taken for another room's."""
FALSE_ALARM_SCATTERED = 1e-4
"""The same in a room whose RIRs scatter more, which few of them hardly tell."""
UNLIKE = 0.05
"""Probability with which an RIR of a room is taken for none of that room."""
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
_SD_PER_MAD = 1.4826
_SD_PER_QUARTILE = 2.2219
"""Of the differences of pairs."""
_EFFICIENCY = 0.82
"""Of that quartile, against the standard deviation (Qn of Rousseeuw & Croux, J. Am. Stat. Assoc. 88 (1993))."""
_STATED = ("room_dims_m", "mesh", "source_pos_m", "mic_pos_m", "source_dir")


def find_other_decays(rows: Sequence[Mapping[str, Any]], log_t20: FloatArray) -> list[Doubt | None]:
    """Find RIRs whose decay times are not those of their room, but those of another.

    T20 scatters within a room by ``0.88 sqrt((1 + 1.9 / n) / (B T))`` of itself, with n = 10 for an integrated impulse
    response (ISO 3382-2:2008, annex A; Davy, J. Sound Vib. 70 (1980)), or by more where the median absolute deviation
    in the room says so, and by `USUAL_SPREAD` in addition. The sum of squares over the octaves then follows a
    chi-squared distribution. In a room whose field is not diffuse, T20 may scatter by a common multiple of that, which
    its other RIRs tell: an RIR must be unusual by the F distribution, too. It must be usual in another room.

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
    rooms: dict[str, tuple[IntArray, _Usual]] = {}
    for room_id in sorted({row["room_id"] for row in rows}):
        members = np.flatnonzero([row["room_id"] == room_id for row in rows])
        told = members[np.isfinite(log_t20[members]).any(axis=1)]
        if len({place_key(rows[n]) for n in told}) >= FEWEST_RIRS:
            rooms[room_id] = members, _usual_decay(log_t20[members])
    for room_id, (members, usual) in rooms.items():
        for n in map(int, members):
            unusual, limit = _deviation(log_t20[n], usual, log_t20[members[members != n]])
            if unusual > limit:  # an object that rings, for one, changes a decay as well
                compared = np.isfinite(log_t20[n] - usual.median)
                others = [other for other, (_, there) in rooms.items()
                          if other != room_id and np.all(np.isfinite(there.median[compared]))
                          and _sum_of_squares(log_t20[n], there) <= chdtri(compared.sum(), UNLIKE)]
                if others:
                    doubts[n] = Doubt(OTHER_DECAY, _describe(rows[n], log_t20[n], usual.median, unusual, limit, others))
    return doubts


class _Usual(NamedTuple):
    """What is usual in a room: median of the log of T20, its deviation and what is expected of it, shape (n_bands,)."""

    median: FloatArray
    deviation: FloatArray
    expected: FloatArray


def _usual_decay(log_t20: FloatArray) -> _Usual:
    """Return what is usual in a room, of bands that are enough."""
    enough = np.isfinite(log_t20).sum(axis=0) >= FEWEST_RIRS
    median, deviation = np.full(len(enough), np.nan), np.full(len(enough), np.nan)
    median[enough] = np.nanmedian(log_t20[:, enough], axis=0)
    deviation[enough] = _SD_PER_MAD * np.nanmedian(np.abs(log_t20[:, enough] - median[enough]), axis=0)
    expected = 0.88 * np.sqrt((1.0 + 1.9 / 10.0) / (_OCTAVE * _HZ * np.exp(median)))
    return _Usual(median, np.hypot(deviation, USUAL_SPREAD), np.hypot(expected, USUAL_SPREAD))


def _deviation(log_t20: FloatArray, usual: _Usual, others: FloatArray) -> tuple[float, float]:
    """Return the sum of squared deviations in standard deviations, and what it exceeds with `FALSE_ALARM`.

    Parameters
    ----------
    others : ndarray, shape (n_rirs, n_bands)
        Of the other RIRs of the room. If they scatter by another factor than expected, that and `FALSE_ALARM_SCATTERED`
        count where they allow for more.
    """
    known = np.isfinite(log_t20 - usual.median)
    n_known = int(known.sum())
    if not n_known:
        return 0.0, 0.0
    unusual, limit = _sum_of_squares(log_t20, usual), float(chdtri(n_known, FALSE_ALARM))
    if unusual > limit:
        factor, df = _scatter(others[:, known] / usual.expected[known])
        scattered = _sum_of_squares(log_t20, usual, factor)
        of_scattered = n_known * float(fdtri(n_known, df, 1.0 - FALSE_ALARM_SCATTERED))
        if scattered * limit < unusual * of_scattered:
            return scattered, of_scattered
    return unusual, limit


def _sum_of_squares(log_t20: FloatArray, usual: _Usual, factor: float = 1.0) -> float:
    """Return the sum of squared deviations, in standard deviations of so many times what is expected or more."""
    return float(np.nansum(((log_t20 - usual.median) / np.fmax(usual.deviation, factor * usual.expected)) ** 2))


def _scatter(values: FloatArray) -> tuple[float, float]:
    """Return the standard deviation within columns, from the differences of pairs, and its degrees of freedom."""
    first, second = np.triu_indices(len(values), 1)
    differences = np.abs(values[first] - values[second])
    df = _EFFICIENCY * float((np.isfinite(values).sum(axis=0) - 1).clip(0).sum())
    return _SD_PER_QUARTILE * float(np.nanquantile(differences, 0.25)), df


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
        See `roomeq.acoustics.same_recordings.cut_parts`.
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
