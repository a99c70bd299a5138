"""Output directories that are complete or absent, made by any number of jobs, and only when something changed.

A step describes its work as named items. `Build` gives each item to exactly one job, keeps a record of every finished
item, and renames the directory into place once all items are finished. A killed run resumes with the next item; an item
whose files are not as its record says, which a loss of power may leave, is made again. A directory is up to date if the
key in its stamp is right: a hash of the step, its options, its inputs and the code.

    build = Build(out, step="compensate", options=dict(taps=511), inputs=[sim_dir])
    if not build.done and build.run(rows_by_id, compensate_one, part=part, nj=nj):
        build.finish(lambda directory, records: write_rirs(directory, records))

Why not Make, Snakemake, DVC or `joblib.Memory`: the unit is an item (an RIR, a speaker) and the result is a directory
that other programs read. Jobs of one step run on different machines that share nothing but a file system without a
server, under Kaldi's own `run.pl`, `queue.pl` or `slurm.pl`; each may be killed at any moment, and the bytes in the end
must be those of an undisturbed run. Those tools decide per file by modification time, need one controlling process, or
cache return values and leave half a directory behind; and Kaldi users have none of them installed.
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
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import starmap
from pathlib import Path
from typing import Any

from roomeq.core.asking import NotUpToDate, only_asked
from roomeq.core.constants import is_whole
from roomeq.core.digests import (
    Listed,
    audio_elsewhere,
    code_digest,
    code_digest_now,
    content_of,
    files_below,
    place_in_entries,
    places_of,
    require_unchanged,
)
from roomeq.core.files import hash_file, listing_written, output_path, path_from, sync, to_json, write_json
from roomeq.core.item_records import ItemRecord, is_as_recorded, is_complete, read_item_record, write_item_record
from roomeq.core.kept_hashes import KeptHashes
from roomeq.core.progress import progress
from roomeq.core.stamps import (
    DONE_FILE,
    FORMAT,
    check_output,
    is_as_stamped,
    stamp_content,
    was_made,
    when_stamped_ns,
)
from roomeq.core.workers import end_with, forked, may_fork, n_processes

logger = logging.getLogger(__name__)

_RECORDS = ".items"
MAX_JOBS = 1024

code_digest()  # of the code as it is loaded: it may be another one on the disk once the inputs are hashed


class Build:
    """One output directory under construction.

    Parameters
    ----------
    out : Path
        The directory to make. If it exists, `step` must have made it.
    step : str
        Name of the step, e.g. ``"simulate"``.
    options : dict
        Everything that changes the result, JSON-able: neither paths nor the number of jobs.
    inputs : list of Path or Listed
        Files and directories that the result depends on. What is not in the key must be read of them once the build is
        made: files that are written to later are refused.
    refers : bool
        The output names audio elsewhere. A later step that takes it as input then depends on its key and not only on
        its files.

    Attributes
    ----------
    out : Path
    work : Path
        Directory that files are written to; `finish` renames it to `out`.
    key : str
        Hash of step, options, inputs and code.

    Raises
    ------
    ValueError
        `out` holds something else, or an input is missing or has the formats of another version of roomeq.
    """

    def __init__(self, out: Path, *, step: str, options: dict[str, Any], inputs: Sequence[Path | Listed],
                 refers: bool = False) -> None:
        self.out = output_path(out)
        self.step, self.options, self.refers, self._inputs = step, options, refers, inputs
        self._check_output()
        self._contents = [content_of(given) for given in inputs]
        digests = [content.digest for content in self._contents]
        described = dict(step=step, options=options, inputs=digests, code=code_digest())
        self.key = hashlib.sha256(to_json(described).encode(errors="surrogateescape")).hexdigest()
        self.work = self.out.with_name(f".{self.out.name}.part-{self.key[:16]}")
        self._replaced = self.out.with_name(f".{self.out.name}.old")
        self._names: list[str] = []
        self._hashes = KeptHashes()
        self._made_of = {name: content for path, content in zip(inputs, digests, strict=True)
                         if not isinstance(path, Listed) and was_made(path)
                         and (name := path_from(path, self.out)).isprintable()}

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what only the process needs that puts the directory in place: workers get a build with each item.

        There may be a hundred thousand files.
        """
        return self.__dict__ | dict(_inputs=[], _contents=[])

    @property
    def done(self) -> bool:
        """Whether the directory exists, is complete, and was made with the same options, inputs and code.

        Where that is the only question (`roomeq.core.asking`), `NotUpToDate` says no and ends the step.
        """
        if not self._is_done(self.out):
            if only_asked():
                raise NotUpToDate(str(self.out))
            return False
        logger.info("%s: up to date", self.out)
        if self._replaced.exists():  # the run that put the directory in place was killed before it had cleared up
            with contextlib.suppress(OSError), self._lock(fcntl.LOCK_EX):
                self._remove_replaced()
        return True

    def run(self, items: Mapping[str, Any], make: Callable[[str, Any], Any], *, part: str | None = None,
            nj: int = 1) -> bool:
        """Make the items that are not made yet; return True if all are made, so that `finish` may be called.

        Parameters
        ----------
        items : mapping
            Items by name (an id).
        make : callable
            ``make(name, item) -> record``: writes the item's files below `work` and returns a JSON-able record.
        part : str, optional
            ``"2/5"``: make only the second of five shares, and leave `finish` to a later call without `part`.
        nj : int
            Number of processes.

        Raises
        ------
        ValueError
            `part` or `nj` is out of range, the code of roomeq has changed since this process started, or, after a
            `part`, an input.
        """
        self._names = list(items)
        names = share(self._names, part)
        check_jobs(nj)
        self._require_same_code()
        with self._lock(fcntl.LOCK_SH):
            if self._is_done(self.out) or self._is_done(self.work):
                return part is None
            (self.work / _RECORDS).mkdir(parents=True, exist_ok=True)
        todo = [name for name in names if not is_complete(self._record_path(name), self.work, self._hashes)]
        if 0 < len(todo) < len(names):
            logger.info("%s: %d of %d items were done before", self.out, len(names) - len(todo), len(names))
        for _ in progress(self._make_items(todo, items, make, nj), len(todo), f"{self.step} {self.out.name}"):
            pass
        if part is not None:
            try:
                self._require_same_inputs()
            except (ValueError, OSError):
                for name in todo:  # they may be of another content than the key says
                    self._record_path(name).unlink(missing_ok=True)
                raise
        return part is None

    def _make_items(self, todo: list[str], items: Mapping[str, Any], make: Callable[[str, Any], Any],
                    nj: int) -> Iterator[None]:
        calls = [(os.getcwd(), self._lock_path, self._record_path(name), make, name, items[name]) for name in todo]
        if nj == 1 or len(todo) < 2:
            yield from starmap(_make_item, calls)
            return
        if may_fork():  # such workers need not import anything
            for _ in forked(lambda call: _make_item(*call), calls, nj):
                yield
            return
        from joblib import Parallel, delayed

        workers = Parallel(n_jobs=n_processes(nj, len(todo)), backend="loky", return_as="generator_unordered")
        yield from workers(delayed(_make_item_in_worker)(os.getpid(), *call) for call in calls)

    def finish(self, assemble: Callable[[Path, list[Any]], object]) -> bool:
        """Call ``assemble(directory, records)`` to write and check the common files; put the directory in place.

        `records` are the items' records in the order of the items.

        Returns
        -------
        assembled : bool
            False if `assemble` was not called because another run, or one that was killed, had already done so.

        Raises
        ------
        ValueError
            Another run with other options put the directory in place meanwhile, or an input or the code of roomeq has
            changed since this process started.
        """
        assembled = False
        with self._lock(fcntl.LOCK_EX):
            if self._is_done(self.out):
                return False
            if not self._is_done(self.work):
                records = self._read_records()
                assemble(self.work, [record.result for record in records])
                self._write_stamp(records)
                assembled = True
            shutil.rmtree(self.work / _RECORDS, ignore_errors=True)
            self._check_output()
            for stale in self.out.parent.glob(f".{glob.escape(self.out.name)}.part-{'[0-9a-f]' * 16}"):
                if stale != self.work:
                    shutil.rmtree(stale, ignore_errors=True)
            self._remove_replaced()
            if self.out.exists():
                self.out.rename(self._replaced)
            self.work.rename(self.out)
            sync(self.out.parent)
            self._remove_replaced()
        return assembled

    def withdraw(self) -> None:
        """Remove the directory unless it is up to date.

        Of directories that belong together, such as sets that share nothing, one of an earlier run then never stands
        beside one of this run, wherever that is killed.
        """
        with self._lock(fcntl.LOCK_EX):
            self._remove_replaced()
            if self.out.exists() and not self._is_done(self.out):
                self.out.rename(self._replaced)
                sync(self.out.parent)
                self._remove_replaced()

    def _remove_replaced(self) -> None:
        shutil.rmtree(self._replaced, ignore_errors=True)

    def _read_records(self) -> list[ItemRecord]:
        self.work.mkdir(parents=True, exist_ok=True)
        records = [read_item_record(self._record_path(name)) for name in self._names]
        if None in records:
            raise ValueError(f"{self.out}: another run, with other options or inputs, made it meanwhile: let one "
                             "run at a time work on a directory, and start this one again")
        return [record for record in records if record]

    def _write_stamp(self, records: list[ItemRecord]) -> None:
        """Write the stamp once all files are on the disk, and those of the items as they were written."""
        for leftover in self.work.rglob(".*.tmp"):  # of a job that was killed while it wrote
            leftover.unlink(missing_ok=True)
        recorded = {name: state for record in records for name, state in record.files.items()}
        for name, state in recorded.items():
            if not is_as_recorded(self.work / name, state, self._hashes):
                raise ValueError(f"{self.work / name}: is not as it was written: check the disk and what else writes "
                                 "there, and start this run again: it makes the file anew")
        files = {}
        for path in files_below(self.work):
            name = str(path.relative_to(self.work))
            if name not in recorded:
                sync(path)
            files[name] = recorded.get(name) or (path.stat().st_size, hash_file(path))
        for folder, _, _ in os.walk(self.work):
            sync(Path(folder))
        audio = audio_elsewhere(self.work, self.out) if self.refers else {}
        try:
            self._require_same_code()
            self._require_same_inputs()
        except (ValueError, OSError):
            shutil.rmtree(self.work, ignore_errors=True)  # a part of it may be of the other code or input
            raise
        write_json(self.work / DONE_FILE, stamp_content(
            format=FORMAT, step=self.step, options=self.options, key=self.key, refers=self.refers, files=files,
            made_of=self._made_of,
            audio={name: content_hash for name, (_, content_hash) in audio.items() if content_hash},
            place=place_in_entries(self.work, self.out)))
        sync(self.work)

    def _require_same_code(self) -> None:
        """Refuse to go on where the code on the disk is not that of the key: modules loaded later would be of it."""
        if code_digest_now() != code_digest():
            raise ValueError(f"{self.out}: the code of roomeq changed while it ran: start again")

    def _require_same_inputs(self) -> None:
        """Refuse to go on where an input has changed: items may be of its earlier and of its present content.

        Of the files of a directory, only those that seem to have changed are read again.
        """
        try:
            for given, content in zip(self._inputs, self._contents, strict=True):
                require_unchanged(given, content)
        except ValueError as error:
            raise ValueError(f"{self.out}: an input changed while it was made: {error}; run this again") from None

    def _is_done(self, directory: Path) -> bool:
        try:
            stamp = json.loads((directory / DONE_FILE).read_text())
            stamped_ns = when_stamped_ns(directory)
            return (stamp["key"] == self.key and stamp.get("place", "") in ("", *places_of(self.out))
                    and all(is_as_stamped(directory, name, size, content_hash, stamped_ns)
                            for name, (size, content_hash) in stamp["files"].items()))
        except (OSError, ValueError, KeyError, TypeError):
            return False

    def _record_path(self, name: str) -> Path:
        plain = re.fullmatch(r"[\w+-][\w.+-]{0,150}", name, re.ASCII)
        safe = name if plain else hashlib.sha256(name.encode()).hexdigest()
        return self.work / _RECORDS / f"{safe}.json"

    def _check_output(self) -> None:
        check_output(self.out, self.step, [path for path in self._inputs if not isinstance(path, Listed)])

    @property
    def _lock_path(self) -> Path:
        return self.out.with_name(f".{self.out.name}.lock")

    def _lock(self, kind: int) -> contextlib.AbstractContextManager[None]:
        """Return the directory's lock: jobs that make items share it, putting the directory in place excludes them."""
        self.out.parent.mkdir(parents=True, exist_ok=True)
        return locked(self._lock_path, kind)


