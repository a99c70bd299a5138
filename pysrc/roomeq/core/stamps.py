"""The stamp of a directory that roomeq made, and whether a result may go to a place."""

import os
from pathlib import Path

from roomeq.core.files import hash_file, read_json

DONE_FILE = ".done"
_HELD = {"step": str, "key": str, "files": dict}


def read_stamp(directory: Path) -> dict:
    """Return what a directory's stamp says: `step, options, key`, and `files` {name: [size, hash]}; or {}.

    Raises
    ------
    ValueError
        The stamp is not one of ours.
    """
    path = Path(directory) / DONE_FILE
    if not path.is_file():
        return {}
    stamp = read_json(path)
    whole = isinstance(stamp, dict) and all(isinstance(stamp.get(key), kind) for key, kind in _HELD.items())
    if not whole or not all(isinstance(entry, list) and list(map(type, entry)) == [int, str]
                            for entry in stamp["files"].values()):
        raise ValueError(f"{path}: is no stamp of roomeq ({', '.join(_HELD)}): remove {directory} and make it again")
    return stamp


def as_sealed(path: Path, size: int, content: str, sealed_ns: int) -> bool:
    """Tell whether a file is what its directory's stamp says; it is read only if it has changed since then.

    Parameters
    ----------
    size, content
        The stamp's entry.
    sealed_ns : int
        When the stamp was written: its `st_ctime_ns`.
    """
    stat = path.stat()
    # by the inode's time: a file put back from elsewhere keeps its own time of change
    return stat.st_size == size and (stat.st_ctime_ns <= sealed_ns or hash_file(path) == content)


def check_output(out: Path, step: str, inputs: list[Path]) -> None:
    """Refuse an output that could not be made, or that would replace what is none of this step's making.

    Raises
    ------
    ValueError
        `out` is no name of a directory, a link, a file, a directory of somebody else or of another step, or one
        that an input lies in.
    """
    if not out.name or out.name == ".." or any(c in str(out) for c in "\n\r\0"):
        raise ValueError(f"output {str(out)!r} must name a directory to make, without line breaks: choose another")
    if out.is_symlink():
        raise ValueError(f"{out}: is a link, and would be replaced: give the directory that it leads to "
                         "(directories above may be links)")
    for path in inputs:
        if _lies_in(path, out):
            raise ValueError(f"{out}: input {path} lies in it and would be lost: choose another output")
    if not out.exists() or (out.is_dir() and not any(out.iterdir())):
        return
    made_by = read_stamp(out).get("step") if out.is_dir() else None
    if made_by is None:
        raise ValueError(f"{out}: exists and was not made by roomeq (no {DONE_FILE} in it): "
                         "choose another output, or move it away")
    if made_by != step:
        raise ValueError(f"{out}: was made by another step ({made_by}, not {step}): choose another output, or "
                         "remove it")


def _lies_in(path: Path, directory: Path) -> bool:
    return Path(os.path.realpath(path)).is_relative_to(os.path.realpath(directory))
