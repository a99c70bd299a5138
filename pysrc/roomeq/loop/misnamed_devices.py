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

EXCHANGED = "the loudspeakers or microphones of the room differ as if their names were exchanged"
OTHER_DEVICE = "the recording is one of another loudspeaker or microphone"
FALSE_ALARM = 1e-6
"""Largest probability with which right names of an RIR directory are doubted."""
FEWEST_ROOMS = 3
"""With both devices, so that the other rooms agree on their difference."""
FEWEST_RIRS = 20
"""Of two devices, so that the spread of single RIRs is known."""
USUAL_SPREAD_DB = 1.0
"""Of the difference of two devices between rooms, in addition to the observed: a just noticeable difference."""
REVERBERATION_S = (0.02, 0.42)
"""After the direct sound: late enough that it hardly matters where the loudspeaker faces."""
WINDOW_S = 0.05
"""Part of the reverberation whose levels are averaged with those of the others: late parts would hardly count in the
energy of all, and the levels would scatter more."""
MOST_DECAY_DB = 30.0
"""Windows with less than the first by more than this are not used: they may be noise."""
BANDS_HZ = 1000.0 * 2.0 ** (np.arange(-7, 9) / 3.0)
"""Third octaves, 200 to 6300 Hz."""

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


def find_exchanged_devices(rows: Sequence[Mapping[str, Any]], levels_db: FloatArray) -> list[Doubt | None]:
    """Find rooms in which the names of two loudspeakers or of two microphones are exchanged.

    The likelihood of exchanged names is compared with that of the stated ones; the difference of the devices is the
    median over the other rooms, and its spread that over all rooms. If the stated names are right, the ratio exceeds
    ``x`` with a probability of ``1 / x`` at most (Markov), for each room and pair of devices.

    Parameters
    ----------
    rows : sequence of mapping
    levels_db : ndarray, shape (n_rirs, n_bands)
        See `reverberation_levels`.
    """
    doubts: list[Doubt | None] = [None] * len(rows)
    compared = list(_common_rooms(rows))
    limit = math.log(max(1, sum(len(rooms) for _, _, rooms in compared)) / FALSE_ALARM)
    for key, pair, rooms in compared:
        difference_db = _differences_db(rooms, levels_db)
        spread_db = 1.4826 * np.median(np.abs(difference_db - np.median(difference_db, axis=0)), axis=0)
        variance = spread_db ** 2 + USUAL_SPREAD_DB ** 2
        for at, (room_id, of_room) in enumerate(rooms.items()):
            usual_db = np.median(np.delete(difference_db, at, axis=0), axis=0)
            gain = float(np.sum(-2.0 * difference_db[at] * usual_db / variance))
            if gain > limit:
                band = int(np.argmax(np.abs(usual_db)))
                doubt = Doubt(EXCHANGED, f"room {room_id}: the {_DEVICES[key]} {' and '.join(pair)} differ by "
                              f"{difference_db[at, band]:.1f} dB at {BANDS_HZ[band]:.0f} Hz, and by "
                              f"{usual_db[band]:.1f} dB in the other rooms; exchanged names are 1e"
                              f"{gain / math.log(10.0):.0f} times likelier, and 1e{limit / math.log(10.0):.0f} may be "
                              f"chance: correct {key}")
                for n in [*of_room[0], *of_room[1]]:
                    doubts[n] = doubt
    return doubts


def find_other_devices(rows: Sequence[Mapping[str, Any]], levels_db: FloatArray) -> list[Doubt | None]:
    """Find single RIRs under the name of another loudspeaker or microphone of their room.

    The levels of an RIR, less those of the second device of a pair in its room, are projected onto the difference of
    the two devices: 1 is expected for the first, 0 for the second. The likelihoods of both are compared, with the
    spread of all RIRs of the pair and the bound of `find_exchanged_devices`.

    Parameters
    ----------
    rows : sequence of mapping
    levels_db : ndarray, shape (n_rirs, n_bands)
        See `reverberation_levels`.
    """
    doubts: list[Doubt | None] = [None] * len(rows)
    compared = [entry for entry in _common_rooms(rows)
                if sum(len(members) for of_room in entry[2].values() for members in of_room) >= FEWEST_RIRS]
    places = [_places(rooms, levels_db) for _, _, rooms in compared]
    limit = math.log(max(1, sum(len(of_pair) for of_pair in places)) / FALSE_ALARM)
    for (key, pair, rooms), of_pair in zip(compared, places, strict=True):
        spread = 1.4826 * np.median(np.abs(np.array(list(of_pair.values()))))
        first = {n for of_room in rooms.values() for n in of_room[0]}
        for n, deviation in of_pair.items():
            gain = (deviation - 0.5) / max(spread ** 2, 1e-12)
            if gain > limit:
                stated, other = pair if n in first else pair[::-1]
                doubts[n] = Doubt(OTHER_DEVICE, f"RIR {rows[n]['id']} of room {rows[n]['room_id']}: its reverberation "
                                  f"is coloured as by {key} {other}, not {stated}, against the other RIRs of the room: "
                                  f"1e{gain / math.log(10.0):.0f} times likelier, and 1e{limit / math.log(10.0):.0f} "
                                  f"may be chance: correct {key}")
    return doubts


def _places(rooms: Mapping[str, tuple[list[int], list[int]]], levels_db: FloatArray) -> dict[int, float]:
    """Return for each RIR of two devices how far it is from its own (0) towards the other (1)."""
    difference_db = _differences_db(rooms, levels_db)
    deviation_of = {}
    for at, (first, second) in enumerate(rooms.values()):
        usual_db = np.median(np.delete(difference_db, at, axis=0), axis=0)
        as_second_db = {n: levels_db[n] - usual_db for n in first} | {n: levels_db[n] for n in second}
        for n in as_second_db:
            others_db = np.median([level_db for m, level_db in as_second_db.items() if m != n], axis=0)
            place = float((levels_db[n] - others_db) @ usual_db / max(usual_db @ usual_db, 1e-12))
            deviation_of[n] = 1.0 - place if n in first else place
    return deviation_of


def _differences_db(rooms: Mapping[str, tuple[list[int], list[int]]], levels_db: FloatArray) -> FloatArray:
    """Return the mean levels of the first device less those of the second, shape (n_rooms, n_bands)."""
    return np.array([np.subtract(*(levels_db[members].mean(axis=0) for members in of_room))
                     for of_room in rooms.values()])


def _common_rooms(rows: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, tuple[str, str], dict]]:
    """Yield key and names of two devices and, of the rooms that have both, the RIRs of each: where rooms suffice."""
    for key in _DEVICES:
        rirs_of: dict[str, dict[str, list[int]]] = {}
        for n, row in enumerate(rows):
            rirs_of.setdefault(row[key], {}).setdefault(row["room_id"], []).append(n)
        for first, second in combinations(sorted(rirs_of), 2):
            rooms = {room_id: (rirs_of[first][room_id], rirs_of[second][room_id])
                     for room_id in rirs_of[first] if room_id in rirs_of[second]}
            if len(rooms) >= FEWEST_ROOMS:
                yield key, (first, second), rooms
