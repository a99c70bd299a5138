"""A few RIRs as measured and as simulated before and after, to look at: their decay and their spectrum.

A figure says what errors in JND do not: where a decay bends, how wide a resonance is. Nothing is fitted to what is
written here, and nothing reads it but the report.
"""

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.lib.format import read_array

from roomeq.acoustics.direct import find_direct
from roomeq.acoustics.iso3382 import energy_decay, octave_bands
from roomeq.core.constants import EXACT_BANDS_HZ, FS_HZ
from roomeq.loop.features import THIRDS_HZ, feature_slice, measure_features
from roomeq.loop.rendering import finished_rir, render_rows
from roomeq.records.rir_dir import load_rir, read_rirs

EXAMPLES_FILE = "examples.npz"
KINDS = ("measured", "before", "after")
DECAY_BANDS = (1, 4)  # octaves: 125 Hz, which has modes, and 1 kHz
N_EXAMPLES = 3
STEP_S = 5e-3
LENGTH_S = 1.5


@dataclass(frozen=True)
class Examples:
    """What is written.

    Attributes
    ----------
    ids, rooms : list of str
    decay_db : ndarray, shape (n_examples, 3 kinds, 2 bands, n_times)
        Backward-integrated energy every `STEP_S` after the direct sound; NaN where noise hides it.
    spectrum_db : ndarray, shape (n_examples, 3 kinds, 22)
        Level in third octaves (`roomeq.loop.features.THIRDS_HZ`); NaN where it was not measured.
    """

    ids: list
    rooms: list
    decay_db: np.ndarray
    spectrum_db: np.ndarray


def write_examples(path, directories, first, last):
    """Write the examples of a loop: sessions of the model it began with and the one it ended with."""
    made = make_examples(directories, first, last)
    np.savez_compressed(path, ids=np.array(made.ids, dtype=str), rooms=np.array(made.rooms, dtype=str),
                        decay_db=made.decay_db, spectrum_db=made.spectrum_db)


def read_examples(path):
    """Read them.

    Raises
    ------
    ValueError
        The file is none of ours.
    """
    found = read_arrays(path, ("ids", "rooms", "decay_db", "spectrum_db"))
    made = Examples([str(one) for one in found["ids"]], [str(one) for one in found["rooms"]], found["decay_db"],
                    found["spectrum_db"])
    size = len(made.ids), len(KINDS)
    if (made.decay_db.shape, made.spectrum_db.shape, len(made.rooms)) != (
            (*size, len(DECAY_BANDS), round(LENGTH_S / STEP_S)), (*size, len(THIRDS_HZ)), size[0]):
        raise ValueError(f"{path}: arrays do not fit each other: close the loop again")
    return made


def read_arrays(path, names):
    """Read arrays of a file that `numpy.savez_compressed` wrote: {name: ndarray}.

    Raises
    ------
    ValueError
        It is no such file, or lacks one of them.
    """
    try:
        with zipfile.ZipFile(path) as found:  # an array of objects is refused
            return {name: read_array(io.BytesIO(found.read(f"{name}.npy"))) for name in names}
    except FileNotFoundError:
        raise
    except Exception as error:  # zipfile, zlib and numpy raise a dozen kinds on broken bytes
        raise ValueError(f"{path}: cannot be read ({type(error).__name__}): close the loop again") from None


def make_examples(directories, first, last):
    """Render the examples.

    Parameters
    ----------
    directories : sequence of Path
        RIR directories that hold the sessions' RIRs.
    first, last : roomeq.loop.session.Session

    Returns
    -------
    Examples
    """
    data = first.data
    chosen = _chosen(data)
    recorded = _recorded(directories, {data.rows[n]["id"] for n in chosen})
    decay_db = np.full((len(chosen), len(KINDS), len(DECAY_BANDS), round(LENGTH_S / STEP_S)), np.nan)
    spectrum_db = np.full((len(chosen), len(KINDS), len(THIRDS_HZ)), np.nan)
    for k, n in enumerate(chosen):
        measured = recorded[data.rows[n]["id"]]
        direct, _ = find_direct(measured, FS_HZ)
        decay_db[k, 0] = _decays(measured, direct)
        features = np.where(data.valid[n], data.features[n], np.nan)[feature_slice("spectrum")]
        spectrum_db[k, 0] = features
        for kind, session in enumerate((first, last), start=1):
            rir, direct, gain_db = _rendered(session, n)
            decay_db[k, kind] = _decays(rir, direct)
            levels_db = measure_features(rir, direct).values[feature_slice("spectrum")] + gain_db
            spectrum_db[k, kind] = np.where(np.isfinite(features), levels_db, np.nan)
    return Examples([data.rows[n]["id"] for n in chosen], [data.rows[n]["room_id"] for n in chosen], decay_db,
                    spectrum_db)


def _chosen(data):
    """Of rooms from the smallest to the largest, one RIR each: that of the median distance."""
    rooms = np.unique(data.room)
    volume_m3 = [data.places[int(np.flatnonzero(data.room == r)[0])].room.volume_m3 for r in rooms]
    ordered = rooms[np.argsort(volume_m3, kind="stable")]
    picked = ordered[np.unique(np.linspace(0, len(ordered) - 1, N_EXAMPLES).round().astype(int))]
    chosen = []
    for r in picked:
        rows = np.flatnonzero(data.room == r)
        chosen.append(int(rows[np.argsort(data.distance_m[rows], kind="stable")[len(rows) // 2]]))
    return chosen


def _recorded(directories, ids):
    return {row["id"]: load_rir(directory, row) for directory in map(Path, directories)
            for row in read_rirs(directory) if row["id"] in ids}


def _rendered(session, n):
    """The RIR of a row as a session's model renders it, its direct sound, and the gain of its recording [dB]."""
    data = session.data
    absorption = session.packing.absorption(session.fit.mean, session.fit.local)
    by_row = session.by_row
    (raw,), _ = render_rows(data, absorption[data.room], by_row, seed=session.seed, rows=[n])
    rir = finished_rir(data, n, raw, by_row[n], session.seed)
    return rir, data.distance_m[n] / raw.scene.air.speed_m_s * FS_HZ, session.packing.gains(session.fit.local)[n]


def _decays(rir, direct):
    """Decay of some octaves, shape (2, n_times) [dB]."""
    bands = octave_bands(rir, FS_HZ, [EXACT_BANDS_HZ[band] for band in DECAY_BANDS])
    result = np.full((len(bands), round(LENGTH_S / STEP_S)), np.nan)
    for line, band in zip(result, bands, strict=True):
        curve = energy_decay(band, FS_HZ, direct).edc_db[::round(STEP_S * FS_HZ)][:len(line)]
        line[:len(curve)] = curve
    return result
