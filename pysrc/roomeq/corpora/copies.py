"""Find recordings that are copies of each other, also in another format or at another level.

A hash would not do: rounding to 16 bits at another level changes samples. *Sketches* of the recordings are compared
instead, short vectors that are nearly as far apart as the recordings (Charikar, Chen and Farach-Colton, 2002, "Finding
frequent items in data streams"). Of RIRs that are long enough, the parts after the direct sound are compared as well
(`roomeq.acoustics.same_recordings`), which finds copies that were resampled, shifted or filtered.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from roomeq.core.arrays import Array, BoolArray, FloatArray
from roomeq.core.constants import FS_HZ
from roomeq.records.rir_dir import load_rir, rir_path
from roomeq.records.schema import NoiseRow, RirRow

SKETCH_SIZE = 256
MAX_DIFFERENCE = 0.005
"""Copies differ by less than this share of their RMS at equal level: 16-bit copies do, other positions do not."""


class RirSketches(NamedTuple):
    """What shows whether RIRs are copies.

    Attributes
    ----------
    wholes : ndarray, shape (n, SKETCH_SIZE)
        See `sketch`.
    parts : ndarray, shape (n, n_samples)
        See `roomeq.acoustics.same_recordings.cut_parts`.
    """

    wholes: FloatArray
    parts: FloatArray


def sketch_rirs(directory: Path, rows: Sequence[RirRow]) -> RirSketches:
    """Return the sketches of RIRs, of arrays those of the first microphone."""
    import numpy as np
    import soxr

    from roomeq.acoustics.direct import find_direct
    from roomeq.acoustics.same_recordings import cut_parts

    wholes, parts = [], []
    for row in rows:
        samples = load_rir(directory, row, row["fs_hz"])
        wholes.append(sketch(samples))
        samples = soxr.resample(samples, row["fs_hz"], FS_HZ, quality="VHQ")
        try:
            direct = find_direct(samples, FS_HZ)
        except ValueError as error:
            raise ValueError(f"{rir_path(directory, row)}: {error}; or run roomeq characterise first, which leaves "
                             "such recordings out") from None
        parts.append(cut_parts(samples, direct.sample))
    return RirSketches(np.array(wholes).reshape(-1, SKETCH_SIZE), np.array(parts))


def find_rir_copies(one: RirSketches, other: RirSketches | None = None) -> list[tuple[int, int]]:
    """Return the pairs of an RIR of one and one of another set that are copies, by their numbers, in order.

    Without another set, RIRs of the one are compared with later ones of it.
    """
    import numpy as np

    from roomeq.acoustics.same_recordings import find_same

    pairs = {(n, m) for n, m, _ in find_same(one.parts, None if other is None else other.parts)}
    for n, whole in enumerate(one.wholes):
        first, others = (n + 1, one) if other is None else (0, other)
        pairs.update((n, first + int(m)) for m in np.flatnonzero(_are_copies(others.wholes[first:], whole)))
    return sorted(pairs)


def sketch_noises(directory: Path, noises: Sequence[NoiseRow]) -> FloatArray:
    """Return the sketches of the first channels of noises, shape (n, SKETCH_SIZE); see `sketch`.

    Raises
    ------
    ValueError
        A noise cannot be read.
    """
    import numpy as np

    from roomeq.core.audio import audio_info, read_audio

    sketches = []
    for noise in noises:
        path = Path(directory) / noise["wav"]
        sketches.append(sketch(read_audio(path, fs_hz=audio_info(path).samplerate, channel=0, dtype="float32")))
    return np.array(sketches).reshape(-1, SKETCH_SIZE)


def sketch(samples: Array) -> FloatArray:
    """Return a vector of norm 1, whose scalar product with another sketch is nearly the correlation of the recordings.

    Each sample is added to one of the elements with a random sign, the same for all recordings.

    Parameters
    ----------
    samples : ndarray, shape (n_samples,)

    Returns
    -------
    sketch : ndarray, shape (SKETCH_SIZE,)
        All 0 if the samples are.
    """
    import numpy as np

    signs = 2 * np.random.default_rng(0).integers(0, 2, len(samples), dtype=np.int8) - 1
    # without the offset of a recorder, which all its quiet noises share
    signed = np.pad((samples - samples.mean()) * signs, (0, -len(samples) % SKETCH_SIZE))
    sums = signed.reshape(-1, SKETCH_SIZE).sum(axis=0, dtype=float)
    return np.asarray(sums / (np.linalg.norm(sums) or 1.0))


def first_copy(of: FloatArray, among: FloatArray) -> int | None:
    """Return the index of the first copy of a recording, or None.

    Parameters
    ----------
    of : ndarray, shape (SKETCH_SIZE,)
        Sketch of the recording.
    among : ndarray, shape (n, SKETCH_SIZE)
        Sketches of others.
    """
    import numpy as np

    found = np.flatnonzero(_are_copies(among, of))
    return int(found[0]) if len(found) else None


def _are_copies(sketches: FloatArray, of: FloatArray) -> BoolArray:
    """Tell which sketches are those of a copy, which may have the other polarity."""
    # of vectors with norm 1, distance^2 = 2 - 2 * product
    similar: BoolArray = abs(sketches @ of) > 1 - MAX_DIFFERENCE ** 2 / 2
    return similar
