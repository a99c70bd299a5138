"""Loudspeakers or microphones whose names are exchanged in one room: their responses differ there the other way round.

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
FALSE_ALARM = 1e-6
"""Largest probability with which names of an RIR directory are taken to be exchanged."""
FEWEST_ROOMS = 3
"""With both devices, so that the other rooms agree on their difference."""
USUAL_SPREAD_DB = 1.0
"""Of the difference of two devices between rooms, in addition to the observed: a just noticeable difference."""
REVERBERATION_S = (0.02, 0.22)
"""After the direct sound: late enough that it hardly matters where the loudspeaker faces."""
BANDS_HZ = 1000.0 * 2.0 ** (np.arange(-7, 9) / 3.0)
"""Third octaves, 200 to 6300 Hz."""

_DEVICES = {"source_id": "loudspeakers", "mic_id": "microphones"}


def reverberation_levels(rir: FloatArray, direct_sample: float) -> FloatArray:
    """Return the level of the reverberation in third octaves relative to their mean [dB], shape (n_bands,)."""
    first, last = (round(direct_sample + time_s * FS_HZ) for time_s in REVERBERATION_S)
    power = np.abs(np.fft.rfft(rir[first:last], FS_HZ)) ** 2  # a bin each hertz
    edges = np.rint(np.append(BANDS_HZ[0] / 2.0 ** (1.0 / 6.0), BANDS_HZ * 2.0 ** (1.0 / 6.0))).astype(int)
    levels_db = power_db(np.add.reduceat(power[:edges[-1]], edges[:-1]))
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
    compared = [(key, pair, rooms) for key in _DEVICES for pair, rooms in _common_rooms(rows, key)]
    limit = math.log(max(1, sum(len(rooms) for _, _, rooms in compared)) / FALSE_ALARM)
    for key, pair, rooms in compared:
        difference_db = np.array([np.subtract(*(levels_db[members].mean(axis=0) for members in of_room))
                                  for of_room in rooms.values()])
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


def _common_rooms(rows: Sequence[Mapping[str, Any]], key: str) -> Iterator[tuple[tuple[str, str], dict]]:
    """Yield pairs of devices and, of the rooms that have both, the RIRs of each, where the rooms are enough."""
    rirs_of: dict[str, dict[str, list[int]]] = {}
    for n, row in enumerate(rows):
        rirs_of.setdefault(row[key], {}).setdefault(row["room_id"], []).append(n)
    for first, second in combinations(sorted(rirs_of), 2):
        rooms = {room_id: (rirs_of[first][room_id], rirs_of[second][room_id])
                 for room_id in rirs_of[first] if room_id in rirs_of[second]}
        if len(rooms) >= FEWEST_ROOMS:
            yield (first, second), rooms
