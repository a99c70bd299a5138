"""Rays, paths and samples of paths in files until they are needed: they are most of what a loop remembers."""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from roomeq.sim.path_sample import PathSample
from roomeq.sim.response import TracedSource
from roomeq.sim.scene import Scene
from roomeq.sim.trace import Paths

Holder = TypeVar("Holder", Paths, PathSample)

_RAYS, _PATHS = ("directions",), ("hits", "codes", "first", "counts")
"""Arrays of `roomeq.sim.trace.Paths` that are kept in files: for every rendering, and for whole paths alone."""
_SAMPLE = ("weight", "reflection_counts", "last_reflection", "specular", "rays")
"""Arrays of a `PathSample` that are kept in files."""


class TraceFolder:
    """A temporary folder of traces and samples; it disappears with the last one that it holds."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="roomeq-traces-")
        self._samples = count()

    def store(self, traced: TracedSource, name: str, *, paths: bool = True) -> "StoredTrace":
        """Move a traced source to files that begin with a name; without its `paths`, if nobody needs them any more."""
        first = Path(self._folder.name) / name
        for n, of_trace in enumerate(traced.paths):
            _save(of_trace, _RAYS + _PATHS * paths, f"{first}-{n}")
        bare = replace(traced, paths=tuple(_emptied(of_trace, _RAYS + _PATHS) for of_trace in traced.paths))
        return StoredTrace(bare, first, paths, self)

    def store_samples(self, samples: Sequence[PathSample]) -> list["StoredSample"]:
        """Move samples to files; those that several microphones share, once."""
        stored: dict[int, StoredSample] = {}
        for sample in samples:
            if id(sample) not in stored:
                first = Path(self._folder.name) / f"sample{next(self._samples)}"
                _save(sample, _SAMPLE, str(first))
                stored[id(sample)] = StoredSample(_emptied(sample, _SAMPLE), first, self)
        return [stored[id(sample)] for sample in samples]


@dataclass(frozen=True, eq=False)
class StoredSample:
    """A `PathSample` in a `TraceFolder`: `bare` is without its arrays, whose files have names that begin with `first`.
    """

    bare: PathSample
    first: Path
    folder: TraceFolder

    def load(self) -> PathSample:
        """Return the sample; its arrays are mapped from the files, and leave memory with it."""
        return _mapped(self.bare, _SAMPLE, str(self.first))


@dataclass(frozen=True, eq=False)
class StoredTrace:
    """A traced source in a `TraceFolder`.

    Attributes
    ----------
    bare : TracedSource
        Without its rays and paths.
    first : Path
        Beginning of the names of their files.
    has_paths : bool
    folder : TraceFolder
    """

    bare: TracedSource
    first: Path
    has_paths: bool
    folder: TraceFolder

    @property
    def scene(self) -> Scene:
        """Scene as traced."""
        return self.bare.scene

    def with_rays(self) -> TracedSource:
        """Return the traced source without paths, for rendering from samples of them."""
        return self._with(_RAYS)

    def load(self) -> TracedSource:
        """Return the traced source; its arrays are mapped from the files, and leave memory with it.

        Raises
        ------
        ValueError
            The paths were not stored.
        """
        if not self.has_paths:
            raise ValueError("the paths of this source were not stored")
        return self._with(_RAYS + _PATHS)

    def _with(self, names: tuple[str, ...]) -> TracedSource:
        return replace(self.bare, paths=tuple(_mapped(paths, names, f"{self.first}-{n}")
                                              for n, paths in enumerate(self.bare.paths)))


def _save(holder: Holder, names: tuple[str, ...], first: str) -> None:
    for name in names:
        path, array = f"{first}-{name}.npy", np.ascontiguousarray(getattr(holder, name))
        try:
            with open(path, "wb") as stream:
                np.lib.format.write_array_header_1_0(stream, np.lib.format.header_data_from_array_1_0(array))
                stream.write(array.data)  # the error of `numpy.save` on a full disk says neither where nor why
        except OSError as error:
            raise ValueError(f"{path}: {error.strerror}: free some space there, or name another folder for temporary "
                             "files in TMPDIR") from None


def _emptied(holder: Holder, names: tuple[str, ...]) -> Holder:
    empty: dict[str, Any] = {name: getattr(holder, name)[:0].copy() for name in names}
    return replace(holder, **empty)


def _mapped(holder: Holder, names: tuple[str, ...], first: str) -> Holder:
    # copy on write: kernels are compiled for writable arrays
    arrays: dict[str, Any] = {name: np.asarray(np.lib.format.open_memmap(f"{first}-{name}.npy", mode="c"))
                              for name in names}
    return replace(holder, **arrays)
