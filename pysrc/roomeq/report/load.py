"""Reading a run's results for the report: what is not there raises `Missing`, what is broken `ValueError`."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from roomeq.core.build import DONE_FILE
from roomeq.core.files import read_json
from roomeq.kaldi.wavscp import parse_entry
from roomeq.records.rir_dir import ROWS_FILE, load_rir, read_rirs
from roomeq.report.page import Missing

STAGES = (("rirs.real", 1, "characterise and split-rirs"), ("rirs.sim.EQ", 4, "compensate"),
          ("rirs.sim.loop", 5, "simulate --model"), ("loop", 5, "close-loop"), ("wer", 10, "wer"),
          ("rirs.sim", 2, "simulate"), ("eq", 3, "fit-eq"), ("measured", 0, "read-measured"))
"""Beginning of a directory's name, the stage that makes it and its verb."""

IN_EXP = ("eq", "loop", "wer")
"""Directories that lie in `exp_dir`."""

SETS = ("train", "dev", "test")


ALL_KINDS = ("real", "sim", "sim.EQ", "sim.loop")
"""Of RIRs and of data made with them, as directories are named."""


def maker(name: str) -> str:
    """Say what makes a directory of a run."""
    if name.endswith(".rvb"):
        stage, verb = 6, "augment"
    elif name.endswith(".clean"):
        stage, verb = 0, "prepare-speech"
    else:
        stage, verb = next((stage, verb) for start, stage, verb in STAGES if name.startswith(start))
    return f"stage {stage} (roomeq {verb})"


@dataclass(frozen=True)
class Run:
    """The results of one run.

    Parameters
    ----------
    data_dir, exp_dir : Path
        Where stages 0-6 wrote data directories and models.
    """

    data_dir: Path
    exp_dir: Path
    _kept: dict = field(default_factory=dict, repr=False, compare=False)
    _rows: dict = field(default_factory=dict, repr=False, compare=False)

    def once(self, key, make: Callable):
        """Return what `make()` returned when it was first asked for under this key: what several sections need."""
        if key not in self._kept:
            self._kept[key] = make()
        return self._kept[key]

    def path(self, name: str) -> Path:
        """Return the path of a directory, which may not exist."""
        return (self.exp_dir if name in IN_EXP else self.data_dir) / name

    def has(self, name: str) -> bool:
        """Tell whether a directory is there."""
        return self.path(name).is_dir()

    def need(self, name: str, file: str | None = None) -> Path:
        """Return the path of a directory or of a file in it.

        Raises
        ------
        Missing
            It is not there.
        """
        path = self.path(name) / file if file else self.path(name)
        if not path.exists():
            folder = "exp" if name in IN_EXP else "data"
            raise Missing("/".join(part for part in (folder, name, file) if part), maker(name))
        return path

    def all_rirs(self, name: str) -> list[dict]:
        """Return the rows of an RIR directory, those of noise sources included."""
        if name not in self._rows:
            self.need(name, ROWS_FILE)
            self._rows[name] = read_rirs(self.path(name))
        return self._rows[name]

    def rirs(self, name: str) -> list[dict]:
        """Return the rows of an RIR directory without those of noise sources."""
        return [row for row in self.all_rirs(name) if not row.get("noise_for")]

    def rir(self, name: str, row: dict) -> np.ndarray:
        """Return the samples of an RIR."""
        return load_rir(self.path(name), row)

    def stamp(self, name: str) -> dict:
        """Return step and options that a directory was made with, or {} where it does not say."""
        path = self.path(name) / DONE_FILE
        return read_json(path) if path.is_file() else {}

    @cached_property
    def names(self) -> list[str]:
        """Names of the directories that are there and the report reads."""
        wanted = ["measured", *(f"{x}.clean" for x in SETS), "rirs.real",
                  *(f"rirs.{kind}.{x}" for kind in ALL_KINDS for x in SETS), *IN_EXP,
                  *(f"{x}.{kind}.rvb" for kind in ALL_KINDS for x in SETS)]
        return [name for name in wanted if self.has(name)]

    @cached_property
    def benches(self) -> list[str]:
        """Results of the benches that lie in `exp_dir`, relative to it."""
        return [f"bench/{name}{kind}" for name in ("fidelity", "speed") for kind in (".json", ".png")
                if (self.exp_dir / "bench" / f"{name}{kind}").is_file()]


def read_pairs(path: Path) -> dict[str, str]:
    """Return a Kaldi table (key, space, the rest of the line); {} where there is no such file."""
    if not path.is_file():
        return {}
    lines = path.read_text(encoding="utf-8").splitlines()
    return {key: value for key, _, value in (line.partition(" ") for line in lines)}


def read_numbers(path: Path) -> dict[str, float]:
    """`read_pairs` with numbers as values.

    Raises
    ------
    ValueError
        A value is not a number; the message names file and key.
    """
    numbers = {}
    for key, value in read_pairs(path).items():
        try:
            numbers[key] = float(value)
        except ValueError:
            raise ValueError(f"{path}: {key}: {value!r} must be a number: make the directory again") from None
    return numbers


def corpus_readme(run: Run, name: str) -> str:
    """Return the README of the corpus that a directory's audio lies in, or an empty text.

    A generated corpus says so there. The corpus is found through the first audio file, up to six folders above it.
    """
    first = _first_audio(run.path(name))
    for folder in list(first.parents)[:6] if first else []:
        if (folder / "README").is_file():
            return (folder / "README").read_text(encoding="utf-8", errors="replace")[:2000]
    return ""


def _first_audio(directory: Path) -> Path | None:
    """Return the resolved path of the first audio file that a directory names."""
    if (directory / ROWS_FILE).is_file():
        return (directory / read_rirs(directory)[0]["wav"]).resolve()
    entries = read_pairs(directory / "wav.scp")
    if not entries:
        return None
    entry = parse_entry(next(iter(entries.values())))
    return None if entry.kind == "pipe" else Path(entry.text).resolve()
