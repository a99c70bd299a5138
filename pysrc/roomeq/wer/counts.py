"""Error counts of a seed by room and by part of the test set: all that word error rates are computed from.

A line of `counts.jsonl` holds those of a seed. Seeds that were trained on several machines are put together by their
lines, without their workspaces.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from roomeq.core.arrays import IntArray
from roomeq.core.files import read_text
from roomeq.wer.breakdown import ACOUSTICS, Breakdown, StratumCounts, ranges
from roomeq.wer.scores import Scores, choose_all_weights, read_scores
from roomeq.wer.scoring import Weights, read_bootci, read_weights
from roomeq.wer.workspace import TEST, System, Workspace

COUNTS_FILE = "counts.jsonl"

Count = Annotated[int, Meta(ge=0)]
Kinds = Annotated[list[Count], Meta(min_length=3, max_length=3)]
"""Numbers of substitutions, deletions and insertions."""


class Bootci(msgspec.Struct, frozen=True):
    """Output of Kaldi's `compute-wer-bootci` [%]."""

    wer: float
    interval: Annotated[list[float], Meta(min_length=2, max_length=2)]


class SystemCounts(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Errors of a system on a set: of each room, and what Kaldi's bootstrap printed, if it was run."""

    of_rooms: list[Kinds]
    bootci: Bootci | None


class SetCounts(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Errors on a set.

    Attributes
    ----------
    has_rooms
        False for clean speech, whose speakers take the place of rooms.
    rooms, words
        Names of the rooms, and words in each.
    errors
        By row and column.
    reference
        SHA-256 of the utterances and their words: all seeds of an experiment recognise the same speech.
    """

    has_rooms: bool
    reference: Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]
    utterances: Annotated[int, Meta(gt=0)]
    rooms: Annotated[list[str], Meta(min_length=1)]
    words: list[Annotated[int, Meta(gt=0)]]
    errors: dict[str, dict[str, SystemCounts]]

    def of_system(self, system: System, rooms: Sequence[str] | None = None) -> IntArray:
        """Return the errors of a system by kind, shape (3,), or of each of some `rooms`, shape (n_rooms, 3)."""
        counts = np.array(self.errors[system.row][system.column].of_rooms)
        return counts.sum(axis=0) if rooms is None else self._in_rooms(counts, rooms)

    def words_of(self, rooms: Sequence[str]) -> IntArray:
        """Return the words of each of some rooms, shape (n_rooms,)."""
        return self._in_rooms(np.array(self.words), rooms)

    def _in_rooms(self, values: IntArray, rooms: Sequence[str]) -> IntArray:
        placed = np.zeros((len(rooms), *values.shape[1:]), dtype=np.int64)
        known = {room: n for n, room in enumerate(self.rooms)}
        for n, room in enumerate(rooms):
            if room in known:
                placed[n] = values[known[room]]
        return placed


class ChosenWeights(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Language model weight and word insertion penalty of a system; whether others beyond them were not tried."""

    lmwt: int
    penalty: str
    at_edge: bool


class SeedCounts(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Errors of a seed.

    Attributes
    ----------
    seed
        Its number.
    kaldi
        Versions of Kaldi that worked.
    dev_of
        Development set of each row.
    weights
        By row and column.
    sets
        By name.
    acoustics
        By room of the test set, and property: its sum over utterances in which it is known, and their number. Seeds
        that an earlier version has counted may lack properties.
    strata
        Parts of the test set.
    """

    seed: Count
    kaldi: list[str]
    rows: Annotated[list[str], Meta(min_length=1)]
    columns: Annotated[list[str], Meta(min_length=1)]
    dev_of: dict[str, str]
    weights: dict[str, dict[str, ChosenWeights]]
    sets: dict[str, SetCounts]
    acoustics: dict[str, dict[str, tuple[float, int]]]
    strata: list[StratumCounts]


def count_seed(workspace: Workspace, breakdown: Breakdown) -> SeedCounts:
    """Count the errors of a workspace.

    Raises
    ------
    ValueError
        See `roomeq.wer.scores.read_scores`.
    """
    seed, weights = workspace.seed(), choose_all_weights(workspace)
    room_of_rir = breakdown.room_of_rir(seed)
    scores = {name: read_scores(workspace, name, weights, room_of_rir) for name in workspace.set_names}
    chosen = {row: {column: _chosen(workspace, System(row, column), weights[System(row, column)])
                    for column in workspace.columns} for row in workspace.rows}
    acoustics, strata = breakdown.counts(workspace, scores[TEST])
    return SeedCounts(seed, workspace.kaldi_versions(), workspace.rows, workspace.columns, workspace.dev_of,
                      chosen, {name: _set_counts(workspace, name, of_set) for name, of_set in scores.items()},
                      acoustics, strata)


def _chosen(workspace: Workspace, system: System, weights: Weights) -> ChosenWeights:
    """Return weights that were chosen; penalties below 0 are never tried."""
    grid = read_weights(workspace.decode_dir(system, workspace.dev_of[system.row]))
    lmwts, penalties = {one.lmwt for one in grid}, {float(one.penalty) for one in grid}
    return ChosenWeights(weights.lmwt, weights.penalty,
                         weights.lmwt in (min(lmwts), max(lmwts)) or float(weights.penalty) == max(penalties))


def _set_counts(workspace: Workspace, name: str, scores: Scores) -> SetCounts:
    errors: dict[str, dict[str, SystemCounts]] = {}
    n_rooms = len(scores.room_names)
    for system in workspace.systems(name):
        of_rooms = np.zeros((n_rooms, 3), dtype=int)
        np.add.at(of_rooms, scores.room, scores.errors[system])
        bootci = read_bootci(workspace.decode_dir(system, name))
        errors.setdefault(system.row, {})[system.column] = SystemCounts(of_rooms.tolist(),
                                                                        Bootci(**bootci) if bootci else None)
    words = np.bincount(scores.room, weights=scores.words, minlength=n_rooms).astype(int)
    return SetCounts(scores.has_rooms, scores.reference, len(scores.words), scores.room_names, words.tolist(), errors)


def counts_text(seeds: Sequence[SeedCounts]) -> str:
    """Return the text of `counts.jsonl`."""
    return "".join(msgspec.json.encode(seed).decode() + "\n" for seed in seeds)


def read_counts(path: Path) -> list[SeedCounts]:
    """Read the seeds of a `counts.jsonl`.

    Raises
    ------
    ValueError
        The file is missing or holds something else.
    """
    if not path.is_file():
        raise ValueError(f"{path}: no such file: give the {COUNTS_FILE} of a directory that roomeq wer made")
    seeds = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        try:
            seeds.append(_checked(msgspec.json.decode(line, type=SeedCounts)))
        except (msgspec.DecodeError, ValueError) as error:
            raise ValueError(f"{path}:{number}: is not what roomeq wer writes ({error}): make it again") from None
    if not seeds:
        raise ValueError(f"{path}: holds no seed: give a {COUNTS_FILE} that roomeq wer made, or leave it out")
    return seeds


def _checked(seed: SeedCounts) -> SeedCounts:
    """Return a seed whose parts fit together; raise ValueError for another."""
    for row in seed.rows:
        for name in (seed.dev_of.get(row), TEST):
            of_set = seed.sets.get(name or "")
            if of_set is None or not all(column in of_set.errors.get(row, {}) and column in seed.weights.get(row, {})
                                         for column in seed.columns):
                raise ValueError(f"errors of {row} on {name} are not complete")
    for name, of_set in seed.sets.items():
        sizes = {len(of_set.words), *(len(system.of_rooms) for of_row in of_set.errors.values()
                                      for system in of_row.values())}
        if sizes != {len(of_set.rooms)}:
            raise ValueError(f"{name} has {len(of_set.rooms)} rooms, but words or errors of another number of them")
    for room in seed.sets[TEST].rooms:
        if not {*ACOUSTICS} >= {*seed.acoustics.get(room, ())} > set():
            raise ValueError(f"acoustics of room {room!r} are missing, or others than {', '.join(ACOUSTICS)}")
    for part in seed.strata:
        if (part.low, part.high) not in ranges(part.what):
            raise ValueError(f"{part.what!r} from {part.low} to {part.high} is no part of the test set")
        if any({*seed.rows} - {*part.errors.get(column, {})} for column in seed.columns):
            raise ValueError(f"errors by {part.what} are not complete")
    return seed


def require_comparable(seeds: dict[str, SeedCounts]) -> None:
    """Refuse seeds, by where they come from, of other systems or speech, and those that are given twice.

    A seed may have drawn no RIR of a room that another seed has.
    """
    first_name, first = next(iter(seeds.items()))
    where: dict[int, str] = {}
    for name, seed in seeds.items():
        for what, here, there in (("rows", seed.rows, first.rows), ("columns", seed.columns, first.columns),
                                  ("development sets", seed.dev_of, first.dev_of),
                                  ("reference texts", _references(seed), _references(first))):
            if here != there:
                raise ValueError(f"{name}: its {what} are not those of {first_name}: put only seeds of one experiment "
                                 "together")
        if seed.seed in where:
            raise ValueError(f"{name}: is of seed {seed.seed}, as {where[seed.seed]}: give each seed once")
        where[seed.seed] = name


def _references(seed: SeedCounts) -> dict[str, str]:
    return {name: of_set.reference for name, of_set in seed.sets.items()}
