"""Decode directories of a Kaldi workspace: which systems were decoded, and on which sets."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from roomeq.core.files import read_text
from roomeq.wer.scoring import BOOTCI_FILE, scoring_dir

ROWS = ("train.clean", "train.real.rvb", "train.sim.free.rvb", "train.sim.rvb", "train.sim.EQ.rvb",
        "train.sim.loop.rvb")
COLUMNS = ("fglarge", "tglarge", "tgmed", "tgsmall", "online")
"""Rows (training data) and columns (language models) of the paper's Table 2, and the rows of drawn rooms and of the
closed loop; others follow."""
VERSION_FILE, SEED_FILE = "kaldi_version", "seed"
SOURCE_FILE = "source"
"""State of a data directory (``local/kaldi/copy_data.py``); copied to what was trained on it and decoded from it."""
CONTENT_FILE = "content"
"""Hash of a data directory (`roomeq.core.digests.digest`) that a step made, in the workspace's copy of it."""
SETTINGS_FILE = "settings"
"""Options of stages 8 to 10 that a row was trained and decoded with, a line each, in the row's directory."""
TEST, DEV = "test.real.rvb", "dev.real.rvb"
BASE, ORACLE, CLEAN = "train.sim.rvb", "train.real.rvb", "train.clean"


class System(NamedTuple):
    """Training data and language model of a recogniser."""

    row: str
    column: str


@dataclass(frozen=True)
class Workspace:
    """A Kaldi workspace, of one seed: every row was decoded with every column.

    Attributes
    ----------
    dev_of : dict of str
        Development set by row: of the row's own kind, as in the paper, if it was decoded; else `DEV`.
    """

    path: Path
    rows: list[str]
    columns: list[str]
    dev_of: dict[str, str]

    def decode_dir(self, system: System, set_name: str) -> Path:
        """Return the decode directory of a system and an evaluation set."""
        return self.path / system.row / f"decode_{set_name}_{system.column}"

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
        return [self.decode_dir(system, name) for name in self.set_names for system in self.systems(name)]

    def inputs(self) -> list[Path]:
        """Return the files and directories that word error rates depend on, except the RIRs."""
        tables = [self.path / "data" / name / table for name in self.set_names
                  for table in ("utt2rir", "utt2snr", "utt2spk")]
        optional = [*tables, *self._content_files().values(), self.path / VERSION_FILE,
                    *(decode / BOOTCI_FILE for decode in self.decode_dirs())]
        return [self.path / SEED_FILE, *map(scoring_dir, self.decode_dirs()),
                *(path for path in optional if path.is_file())]

    def _content_files(self) -> dict[str, Path]:
        return {name: self.path / "data" / name / CONTENT_FILE for name in [*self.rows, *self.set_names]}

    def contents(self) -> dict[str, str]:
        """Return the hash of each set that was trained on or decoded, by name, where it is known."""
        return {name: read_text(path).strip() for name, path in self._content_files().items() if path.is_file()}

    def seed(self) -> int:
        """Return the seed that all was drawn with.

        Raises
        ------
        ValueError
            The file `SEED_FILE` is missing or holds something else.
        """
        path = self.path / SEED_FILE
        text = read_text(path).strip() if path.is_file() else ""
        if not re.fullmatch(r"\d{1,9}", text, re.ASCII):
            raise ValueError(f"{path}: must hold the seed of the run: run stage 8 again, which writes it")
        return int(text)

    def require_present(self) -> None:
        """Raise ValueError for a model or a decoding of other data, or of another seed, than the workspace has now."""
        seed = self.seed()
        for row in self.rows:
            trained = self.path / row / SEED_FILE
            if not trained.is_file() or read_text(trained).strip() != str(seed):
                raise ValueError(f"{trained}: must hold the seed of the workspace, {seed}: run stages 8 to 10 with one "
                                 "seed for all rows")
            self._require_source(self.path / row, row, "trained on")
            for name in self.sets_of(row):
                for column in self.columns:
                    self._require_source(self.decode_dir(System(row, column), name), name, "decoded from")

    def _require_source(self, made: Path, name: str, how: str) -> None:
        now, then = self.path / "data" / name / SOURCE_FILE, made / SOURCE_FILE
        if not then.is_file() or not now.is_file() or read_text(then) != read_text(now):
            raise ValueError(f"{made}: was not {how} what {now.parent} holds now: run stages 8 to 10 again with this "
                             "row among --rows, or remove it")

    def kaldi_versions(self) -> list[str]:
        """Return the versions of Kaldi that worked in the workspace; see ``local/kaldi/check_kaldi.sh``."""
        path = self.path / VERSION_FILE
        return sorted({line.strip() for line in read_text(path).splitlines()}) if path.is_file() else []


def compared(rows: list[str]) -> list[str]:
    """Return the rows that may close a part of the gap between `BASE` and `ORACLE`."""
    return [row for row in rows if row not in (BASE, ORACLE, CLEAN)]


def find_workspaces(paths: Sequence[Path]) -> list[Workspace]:
    """Find rows and columns, those of the first workspace.

    Raises
    ------
    ValueError
        A workspace is missing or holds no decoding, or the decode directory of a row and column is missing, or of
        other data than the workspace holds.
    """
    for path in paths:
        if not path.is_dir():
            raise ValueError(f"{path}: no such Kaldi workspace: check the path, or run stages 8 to 10")
    resolved = [path.resolve() for path in paths]
    for n, path in enumerate(paths):
        if resolved[n] in resolved[:n]:
            raise ValueError(f"workspace {path} is given twice: give each seed's once")
    first = paths[0]
    rows = _in_order({path.parent.name for path in first.glob("train.*/decode_*") if path.is_dir()}, ROWS)
    columns = _in_order({path.name.removeprefix(f"decode_{TEST}_") for row in rows
                         for path in (first / row).glob(f"decode_{TEST}_*")}, COLUMNS)
    if not columns:
        raise ValueError(f"{first}: no train.*/decode_{TEST}_* in it: run stages 8 to 10, or check the path")
    dev_of = {row: _dev_set(first, row) for row in rows}
    workspaces = [Workspace(path, rows, columns, dev_of) for path in paths]
    for path in (scoring_dir(decode) for workspace in workspaces for decode in workspace.decode_dirs()):
        if not path.is_dir():
            raise ValueError(f"{path}: no such directory, but other rows, columns or seeds have it: decode and score "
                             "it (stage 10), or leave the row or column out of all")
    for workspace in workspaces:
        workspace.require_present()
    _require_same_settings([workspace.path / row for workspace in workspaces for row in workspace.rows])
    return workspaces


def _require_same_settings(rows: list[Path]) -> None:
    """Raise ValueError for two rows whose recognisers differ in more than their data."""
    files = [row / SETTINGS_FILE for row in rows]
    settings = [sorted(read_text(file).splitlines()) if file.is_file() else [] for file in files]
    for file, lines in zip(files, settings, strict=True):
        if lines != settings[0]:
            differing = sorted({line.split(" ")[0] for line in set(lines) ^ set(settings[0])})
            raise ValueError(f"{file}: is not as {files[0]} ({', '.join(differing)}): rows of other settings cannot be "
                             "compared; run stages 8 to 10 for all rows with the same options, remove the row, or "
                             "keep the rows of each in an --exp of its own")


def _in_order(names: set[str], known: tuple[str, ...]) -> list[str]:
    return [name for name in known if name in names] + sorted(names - set(known))


def _dev_set(workspace: Path, row: str) -> str:
    own = f"dev.{row.removeprefix('train.')}"
    return own if any((workspace / row).glob(f"decode_{own}_*")) else DEV
