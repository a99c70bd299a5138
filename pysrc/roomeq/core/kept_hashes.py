"""Hashes of files, kept as long as a quick look finds the file unchanged."""

import time
from pathlib import Path
from typing import Any

from roomeq.core.files import hash_file

SETTLED_NS = 2_000_000_000
"""Age of a file from which its hash is kept: a change within the clock's tick cannot be seen [ns]."""

Look = tuple[int, int, int, int]
"""Size, modification time [ns], inode's time [ns] and inode of a file."""


def quick_look(path: Path) -> Look:
    """Return what tells a changed file without reading it; the inode's time cannot be set back by a program.

    Raises
    ------
    OSError
        There is no such file.
    """
    stat = path.stat()
    return stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns, stat.st_ino


class KeptHashes:
    """Content hashes by path, each with the quick look at the file when it was read."""

    def __init__(self) -> None:
        self._known: dict[str, tuple[Look, str]] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        return KeptHashes, ()  # what a worker process gets with every item must be small

    def of(self, path: Path) -> str:
        """Return the hash of a file's content; read the file only if it may have changed since the last time.

        Raises
        ------
        OSError
            The file cannot be read.
        """
        look = quick_look(path)
        known_look, content_hash = self._known.get(str(path), (None, ""))
        if look != known_look:
            content_hash = hash_file(path)
            if time.time_ns() - look[2] > SETTLED_NS:
                self._known[str(path)] = look, content_hash
        return content_hash
