"""Labelling errors: what can be wrong in the rows of measured RIRs, applied to a set of generated rooms."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

from roomeq.records.rir_dir import write_rirs
from testbed.draws import generator

LENGTHS = ("source_pos_m", "mic_pos_m", "room_dims_m")
POSITIONS, DIMENSIONS = LENGTHS[:2], LENGTHS[2:]
UNITS = {"cm": 100.0, "feet": 1.0 / 0.3048}
"""What a length in metres is multiplied by where it is stated in another unit."""


def make_mislabelled(error, seed, clean, out):
    """Copy an RIR directory with one labelling error.

    Parameters
    ----------
    error : str
        Key of `ERRORS`.
    seed : int
        Which rooms and RIRs are wrong.
    clean, out : Path

    Returns
    -------
    ids : set of str
        The RIRs whose rows are wrong.
    """
    clean, out = Path(clean), Path(out)
    rows = [json.loads(line) for line in (clean / "rirs.jsonl").read_text().splitlines()]
    shutil.copytree(clean / "audio", out / "audio")
    before = {row["id"]: dict(row) for row in rows}
    rows = ERRORS[error](rows, generator(seed, "labelling error", error))
    for row in rows:
        if row["id"] not in before:  # another name of a file is another file
            shutil.copy(out / row["wav"], out / f"audio/{row['id']}.wav")
            row["wav"] = f"audio/{row['id']}.wav"
    write_rirs(out, sorted(rows, key=lambda row: row["id"]))
    return {row["id"] for row in rows if row != before.get(row["id"])}


def _two_rooms(rows, rng):
    return rng.permutation(sorted({row["room_id"] for row in rows}))[:2].tolist()


def _of_room(rows, room):
    return [row for row in rows if row["room_id"] == room]


def _scaled(keys, factor, everywhere):
    def apply(rows, rng):
        for row in rows if everywhere else _of_room(rows, _two_rooms(rows, rng)[0]):
            row.update({key: [x * factor for x in row[key]] for key in keys})
        return rows
    return apply


def _swapped(rows, rng):
    """Exchange the recordings of two RIRs of different rooms."""
    a, b = (rng.choice(_of_room(rows, room)) for room in _two_rooms(rows, rng))
    a["wav"], b["wav"] = b["wav"], a["wav"]
    return rows


def _mislabelled_source(rows, rng):
    """Give two RIRs of one loudspeaker in one room the other's name."""
    room = _of_room(rows, _two_rooms(rows, rng)[0])
    names = sorted({row["source_id"] for row in room})
    for row in rng.permutation([row for row in room if row["source_id"] == names[0]])[:2]:
        row["source_id"] = names[1]
    return rows


def _exchanged_sources(rows, rng):
    """Exchange the names of the two loudspeakers of one room."""
    room = _of_room(rows, _two_rooms(rows, rng)[0])
    names = sorted({row["source_id"] for row in room})
    for row in room:
        row["source_id"] = names[1 - names.index(row["source_id"])]
    return rows


def _duplicated_room(rows, rng):
    room = _two_rooms(rows, rng)[0]
    return rows + [row | dict(id=f"copy-{row['id']}", room_id=f"copy-{room}") for row in _of_room(rows, room)]


def _long(everywhere):
    """State the length of one room, or of all, 10 % too large."""
    def apply(rows, rng):
        for row in rows if everywhere else _of_room(rows, _two_rooms(rows, rng)[0]):
            row["room_dims_m"] = [1.1 * row["room_dims_m"][0], *row["room_dims_m"][1:]]
        return rows
    return apply


def _exchanged_positions(rows, rng):
    """Exchange the positions of source and microphone of one RIR."""
    row = rng.choice(rows)
    row["source_pos_m"], row["mic_pos_m"] = row["mic_pos_m"], row["source_pos_m"]
    return rows


ERRORS: dict[str, Callable] = {
    f"{what} in {unit}, {'all rooms' if everywhere else 'one room'}": _scaled(keys, factor, everywhere)
    for unit, factor in UNITS.items()
    for what, keys in (("positions", POSITIONS), ("dimensions", DIMENSIONS), ("all lengths", LENGTHS))
    for everywhere in (False, True)
} | {
    "recordings of two rooms swapped": _swapped,
    "two RIRs of another loudspeaker": _mislabelled_source,
    "loudspeakers of one room exchanged": _exchanged_sources,
    "room duplicated": _duplicated_room,
    "one room 10 % too long": _long(False),
    "all rooms 10 % too long": _long(True),
    "source and microphone exchanged": _exchanged_positions,
}
