"""Runs of the recipe that can be followed from stage to stage, and killed within one."""

import os
import re
import shutil
import threading
import time
from pathlib import Path

from recipe_run import kill, start

STAGES = (0, 1, 2, 3, 4, 5, 6, 7)
PARTS = ("run.sh", "path.sh", "cmd.sh", "pyproject.toml", "requirements.txt", "conf", "local", "steps", "utils",
         "pysrc")


def freeze(project_dir, tree):
    """Copy the recipe, so that a bench of an hour runs one code whatever is edited meanwhile."""
    if tree.is_dir():
        return tree
    building = tree.with_name(f".{tree.name}.part")
    shutil.rmtree(building, ignore_errors=True)
    building.mkdir(parents=True)
    for name in PARTS:
        path = project_dir / name
        if path.is_dir():
            shutil.copytree(path, building / name, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
        else:
            shutil.copy2(path, building / name)
    (building / ".venv").symlink_to((project_dir / ".venv").resolve())
    building.rename(tree)
    return tree


class Run:
    """One run of the recipe: its output so far, and when each stage began.

    Parameters
    ----------
    tree : Path
        Directory of `run.sh`.
    where : Path
        Everything but stand-in corpora is written below it.
    corpora : Path
        Where these are, or go.
    nj : int
    more : str
        Further options of `run.sh`.
    """

    _running: set["Run"] = set()

    def __init__(self, tree: Path, where: Path, corpora: Path, nj: int, *more: str):
        where.mkdir(parents=True, exist_ok=True)
        self.lines: list[str] = []
        self.began_s: dict[int, float] = {}
        self._changed = threading.Condition()
        self._process = start(tree, where, corpora, nj, *more)
        self._running.add(self)
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        for line in self._process.stdout:
            with self._changed:
                self.lines.append(line.rstrip("\n"))
                if found := re.match(r"\S+ run\.sh: stage (\d+):", line):
                    self.began_s[int(found[1])] = time.monotonic()
                self._changed.notify_all()
        with self._changed:
            self.began_s["end"] = time.monotonic()
            self._changed.notify_all()

    @property
    def stage(self) -> int | None:
        """The stage it is in, or was in last."""
        return max((stage for stage in self.began_s if stage != "end"), default=None)

    def wait(self) -> int:
        """Wait until it ends; return its exit status."""
        self._reader.join()
        self._running.discard(self)
        return self._process.wait()

    def wait_for(self, stage: int, then_s: float) -> bool:
        """Wait until so long after a stage has begun; False if the run ended before."""
        with self._changed:
            self._changed.wait_for(lambda: stage in self.began_s or "end" in self.began_s)
            if stage not in self.began_s:
                return False
            until_s = self.began_s[stage] + then_s
            return not self._changed.wait_for(lambda: "end" in self.began_s, max(0, until_s - time.monotonic()))

    def kill(self) -> None:
        """Kill it with everything it started."""
        kill(self._process, read=False)
        self._reader.join()
        self._running.discard(self)

    @classmethod
    def kill_all(cls) -> None:
        """Kill all that have not been waited for."""
        for run in list(cls._running):
            run.kill()

    def survivors(self) -> list[int]:
        """Return processes of its session that are still there some seconds after it was killed."""
        until_s = time.monotonic() + 5
        while (found := self._in_session()) and time.monotonic() < until_s:
            time.sleep(0.1)
        return found

    def _in_session(self) -> list[int]:
        found = []
        for path in Path("/proc").glob("[0-9]*/stat"):
            try:
                fields = path.read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if int(fields[3]) == self._process.pid and fields[0] not in "ZX":
                found.append(int(path.parent.name))
        return found

    def durations_s(self) -> dict[int, float]:
        """How long each stage took."""
        ends = [*list(self.began_s.values())[1:]]
        return {stage: end - began for (stage, began), end in zip(self.began_s.items(), ends, strict=False)}


def is_refusal(lines: list[str]) -> bool:
    """Tell whether a failed run said why in a line, without a traceback."""
    return bool(lines) and not any(line.startswith("Traceback") for line in lines) and re.match(
        r"(\d\d:\d\d:\d\d )?[\w./-]+: .+", lines[-1]) is not None


def leftovers(where: Path) -> list[str]:
    """Return what a run leaves behind when it is killed: work directories and temporary files."""
    found = []
    for folder, folders, names in os.walk(where):
        for name in [*folders, *names]:
            if re.search(r"\.part-[0-9a-f]{16}$|\.old$|\.tmp$", name):
                found.append(str(Path(folder, name).relative_to(where)))
    return sorted(found)
