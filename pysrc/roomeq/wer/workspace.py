"""Decode directories of Kaldi workspaces, one workspace per seed: which systems were decoded, and their errors."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from roomeq.core.arrays import FloatArray, IntArray
from roomeq.core.files import read_text
from roomeq.wer.scoring import (
    BOOTCI_FILE,
    REFERENCE_FILE,
    Texts,
    Weights,
    choose_weights,
    count_errors,
    read_hypotheses,
    read_reference,
    read_texts,
    scoring_dir,
)

ROWS = ("train.clean", "train.real.rvb", "train.sim.free.rvb", "train.sim.rvb", "train.sim.EQ.rvb",
        "train.sim.loop.rvb")
COLUMNS = ("fglarge", "tglarge", "tgmed", "tgsmall", "online")
"""Rows (training data) and columns (language models) of the paper's Table 2, and the rows of drawn rooms and of the
closed loop; others follow."""
VERSION_FILE = "kaldi_version"
TEST, DEV = "test.real.rvb", "dev.real.rvb"
BASE, ORACLE, CLEAN = "train.sim.rvb", "train.real.rvb", "train.clean"


class System(NamedTuple):
    """Training data and language model of a recogniser."""

    row: str
    column: str


@dataclass(frozen=True)
class Decodings:
    """Decode directories of all workspaces: every row and column is in every workspace.

    Attributes
    ----------
    workspaces : list of Path
        One per seed.
    dev_of : dict of str
        Development set by row: of the row's own kind, as in the paper, if it was decoded; else `DEV`.
    """

    workspaces: list[Path]
    rows: list[str]
    columns: list[str]
    dev_of: dict[str, str]

    def decode_dir(self, seed: int, system: System, set_name: str) -> Path:
        """Return the decode directory of a system and an evaluation set."""
        return self.workspaces[seed] / system.row / f"decode_{set_name}_{system.column}"

    def sets_of(self, row: str) -> tuple[str, str]:
        """Return the names of the development and test set of a row."""
        return self.dev_of[row], TEST

    @property
    def set_names(self) -> list[str]:
        """Names of all evaluation sets."""
        return sorted({name for row in self.rows for name in self.sets_of(row)})

    def systems(self, set_name: str | None = None) -> list[System]:
        """Return all systems, or those that were decoded on one set."""
        return [System(row, column) for row in self.rows if set_name is None or set_name in self.sets_of(row)
                for column in self.columns]

    def decode_dirs(self) -> list[Path]:
        """Return all decode directories."""
        return [self.decode_dir(seed, system, name) for seed in range(len(self.workspaces))
                for name in self.set_names for system in self.systems(name)]

    def inputs(self) -> list[Path]:
        """Return the files and directories that word error rates depend on, except the RIRs."""
        tables = [workspace / "data" / name / table for workspace in self.workspaces for name in self.set_names
                  for table in ("utt2rir", "utt2snr", "utt2spk")]
        optional = [*tables, *(workspace / VERSION_FILE for workspace in self.workspaces),
                    *(decode / BOOTCI_FILE for decode in self.decode_dirs())]
        return [*map(scoring_dir, self.decode_dirs()), *(path for path in optional if path.is_file())]


def compared(rows: list[str]) -> list[str]:
    """Return the rows that may close a part of the gap between `BASE` and `ORACLE`."""
    return [row for row in rows if row not in (BASE, ORACLE, CLEAN)]


def find_decodings(workspaces: list[Path]) -> Decodings:
    """Find rows and columns, those of the first workspace.

    Raises
    ------
    ValueError
        A workspace is missing or holds no decoding, or the decode directory of a row and column is missing.
    """
    for workspace in workspaces:
        if not workspace.is_dir():
            raise ValueError(f"{workspace}: no such Kaldi workspace: check the path, or run stages 8 to 10")
    resolved = [path.resolve() for path in workspaces]
    for n, workspace in enumerate(workspaces):
        if resolved[n] in resolved[:n]:
            raise ValueError(f"workspace {workspace} is given twice: give each seed's once")
    first = workspaces[0]
    rows = _in_order({path.parent.name for path in first.glob("train.*/decode_*") if path.is_dir()}, ROWS)
    columns = _in_order({path.name.removeprefix(f"decode_{TEST}_") for row in rows
                         for path in (first / row).glob(f"decode_{TEST}_*")}, COLUMNS)
    if not columns:
        raise ValueError(f"{first}: no train.*/decode_{TEST}_* in it: run stages 8 to 10, or check the path")
    decodings = Decodings(workspaces, rows, columns, {row: _dev_set(first, row) for row in rows})
    for path in map(scoring_dir, decodings.decode_dirs()):
        if not path.is_dir():
            raise ValueError(f"{path}: no such directory, but other rows, columns or seeds have it: decode and score "
                             "it (stage 10), or leave the row or column out of all")
    return decodings


def kaldi_versions(workspaces: list[Path]) -> list[str]:
    """Return the versions of Kaldi that worked in the workspaces; see ``local/kaldi/check_kaldi.sh``."""
    paths = [workspace / VERSION_FILE for workspace in workspaces]
    return sorted({line.strip() for path in paths if path.is_file() for line in read_text(path).splitlines()})


def _in_order(names: set[str], known: tuple[str, ...]) -> list[str]:
    return [name for name in known if name in names] + sorted(names - set(known))


def _dev_set(workspace: Path, row: str) -> str:
    own = f"dev.{row.removeprefix('train.')}"
    return own if any((workspace / row).glob(f"decode_{own}_*")) else DEV


@dataclass(frozen=True)
class Scores:
    """Errors of all systems on one evaluation set; lists have one array per seed.

    Attributes
    ----------
    counts : dict of list of ndarray, each of shape (n_utterances, 3)
        Substitutions, deletions and insertions by system.
    words : list of ndarray, each of shape (n_utterances,)
        Words of the reference.
    utterances : list of list of str, each of length n_utterances
        Identifier of each utterance.
    sources : list of list of str, each of length n_utterances
        RIR of each utterance; of clean speech the speaker.
    rooms : list of ndarray, each of shape (n_utterances,)
        Indices into `room_names`.
    room_names : list of str
        Clean speech has no rooms; its speakers take their place.
    has_rooms : bool
        False for clean speech.
    """

    counts: dict[System, list[IntArray]]
    words: list[IntArray]
    utterances: list[list[str]]
    sources: list[list[str]]
    rooms: list[IntArray]
    room_names: list[str]
    has_rooms: bool

    def word_table(self, room_names: list[str]) -> FloatArray:
        """Return the words of each seed and room, shape (n_seeds, n_rooms)."""
        return self._table(self.words, room_names)

    def error_table(self, system: System, room_names: list[str]) -> FloatArray:
        """Return the errors of a system for each seed and room, shape (n_seeds, n_rooms)."""
        return self._table([counts.sum(axis=1) for counts in self.counts[system]], room_names)

    def _table(self, values: Sequence[IntArray], room_names: list[str]) -> FloatArray:
        position = {name: n for n, name in enumerate(room_names)}
        index = np.array([position[name] for name in self.room_names])
        return np.array([np.bincount(index[rooms], weights=of_seed, minlength=len(room_names))
                         for rooms, of_seed in zip(self.rooms, values, strict=True)])


def read_scores(decodings: Decodings, set_name: str, weights: dict[System, list[Weights]],
                room_of_rir: dict[str, str]) -> Scores:
    """Count the errors of all systems on a set.

    Parameters
    ----------
    weights
        Weights to score each system with, one per seed.

    Raises
    ------
    ValueError
        References differ between systems, an utterance has no hypothesis or RIR, or its RIR is unknown.
    """
    systems = decodings.systems(set_name)
    counts: dict[System, list[IntArray]] = {system: [] for system in systems}
    words, utterances, sources = [], [], []
    for seed, workspace in enumerate(decodings.workspaces):
        reference = read_shared_reference(decodings, seed, set_name)
        for system in systems:
            path = weights[system][seed].path(decodings.decode_dir(seed, system, set_name))
            counts[system].append(count_errors(list(reference.values()), read_hypotheses(path, reference)))
        words.append(np.array([len(spoken) for spoken in reference.values()]))
        utterances.append(list(reference))
        sources.append(_read_sources(workspace / "data" / set_name, reference, room_of_rir))
    room_of = {source: source if _is_clean(set_name) else room_of_rir[source] for source in set().union(*sources)}
    room_names = sorted(set(room_of.values()))
    index = {name: n for n, name in enumerate(room_names)}
    rooms = [np.array([index[room_of[source]] for source in of_seed]) for of_seed in sources]
    return Scores(counts, words, utterances, sources, rooms, room_names, has_rooms=not _is_clean(set_name))


def read_shared_reference(decodings: Decodings, seed: int, set_name: str) -> Texts:
    """Read the reference of a set, which must be the same for all systems."""
    first_dir, *other_dirs = [decodings.decode_dir(seed, system, set_name) for system in decodings.systems(set_name)]
    shared = read_reference(first_dir)
    for decode in other_dirs:
        reference = read_reference(decode)
        for utterance in [*shared, *reference]:
            if reference.get(utterance) != shared.get(utterance):
                raise ValueError(f"{scoring_dir(decode)}/{REFERENCE_FILE}: reference of {utterance!r} is not that of "
                                 f"{first_dir}: rows are compared on the same speech, decode them on one data "
                                 "directory")
    return shared


def _read_sources(data: Path, reference: Texts, room_of_rir: dict[str, str]) -> list[str]:
    """Return the RIR of each utterance of a data directory; the speaker if it is clean speech."""
    clean = _is_clean(data.name)
    path = data / ("utt2spk" if clean else "utt2rir")
    table, sources = read_texts(path), []
    for utterance in reference:
        source = " ".join(table.get(utterance, ()))
        if not source:
            raise ValueError(f"{path}: no {'speaker' if clean else 'RIR'} of utterance {utterance!r}: make the data "
                             "directory again")
        if not clean and source not in room_of_rir:
            raise ValueError(f"{path}: RIR {source!r} of utterance {utterance!r} is not among those of --rirs: give "
                             "the RIR directory that the set was made with")
        sources.append(source)
    return sources


def _is_clean(set_name: str) -> bool:
    return set_name.endswith(".clean")


def choose_all_weights(decodings: Decodings) -> dict[System, list[Weights]]:
    """Return the weights of each system and seed, chosen on its development set."""
    return {system: [choose_weights(decodings.decode_dir(seed, system, decodings.dev_of[system.row]))
                     for seed in range(len(decodings.workspaces))] for system in decodings.systems()}
