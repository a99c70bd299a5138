"""What an output depends on, as hashes: files, directories, audio that lies elsewhere, and the code itself."""

import contextlib
import hashlib
import importlib.metadata
import json
import os
import platform
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

from roomeq.core.files import hash_file
from roomeq.core.stamps import DONE_FILE, as_sealed, read_stamp

_NUMERICS = ("embreex", "numba", "numpy", "scikit-learn", "scipy", "soundfile", "soxr", "trimesh")


def digest(path: Path) -> str:
    """Return a hash of a file's content or of a directory's.

    Files of a directory that a `Build` made count by the content hash in its stamp (unless changed since), and
    with its key where they refer to audio elsewhere; files of any other directory (a corpus of many gigabytes)
    count by name, size and time of change.

    Raises
    ------
    ValueError
        There is no such path.
    """
    path = Path(path)
    if path.is_file():
        return hash_file(path)
    if not path.is_dir():
        raise ValueError(f"{path}: no such file or directory: check the path, or run the step that makes it")
    stamp = read_stamp(path)
    sealed_ns = (path / DONE_FILE).stat().st_ctime_ns if stamp else 0
    stamped = stamp.get("files", {})
    total = hashlib.sha256(stamp["key"].encode() if stamp.get("refers") else b"")
    for file in files_below(path):
        name, stat = str(file.relative_to(path)), file.stat()
        if name not in stamped and stamped:
            continue  # what others (Kaldi) put beside our files is not our input
        if name in stamped and as_sealed(file, *stamped[name], sealed_ns):
            mark = stamped[name][1]
        elif stamped:
            mark = hash_file(file)
        else:
            mark = f"{stat.st_size} {stat.st_mtime_ns}"
        total.update(f"{name}\0{mark}\n".encode(errors="surrogateescape"))
    for file in [] if stamped else _named_audio(path):
        total.update(f"{file} {_size_and_time(file)}\n".encode(errors="surrogateescape"))
    return total.hexdigest()


def audio_digest(paths: Iterable[Path]) -> str:
    """Return a hash of files by name, size and time of change: what an output made of a list of files depends on.

    Absent files count as such: whoever reads them says so.
    """
    total = hashlib.sha256()
    for path in paths:
        total.update(f"{path} {_size_and_time(path)}\n".encode(errors="surrogateescape"))
    return total.hexdigest()


def _size_and_time(path: Path) -> tuple[int, int] | None:
    try:
        stat = path.stat()
    except (OSError, ValueError):
        return None
    return stat.st_size, stat.st_mtime_ns


def _named_audio(directory: Path) -> Iterator[Path]:
    """Yield the audio that tables of an RIR directory name; lines that are wrong are the reader's business."""
    for name in ("rirs.jsonl", "noises.jsonl"):
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
            for line in (directory / name).read_text(encoding="utf-8").splitlines():
                yield directory / json.loads(line)["wav"]


def files_below(directory: Path) -> list[Path]:
    """Return all files below a directory, hidden ones left out, in a fixed order; each folder once, links or not."""
    found, seen = [], set()
    for folder, folders, names in os.walk(directory, followlinks=True):
        place = os.path.realpath(folder)
        if place in seen:  # links to links, or to a folder above: there would be no end
            folders.clear()
            continue
        seen.add(place)
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        paths = (Path(folder) / name for name in sorted(names) if not name.startswith("."))
        found += [path for path in paths if path.is_file()]
    return found


@cache
def code_digest() -> str:
    """Return a hash of the package's source and of what computes for it: other code's results are not up to date."""
    total = hashlib.sha256(f"Python {platform.python_version_tuple()[:2]}".encode())
    for name in _NUMERICS:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            total.update(f"{name} {importlib.metadata.version(name)}".encode())
    total.update(source_digest(Path(__file__).parents[1]).encode())
    return total.hexdigest()


def source_digest(*paths: Path) -> str:
    """Return a hash of Python files, and of those below folders."""
    total = hashlib.sha256()
    for path in paths:
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            total.update(file.read_bytes())
    return total.hexdigest()
