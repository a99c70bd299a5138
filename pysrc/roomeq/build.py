"""Output directories that are made whole or not at all, by any number of jobs, and made only when needed.

A step describes its work as named items. `Build` gives each item to exactly one job, keeps a record of every
item that is finished, and renames the directory into place when all are. A killed run goes on where it stopped.
Whether a directory is up to date is decided by a key: a hash of the step, its options, its inputs and the code.

    build = Build(out, step="compensate", options=dict(taps=511), inputs=[sim_dir])
    if not build.done and build.run(rows_by_id, compensate_one, part=part, nj=nj):
        build.finish(lambda directory, records: write_rirs(directory, records))
"""

import contextlib
import fcntl
import hashlib
import json
import logging
import os
import re
import shutil
from collections.abc import Callable, Iterator
from functools import cache
from itertools import starmap
from pathlib import Path

from roomeq.files import hash_file, read_json, to_json, write_json
from roomeq.progress import progress

logger = logging.getLogger(__name__)

DONE_FILE = ".done"
_RECORDS = ".items"


class Build:
    """One output directory under construction.

    Parameters
    ----------
    out : Path
        The directory to make. If it exists it must be one that a `Build` made.
    step : str
        Name of the step, e.g. ``"simulate"``.
    options : dict
        Everything that changes the result, JSON-able. Not: paths, number of jobs.
    inputs : list of Path
        Files and directories that the result depends on.

    Attributes
    ----------
    out : Path
    work : Path
        Where files are written until the directory is whole.
    done : bool
        The directory is there, whole, and of the same options, inputs and code.

    Raises
    ------
    ValueError
        `out` holds something else, or an input is missing.
    """

    def __init__(self, out: Path, *, step: str, options: dict, inputs: list[Path]):
        self.out = Path(os.path.normpath(out))
        self._check_ours()
        self.step, self.options = step, options
        described = dict(step=step, options=options, inputs=[digest(path) for path in inputs], code=code_digest())
        self.key = hashlib.sha256(to_json(described).encode()).hexdigest()
        self.work = self.out.with_name(f".{self.out.name}.part-{self.key[:16]}")
        self._names: list[str] = []

    @property
    def done(self) -> bool:
        if _is_done(self.out, self.key):
            logger.info("%s: up to date", self.out)
            return True
        return False

    def run(self, items: dict, make: Callable, *, part: str | None = None, nj: int = 1) -> bool:
        """Do the items that are still to do; return True when all are done and `finish` may be called.

        Parameters
        ----------
        items : dict
            What to do, by name (an id).
        make : callable
            ``make(name, item) -> record``: writes the item's files below `work` and returns a JSON-able record.
        part : str, optional
            ``"2/5"``: do only the second of five shares, and leave finishing to a later call without `part`.
        nj : int
            Processes to use.
        """
        self._names = list(items)
        mine = share(self._names, part)
        with self._lock(fcntl.LOCK_SH):
            if _is_done(self.out, self.key) or _is_done(self.work, self.key):
                return part is None
            (self.work / _RECORDS).mkdir(parents=True, exist_ok=True)
            todo = [name for name in mine if not self._record_path(name).is_file()]
            if 0 < len(todo) < len(mine):
                logger.info("%s: %d of %d items were done before", self.out, len(mine) - len(todo), len(mine))
            for _ in progress(self._each(todo, items, make, nj), len(todo), f"{self.step} {self.out.name}"):
                pass
        return part is None

    def _each(self, todo: list[str], items: dict, make: Callable, nj: int) -> Iterator:
        calls = ((os.getcwd(), self._record_path(name), make, name, items[name]) for name in todo)
        if nj == 1 or len(todo) < 2:
            yield from starmap(_make_one, calls)
            return
        from joblib import Parallel, delayed

        yield from Parallel(n_jobs=nj, return_as="generator_unordered")(delayed(_make_one)(*call) for call in calls)

    def finish(self, assemble: Callable) -> None:
        """Call ``assemble(directory, records)``, which writes the files of the whole; put the directory in place.

        `records` are the items' records in the order of the items. `assemble` also validates.
        """
        with self._lock(fcntl.LOCK_EX):
            if _is_done(self.out, self.key):
                return
            if not _is_done(self.work, self.key):
                self.work.mkdir(parents=True, exist_ok=True)
                assemble(self.work, [read_json(self._record_path(name)) for name in self._names])
                self._seal()
            self._check_ours()
            retired = self.out.with_name(f".{self.out.name}.old-{os.getpid()}")
            if self.out.exists():
                self.out.rename(retired)
            self.work.rename(self.out)
            for stale in [*self.out.parent.glob(f".{self.out.name}.part-*"),
                          *self.out.parent.glob(f".{self.out.name}.old-*")]:
                shutil.rmtree(stale, ignore_errors=True)

    def _seal(self) -> None:
        shutil.rmtree(self.work / _RECORDS, ignore_errors=True)
        for leftover in self.work.rglob(".*.tmp"):  # of a job that was killed while it wrote
            leftover.unlink()
        files = {}
        for path in _files_below(self.work):
            files[str(path.relative_to(self.work))] = [path.stat().st_size, hash_file(path)]
        write_json(self.work / DONE_FILE, dict(step=self.step, options=self.options, key=self.key, files=files))

    def _record_path(self, name: str) -> Path:
        safe = name if re.fullmatch(r"[\w+-][\w.+-]{0,150}", name) else hashlib.sha256(name.encode()).hexdigest()
        return self.work / _RECORDS / f"{safe}.json"

    def _check_ours(self) -> None:
        if self.out.is_file() or (self.out.is_dir() and any(self.out.iterdir())
                                  and not (self.out / DONE_FILE).is_file()):
            raise ValueError(f"{self.out}: exists and was not made by roomeq (no {DONE_FILE} in it): "
                             "choose another output, or move it away")

    @contextlib.contextmanager
    def _lock(self, how: int) -> Iterator[None]:
        """Jobs that work on items share the lock; putting the directory in place needs it alone."""
        self.out.parent.mkdir(parents=True, exist_ok=True)
        with open(self.out.with_name(f".{self.out.name}.lock"), "a") as stream:
            fcntl.flock(stream, how)
            yield


