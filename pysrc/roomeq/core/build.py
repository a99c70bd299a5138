"""Output directories that are made whole or not at all, by any number of jobs, and made only when needed.

A step describes its work as named items. `Build` gives each item to exactly one job, keeps a record of every
item that is finished, and renames the directory into place when all are. A killed run goes on where it stopped.
Whether a directory is up to date is decided by a key: a hash of the step, its options, its inputs and the code.

    build = Build(out, step="compensate", options=dict(taps=511), inputs=[sim_dir])
    if not build.done and build.run(rows_by_id, compensate_one, part=part, nj=nj):
        build.finish(lambda directory, records: write_rirs(directory, records))
"""

import contextlib
import errno
import fcntl
import glob
import hashlib
import json
import logging
import os
import re
import shutil
from collections.abc import Callable, Iterator
from itertools import starmap
from pathlib import Path

from roomeq.core.digests import code_digest, digest, files_below
from roomeq.core.files import hash_file, read_json, to_json, write_json, write_text
from roomeq.core.progress import progress
from roomeq.core.stamps import DONE_FILE, as_sealed, check_output

logger = logging.getLogger(__name__)

_RECORDS = ".items"
MAX_JOBS = 1024


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
    refers : bool
        The output names audio that lies elsewhere: those who take it as input depend on how it was made, not only
        on the files in it.

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

    def __init__(self, out: Path, *, step: str, options: dict, inputs: list[Path], refers: bool = False):
        self.out = Path(os.path.normpath(out))
        self.step, self.options, self.refers, self._inputs = step, options, refers, inputs
        self._check_ours()
        described = dict(step=step, options=options, inputs=[digest(path) for path in inputs], code=code_digest())
        self.key = hashlib.sha256(to_json(described).encode(errors="surrogateescape")).hexdigest()
        self.work = self.out.with_name(f".{self.out.name}.part-{self.key[:16]}")
        self._retired = self.out.with_name(f".{self.out.name}.old")
        self._names: list[str] = []

    @property
    def done(self) -> bool:
        if _is_done(self.out, self.key):
            logger.info("%s: up to date", self.out)
            if self._retired.exists():  # whoever put the directory in place was killed before the end
                with contextlib.suppress(OSError), self._lock(fcntl.LOCK_EX):
                    self._clear_retired()
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
        check_jobs(nj)
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
        calls = ((os.getcwd(), self._lock_path, self._record_path(name), make, name, items[name]) for name in todo)
        if nj == 1 or len(todo) < 2:
            yield from starmap(_make_one, calls)
            return
        from joblib import Parallel, delayed

        yield from Parallel(n_jobs=nj, return_as="generator_unordered")(delayed(_make_one)(*call) for call in calls)

    def finish(self, assemble: Callable) -> bool:
        """Call ``assemble(directory, records)``, which writes the files of the whole; put the directory in place.

        `records` are the items' records in the order of the items. `assemble` also validates.

        Returns
        -------
        assembled : bool
            False where it was not called, since another run, or a killed one, had come as far as that.

        Raises
        ------
        ValueError
            Another run with other options put the directory in place meanwhile.
        """
        assembled = False
        with self._lock(fcntl.LOCK_EX):
            if _is_done(self.out, self.key):
                return False
            if not _is_done(self.work, self.key):
                assemble(self.work, self._read_records())
                self._seal()
                assembled = True
            shutil.rmtree(self.work / _RECORDS, ignore_errors=True)
            self._check_ours()
            for stale in self.out.parent.glob(f".{glob.escape(self.out.name)}.part-{'[0-9a-f]' * 16}"):
                if stale != self.work:
                    shutil.rmtree(stale, ignore_errors=True)
            self._clear_retired()
            if self.out.exists():
                self.out.rename(self._retired)
            self.work.rename(self.out)
            self._clear_retired()
        return assembled

    def _clear_retired(self) -> None:
        shutil.rmtree(self._retired, ignore_errors=True)

    def _read_records(self) -> list:
        self.work.mkdir(parents=True, exist_ok=True)
        try:
            return [read_json(self._record_path(name)) for name in self._names]
        except FileNotFoundError:
            raise ValueError(f"{self.out}: another run, with other options or inputs, made it meanwhile: let one "
                             "run at a time work on a directory, and start this one again") from None

    def _seal(self) -> None:
        for leftover in self.work.rglob(".*.tmp"):  # of a job that was killed while it wrote
            leftover.unlink(missing_ok=True)
        files = {}
        for path in files_below(self.work):
            files[str(path.relative_to(self.work))] = [path.stat().st_size, hash_file(path)]
        write_json(self.work / DONE_FILE, dict(step=self.step, options=self.options, key=self.key,
                                               refers=self.refers, files=files))

    def _record_path(self, name: str) -> Path:
        plain = re.fullmatch(r"[\w+-][\w.+-]{0,150}", name, re.ASCII)
        safe = name if plain else hashlib.sha256(name.encode()).hexdigest()
        return self.work / _RECORDS / f"{safe}.json"

    def _check_ours(self) -> None:
        check_output(self.out, self.step, self._inputs)

    @property
    def _lock_path(self) -> Path:
        return self.out.with_name(f".{self.out.name}.lock")

    def _lock(self, how: int):
        """Jobs that work on items share the lock; putting the directory in place needs it alone."""
        self.out.parent.mkdir(parents=True, exist_ok=True)
        return locked(self._lock_path, how)


