"""Read the results of a run. Absent results raise `Missing`; malformed results raise `ValueError`."""

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from roomeq.core.arrays import FloatArray
from roomeq.core.digests import digest
from roomeq.core.files import read_json
from roomeq.core.stamps import read_stamp
from roomeq.records.rir_dir import ROWS_FILE, load_rir, read_rirs
from roomeq.records.schema import RirRow
from roomeq.report.kinds import EXTENDED, KIND_NAMES, KINDS

T = TypeVar("T")
Context = dict[str, Any]
"""Values that a section passes to its template."""

STAGES = (("rirs.real", 1, "characterise and split-rirs"), ("rirs.sim.EQ", 4, "compensate"),
          ("rirs.sim.loop", 5, "simulate --model"), ("loop", 5, "close-loop"), ("wer", 10, "wer"),
          ("rirs.sim.free", 2, "simulate --rooms"), ("rirs.sim", 2, "simulate"), ("eq", 3, "fit-eq"),
          ("measured", 0, "read-measured"))
"""Prefix of a directory's name, the stage that writes it and its verb."""

IN_EXP = ("eq", "loop", "wer")
"""Directories below `exp_dir`."""

OTHER_WER = "{} is of other data: run stages 8 to 10"

SETS = ("train", "dev", "test")


class Missing(Exception):  # noqa: N818 - not an error: the section states it and the page goes on
    """A section needs a part of the run that is absent.

    Parameters
    ----------
    part : str
        The absent part, e.g. ``"data/rirs.sim.EQ.train"``.
    maker : str
        The step that writes it, e.g. ``"stage 4 (roomeq compensate)"``.
    """

    def __init__(self, part: str, maker: str) -> None:
        super().__init__(f"{part} is missing: run {maker}")
        self.part, self.maker = part, maker


def maker(name: str) -> str:
    """Name the stage and the verb that write a directory of a run."""
    if name.endswith(".rvb"):
        stage, verb = 6, "augment"
    elif name.endswith(".clean"):
        stage, verb = 0, "prepare-speech"
    else:
        stage, verb = next((stage, verb) for prefix, stage, verb in STAGES if name.startswith(prefix))
    return f"stage {stage} (roomeq {verb})"


