"""The RIR directory: audio plus `rirs.jsonl`, one JSON object a line, sorted by id.

Every step that makes or takes RIRs speaks this format. Keys of a row:

required
    `id`, `wav` (relative to the directory), `room_id`, `source_id`, `mic_id`, `fs_hz`, `n_samples`
geometry, `null` where nobody measured it (each coordinate on its own)
    `room_dims_m` [x, y, z] or `mesh` (a file), `source_pos_m`, `mic_pos_m`, `source_dir`, `mic_dir`
parameters
    `acoustic_parameters`: what `roomeq characterise` measured; `screen`: why the RIR is left out of the EQ fit, or null
"""

import os
import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np

from roomeq.core.audio import audio_info, read_audio
from roomeq.core.constants import BANDS_HZ, FS_HZ
from roomeq.core.files import read_jsonl, write_jsonl, write_text
from roomeq.records.schema import noise_problem, row_problem

ROWS_FILE = "rirs.jsonl"
NOISES_FILE = "noises.jsonl"


def read_rirs(directory: Path) -> list[dict]:
    """Read and check the rows of an RIR directory.

    Raises
    ------
    ValueError
        The directory or its `rirs.jsonl` is missing or empty, or a row breaks the contract; the message names
        the first line that does.
    """
    path = Path(directory) / ROWS_FILE
    rows = _checked(path, row_problem)
    if not rows:
        raise ValueError(f"{path}: no RIRs in it: run the step that makes it again")
    return rows


def _checked(path: Path, problem_of: Callable) -> list[dict]:
    """Read rows; each must be right, and its id sort after the one before."""
    rows, previous = read_jsonl(path), ""
    for number, row in enumerate(rows, start=1):
        problem = problem_of(row)
        if not problem and row["id"] <= previous:
            problem = f"id {row['id']!r} must sort after {previous!r} (duplicate or unsorted)"
        if problem:
            raise ValueError(f"{path}:{number}: {problem}: correct the line or make the file again")
        previous = row["id"]
    return rows


def write_rirs(directory: Path, rows: list[dict], final_directory: Path | None = None) -> None:
    """Write `rirs.jsonl`, sorted by id, and Kaldi's `rir_list` beside it.

    Parameters
    ----------
    directory : Path
        Where the files go.
    rows : list of dict
    final_directory : Path, optional
        Path of the directory as `rir_list` shall name it, where it is still being built elsewhere.

    Raises
    ------
    ValueError
        A row breaks the contract or two rows share an id.
    """
    directory = Path(directory)
    rows = sorted(rows, key=lambda row: row.get("id", ""))
    for n, row in enumerate(rows):
        problem = row_problem(row)
        if not problem and n and row["id"] == rows[n - 1]["id"]:
            problem = f"id {row['id']!r} stands twice: ids must be unique"
        if problem:
            raise ValueError(f"{directory / ROWS_FILE}: {problem}")
    write_jsonl(directory / ROWS_FILE, rows)
    base = Path(final_directory or directory)
    write_text(directory / "rir_list", "".join(
        f"--rir-id {row['id']} --room-id {row['room_id']} {shlex.quote(_as_16_bit(base / row['wav']))}\n"
        for row in rows if not row.get("noise_for")))


def _as_16_bit(path: Path) -> str:
    """Return the pipe through which Kaldi reads an RIR: `wav-reverberate` takes 16-bit PCM only, and its output does
    not depend on the RIR's level, so sox brings it to full scale."""
    return f"sox -D {shlex.quote(os.path.normpath(path))} -b 16 -e signed-integer -t wav - gain -n -1 |"


def rir_path(directory: Path, row: dict) -> Path:
    """Return the path of a row's audio."""
    return Path(directory) / row["wav"]


def relocated(rows: list[dict], directory: Path, out: Path) -> list[dict]:
    """Return rows of RIRs or noises as another directory must write them, so that they name the same audio."""
    return [row | dict(wav=os.path.relpath(rir_path(directory, row), out)) for row in rows]


