"""Losses of power at any place of a step, by the record of what it does to the file system; then it runs again."""

import random
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

from commands import call
from crash_replay import Disk, Files, Op, disk_after, files_of, record
from generated_damage import Example, World
from pipeline import Step

from roomeq.core.stamps import DONE_FILE

AUDIO_STEPS = ("prepare-speech", "read-measured", "read-noises", "simulate", "compensate", "augment real",
               "export lhotse", "export nemo")
"""Steps that write audio, one of each kind."""
TICK_S = 0.02
"""Files that are this old are older by the clock of any file system."""


class Losses:
    """A step that has been recorded while it made its output, and what a loss of power may have left of it.

    Parameters
    ----------
    world : World
        Its directory must be the current one.
    step : Step
    over_older : bool
        The step replaces an output that it made with another seed.
    """

    def __init__(self, world: World, step: Step, over_older: bool = False) -> None:
        self.world, self.step = world, step
        self.name = f"{step.name}, over an older output" if over_older else step.name
        self._clear()
        if over_older:
            assert call([*step.argv[:1], "--seed", "7", *step.argv[1:]])[0] == 0
            assert world.wrong(step.makes)
        self.before = files_of(world.root)
        self.ops: list[Op] = record(self._run, world.root, world.root.with_name(f"{world.root.name}.ops"))
        disk = Disk(self.before)
        for op in self.ops:
            disk.do(op)
        assert disk.files() == files_of(world.root), "something was written that is not in the record"
        assert not world.wrong(step.makes)

    def _run(self) -> None:
        status, said = call(self.step.argv)
        assert status == 0, said

    def _is_ours(self, name: str) -> bool:
        """Tell whether a file or directory belongs to the output, to a directory under construction, or to a lock."""
        for made in self.step.makes:
            folder, _, last = made.rpartition("/")
            if name == made or name.startswith((f"{made}/", f"{folder}/.{last}.")):
                return True
        return False

    def _clear(self) -> None:
        for name in files_of(self.world.root):
            path = self.world.root / name
            if self._is_ours(name) and path.exists():
                shutil.rmtree(path) if path.is_dir() else path.unlink()

    def states(self, kept: str, rng: random.Random) -> Iterator[Files]:
        """Yield the different states of the disk after each operation."""
        disk, seen = Disk(self.before), set()
        for op in self.ops:
            disk.do(op)
            state = {name: content for name, content in disk.on_disk(kept, rng).items() if self._is_ours(name)}
            key = frozenset(state.items())
            if key not in seen:
                seen.add(key)
                yield state

    def examples(self, kept: str, number: int | None, rng: random.Random) -> Iterator[Example]:
        """Yield what comes of losses of power, at all different states or at so many of them."""
        if kept == "some":
            found = [disk_after(self.before, self.ops[:rng.randrange(1, len(self.ops))], kept, rng)
                     for _ in range(number or 50)]
        else:
            found = list(self.states(kept, rng))
            found = found if number is None else rng.sample(found, min(number, len(found)))
        for state in found:
            yield self._example(kept, {name: content for name, content in state.items() if self._is_ours(name)})

    def after_the_end(self, kept: str, rng: random.Random) -> Example:
        """Return what comes of a loss of power after the last operation."""
        state = disk_after(self.before, self.ops, kept, rng)
        return self._example(kept, {name: content for name, content in state.items() if self._is_ours(name)})

    def _example(self, kept: str, state: Files) -> Example:
        self._clear()
        self._put(state)
        status, said = call(self.step.argv)
        wrong = [] if status else self.world.wrong(self.step.makes)
        refused = status == 1 and said.count("\n") == 1 and "internal error" not in said
        outcome = f"exit {status}: {said.strip()}" if status else f"other results: {wrong}" if wrong else "same bytes"
        self.world.restore()
        return Example(self.name, "power", kept, f"{len(state)} files", outcome, refused if status else not wrong)

    def _put(self, state: Files) -> None:
        """Write a state of the disk; stamps last, since a loss of power leaves files older than a stamp on the disk."""
        for name, content in state.items():
            if content is None:
                (self.world.root / name).mkdir(parents=True, exist_ok=True)
            elif Path(name).name != DONE_FILE:
                (self.world.root / name).write_bytes(content)
        time.sleep(TICK_S)
        for name, content in state.items():
            if content is not None and Path(name).name == DONE_FILE:
                (self.world.root / name).write_bytes(content)