@dataclass(eq=False)
class Run:
    """The results of one run.

    Parameters
    ----------
    data_dir, exp_dir : Path
        Directories of the RIRs and data sets, and of the fitted models.
    kinds : tuple of str
        Kinds of RIRs (`roomeq.report.kinds`) that belong to the run; what is there of others is of an earlier one.
    """

    data_dir: Path
    exp_dir: Path
    kinds: tuple[str, ...] = KIND_NAMES
    _cache: dict[Hashable, Any] = field(default_factory=dict, init=False, repr=False)

    def cached(self, key: Hashable, compute: Callable[[], T]) -> T:
        """Return the result of `compute()`, which runs once for each key."""
        if key not in self._cache:
            self._cache[key] = compute()
        result: T = self._cache[key]
        return result

    def path(self, name: str) -> Path:
        """Return the path of a directory, which may be absent."""
        return (self.exp_dir if name in IN_EXP else self.data_dir) / name

    def label(self, name: str) -> str:
        """Return the name of a directory as the page shows it, without the path of the run."""
        return f"{'exp' if name in IN_EXP else 'data'}/{name}"

    def has(self, name: str) -> bool:
        """Tell whether a directory exists and belongs to the run."""
        return (self.path(name).is_dir() and set(KIND_NAMES).difference(self.kinds).isdisjoint(_kinds_in(name))
                and (name != "wer" or not self.other_wer))

    @cached_property
    def other_wer(self) -> bool:
        """Whether the word error rates are of other far-field speech than is there: that of an earlier run."""
        path = self.path("wer") / "wer.json"
        try:
            stated = read_json(path).get("data", {}) if path.is_file() else {}
            return any(digest(self.path(name)) not in hashes for name, hashes in stated.items()
                       if name.endswith(".rvb") and self.has(name))
        except (ValueError, AttributeError, TypeError):  # not what roomeq wer writes; the section says so
            return False

    def need(self, name: str, file: str | None = None) -> Path:
        """Return the path of a directory or of a file in it.

        Raises
        ------
        Missing
            It is absent, or of another run.
        """
        path = self.path(name) / file if file else self.path(name)
        if not self.has(name) or not path.exists():
            raise Missing("/".join(part for part in (self.label(name), file) if part), maker(name))
        return path

    def all_rirs(self, name: str) -> list[RirRow]:
        """Return the rows of an RIR directory, those of noise sources included."""
        self.need(name, ROWS_FILE)
        return self.cached(("rirs", name), lambda: read_rirs(self.path(name)))

    def rirs(self, name: str) -> list[RirRow]:
        """Return the rows of an RIR directory without those of noise sources."""
        return [row for row in self.all_rirs(name) if not row.get("noise_for")]

    def rir(self, name: str, row: RirRow) -> FloatArray:
        """Return the samples of an RIR."""
        return load_rir(self.path(name), row)

    def options(self, name: str) -> dict[str, Any]:
        """Return the options of the step that wrote a directory, or {} if it has no stamp."""
        stamp = read_stamp(self.path(name))
        return stamp.options if stamp else {}

    @cached_property
    def names(self) -> list[str]:
        """Names of the existing directories that the report reads."""
        candidates = ["measured", *(f"{split}.clean" for split in SETS), "rirs.real",
                      *(f"rirs.{kind.name}.{split}" for kind in KINDS for split in SETS), *IN_EXP,
                      *(f"{split}.{kind.name}.rvb" for kind in KINDS for split in SETS)]
        return [name for name in candidates if self.has(name)]

    @cached_property
    def benches(self) -> list[str]:
        """Result files of the benches, relative to `exp_dir`."""
        return [f"bench/{name}{suffix}" for name in ("fidelity", "speed") for suffix in (".json", ".png")
                if (self.exp_dir / "bench" / f"{name}{suffix}").is_file()]


def _kinds_in(name: str) -> tuple[str, ...]:
    """Return what a directory's name may say of its kind: that of ``rirs.KIND.train`` and of ``train.KIND.rvb``."""
    return (EXTENDED.name,) if name == "loop" else (name.removeprefix("rirs.").rpartition(".")[0],
                                                    name.removesuffix(".rvb").partition(".")[2])


def read_pairs(path: Path) -> dict[str, str]:
    """Return a Kaldi table (key, space, rest of the line); {} if the file is absent."""
    if not path.is_file():
        return {}
    lines = path.read_text(encoding="utf-8").splitlines()
    return {key: value for key, _, value in (line.partition(" ") for line in lines)}


def read_numbers(path: Path) -> dict[str, float]:
    """Return a Kaldi table of numbers.

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


def is_synthetic(run: Run, name: str) -> bool:
    """Tell whether the README of a directory's corpus states that the corpus is generated.

    The README lies in one of the six directories above the first audio file.
    """
    audio = _first_audio(run.path(name))
    for folder in list(audio.parents)[:6] if audio else []:
        if (folder / "README").is_file():
            return (folder / "README").read_text(encoding="utf-8", errors="replace").startswith("Generated")
    return False


def synthetic_corpora(run: Run) -> list[str]:
    """Name the corpora of a run that are synthetic."""
    speech = any(is_synthetic(run, f"{split}.clean") for split in SETS)
    return ["measured RIRs"] * is_synthetic(run, "measured") + ["speech"] * speech


def _first_audio(directory: Path) -> Path | None:
    """Return the resolved path of the first audio file that a directory lists."""
    if (directory / ROWS_FILE).is_file():
        return (directory / read_rirs(directory)[0]["wav"]).resolve()
    entries = read_pairs(directory / "wav.scp")
    if not entries:
        return None
    from roomeq.kaldi.wavscp import parse_entry

    entry = parse_entry(next(iter(entries.values())))
    return None if entry.kind == "pipe" else Path(entry.text).resolve()