def _make_one(folder: str, record_path: Path, make: Callable, name: str, item) -> None:
    os.chdir(folder)  # workers live longer than one call, and paths may be relative
    write_json(record_path, make(name, item))


def share(names: list[str], part: str | None) -> list[str]:
    """Return the names of one share, ``"JOB/JOBS"``, counted from 1.

    Raises
    ------
    ValueError
        `part` is not of that form.
    """
    if part is None:
        return names
    found = re.fullmatch(r"(\d+)/(\d+)", part)
    if not found or not 1 <= int(found[1]) <= int(found[2]):
        raise ValueError(f"part={part!r} must be JOB/JOBS with 1 <= JOB <= JOBS, such as 2/5")
    return names[int(found[1]) - 1::int(found[2])]


def _is_done(directory: Path, key: str) -> bool:
    try:
        stamp = json.loads((directory / DONE_FILE).read_text())
        return stamp["key"] == key and all(
            (directory / name).stat().st_size == size for name, (size, _) in stamp["files"].items())
    except (OSError, ValueError, KeyError, TypeError):
        return False


def digest(path: Path) -> str:
    """Return a hash of a file's content or of a directory's.

    Files of a directory that a `Build` made count by the content hash in its stamp (unless changed since); files
    of any other directory (a corpus of many gigabytes) count by name, size and time of change.

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
    stamped, sealed_ns = {}, 0
    if (path / DONE_FILE).is_file():
        stamped = read_json(path / DONE_FILE)["files"]
        sealed_ns = (path / DONE_FILE).stat().st_mtime_ns
    total = hashlib.sha256()
    for file in _files_below(path):
        name, stat = str(file.relative_to(path)), file.stat()
        if name not in stamped and stamped:
            continue  # what others (Kaldi) put beside our files is not our input
        if name in stamped and stat.st_size == stamped[name][0] and stat.st_mtime_ns <= sealed_ns:
            mark = stamped[name][1]
        elif stamped:
            mark = hash_file(file)
        else:
            mark = f"{stat.st_size} {stat.st_mtime_ns}"
        total.update(f"{name}\0{mark}\n".encode(errors="surrogateescape"))
    return total.hexdigest()


def _files_below(directory: Path) -> list[Path]:
    """Return all files below a directory, hidden ones left out, in a fixed order."""
    found = []
    for folder, folders, names in os.walk(directory, followlinks=True):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        found += [Path(folder) / name for name in sorted(names) if not name.startswith(".")]
    return found


@cache
def code_digest() -> str:
    """Return a hash of the package's source: results of other code are not up to date."""
    total = hashlib.sha256()
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        total.update(path.read_bytes())
    return total.hexdigest()
