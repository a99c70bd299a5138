"""The decode directories of Kaldi workspaces, one workspace a seed: what was decoded, and its errors by room."""

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from roomeq.wer.scoring import (
    BOOTCI_FILE,
    Weights,
    choose_weights,
    count_errors,
    read_bootci,
    read_hypotheses,
    read_reference,
    read_texts,
    scoring_dir,
)

logger = logging.getLogger(__name__)

ROWS = ("train.clean", "train.real.rvb", "train.sim.rvb", "train.sim.EQ.rvb", "train.sim.loop.rvb")
COLUMNS = ("fglarge", "tglarge", "tgmed", "tgsmall", "online")
"""Of the paper's Table 2, in its order; others come behind them."""
TEST, DEV = "test.real.rvb", "dev.real.rvb"
BASE, ORACLE, CLEAN = "train.sim.rvb", "train.real.rvb", "train.clean"


@dataclass(frozen=True)
class Decoded:
    """What all workspaces hold.

    Parameters
    ----------
    workspaces : list of Path
        One a seed.
    rows, columns : list of str
    dev_of : dict of str
        Development set by row: of the row's own kind, as in the paper, where it was decoded; else `DEV`.
    """

    workspaces: list[Path]
    rows: list[str]
    columns: list[str]
    dev_of: dict[str, str]

    def decode(self, seed: int, row: str, name: str, column: str) -> Path:
        """Return a decode directory."""
        return self.workspaces[seed] / row / f"decode_{name}_{column}"

    def sets_of(self, row: str) -> tuple[str, str]:
        """Return the names of a row's development and test set."""
        return self.dev_of[row], TEST

    def rows_of(self, name: str) -> list[str]:
        """Return the rows that were decoded on a set."""
        return [row for row in self.rows if name in self.sets_of(row)]

    def inputs(self) -> list[Path]:
        """Return what the result depends on, the RIRs apart."""
        found = []
        for seed, workspace in enumerate(self.workspaces):
            sets = sorted({name for row in self.rows for name in self.sets_of(row)})
            found += [path for name in sets for table in ("utt2rir", "utt2snr", "utt2spk")
                      if (path := workspace / "data" / name / table).is_file()]
            for row in self.rows:
                decodes = [self.decode(seed, row, name, column) for name in self.sets_of(row)
                           for column in self.columns]
                found += [scoring_dir(decode) for decode in decodes]
                found += [path for decode in decodes if (path := decode / BOOTCI_FILE).is_file()]
        return found


def compared(rows: list[str]) -> list[str]:
    """Return the rows that may close a part of the gap between `BASE` and `ORACLE`."""
    return [row for row in rows if row not in (BASE, ORACLE, CLEAN)]


def find_decoded(workspaces: list[Path]) -> Decoded:
    """Find rows and columns, which must be those of the first workspace in all of them.

    Only clean training data, with which nothing is compared, may be missing: it is left out where it is not in all.

    Raises
    ------
    ValueError
        A workspace holds none, or a decode directory of a row and column is missing.
    """
    for workspace in workspaces:
        if not workspace.is_dir():
            raise ValueError(f"{workspace}: no such Kaldi workspace: check the path, or run stages 8 to 10")
    if len({path.resolve() for path in workspaces}) < len(workspaces):
        raise ValueError(f"workspace {_repeated(workspaces)} is given twice: give each seed's once")
    first = workspaces[0]
    rows = _ordered({path.parent.name for path in first.glob("train.*/decode_*") if path.is_dir()}, ROWS)
    columns = _ordered({path.name.removeprefix(f"decode_{TEST}_") for row in rows
                        for path in (first / row).glob(f"decode_{TEST}_*")}, COLUMNS)
    if not columns:
        raise ValueError(f"{first}: no train.*/decode_{TEST}_* in it: run stages 8 to 10, or check the path")
    if CLEAN in rows and not all(any((workspace / CLEAN).glob("decode_*")) for workspace in workspaces):
        logger.warning("%s was not decoded in all workspaces: left out", CLEAN)
        rows.remove(CLEAN)
    decoded = Decoded(workspaces, rows, columns, {row: _dev_set(first, row) for row in rows})
    for seed in range(len(workspaces)):
        for row in rows:
            for name in decoded.sets_of(row):
                for column in columns:
                    path = scoring_dir(decoded.decode(seed, row, name, column))
                    if not path.is_dir():
                        raise ValueError(f"{path}: no such directory, but other rows, columns or seeds have it: decode "
                                         "and score it (stage 10), or leave the row or column out of all")
    return decoded


def _repeated(paths: list[Path]) -> Path:
    resolved = [path.resolve() for path in paths]
    return next(path for n, path in enumerate(paths) if path.resolve() in resolved[:n])


def _ordered(found: set[str], known: tuple[str, ...]) -> list[str]:
    return [name for name in known if name in found] + sorted(found - set(known))


def _dev_set(workspace: Path, row: str) -> str:
    own = f"dev.{row.removeprefix('train.')}"
    return own if any((workspace / row).glob(f"decode_{own}_*")) else DEV