def check_jobs(nj: int) -> None:
    """Raise a `ValueError` for a number of processes or threads that is none."""
    if not 1 <= nj <= MAX_JOBS:
        raise ValueError(f"nj={nj} must lie in [1, {MAX_JOBS}]: give the number of processes")


@contextlib.contextmanager
def locked(path: Path, how: int) -> Iterator[None]:
    """Hold the lock of a file, ``fcntl.LOCK_SH`` or ``LOCK_EX``; whoever has it goes first."""
    with open(path, "a+") as stream:  # NFS gives shared locks to readers only, exclusive ones to writers
        try:
            fcntl.flock(stream, how | fcntl.LOCK_NB)
        except BlockingIOError:
            logger.info("%s: waiting for another run that works on it", path.with_name(path.name[1:-len(".lock")]))
            fcntl.flock(stream, how)
        except OSError as error:
            if error.errno not in (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP):
                raise
            logger.warning("%s: this file system has no locks: let one run at a time work on a directory", path)
        yield


def _make_one(folder: str, lock: Path, record_path: Path, make: Callable, name: str, item) -> None:
    os.chdir(folder)  # workers live longer than one call, and paths may be relative
    with locked(lock, fcntl.LOCK_SH):
        # another run may have made the item, or put the whole directory in place: nothing must come after that
        if record_path.parent.is_dir() and not record_path.is_file():
            write_text(record_path, to_json(make(name, item)))


def share(names: list[str], part: str | None) -> list[str]:
    """Return the names of one share, ``"JOB/JOBS"``, counted from 1.

    Raises
    ------
    ValueError
        `part` is not of that form.
    """
    if part is None:
        return names
    found = re.fullmatch(r"(\d{1,9})/(\d{1,9})", part)
    if not found or not 1 <= int(found[1]) <= int(found[2]):
        raise ValueError(f"part={part!r} must be JOB/JOBS with 1 <= JOB <= JOBS, such as 2/5")
    return names[int(found[1]) - 1::int(found[2])]


def _is_done(directory: Path, key: str) -> bool:
    try:
        stamp = json.loads((directory / DONE_FILE).read_text())
        sealed_ns = (directory / DONE_FILE).stat().st_ctime_ns
        return stamp["key"] == key and all(
            as_sealed(directory / name, size, content, sealed_ns) for name, (size, content) in stamp["files"].items())
    except (OSError, ValueError, KeyError, TypeError):
        return False
