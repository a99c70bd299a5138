"""A few RIRs as measured and as simulated before and after the loop: decays and spectra, and the samples to listen to.

Figures show what errors in JND do not: where a decay bends, how wide a resonance is. No fit uses the examples.
"""

import io
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.lib.format import read_array

from roomeq.acoustics.direct import find_direct
from roomeq.acoustics.iso3382 import octave_decays
from roomeq.acoustics.octaves import SPECTRUM_HZ
from roomeq.core.arrays import Array, FloatArray
from roomeq.core.constants import EXACT_BANDS_HZ, FS_HZ
from roomeq.loop.data import Data
from roomeq.loop.features import feature_slice, measure_features
from roomeq.loop.rendering import finished_rir, render_rows, row_models
from roomeq.loop.session import Session
from roomeq.records.rir_dir import load_rir, read_rirs

EXAMPLES_FILE = "examples.npz"
KINDS = ("measured", "before", "after")
DECAY_BANDS = (1, 4)  # octaves: 125 Hz, which has modes, and 1 kHz
N_EXAMPLES = 3
STEP_S = 5e-3
LENGTH_S = 1.5
LEAD_S = 0.016
"""Time before the direct sound with which the RIRs to listen to begin [s]."""
N_SAMPLES = round((LEAD_S + LENGTH_S) * FS_HZ)


@dataclass(frozen=True)
class Examples:
    """Decays, spectra and samples of some RIRs.

    Attributes
    ----------
    ids, rooms : list of str
    decay_db : ndarray, shape (n_examples, 3 kinds, 2 bands, n_times)
        Backward-integrated energy every `STEP_S` after the direct sound; NaN where noise hides it.
    spectrum_db : ndarray, shape (n_examples, 3 kinds, 25)
        Level in third octaves (`roomeq.acoustics.octaves.SPECTRUM_HZ`); NaN where it was not measured.
    rirs : ndarray, shape (n_examples, 3 kinds, N_SAMPLES)
        The RIRs from `LEAD_S` before the direct sound on, with the gain of the recording.
    """

    ids: list[str]
    rooms: list[str]
    decay_db: FloatArray
    spectrum_db: FloatArray
    rirs: FloatArray


def write_examples(path: Path, recordings: Mapping[int, FloatArray], first: Session, last: Session) -> None:
    """Write the examples of a loop; see `make_examples`."""
    examples = make_examples(recordings, first, last)
    np.savez_compressed(path, ids=np.array(examples.ids, dtype=str), rooms=np.array(examples.rooms, dtype=str),
                        decay_db=examples.decay_db, spectrum_db=examples.spectrum_db,
                        rirs=examples.rirs.astype(np.float32))


def read_examples(path: Path) -> Examples:
    """Read the examples of a loop.

    Raises
    ------
    ValueError
        The file is invalid.
    """
    arrays = read_arrays(path, ("ids", "rooms", "decay_db", "spectrum_db", "rirs"))
    examples = Examples([str(name) for name in arrays["ids"]], [str(name) for name in arrays["rooms"]],
                        arrays["decay_db"], arrays["spectrum_db"], arrays["rirs"])
    size = len(examples.ids), len(KINDS)
    if (examples.decay_db.shape, examples.spectrum_db.shape, examples.rirs.shape, len(examples.rooms)) != (
            (*size, len(DECAY_BANDS), round(LENGTH_S / STEP_S)), (*size, len(SPECTRUM_HZ)),
            (*size, N_SAMPLES), size[0]):
        raise ValueError(f"{path}: arrays do not fit each other: run roomeq close-loop again")
    return examples


def read_arrays(path: Path, names: Sequence[str]) -> dict[str, Array]:
    """Read named arrays of a file that `numpy.savez_compressed` wrote.

    Raises
    ------
    ValueError
        The file cannot be read, or lacks an array.
    """
    try:
        with zipfile.ZipFile(path) as archive:  # an array of objects is refused
            return {name: read_array(io.BytesIO(archive.read(f"{name}.npy"))) for name in names}
    except FileNotFoundError:
        raise
    except Exception as error:  # zipfile, zlib and numpy raise a dozen kinds on broken bytes
        raise ValueError(f"{path}: cannot be read ({type(error).__name__}): run roomeq close-loop again") from None


