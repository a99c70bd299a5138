"""Traced sources whose paths lie in a file until they are needed: they are most of what a loop has to remember."""

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from roomeq.core.arrays import Array
from roomeq.sim.response import TracedSource
from roomeq.sim.scene import Scene

_LARGE = ("hits", "codes")
"""Arrays of `roomeq.sim.trace.Paths` that are kept in files."""


def without_paths(traced: TracedSource) -> TracedSource:
    """Return a traced source without the large arrays of its paths."""
    return replace(traced, paths=tuple(replace(paths, **{array: getattr(paths, array)[:0].copy() for array in _LARGE})
                                       for paths in traced.paths))


class TraceFolder:
    """A temporary folder of traces; it disappears with the last trace that it holds."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="roomeq-traces-")

    def store(self, traced: TracedSource, name: str) -> "StoredTrace":
        """Move the paths of a traced source to files that begin with a name."""
        first = Path(self._folder.name) / name
        for n, paths in enumerate(traced.paths):
            for array in _LARGE:
                np.save(f"{first}-{n}-{array}.npy", getattr(paths, array))
        return StoredTrace(without_paths(traced), first, self)


@dataclass(frozen=True, eq=False)
class StoredTrace:
    """A traced source in a `TraceFolder`, or one whose paths nobody needs any more.

    Attributes
    ----------
    small : TracedSource
        Without the large arrays of its paths.
    first : Path or None
        Beginning of the names of their files.
    folder : TraceFolder or None
    """

    small: TracedSource
    first: Path | None = None
    folder: TraceFolder | None = None

    @property
    def scene(self) -> Scene:
        """Scene as traced."""
        return self.small.scene

    def load(self) -> TracedSource:
        """Return the traced source; its paths are mapped from the file, and leave memory with it.

        Raises
        ------
        ValueError
            The paths were not stored.
        """
        if self.first is None:
            raise ValueError("the paths of this source were not stored")
        return replace(self.small, paths=tuple(
            replace(paths, hits=self._array(n, "hits"), codes=self._array(n, "codes"))
            for n, paths in enumerate(self.small.paths)))

    def _array(self, n: int, name: str) -> Array:
        # copy on write: kernels are compiled for writable arrays
        return np.asarray(np.lib.format.open_memmap(f"{self.first}-{n}-{name}.npy", mode="c"))