def check_jobs(nj: int) -> None:
    """Raise a `ValueError` where a number of processes or threads is out of range."""
    if not is_whole(nj):
        raise ValueError(f"nj={nj!r} must be a whole number: give the number of processes")
    if not 1 <= nj <= MAX_JOBS:
        raise ValueError(f"nj={nj} must lie in [1, {MAX_JOBS}]: give the number of processes")


@contextlib.contextmanager
def locked(path: Path, kind: int) -> Iterator[None]:
    """Hold the lock of a file, ``fcntl.LOCK_SH`` or ``LOCK_EX``; wait for a process that holds it."""
    with open(path, "a+") as stream:  # NFS gives shared locks to readers only, exclusive ones to writers
        try:
            fcntl.flock(stream, kind | fcntl.LOCK_NB)
        except BlockingIOError:
            logger.info("%s: waiting for another run that works on it", path.with_name(path.name[1:-len(".lock")]))
            fcntl.flock(stream, kind)
        except OSError as error:
            if error.errno not in (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP):
                raise
            logger.warning("%s: this file system has no locks: let one run at a time work on a directory", path)
        yield


def _make_item_in_worker(parent: int, *call: Any) -> None:
    end_with(parent)
    _make_item(*call)


def _make_item(folder: str, lock: Path, record_path: Path, make: Callable[[str, Any], Any], name: str,
               item: Any) -> None:
    os.chdir(folder)  # a worker process outlives one call, and paths may be relative
    work = record_path.parents[1]
    with locked(lock, fcntl.LOCK_SH):
        # another run may have made the item, or put the directory in place, which must not be written to
        if record_path.parent.is_dir() and not is_complete(record_path, work, KeptHashes()):
            with listing_written() as written:
                result = make(name, item)
            write_item_record(record_path, work, result, written)


def share(names: list[str], part: str | None) -> list[str]:
    """Return the names of one share, ``"JOB/JOBS"``, counted from 1.

    Raises
    ------
    ValueError
        `part` is not of that form.
    """
    if part is None:
        return names
    match = re.fullmatch(r"(\d{1,9})/(\d{1,9})", part) if isinstance(part, str) else None
    if not match or not 1 <= int(match[1]) <= int(match[2]):
        raise ValueError(f"part={part!r} must be JOB/JOBS with 1 <= JOB <= JOBS, such as 2/5")
    return names[int(match[1]) - 1::int(match[2])]