@dataclass(frozen=True)
class Scores:
    """Errors of one set, all rows and columns that were decoded on it.

    Parameters
    ----------
    counts : dict of list of ndarray, each of shape (n_utterances, 3)
        By (row, column): of each seed, substitutions, deletions and insertions.
    words : list of ndarray, each of shape (n_utterances,)
        Of each seed's reference.
    rooms : list of ndarray, each of shape (n_utterances,)
        Index into `room_names`.
    room_names : list of str
        Clean speech has speakers for rooms.
    has_rooms : bool
    """

    counts: dict[tuple[str, str], list[np.ndarray]]
    words: list[np.ndarray]
    rooms: list[np.ndarray]
    room_names: list[str]
    has_rooms: bool

    def table(self, values: list[np.ndarray], room_names: list[str]) -> np.ndarray:
        """Return sums over the utterances of each seed and room, shape (n_seeds, n_rooms)."""
        place = {name: n for n, name in enumerate(room_names)}
        here = np.array([place[name] for name in self.room_names])
        return np.array([np.bincount(here[rooms], weights=one, minlength=len(room_names))
                         for rooms, one in zip(self.rooms, values, strict=True)])

    def errors(self, row: str, column: str, room_names: list[str]) -> np.ndarray:
        """Return `table` of a system's errors."""
        return self.table([one.sum(axis=1) for one in self.counts[row, column]], room_names)


def read_scores(decoded: Decoded, name: str, weights: dict, room_of: dict[str, str]) -> Scores:
    """Count the errors of a set at the weights chosen.

    Parameters
    ----------
    weights : dict of list of Weights
        By (row, column), one a seed.
    room_of : dict of str
        Room by RIR id.

    Raises
    ------
    ValueError
        References differ between rows or columns, an utterance has no hypothesis or RIR, or its RIR is unknown.
    """
    systems = [(row, column) for row in decoded.rows_of(name) for column in decoded.columns]
    counts, words, labels = {system: [] for system in systems}, [], []
    for seed, workspace in enumerate(decoded.workspaces):
        reference = same_reference(decoded, seed, name)
        for system in systems:
            path = weights[system][seed].path(decoded.decode(seed, system[0], name, system[1]))
            counts[system].append(count_errors(list(reference.values()), read_hypotheses(path, reference)))
        words.append(np.array([len(spoken) for spoken in reference.values()]))
        labels.append(_rooms(workspace / "data" / name, name, reference, room_of))
    names = sorted(set().union(*labels))
    index = {label: n for n, label in enumerate(names)}
    rooms = [np.array([index[label] for label in one]) for one in labels]
    return Scores(counts, words, rooms, names, has_rooms=not _is_clean(name))


def same_reference(decoded: Decoded, seed: int, name: str) -> dict[str, tuple[str, ...]]:
    """Return a set's reference, which all rows and columns must share."""
    first = None
    for row in decoded.rows_of(name):
        for column in decoded.columns:
            decode = decoded.decode(seed, row, name, column)
            reference = read_reference(decode)
            first = first or (reference, decode)
            for utterance in [*first[0], *reference]:
                if reference.get(utterance) != first[0].get(utterance):
                    raise ValueError(f"{scoring_dir(decode)}/test_filt.txt: reference of {utterance!r} is not that of "
                                     f"{first[1]}: rows are compared on the same speech, decode them on one data "
                                     "directory")
    return first[0]


def _rooms(data: Path, name: str, reference: dict, room_of: dict[str, str]) -> list[str]:
    """Return the room of each utterance; clean speech has none: its speaker."""
    path = data / ("utt2spk" if _is_clean(name) else "utt2rir")
    table, labels = read_texts(path), []
    for utterance in reference:
        label = " ".join(table.get(utterance, ()))
        if not label:
            raise ValueError(f"{path}: no {'speaker' if _is_clean(name) else 'RIR'} of utterance {utterance!r}: make "
                             "the data directory again")
        if not _is_clean(name):
            if label not in room_of:
                raise ValueError(f"{path}: RIR {label!r} of utterance {utterance!r} is not among those of --rirs: give "
                                 "the RIR directory that the set was made with")
            label = room_of[label]
        labels.append(label)
    return labels


def _is_clean(name: str) -> bool:
    return name.endswith(".clean")


def choose_all(decoded: Decoded) -> dict[tuple[str, str], list[Weights]]:
    """Return the weights of each row, column and seed, chosen on the development set."""
    chosen = {}
    for row in decoded.rows:
        for column in decoded.columns:
            chosen[row, column] = [
                choose_weights(decode, read_reference(decode)) for seed in range(len(decoded.workspaces))
                for decode in [decoded.decode(seed, row, decoded.dev_of[row], column)]]
    return chosen


def read_all_bootci(decoded: Decoded, row: str, name: str, column: str) -> list[dict | None]:
    """Return what Kaldi's own bootstrap said of a system, by seed."""
    return [read_bootci(decoded.decode(seed, row, name, column)) for seed in range(len(decoded.workspaces))]