def load_rir(directory: Path, row: dict) -> np.ndarray:
    """Read the RIR of a row, shape (n_samples,), at `FS_HZ`.

    Raises
    ------
    ValueError
        See `roomeq.core.audio.read_audio`; also when the RIR is silent or its length is not the row's.
    """
    path = rir_path(directory, row)
    rir = read_audio(path, resample=False)
    if len(rir) != row["n_samples"]:
        raise ValueError(f"{path}: {len(rir)} samples where {ROWS_FILE} says {row['n_samples']}: make it again")
    if not np.any(rir):
        raise ValueError(f"{path}: RIR {row['id']} is silent (all samples 0): leave it out or record it again")
    return rir


def decay_range_s(rows: list[dict]) -> tuple[float, float]:
    """Return the shortest and longest decay time of the rooms of some RIRs [s]: of each, the median T20 at 1 kHz.

    T20, which ambient noise spoils less often than T30, and a median, so that no single RIR decides.

    Raises
    ------
    ValueError
        No room has a valid T20.
    """
    band, of_room = BANDS_HZ.index(1000), {}
    for row in rows:
        parameters = row.get("acoustic_parameters") or {}
        t20_s, valid = ((parameters.get(key) or [None] * len(BANDS_HZ))[band] for key in ("t20_s", "t20_valid"))
        if valid and t20_s is not None:
            of_room.setdefault(row["room_id"], []).append(t20_s)
    if not of_room:
        raise ValueError("no RIR has a valid T20 at 1 kHz among its acoustic parameters: run roomeq characterise first, or give two "
                         "times [s]")
    medians_s = [float(np.median(times_s)) for times_s in of_room.values()]
    return min(medians_s), max(medians_s)


def read_noises(directory: Path) -> list[dict]:
    """Read and check `noises.jsonl` of an RIR directory (`id, wav, room_id, kind, duration_s, fs_hz`), or return [].

    Raises
    ------
    ValueError
        A row breaks the contract; the message names the first line that does.
    """
    path = Path(directory) / NOISES_FILE
    return _checked(path, noise_problem) if path.is_file() else []


def write_noises(directory: Path, rows: list[dict]) -> None:
    """Write `noises.jsonl`, sorted by id."""
    write_jsonl(Path(directory) / NOISES_FILE, sorted(rows, key=lambda row: row["id"]))


def validate_rirs(directory: Path) -> int:
    """Check an RIR directory whole, audio included, and return the number of RIRs.

    Raises
    ------
    ValueError
        The first line that breaks the contract, or the first audio file that does not fit its row.
    """
    rows = read_rirs(directory)
    for row in rows:
        info = audio_info(rir_path(directory, row))
        if (info.samplerate, info.frames, info.channels) != (row["fs_hz"], row["n_samples"], 1):
            raise ValueError(f"{rir_path(directory, row)}: {info.channels} channels of {info.frames} samples at "
                             f"{info.samplerate} Hz do not fit row {row['id']}: make it again")
        if info.samplerate != FS_HZ:
            raise ValueError(f"{rir_path(directory, row)}: sample rate {info.samplerate} Hz must be {FS_HZ} Hz")
        load_rir(directory, row)
    ids = {row["id"] for row in rows}
    for number, row in enumerate(rows, start=1):
        if row.get("noise_for") and row["noise_for"] not in ids:
            raise ValueError(f"{Path(directory) / ROWS_FILE}:{number}: noise_for={row['noise_for']!r} must be the id "
                             "of another RIR of the directory: make it again")
    validate_noises(directory)
    return len(rows)


def validate_noises(directory: Path) -> int:
    """Check the noises of a directory whole, audio included, and return their number.

    Raises
    ------
    ValueError
        The first line that breaks the contract, or the first audio file that does not fit its row.
    """
    noises = read_noises(directory)
    for noise in noises:
        path = Path(directory) / noise["wav"]
        info = audio_info(path)
        stated_s, rate_hz = noise.get("duration_s"), noise.get("fs_hz") or info.samplerate
        if info.samplerate != rate_hz or (stated_s is not None and abs(info.frames / rate_hz - stated_s) > 1e-3):
            raise ValueError(f"{path}: {info.frames / info.samplerate:g} s at {info.samplerate} Hz do not fit row "
                             f"{noise['id']} ({stated_s} s at {rate_hz} Hz): make it again")
        if not np.any(read_audio(path, channel=0, dtype="float32")):
            raise ValueError(f"{path}: noise {noise['id']} is silent (all samples 0): leave it out")
    return len(noises)
