"""Repeated takes: recordings of one source and microphone in one place, which say nothing that the first did not.

What counts as evidence counts each measurement once: `roomeq.corpora.characterise` drops repeats, and the closed loop
leaves them out. Two states of a room are two rooms (`room_id`), and positions that nobody knows are not the same.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from roomeq.core.arrays import FloatArray
from roomeq.core.constants import FS_HZ
from roomeq.records.geometry import position_key
from roomeq.records.rir_dir import load_rir, rir_path

SAME_TAKE_S = 0.05
SAME_TAKE_CORRELATION = 0.8
"""Two RIRs of one position are takes of one measurement if their first 50 ms correlate better than this."""
_N_COMPARED, _REACH = round(SAME_TAKE_S * FS_HZ), round(5e-4 * FS_HZ)


class Repeat(NamedTuple):
    """The id of the take that is kept, and what is the same: ``"positions"`` or ``"audio"``."""

    of: str
    same: str

    def __str__(self) -> str:
        return f"same {self.same} as {self.of}"


def keeping_order(rows: Sequence[Mapping[str, Any]]) -> list[int]:
    """Return the numbers of rows, those first that are kept before others: by id, but marked repeats last."""
    return sorted(range(len(rows)), key=lambda n: (rows[n].get("repeat_of") is not None, rows[n]["id"]))


def find_repeats(rirs: Sequence[tuple[Path, Mapping[str, Any]]], sounds: Sequence[str] = ()) -> list[Repeat | None]:
    """Find the repeats of other recordings; the first take of each measurement is none.

    A repeat is marked (`repeat_of`), or its room, devices, positions and facings are those of an earlier take
    (`roomeq.records.geometry.position_key`) and both begin alike: the channels of an array or of a dummy head do not.
    Where hashes of the samples are given, a recording with those of an earlier one is a repeat as well.

    Parameters
    ----------
    rirs : sequence of (Path, mapping)
        RIR directories and rows at `FS_HZ`, whose ids differ.
    sounds : sequence of str, optional
        A hash of the samples of each.

    Returns
    -------
    list of Repeat or None
        For each RIR.

    Raises
    ------
    ValueError
        A recording that is compared cannot be read or has no direct sound; the message names the file.
    """
    rows = [row for _, row in rirs]
    room_of = {row["id"]: row["room_id"] for row in rows}
    repeats: list[Repeat | None] = [None] * len(rirs)
    repeated: set[str] = set()
    kept_sounds: dict[str, str] = {}
    kept_at: dict[str, list[int]] = {}
    beginnings: dict[int, FloatArray] = {}

    def beginning(n: int) -> FloatArray:
        if n not in beginnings:
            beginnings[n] = _beginning(*rirs[n])
        return beginnings[n]

    for n in keeping_order(rows):
        row, position, marked = rows[n], position_key(rows[n]), rows[n].get("repeat_of")
        earlier = kept_at.setdefault(position, []) if position is not None else []
        if marked is not None and room_of.get(marked) == row["room_id"] and marked not in repeated:
            repeats[n] = Repeat(marked, "positions")
        elif sounds and sounds[n] in kept_sounds:
            repeats[n] = Repeat(kept_sounds[sounds[n]], "audio")
        else:
            take = next((m for m in earlier if _same_take(beginning(m), beginning(n))), None)
            repeats[n] = None if take is None else Repeat(rows[take]["id"], "positions")
        if repeats[n]:
            repeated.add(row["id"])
            continue
        earlier.append(n)
        if sounds:
            kept_sounds[sounds[n]] = row["id"]
    return repeats


def find_further_takes(rirs: Sequence[tuple[Path, Mapping[str, Any]]], of: Sequence[tuple[Path, Mapping[str, Any]]]
                       ) -> list[Repeat | None]:
    """Find further takes of measurements of which another set holds a take, by the rule of `find_repeats`.

    Parameters
    ----------
    rirs, of : sequence of (Path, mapping)
        RIR directories and rows at `FS_HZ`, of the one and of the other set.

    Returns
    -------
    list of Repeat or None
        For each RIR of the one set.

    Raises
    ------
    ValueError
        As `find_repeats`.
    """
    rooms = {(row["room_id"], row["id"]) for _, row in of}
    at: dict[str, list[tuple[Path, Mapping[str, Any]]]] = {}
    for rir in of:
        if (position := position_key(rir[1])) is not None:
            at.setdefault(position, []).append(rir)
    takes: list[Repeat | None] = []
    for directory, row in rirs:
        first = row.get("repeat_of") if (row["room_id"], row.get("repeat_of")) in rooms else None
        if first is None and (others := at.get(position_key(row) or "")):
            beginning = _beginning(directory, row)
            first = next((other[1]["id"] for other in others if _same_take(_beginning(*other), beginning)), None)
        takes.append(None if first is None else Repeat(first, "positions"))
    return takes


def _beginning(directory: Path, row: Mapping[str, Any]) -> FloatArray:
    """Return what is compared of a recording and `_REACH` on both sides, shape (`_N_COMPARED` + 2 `_REACH`,)."""
    import numpy as np

    from roomeq.acoustics.direct import find_direct

    rir = load_rir(directory, row)
    try:
        start = max(0, round(find_direct(rir, FS_HZ).sample))
    except ValueError as error:
        raise ValueError(f"{rir_path(directory, row)}: {error}") from None
    return np.pad(rir, (_REACH, _N_COMPARED + _REACH))[start:start + _N_COMPARED + 2 * _REACH]


def _same_take(first: FloatArray, second: FloatArray) -> bool:
    """Tell whether two beginnings correlate, at the best shift of up to 0.5 ms."""
    import numpy as np

    first = first[_REACH:-_REACH]
    windows = np.lib.stride_tricks.sliding_window_view(second, _N_COMPARED)
    size = np.linalg.norm(first) * np.linalg.norm(windows, axis=1)
    return bool(np.max(np.abs(windows @ first) / np.maximum(size, 1e-300)) > SAME_TAKE_CORRELATION)
