"""Hashes of everything that an output depends on: files, directories, audio that they refer to, and the code."""

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
from roomeq.core.stamps import DONE_FILE, is_as_stamped, read_stamp

_NUMERICS = ("embreex", "numba", "numpy", "scikit-learn", "scipy", "soundfile", "soxr", "trimesh")


def digest(path: Path) -> str:
    """Return a hash of a file's content or of a directory's.

    A directory that a `Build` made is hashed by the content hashes in its stamp (a file that has changed since is read
    again), and by the stamp's key where it refers to audio elsewhere. Any other directory (a corpus of many gigabytes)
    is hashed by name, size and modification time of its files.

    Raises
    ------
    ValueError
        There is no such path, or the directory has the formats of another version of roomeq.
    """
    path = Path(path)
    if path.is_file():
        return hash_file(path)
    if not path.is_dir():
        raise ValueError(f"{path}: no such file or directory: check the path, or run the step that makes it")
    stamp = read_stamp(path)
    stamped_ns = (path / DONE_FILE).stat().st_ctime_ns if stamp else 0
    stamped = stamp.files if stamp else {}
    total = hashlib.sha256(stamp.key.encode() if stamp and stamp.refers else b"")
    for file in files_below(path):
        name, stat = str(file.relative_to(path)), file.stat()
        if name not in stamped and stamped:
            continue  # a file that others (Kaldi) put beside ours is not an input
        if name in stamped and is_as_stamped(file, *stamped[name], stamped_ns):
            state = stamped[name][1]
        elif stamped:
            state = hash_file(file)
        else:
            state = f"{stat.st_size} {stat.st_mtime_ns}"
        total.update(f"{name}\0{state}\n".encode(errors="surrogateescape"))
    for file in [] if stamped else _audio_in_tables(path):
        total.update(f"{file} {_size_and_time(file)}\n".encode(errors="surrogateescape"))
    return total.hexdigest()


def audio_digest(paths: Iterable[Path]) -> str:
    """Return a hash of files by name, size and modification time, for an output that is made of a list of files.

    A file that is absent is hashed as absent: reading it raises the error.
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


def _audio_in_tables(directory: Path) -> Iterator[Path]:
    """Yield the audio files that the tables of an RIR directory name; the reader reports lines that are wrong."""
    for name in ("rirs.jsonl", "noises.jsonl"):
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
            for line in (directory / name).read_text(encoding="utf-8").splitlines():
                yield directory / json.loads(line)["wav"]


def files_below(directory: Path) -> list[Path]:
    """Return all files below a directory except hidden ones, in a fixed order; a linked folder is entered once."""
    files, entered = [], set()
    for folder, folders, names in os.walk(directory, followlinks=True):
        real = os.path.realpath(folder)
        if real in entered:  # a link to a folder above would never end
            folders.clear()
            continue
        entered.add(real)
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        paths = (Path(folder) / name for name in sorted(names) if not name.startswith("."))
        files += [path for path in paths if path.is_file()]
    return files


@cache
def code_digest() -> str:
    """Return a hash of the package's source and of the versions of Python and of the numerical libraries."""
    total = hashlib.sha256(f"Python {platform.python_version_tuple()[:2]}".encode())
    for name in _NUMERICS:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            total.update(f"{name} {importlib.metadata.version(name)}".encode())
    total.update(source_digest(Path(__file__).parents[1]).encode())
    return total.hexdigest()


def source_digest(*paths: Path) -> str:
    """Return a hash of Python files, given one by one or as folders."""
    total = hashlib.sha256()
    for path in paths:
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            total.update(file.read_bytes())
    return total.hexdigest()
