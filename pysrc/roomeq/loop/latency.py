"""Latency that recordings have in common although their rows say that sample 0 is the emission.

Sound later than geometry allows is taken for a detour around an obstacle that hides the direct sound
(`roomeq.loop.features`). That is right for single RIRs. With a latency, all direct sounds are late by the same time,
whatever their distance.
"""

import logging
from collections import Counter
from collections.abc import Sequence

import numpy as np

from roomeq.core.arrays import FloatArray
from roomeq.core.constants import FS_HZ
from roomeq.loop.features import NEAR_S, NEAR_SHARE
from roomeq.loop.unknown_geometry import assumed_position, declared_speed_m_s
from roomeq.records.schema import RirRow, is_timed, unit_name

logger = logging.getLogger(__name__)

MIN_RIRS = 3
"""Fewest RIRs that tell a latency from detours around obstacles: two of them agree by chance in 16 % of cases."""
AGREEING_SHARE = 0.8
"""Least share of RIRs whose direct sounds agree within `NEAR_S`. Of three to eight RIRs that were chosen at random from
generated rooms with obstacles, in which half of the direct sounds are hidden, less than 2 % do."""


def find_latencies(rows: Sequence[RirRow], direct_s: FloatArray) -> FloatArray:
    """Return the latency that each RIR has in common with others, and log it.

    The difference of the direct sound's arrival, found without geometry, and the expected one is a latency if its
    median over the RIRs exceeds the tolerance of geometry and most of them agree with the median. It may be negative:
    the start of the recordings was cut off. The RIRs are those of a room; rooms with fewer than `MIN_RIRS` are taken
    together by source. A wrong position of the only source of a room can have the same effect.

    Parameters
    ----------
    rows : sequence of RirRow
        x and y of source and microphone are known; an unknown height is the prior's mean.
    direct_s : ndarray, shape (n_rirs,)
        Times of the direct sounds in the recordings.

    Returns
    -------
    ndarray, shape (n_rirs,)
        [s]; 0 where there is none, and where rows do not say that sample 0 is the emission.
    """
    timed = [n for n, row in enumerate(rows) if is_timed(row)]
    n_of_room = Counter(rows[n]["room_id"] for n in timed)
    groups: dict[str, list[int]] = {}
    for n in timed:
        room_id = rows[n]["room_id"]
        name = f"room {room_id}" if n_of_room[room_id] >= MIN_RIRS else (
            f"source {unit_name(rows[n], 'source')} in rooms of fewer than {MIN_RIRS} RIRs")
        groups.setdefault(name, []).append(n)
    latencies_s = np.zeros(len(rows))
    for name, members in groups.items():
        expected_s = np.array([_expected_s(rows[n]) for n in members])
        late_s = direct_s[members] - expected_s
        latency_s = float(np.median(late_s))
        tolerance_s = NEAR_S + NEAR_SHARE * float(np.median(expected_s))
        agree = np.abs(late_s - latency_s) <= NEAR_S
        if len(members) >= MIN_RIRS and abs(latency_s) > tolerance_s and agree.mean() >= AGREEING_SHARE:
            latencies_s[members] = latency_s
            logger.warning("%s: the direct sounds of %d of %d RIRs are %s than positions and tof_removed=false say, by "
                           "%.2f ms within %.1f ms, and may be by %.2f ms: times of arrival are not used: check "
                           "source_pos_m and mic_pos_m (one may be wrong by %.2g m); if they are right, it is a "
                           "latency of %.0f samples: take it out of the recordings, or set tof_removed to null", name,
                           agree.sum(), len(members), "later" if latency_s > 0.0 else "earlier", 1e3 * abs(latency_s),
                           1e3 * NEAR_S, 1e3 * tolerance_s, abs(latency_s) * declared_speed_m_s(rows[members[0]]),
                           latency_s * FS_HZ)
    return latencies_s


def _expected_s(row: RirRow) -> float:
    source_m, mic_m = (assumed_position(position) for position in (row["source_pos_m"], row["mic_pos_m"]))
    return float(np.linalg.norm(source_m - mic_m)) / declared_speed_m_s(row)
