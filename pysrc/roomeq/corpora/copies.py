"""Find recordings that are copies of each other, also in another format or at another level.

A hash would not do: rounding to 16 bits at another level changes samples. *Sketches* of the recordings are compared
instead, short vectors that are nearly as far apart as the recordings (Charikar, Chen and Farach-Colton, 2002, "Finding
frequent items in data streams").
"""

from collections.abc import Sequence
from pathlib import Path

from roomeq.core.arrays import Array, FloatArray
from roomeq.records.rir_dir import load_rir
from roomeq.records.schema import NoiseRow, RirRow

SKETCH_SIZE = 256
MAX_DIFFERENCE = 0.005
"""Copies differ by less than this share of their RMS at equal level: 16-bit copies do, other positions do not."""


def sketch_rirs(directory: Path, rows: Sequence[RirRow]) -> FloatArray:
    """Return the sketches of RIRs, of arrays those of the first microphone, shape (n, SKETCH_SIZE); see `sketch`."""
    import numpy as np

    return np.array([sketch(load_rir(directory, row, row["fs_hz"])) for row in rows]).reshape(-1, SKETCH_SIZE)


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

    # of vectors with norm 1, distance^2 = 2 - 2 * product; a copy may have the other polarity
    found = np.flatnonzero(np.abs(among @ of) > 1 - MAX_DIFFERENCE ** 2 / 2)
    return int(found[0]) if len(found) else None
