"""Damage drawn at random: one file of the smallest recipe changes between two of its steps, then a step runs again.

Afterwards either all files are as they were in an undisturbed run, or a command has refused in one line that names the
file. Examples are drawn by number, not by hypothesis: steps, places and kinds of damage come round in turn, so that few
examples reach all of them, and an example has nothing to shrink.
"""

import os
import random
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from commands import call
from pipeline import REPORT, STEPS, Step, put_corpora

from roomeq.report.section_data import UNSTAMPED

RECIPE = (*STEPS, REPORT)
MADE = tuple(dict.fromkeys(directory for step in RECIPE for directory in step.makes))
PAGE = "exp/report/index.html"
FROM_THE_START = Step("all steps", "", MADE)
"""All steps, run in turn until one refuses, as `run.sh` does."""


def flip(rng: random.Random, path: Path, other: Path) -> None:
    """Change one bit."""
    content = bytearray(path.read_bytes())
    content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    path.write_bytes(content)


def cut(rng: random.Random, path: Path, other: Path) -> None:
    """Cut the end off."""
    os.truncate(path, rng.randrange(1, path.stat().st_size))


def empty(rng: random.Random, path: Path, other: Path) -> None:
    """Leave nothing in the file."""
    os.truncate(path, 0)


def remove(rng: random.Random, path: Path, other: Path) -> None:
    """Take the file away."""
    path.unlink()


def swap(rng: random.Random, path: Path, other: Path) -> None:
    """Let two files change their names."""
    between = path.with_name("between")
    path.rename(between)
    other.rename(path)
    between.rename(other)


def age(rng: random.Random, path: Path, other: Path) -> None:
    """Put other content of the same size there, with an older time of modification."""
    before = path.stat()
    content = bytearray(path.read_bytes())
    start = rng.randrange(len(content))
    content[start:start + 50] = bytes(byte ^ rng.randrange(1, 256) for byte in content[start:start + 50])
    path.write_bytes(content)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns - rng.randrange(2) * 10**12))


KINDS: tuple[Callable[[random.Random, Path, Path], None], ...] = (flip, cut, empty, remove, swap, age)
PLACES = ("output", "input", "referred")


class Example(NamedTuple):
    """What was damaged, which step ran then, and what came of it; `ok` if that is as it must be."""

    step: str
    place: str
    kind: str
    file: str
    outcome: str
    ok: bool


class World:
    """Steps that have run, of which files are damaged, and which run again and are restored.

    Parameters
    ----------
    root : Path
        Directory in which the steps run. It must be the current one.
    steps : sequence of Step
        Default: the whole recipe.
    """

    def __init__(self, root: Path, steps: Sequence[Step] = RECIPE) -> None:
        self.root = root
        if steps is RECIPE:
            put_corpora(root)
        for step in steps:
            status, said = call(step.argv)
            assert status == 0, said
        self.right = self.contents()

    def contents(self) -> dict[str, bytes]:
        """Return the files of the world but locks."""
        return {str(path.relative_to(self.root)): path.read_bytes() for path in sorted(self.root.rglob("*"))
                if path.is_file() and path.suffix != ".lock"}

    def restore(self) -> None:
        """Put all files back as they were; nothing else stays."""
        found = self.contents()
        for name in found.keys() - self.right.keys():
            (self.root / name).unlink()
        for name, content in self.right.items():
            if found.get(name) != content:
                (self.root / name).parent.mkdir(parents=True, exist_ok=True)
                (self.root / name).write_bytes(content)

    def wrong(self, directories: Iterable[str]) -> list[str]:
        """Return the files in some directories that are not as they were in the undisturbed run, but for stamps."""
        now, within = self.contents(), tuple(f"{directory}/" for directory in directories)
        return [name for name in sorted(self.right.keys() | now.keys()) if now.get(name) != self.right.get(name)
                and name.startswith(within) and not any(part.startswith(".") for part in Path(name).parts)]

    def example(self, number: int) -> Example:
        """Damage a file, run a step, and restore the world; the number decides what is damaged and how."""
        rng = random.Random(f"damage {number}")
        step, place, kind = CASES[number % len(CASES)]
        directories = dict(output=step.makes, input=step.reads, referred=step.refers)[place]
        directory = rng.choice(directories)
        name = rng.choice([name for name in self.right if name.startswith(f"{directory}/") and self.right[name]])
        other = self._other(rng, directory, name)
        if kind is swap and other is None:
            kind = flip
        kind(rng, self.root / name, self.root / (other or name))
        try:
            outcome, ok = self._judge(step, {name, other} if kind is swap else {name})
        finally:
            self.restore()
        return Example(step.name, place, kind.__name__, f"{name} and {other}" if kind is swap else name, outcome, ok)

    def _other(self, rng: random.Random, directory: str, name: str) -> str | None:
        """Return a file of the same kind with other content."""
        stamp = Path(name).name == ".done"
        others = [other for other, content in self.right.items() if Path(other).suffix == Path(name).suffix
                  and (Path(other).name == ".done" if stamp else other.startswith(f"{directory}/"))
                  and content not in (self.right[name], b"")]
        return rng.choice(others) if others else None

    def _judge(self, step: Step, damaged: set[str]) -> tuple[str, bool]:
        for each in RECIPE if step is FROM_THE_START else [step]:
            status, said = call(each.argv)
            if status:
                named = any(name.removesuffix("/.done") in said for name in damaged)
                good = status == 1 and said.count("\n") == 1 and named and "internal error" not in said
                return f"{each.name}: exit {status}: {said.strip()}", good
        wrong = self.wrong(step.makes)
        if wrong == [PAGE] and UNSTAMPED in (self.root / PAGE).read_text():  # who removes a stamp takes it as it is
            return "said in the report", True
        return f"other results: {', '.join(wrong)[:300]}" if wrong else "same bytes", not wrong


_PLACES = [(step, place) for step in (*RECIPE, FROM_THE_START) for place, directories in
           zip(PLACES, (step.makes, step.reads, step.refers), strict=True) if directories]
CASES = [(step, place, kind) for n, kind in enumerate(KINDS) for step, place in _PLACES]
