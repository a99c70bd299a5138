"""Rays, paths and samples of paths in files until they are needed: they are most of what a loop remembers."""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from roomeq.core.arrays import Array
from roomeq.sim.path_sample import PathSample
from roomeq.sim.response import TracedSource
from roomeq.sim.scene import Scene

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
            for array in _RAYS + _PATHS * paths:
                np.save(f"{first}-{n}-{array}.npy", getattr(of_trace, array))
        bare = replace(traced, paths=tuple(
            replace(of_trace, **{array: getattr(of_trace, array)[:0].copy() for array in _RAYS + _PATHS})
            for of_trace in traced.paths))
        return StoredTrace(bare, first, paths, self)

    def store_samples(self, samples: Sequence[PathSample]) -> list["StoredSample"]:
        """Move samples to files; those that several microphones share, once."""
        stored: dict[int, StoredSample] = {}
        for sample in samples:
            if id(sample) not in stored:
                first = Path(self._folder.name) / f"sample{next(self._samples)}"
                for array in _SAMPLE:
                    np.save(f"{first}-{array}.npy", getattr(sample, array))
                bare = replace(sample, **{array: getattr(sample, array)[:0].copy() for array in _SAMPLE})
                stored[id(sample)] = StoredSample(bare, first, self)
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
        arrays: dict[str, Any] = {name: _mapped(f"{self.first}-{name}.npy") for name in _SAMPLE}
        return replace(self.bare, **arrays)


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
        arrays: list[dict[str, Any]] = [{name: _mapped(f"{self.first}-{n}-{name}.npy") for name in names}
                                        for n in range(len(self.bare.paths))]
        return replace(self.bare, paths=tuple(
            replace(paths, **of_trace) for paths, of_trace in zip(self.bare.paths, arrays, strict=True)))


def _mapped(file: str) -> Array:
    # copy on write: kernels are compiled for writable arrays
    return np.asarray(np.lib.format.open_memmap(file, mode="c"))
