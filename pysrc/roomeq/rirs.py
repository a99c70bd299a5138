"""The RIR directory: audio plus `rirs.jsonl`, one JSON object a line, sorted by id.

Every step that makes or takes RIRs speaks this format. Keys of a row:

required
    `id`, `wav` (relative to the directory), `room_id`, `source_id`, `mic_id`, `fs_hz`, `n_samples`
geometry, `null` where nobody measured it (each coordinate on its own)
    `room_dims_m` [x, y, z] or `mesh` (a file), `source_pos_m`, `mic_pos_m`, `source_dir`, `mic_dir`
passport
    `passport`: what `roomeq characterise` measured; `screen`: why the RIR is left out of the EQ fit, or null
"""

import math
import os
import re
import shlex
from pathlib import Path

import numpy as np

from roomeq.audio import audio_info, read_audio
from roomeq.constants import FS_HZ
from roomeq.files import read_jsonl, write_jsonl, write_text

ROWS_FILE = "rirs.jsonl"
NOISES_FILE = "noises.jsonl"
_ID = re.compile(r"[A-Za-z0-9_+][A-Za-z0-9._+-]*")
_REQUIRED = ("id", "wav", "room_id", "source_id", "mic_id", "fs_hz", "n_samples")
_POSITIONS = ("room_dims_m", "source_pos_m", "mic_pos_m", "source_dir", "mic_dir")


def is_id(text: str) -> bool:
    """Tell whether a text may be an id: letters, digits and ``._+-``, no path, no leading dash or dot."""
    return isinstance(text, str) and _ID.fullmatch(text) is not None


def make_id(text: str) -> str:
    """Return the text with everything that an id may not hold turned into ``-``."""
    cleaned = re.sub(r"[^A-Za-z0-9._+-]+", "-", text).lstrip(".-")
    return cleaned or "x"


def read_rirs(directory: Path) -> list[dict]:
    """Read and check the rows of an RIR directory.

    Raises
    ------
    ValueError
        The directory or its `rirs.jsonl` is missing or empty, or a row breaks the contract; the message names
        the first line that does.
    """
    path = Path(directory) / ROWS_FILE
    rows = read_jsonl(path)
    if not rows:
        raise ValueError(f"{path}: no RIRs in it: run the step that makes it again")
    previous = ""
    for number, row in enumerate(rows, start=1):
        problem = row_problem(row)
        if not problem and row["id"] <= previous:
            problem = f"id {row['id']!r} must sort after {previous!r} (duplicate or unsorted)"
        if problem:
            raise ValueError(f"{path}:{number}: {problem}: correct the line or make the file again")
        previous = row["id"]
    return rows


def row_problem(row: dict) -> str | None:
    """Return what is wrong with one row, or None."""
    missing = [key for key in _REQUIRED if key not in row]
    if missing:
        return f"key {missing[0]!r} is missing"
    for key in ("id", "room_id", "source_id", "mic_id"):
        if not is_id(row[key]):
            return f"{key}={row[key]!r} must be letters, digits or ._+- and hold no path"
    if not isinstance(row["wav"], str) or "\n" in row["wav"] or not row["wav"]:
        return f"wav={row['wav']!r} must be a file name"
    for key in ("fs_hz", "n_samples"):
        if not isinstance(row[key], int) or isinstance(row[key], bool) or row[key] <= 0:
            return f"{key}={row[key]!r} must be a positive integer"
    for key in _POSITIONS:
        value = row.get(key)
        if value is not None and not _is_vector(value):
            return f"{key}={value!r} must be three numbers (each may be null)"
    return None


def _is_vector(value) -> bool:
    return isinstance(value, list) and len(value) == 3 and all(
        x is None or (isinstance(x, (int, float)) and not isinstance(x, bool) and math.isfinite(x)) for x in value)


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
    # wav-reverberate reads 16-bit PCM only, and normalises the output: sox brings any RIR to full scale
    write_text(directory / "rir_list", "".join(
        f"--rir-id {row['id']} --room-id {row['room_id']} "
        f"sox -D {shlex.quote(str(base / row['wav']))} -b 16 -e signed-integer -t wav - gain -n -1 |\n"
        for row in rows if not row.get("noise_for")))


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
        See `roomeq.audio.read_audio`; also when the RIR is silent or its length is not the row's.
    """
    path = rir_path(directory, row)
    rir = read_audio(path, resample=False)
    if len(rir) != row["n_samples"]:
        raise ValueError(f"{path}: {len(rir)} samples where {ROWS_FILE} says {row['n_samples']}: make it again")
    if not np.any(rir):
        raise ValueError(f"{path}: RIR {row['id']} is silent (all samples 0): leave it out or record it again")
    return rir


def read_noises(directory: Path) -> list[dict]:
    """Read `noises.jsonl` of an RIR directory (`id, wav, room_id, kind, duration_s, fs_hz`), or []."""
    path = Path(directory) / NOISES_FILE
    if not path.is_file():
        return []
    rows = read_jsonl(path)
    for number, row in enumerate(rows, start=1):
        if not is_id(row.get("id")) or not isinstance(row.get("wav"), str):
            raise ValueError(f"{path}:{number}: a noise needs an id (letters, digits, ._+-) and a wav")
        if row.get("kind") not in ("ambient", "point"):
            raise ValueError(f"{path}:{number}: kind={row.get('kind')!r} must be 'ambient' or 'point'")
    return rows


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
    for noise in read_noises(directory):
        audio_info(Path(directory) / noise["wav"])
    return len(rows)
