"""Traced sources whose rays and paths lie in files until they are needed: they are most of what a loop remembers."""

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from roomeq.core.arrays import Array
from roomeq.sim.response import TracedSource
from roomeq.sim.scene import Scene

_RAYS, _PATHS = ("directions",), ("hits", "codes", "first", "counts")
"""Arrays of `roomeq.sim.trace.Paths` that are kept in files: for every rendering, and for whole paths alone."""


class TraceFolder:
    """A temporary folder of traces; it disappears with the last trace that it holds."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="roomeq-traces-")

    def store(self, traced: TracedSource, name: str, *, paths: bool = True) -> "StoredTrace":
        """Move a traced source to files that begin with a name; without its `paths`, if nobody needs them any more."""
        first = Path(self._folder.name) / name
        for n, of_trace in enumerate(traced.paths):
            for array in _RAYS + _PATHS * paths:
                np.save(f"{first}-{n}-{array}.npy", getattr(of_trace, array))
        bare = replace(traced, paths=tuple(
            replace(of_trace, **{array: getattr(of_trace, array)[:0].copy() for array in _RAYS + _PATHS})
            for of_trace in traced.paths))
        return StoredTrace(bare, first, paths, self)


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
        arrays: list[dict[str, Any]] = [{name: self._array(n, name) for name in names}
                                        for n in range(len(self.bare.paths))]
        return replace(self.bare, paths=tuple(
            replace(paths, **of_trace) for paths, of_trace in zip(self.bare.paths, arrays, strict=True)))

    def _array(self, n: int, name: str) -> Array:
        # copy on write: kernels are compiled for writable arrays
        return np.asarray(np.lib.format.open_memmap(f"{self.first}-{n}-{name}.npy", mode="c"))
