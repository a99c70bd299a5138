"""Running a case as `roomeq` would be: what it printed, and what it did to the files."""

import contextlib
import io
import os
import shutil
import traceback
from pathlib import Path

from right import WORLDS, put_earlier
from wrong import Case

from roomeq.cli import main
from roomeq.core.limits import LIMITS

STEPS = ("read-measured", "read-noises", "characterise", "simulate", "fit-eq", "compensate", "augment", "wer",
         "report")
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


def call(argv: list[str]) -> tuple[int, str]:
    """Run the command line in this process: exit status and what it wrote to stderr; a traceback is status 99."""
    said, bounds = io.StringIO(), {limit.variable: os.environ.get(limit.variable, "") for limit in LIMITS}
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        try:
            status = main(argv)
        except SystemExit as stop:
            status = stop.code
        except BaseException:
            traceback.print_exc(file=said)
            status = 99
        finally:
            os.environ.update(bounds)
    return status, said.getvalue()
