"""How often each surface was met along a ray, packed: several counts in one word."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from roomeq.core.arrays import Array, IntArray, Number
from roomeq.core.jit import compiled, for_chunks

if TYPE_CHECKING:
    from roomeq.sim.trace import Paths


class Tallies(NamedTuple):
    """How often each surface was met up to each stored reflection.

    Attributes
    ----------
    words
        Of uint64, shape (n_stored, n_words).
    word, shift
        Which word counts each surface, and from which bit on, shape (n_surfaces,).
    mask
        Bits of one count.
    """

    words: Array
    word: IntArray
    shift: Array
    mask: np.uint64


def count_type(counts: Array) -> type[np.uint8] | type[np.uint16]:
    """Return the type that holds as many reflections as rays have at most, of numbers of shape (n_rays,)."""
    return np.uint8 if counts.max() < 256 else np.uint16


def tally_reflections(paths: "Paths") -> Tallies:
    """Count the reflections of rays by surface."""
    bits = 8 * np.dtype(count_type(paths.counts)).itemsize
    word, place = np.divmod(np.arange(len(paths.scattering)), 64 // bits)
    tallies = Tallies(np.empty((len(paths.codes), word[-1] + 1), np.uint64), word, (place * bits).astype(np.uint64),
                      np.uint64(2 ** bits - 1))
    for_chunks(len(paths.counts), lambda chunk, low, high: _tally(
        paths.codes, paths.face_surface, paths.first, paths.counts, tallies, low, high))
    return tallies


@compiled
def _tally(codes: Array, face_surface: Array, first: Array, counts: Array, tallies: Tallies, low: Number,
           high: Number) -> None:
    """Count hits per surface along rays `low` to `high`."""
    words, one = tallies.words, np.uint64(1)
    for word in range(words.shape[1]):
        increment = np.zeros(len(face_surface), np.uint64)
        for face, surface in enumerate(face_surface):
            if tallies.word[surface] == word:
                increment[face] = one << tallies.shift[surface]
        for ray in range(low, high):
            so_far = np.uint64(0)
            for at in range(np.uint64(first[ray]), np.uint64(first[ray] + counts[ray])):  # unsigned is faster
                so_far += increment[np.uint64(codes[at] >> 2)]
                words[at, word] = so_far
