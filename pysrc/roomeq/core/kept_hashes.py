"""Hashes of files, kept as long as a quick look finds the file unchanged.

Hashes of large inputs, such as a corpus of speech, are kept from run to run in the user's cache directory. They save
time only: a file that has changed in any way, or whose hash is not kept, is read.
"""

import contextlib
import fcntl
import hashlib
import json
import stat
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

from roomeq.core.files import hash_file, read_sealed, user_cache, write_sealed

SETTLED_NS = 2_000_000_000
"""Age of a file from which its hash is kept: a change within a tick of the clock cannot be seen [ns]."""
KEPT_FROM_BYTES = 64_000_000
"""Total size of files from which their hashes are kept from run to run; less is read in a moment."""
_THREADS = 4


class Look(NamedTuple):
    """What tells a changed file without reading it; no program can set the inode's time (ctime) back."""

    size: int
    mtime_ns: int
    ctime_ns: int
    inode: int


def quick_look(path: Path) -> Look | None:
    """Return what can be seen of a file without reading it, or None where there is no such (regular) file."""
    try:
        status = path.stat()
    except (OSError, ValueError):
        return None
    if not stat.S_ISREG(status.st_mode):
        return None
    return Look(status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino)


class KeptHashes:
    """Content hashes by path, each with the quick look at the file when it was read."""

    def __init__(self, known: dict[str, tuple[Look, str]] | None = None) -> None:
        self.known = known or {}

    def __reduce__(self) -> tuple[Any, ...]:
        return KeptHashes, ()  # what a worker process gets with every item must be small

    def find(self, path: Path) -> str | None:
        """Return the hash of a file that has not changed since it was read, else None."""
        look, content_hash = self.known.get(str(path), (None, None))
        return content_hash if look is not None and look == quick_look(path) else None

    def of(self, path: Path) -> str | None:
        """Return the hash of a file's content, or None where there is no such file; read it only if need be.

        Raises
        ------
        OSError
            The file cannot be read.
        """
        look, content_hash = quick_look(path), self.find(path)
        if look is None or content_hash is not None:
            return content_hash
        content_hash = hash_file(path)
        if time.time_ns() - look.ctime_ns > SETTLED_NS:
            self.known[str(path)] = look, content_hash
        return content_hash


_in_memory = KeptHashes()
"""Of small inputs that this process has read, and of others where no file holds their hashes."""


def hashes_of_input(name: str, paths: Iterable[Path]) -> list[str | None]:
    """Return the hashes of the files of an input; those of a large one are kept from run to run, others in memory.

    Parameters
    ----------
    name : str
        What tells this input from others.
    paths : iterable of Path

    Returns
    -------
    hashes : list
        A hash for each path, or None where there is no file.
    """
    paths = list(paths)
    if sum(look.size for path in paths if (look := quick_look(path))) < KEPT_FROM_BYTES:
        return _read_in_threads(_in_memory, paths)
    store = user_cache() / "hashes" / f"{hashlib.sha256(name.encode(errors='surrogateescape')).hexdigest()[:32]}.json"
    known = _read_store(store)
    if None not in (hashes := [known.find(path) for path in paths]):
        return hashes
    with _lock(store):  # one of several jobs reads the files, the others wait for it
        known = _read_store(store)
        hashes = _read_in_threads(known, paths)
        kept = {key: known.known[key] for path in paths if (key := str(path)) in known.known}
        with contextlib.suppress(OSError):
            write_sealed(store, json.dumps(kept))
    return hashes


def _read_in_threads(known: KeptHashes, paths: list[Path]) -> list[str | None]:
    if None not in (hashes := [known.find(path) for path in paths]):
        return hashes
    with ThreadPoolExecutor(_THREADS) as pool:
        return list(pool.map(known.of, paths))


def _read_store(store: Path) -> KeptHashes:
    """Return what is kept in a file; where it is absent or damaged, what is in memory: perhaps none can be written."""
    body = read_sealed(store)
    if body is None:
        return _in_memory
    return KeptHashes({path: (Look(*look), content_hash) for path, (look, content_hash) in json.loads(body).items()})


@contextlib.contextmanager
def _lock(store: Path) -> Iterator[None]:
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):  # a cache that cannot be written is done without
            store.parent.mkdir(parents=True, exist_ok=True)
            fcntl.flock(stack.enter_context(open(store.with_suffix(".lock"), "a")), fcntl.LOCK_EX)
        yield