def read_recordings(directories: Sequence[Path], data: Data) -> dict[int, FloatArray]:
    """Read the recordings that become examples from the RIR directories of the data, by the number of the RIR."""
    chosen = {data.rows[n]["id"]: n for n in _chosen(data)}
    recordings = {row["id"]: load_rir(directory, row) for directory in map(Path, directories)
                  for row in read_rirs(directory) if row["id"] in chosen}
    return {n: recordings[name] for name, n in chosen.items()}


def make_examples(recordings: Mapping[int, FloatArray], first: Session, last: Session) -> Examples:
    """Render a few RIRs with the base model and with the final model.

    Parameters
    ----------
    recordings : mapping
        Recordings by the number of the RIR (`read_recordings`).
    first, last : Session
        Of the base model and of the final model.
    """
    data = first.data
    chosen = list(recordings)
    decay_db = np.full((len(chosen), len(KINDS), len(DECAY_BANDS), round(LENGTH_S / STEP_S)), np.nan)
    spectrum_db = np.full((len(chosen), len(KINDS), len(SPECTRUM_HZ)), np.nan)
    rirs = np.zeros((len(chosen), len(KINDS), N_SAMPLES))
    for k, n in enumerate(chosen):
        measured = recordings[n]
        direct, _ = find_direct(measured, FS_HZ)
        decay_db[k, 0] = _decays(measured, direct)
        rirs[k, 0] = _from_direct(measured, direct)
        measured_db = np.where(data.valid[n], data.features[n], np.nan)[feature_slice("spectrum")]
        spectrum_db[k, 0] = measured_db
        for kind, session in enumerate((first, last), start=1):
            rir, direct, gain_db = _rendered(session, n)
            decay_db[k, kind] = _decays(rir, direct)
            rirs[k, kind] = _from_direct(rir, direct) * 10.0 ** (gain_db / 20.0)
            levels_db = measure_features(rir, direct).values[feature_slice("spectrum")] + gain_db
            spectrum_db[k, kind] = np.where(np.isfinite(measured_db), levels_db, np.nan)
    return Examples([data.rows[n]["id"] for n in chosen], [data.rows[n]["room_id"] for n in chosen], decay_db,
                    spectrum_db, rirs)


def _from_direct(rir: FloatArray, direct: float) -> FloatArray:
    """Return an RIR from `LEAD_S` before the direct sound on, shape (N_SAMPLES,)."""
    start = round(direct - LEAD_S * FS_HZ)
    part = np.concatenate([np.zeros(max(0, -start)), rir[max(0, start):]])[:N_SAMPLES]
    return np.pad(part, (0, N_SAMPLES - len(part)))


def _chosen(data: Data) -> list[int]:
    """Choose rooms from the smallest to the largest, and of each the RIR of the median distance."""
    rooms = np.unique(data.room)
    volume_m3 = [data.places[int(np.flatnonzero(data.room == r)[0])].room.volume_m3 for r in rooms]
    ordered = rooms[np.argsort(volume_m3, kind="stable")]
    picked = ordered[np.unique(np.linspace(0, len(ordered) - 1, N_EXAMPLES).round().astype(int))]
    chosen = []
    for r in picked:
        rows = np.flatnonzero(data.room == r)
        chosen.append(int(rows[np.argsort(data.distance_m[rows], kind="stable")[len(rows) // 2]]))
    return chosen


def _rendered(session: Session, n: int) -> tuple[FloatArray, float, float]:
    """Render RIR `n` with a session's model; return it, its direct sample, and the gain of its recording [dB]."""
    data, index = session.data, session.index
    absorption = index.absorption(session.fit.mean, session.fit.local)
    by_row = session.by_row
    (raw,), _ = render_rows(data, row_models(data, absorption, by_row, [n]), seed=session.seed)
    rir = finished_rir(data, n, raw, by_row[n], session.seed)
    return rir, data.distance_m[n] / raw.scene.air.speed_m_s * FS_HZ, index.gains(session.fit.local)[n]


def _decays(rir: FloatArray, direct: float) -> FloatArray:
    """Return the decay curves of `DECAY_BANDS`, shape (2, n_times) [dB]."""
    decays = octave_decays(rir, FS_HZ, direct, [EXACT_BANDS_HZ[band] for band in DECAY_BANDS])
    result = np.full((len(decays), round(LENGTH_S / STEP_S)), np.nan)
    for line, decay in zip(result, decays, strict=True):
        curve = decay.edc_db[::round(STEP_S * FS_HZ)][:len(line)]
        line[:len(curve)] = curve
    return result
