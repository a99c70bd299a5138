"""Loudspeakers or microphones under another's name: exchanged in one room, or single RIRs.

The levels of the reverberation hold the responses of loudspeaker, microphone and room. In the difference between two
loudspeakers of one room, the room cancels, and the difference should be that of the same two in other rooms.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np

from roomeq.acoustics.decibels import power_db
from roomeq.core.arrays import FloatArray
from roomeq.core.constants import FS_HZ
from roomeq.loop.doubtful_geometry import Doubt
from roomeq.records.geometry import place_key

EXCHANGED = "the loudspeakers or microphones of the room differ as if their names were exchanged"
OTHER_DEVICE = "the recording is one of another loudspeaker or microphone"
FALSE_ALARM = 1e-6
"""Largest probability with which right names of an RIR directory are doubted."""
FEWEST_ROOMS = 3
"""With both devices, so that the other rooms agree on their difference."""
FEWEST_RIRS = 20
"""Of two devices, each of different places, so that the spread of single RIRs is known."""
REVERBERATION_S = (0.02, 0.42)
"""After the direct sound: late enough that it hardly matters where the loudspeaker faces."""
SUSPECTS, FEWEST_OF_ROOM = 2, 4
"""RIRs of a room that are least like their device and may be misnamed, and the others from which on its spread is
known."""
WINDOW_S = 0.05
"""Part of the reverberation whose levels are averaged with those of the others: late parts would hardly count in the
energy of all, and the levels would scatter more."""
MOST_DECAY_DB = 30.0
"""Windows with less than the first by more than this are not used: they may be noise."""
BANDS_HZ = 1000.0 * 2.0 ** (np.arange(-7, 9) / 3.0)
"""Third octaves, 200 to 6300 Hz."""

_LEAST = 1e-12
_DEVICES = {"source_id": "loudspeakers", "mic_id": "microphones"}


def reverberation_levels(rir: FloatArray, direct_sample: float) -> FloatArray:
    """Return the mean level of the reverberation's windows in third octaves, relative to the mean over bands [dB].

    Returns
    -------
    levels_db : ndarray, shape (n_bands,)
        Zero without reverberation.
    """
    first, last = (round(direct_sample + time_s * FS_HZ) for time_s in REVERBERATION_S)
    length = round(WINDOW_S * FS_HZ)
    reverberation = rir[first:last]
    if len(reverberation) < length:
        return np.zeros(len(BANDS_HZ))
    windows = reverberation[:len(reverberation) // length * length].reshape(-1, length)
    energy = np.sum(windows ** 2, axis=1)
    faint = energy < energy[0] * 10.0 ** (-MOST_DECAY_DB / 10.0)
    windows = windows[:int(np.argmax(faint))] if faint.any() else windows
    power = np.abs(np.fft.rfft(windows, FS_HZ)) ** 2  # a bin each hertz
    edges = np.rint(np.append(BANDS_HZ[0] / 2.0 ** (1.0 / 6.0), BANDS_HZ * 2.0 ** (1.0 / 6.0))).astype(int)
    levels_db = power_db(np.add.reduceat(power[:, :edges[-1]], edges[:-1], axis=1)).mean(axis=0)
    return levels_db - levels_db.mean()


def find_misnamed_devices(rows: Sequence[Mapping[str, Any]], levels_db: FloatArray) -> list[Doubt | None]:
    """Find rooms in which the names of two devices are exchanged, and single RIRs under the name of another device.

    Levels are projected onto the usual difference of two devices, the median over the other rooms: the difference of a
    room is then 1, or -1 if the names are exchanged, and a single RIR is 0 from its own device, or 1 if it is the
    other's. The likelihoods of both are compared, with the spread of the single RIRs, or that of the room's own RIRs if
    it is larger: positions differ more where a few reflections are strong. If the stated names are right, their ratio
    exceeds ``x`` with a probability of ``1 / x`` at most (Markov), for each room and each RIR. Devices that do not
    differ usually are not compared in effect: their projections spread widely.

    Parameters
    ----------
    rows : sequence of mapping
    levels_db : ndarray, shape (n_rirs, n_bands)
        See `reverberation_levels`.
    """
    doubts: list[Doubt | None] = [None] * len(rows)
    compared = list(_common_rooms(rows))
    n_tests = sum(1 + len(first) + len(second) for _, _, rooms in compared for first, second in rooms.values())
    limit = math.log(max(1, n_tests) / FALSE_ALARM)
    for key, pair, rooms in compared:
        share, distance = _projected(rooms, levels_db)
        spread, between = robust_deviation(np.concatenate(distance)), robust_deviation(np.array(share) - 1.0)
        for (room_id, members), room_share, distances in zip(rooms.items(), share, distance, strict=True):
            variance = max(spread ** 2 * sum(1.0 / len(of_device) for of_device in members), between ** 2, _LEAST)
            gain = -2.0 * room_share / variance
            if gain > limit:
                for n in [*members[0], *members[1]]:
                    doubts[n] = Doubt(EXCHANGED, f"room {room_id}: the {_DEVICES[key]} {' and '.join(pair)} differ as "
                                      "in the other rooms with exchanged names, by "
                                      f"{-room_share:.1f} times as much; {_odds(gain, limit)}: correct {key}")
                continue
            near = np.sort(np.abs(distances))[:-SUSPECTS]
            own = robust_deviation(near) if len(near) >= FEWEST_OF_ROOM else 0.0
            of_rir = max(spread, own) ** 2
            for n, rir_distance in zip([*members[0], *members[1]], distances, strict=True):
                gain = (rir_distance - 0.5) / max(of_rir, _LEAST)
                if gain > limit:
                    stated, other = pair if n in members[0] else pair[::-1]
                    doubts[n] = Doubt(OTHER_DEVICE, f"RIR {rows[n]['id']} of room {room_id}: its reverberation is "
                                      f"coloured as by {key} {other}, not {stated}, beside the room's other RIRs; "
                                      f"{_odds(gain, limit)}: correct {key}")
    return doubts


def robust_deviation(errors: FloatArray) -> float:
    """Return the standard deviation of normal errors about zero from the median of their sizes, despite outliers."""
    return float(1.4826 * np.median(np.abs(errors)))


def _odds(gain: float, limit: float) -> str:
    return (f"that is 1e{gain / math.log(10.0):.0f} times likelier than the stated names, and 1e"
            f"{limit / math.log(10.0):.0f} may be chance")


def _projected(rooms: Mapping[str, tuple[list[int], list[int]]], levels_db: FloatArray
               ) -> tuple[list[float], list[FloatArray]]:
    """Project the levels of two devices onto their usual difference.

    Returns
    -------
    share : list of float
        Of each room: the difference of the two, in units of the usual one.
    distance : list of ndarray
        Of each room: how far each RIR is from its own device (0) towards the other (1), those of the first device
        first.
    """
    difference_db = np.array([np.subtract(*(levels_db[members].mean(axis=0) for members in of_room))
                              for of_room in rooms.values()])
    share, distance = [], []
    for at, (first, second) in enumerate(rooms.values()):
        usual_db = np.median(np.delete(difference_db, at, axis=0), axis=0)
        along = usual_db / max(usual_db @ usual_db, _LEAST)
        share.append(float(difference_db[at] @ along))
        place = np.array([*(levels_db[first] - usual_db) @ along, *levels_db[second] @ along])  # were all the second
        others = np.array([np.median(np.delete(place, n)) for n in range(len(place))])
        deviation = place - others  # as far beyond its own device
        distance.append(np.where(np.arange(len(place)) < len(first), -deviation, deviation))
    return share, distance


def _common_rooms(rows: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, tuple[str, str], dict]]:
    """Yield key and names of two devices and, of the rooms that have both, the RIRs of each: where rooms suffice."""
    for key in _DEVICES:
        rirs_of: dict[str, dict[str, list[int]]] = {}
        for n, row in enumerate(rows):
            rirs_of.setdefault(row[key], {}).setdefault(row["room_id"], []).append(n)
        for first, second in combinations(sorted(rirs_of), 2):
            rooms = {room_id: (rirs_of[first][room_id], rirs_of[second][room_id])
                     for room_id in rirs_of[first] if room_id in rirs_of[second]}
            n_places = sum(len({place_key(rows[n]) for n in members}) for of_room in rooms.values()
                           for members in of_room)
            if len(rooms) >= FEWEST_ROOMS and n_places >= FEWEST_RIRS:
                yield key, (first, second), rooms
