"""What the tables of bad inputs are written in: a case, and small ways of breaking a file.

A case names directories of `right` in its command line; they are copied, broken by its edits, and the command is
run there. Paths are relative to that copy.
"""

import json
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import soundfile

Edit = Callable[[Path], None]
HOSTILE = "it's \"$(touch evil)\" `touch evil`; é*"
"""What a shell, or a careless reader, would trip over."""


class Case(NamedTuple):
    """A command that must fail: `command` is split as a shell would, `message` is searched in the one line."""

    name: str
    command: str
    message: str
    edits: tuple[Edit, ...] = ()

    @property
    def argv(self) -> list[str]:
        return shlex.split(self.command)


def write(name: str, content: str | bytes) -> Edit:
    """Put a file there."""
    def edit(root: Path) -> None:
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return edit


def audio(name: str, samples, fs_hz: int = 16000, subtype: str = "PCM_16") -> Edit:
    """Put an audio file there; a number stands for so many samples of noise."""
    if isinstance(samples, int):
        samples = 0.1 * np.random.default_rng(0).standard_normal(samples).clip(-5, 5)

    def edit(root: Path) -> None:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        soundfile.write(root / name, samples, fs_hz, subtype=subtype)
    return edit


def remove(name: str) -> Edit:
    return lambda root: (root / name).unlink()


def cut(name: str, keep: float) -> Edit:
    """Keep only the first part of a file."""
    def edit(root: Path) -> None:
        data = (root / name).read_bytes()
        (root / name).write_bytes(data[:int(keep * len(data))])
    return edit


def patch(name: str, offset: int, data: bytes) -> Edit:
    """Overwrite bytes in place; a negative offset counts from the end."""
    def edit(root: Path) -> None:
        old = bytearray((root / name).read_bytes())
        offset_ = offset % len(old)
        old[offset_:offset_ + len(data)] = data
        (root / name).write_bytes(old)
    return edit


def line(name: str, number: int, text: str | None) -> Edit:
    """Replace a line (None: remove it; one behind the last: add it)."""
    def edit(root: Path) -> None:
        lines = (root / name).read_text().splitlines()
        lines[number - 1:number] = [] if text is None else [text]
        (root / name).write_text("".join(f"{one}\n" for one in lines))
    return edit


def reorder(name: str, order: Callable[[list[str]], list[str]]) -> Edit:
    """Replace the lines of a file by what a function makes of them."""
    def edit(root: Path) -> None:
        lines = order((root / name).read_text().splitlines())
        (root / name).write_text("".join(f"{one}\n" for one in lines))
    return edit


def row(name: str, number: int, _without: str = "", **keys) -> Edit:
    """Change keys of one line of a JSONL file."""
    def edit(root: Path) -> None:
        lines = (root / name).read_text().splitlines()
        changed = json.loads(lines[number - 1]) | keys
        changed.pop(_without, None)
        lines[number - 1] = json.dumps(changed)
        (root / name).write_text("".join(f"{one}\n" for one in lines))
    return edit


def keys(name: str, **changed) -> Edit:
    """Change keys of a JSON file."""
    def edit(root: Path) -> None:
        (root / name).write_text(json.dumps(json.loads((root / name).read_text()) | changed))
    return edit
