"""Rays and samples of paths in a file until they are needed: they are most of what a loop remembers."""

import math
import mmap
import os
import tempfile
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeVar

import numpy as np

from roomeq.core.arrays import Array
from roomeq.sim.path_sample import PathSample
from roomeq.sim.response import TracedSource
from roomeq.sim.scene import Scene
from roomeq.sim.trace import Paths

Holder = TypeVar("Holder", Paths, PathSample)

_RAYS, _PATHS = ("directions",), ("hits", "codes", "first", "counts")
"""Arrays of `roomeq.sim.trace.Paths` that are kept in the file, as every rendering needs them, and that are dropped."""
_SAMPLE = ("weight", "reflection_counts", "last_reflection", "specular", "rays")
"""Arrays of a `PathSample` that are kept in the file."""


class _Place(NamedTuple):
    """Where an array lies in the file, and what it is."""

    offset: int
    dtype: np.dtype
    shape: tuple[int, ...]


class TraceFile:
    """A temporary file of traces and samples.

    It has no name: its space is free again when the process and those that it has forked have ended, also by a signal.
    Only the process that made it stores in it: forked ones would write to the same places.
    """

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile(prefix="roomeq-traces-", buffering=0)
        self._lock = threading.Lock()
        self._maker = os.getpid()
        self._end = 0

    def store(self, traced: TracedSource) -> "StoredTrace":
        """Move the rays of a traced source to the file, without their paths: renderings take samples of those."""
        stored = tuple(self._save(of_trace, _RAYS) for of_trace in traced.paths)
        bare = replace(traced, paths=tuple(_emptied(of_trace, _RAYS + _PATHS) for of_trace in traced.paths))
        return StoredTrace(bare, stored, self)

    def store_samples(self, samples: Sequence[PathSample]) -> list["StoredSample"]:
        """Move samples to the file; those that several microphones share, once."""
        stored: dict[int, StoredSample] = {}
        for sample in samples:
            if id(sample) not in stored:
                stored[id(sample)] = StoredSample(_emptied(sample, _SAMPLE), self._save(sample, _SAMPLE), self)
        return [stored[id(sample)] for sample in samples]

    def store_array(self, array: Array) -> "StoredArray":
        """Move an array to the file."""
        return StoredArray(self._append(np.ascontiguousarray(array)), self)

    def load(self, holder: Holder, arrays: Mapping[str, _Place], names: Sequence[str]) -> Holder:
        """Return a holder with some of its arrays, which are mapped from the file, and leave memory with it."""
        loaded: dict[str, Any] = {name: self.load_array(arrays[name]) for name in names}
        return replace(holder, **loaded)

    def _save(self, holder: Paths | PathSample, names: Sequence[str]) -> dict[str, _Place]:
        return {name: self._append(np.ascontiguousarray(getattr(holder, name))) for name in names}

    def _append(self, array: Array) -> _Place:
        if os.getpid() != self._maker:
            raise RuntimeError("a forked process stores in the file of another")
        with self._lock:  # mappings begin at whole pages
            offset = self._end
            self._end += math.ceil(array.nbytes / mmap.ALLOCATIONGRANULARITY) * mmap.ALLOCATIONGRANULARITY
        rest, at = array.reshape(-1).view(np.uint8).data, offset
        try:
            while len(rest):
                n_written = os.pwrite(self._file.fileno(), rest, at)
                rest, at = rest[n_written:], at + n_written
        except OSError as error:
            raise ValueError(f"{tempfile.gettempdir()}: {error.strerror}: free some space there, or name another "
                             "folder for temporary files in TMPDIR") from None
        return _Place(offset, array.dtype, array.shape)

    def load_array(self, stored: _Place) -> Array:
        """Return an array, which is mapped from the file."""
        n_bytes = math.prod(stored.shape) * stored.dtype.itemsize
        if n_bytes == 0:
            return np.empty(stored.shape, stored.dtype)
        # copy on write: kernels are compiled for writable arrays
        mapped = mmap.mmap(self._file.fileno(), n_bytes, access=mmap.ACCESS_COPY, offset=stored.offset)
        return np.frombuffer(mapped, stored.dtype).reshape(stored.shape)


@dataclass(frozen=True, eq=False)
class StoredArray:
    """An array in a `TraceFile`."""

    place: _Place
    file: TraceFile

    def load(self) -> Array:
        """Return the array, which is mapped from the file, and leaves memory with it."""
        return self.file.load_array(self.place)


@dataclass(frozen=True, eq=False)
class StoredSample:
    """A `PathSample` in a `TraceFile`: `bare` is without its arrays."""

    bare: PathSample
    arrays: Mapping[str, _Place]
    file: TraceFile

    def load(self) -> PathSample:
        """Return the sample; its arrays are mapped from the file, and leave memory with it."""
        return self.file.load(self.bare, self.arrays, _SAMPLE)


@dataclass(frozen=True, eq=False)
class StoredTrace:
    """The rays of a traced source in a `TraceFile`.

    Attributes
    ----------
    bare : TracedSource
        Without its rays and paths.
    arrays : tuple of dict
        Where the rays of each trace are.
    file : TraceFile
    """

    bare: TracedSource
    arrays: tuple[Mapping[str, _Place], ...]
    file: TraceFile

    @property
    def scene(self) -> Scene:
        """Scene as traced."""
        return self.bare.scene

    def load(self) -> TracedSource:
        """Return the traced source without paths; its arrays are mapped from the file, and leave memory with it."""
        return replace(self.bare, paths=tuple(self.file.load(paths, arrays, _RAYS)
                                              for paths, arrays in zip(self.bare.paths, self.arrays, strict=True)))


def _emptied(holder: Holder, names: tuple[str, ...]) -> Holder:
    empty: dict[str, Any] = {name: getattr(holder, name)[:0].copy() for name in names}
    return replace(holder, **empty)
