"""Running a case as `roomeq` would be: what it printed, and what it did to the files."""

import os
import shutil
from pathlib import Path

from commands import call
from right import WORLDS, put_earlier
from wrong import Case

__all__ = ["call", "set_up", "snapshot"]

STEPS = ("read-measured", "read-noises", "characterise", "simulate", "fit-eq", "compensate", "augment", "export",
         "wer", "report")
OUTPUTS = {"prepare-speech": [("out/train.clean", "prepare-speech")], "split-rirs": [("out.train", "split")]}


def set_up(case: Case, worlds: Path, root: Path) -> None:
    """Copy the directories that a case names, put an earlier result where its output goes, and break things."""
    named = {word.split("/")[0] for word in case.argv} & set(WORLDS)
    for name in named:
        shutil.copytree(worlds / name, root / name)
    for verb in set(case.argv) & (set(STEPS) | set(OUTPUTS)):
        for out, step in OUTPUTS.get(verb) or [("out", verb)]:
            put_earlier(root / out, step)
    for edit in case.edits:
        edit(root)


def snapshot(root: Path) -> dict[str, bytes | None]:
    """Return all files below a folder but the locks and the unfinished work of a `Build`."""
    found = {}
    for folder, folders, names in os.walk(root):
        folders[:] = [name for name in folders if ".part-" not in name]
        for name in [*names, *folders]:
            path = Path(folder) / name
            if not name.endswith(".lock"):
                found[str(path.relative_to(root))] = path.read_bytes() if path.is_file() else None
    return found
