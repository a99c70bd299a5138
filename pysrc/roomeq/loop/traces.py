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


class TraceFolder:
    """A temporary folder of traces; it disappears with the last trace that it holds."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="roomeq-traces-")

    def store(self, traced: TracedSource, name: str) -> "StoredTrace":
        """Move the paths of a traced source to files that begin with a name."""
        first = Path(self._folder.name) / name
        small = []
        for n, paths in enumerate(traced.paths):
            for array in _LARGE:
                np.save(f"{first}-{n}-{array}.npy", getattr(paths, array))
            small.append(replace(paths, hits=paths.hits[:0].copy(), codes=paths.codes[:0].copy()))
        return StoredTrace(replace(traced, paths=tuple(small)), first, self)


@dataclass(frozen=True, eq=False)
class StoredTrace:
    """A traced source in a `TraceFolder`.

    Attributes
    ----------
    small : TracedSource
        Without the large arrays of its paths.
    first : Path
        Beginning of the names of their files.
    folder : TraceFolder
    """

    small: TracedSource
    first: Path
    folder: TraceFolder

    @property
    def scene(self) -> Scene:
        """Scene as traced."""
        return self.small.scene

    def load(self) -> TracedSource:
        """Return the traced source; its paths are mapped from the file, and leave memory with it."""
        return replace(self.small, paths=tuple(
            replace(paths, hits=self._array(n, "hits"), codes=self._array(n, "codes"))
            for n, paths in enumerate(self.small.paths)))

    def _array(self, n: int, name: str) -> Array:
        # copy on write: kernels are compiled for writable arrays
        return np.asarray(np.lib.format.open_memmap(f"{self.first}-{n}-{name}.npy", mode="c"))
