"""The RIR directory: audio, `rirs.jsonl` and `noises.jsonl` with one JSON object per line, sorted by id.

Every step that writes or reads RIRs uses this format. `roomeq.records.schema` declares the keys of a row:

required
    `id`, `wav` (relative to the directory), `room_id`, `source_id`, `mic_id`; `fs_hz` and `n_samples` are read from the
    audio file where a hand-written row lacks them
geometry, `null` where nobody measured it (each coordinate on its own)
    `room_dims_m` [x, y, z] or `mesh` (a file), `source_pos_m`, `mic_pos_m`, `source_dir`, `mic_dir`
measurement
    `suspicious`: why the recording is no RIR, or null; a row without it is checked where its audio is used
parameters
    `acoustic_parameters`: what `roomeq characterise` measured; `screen`: why the EQ fit leaves the RIR out, or null
"""

import contextlib
import difflib
import json
import logging
import os
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, cast
from urllib.parse import unquote

from roomeq.core.arrays import FloatArray
from roomeq.core.constants import FS_HZ, require_air, require_fs
from roomeq.core.files import path_from, read_jsonl, write_jsonl, write_text
from roomeq.core.stamps import read_stamp
from roomeq.records.parameters import value_of
from roomeq.records.schema import NoiseRow, RirRow, noise_problem, row_problem, stated_air

logger = logging.getLogger(__name__)

ROWS_FILE = "rirs.jsonl"
NOISES_FILE = "noises.jsonl"
_LIKENESS = 0.7  # of a key to a known one, above which it may be misspelt


def read_rirs(directory: Path) -> list[RirRow]:
    """Read and check the rows of an RIR directory; each has `fs_hz` and `n_samples`.

    Raises
    ------
    ValueError
        The directory or its `rirs.jsonl` is missing or empty, another version of roomeq wrote it, or a row breaks the
        contract; the message names the first line that does.
    """
    path = Path(directory) / ROWS_FILE
    read_stamp(directory)
    if not path.is_file():
        raise ValueError(f"{path}: no such file: check the path, or run the step that makes it (of recordings: roomeq "
                         "read-measured)")
    rows = cast(list[RirRow], _read_checked(path, row_problem))
    if not rows:
        raise ValueError(f"{path}: no RIRs in it: run the step that makes it again")
    for number, row in enumerate(rows, start=1):
        if "fs_hz" not in row or "n_samples" not in row:
            from roomeq.core.audio import audio_info

            try:
                header = audio_info(rir_path(directory, row))
            except ValueError as error:
                raise ValueError(f"{path}:{number}: fs_hz and n_samples cannot be read: {error}; roomeq "
                                 "simulate needs no audio if the row states both") from None
            row.setdefault("fs_hz", header.samplerate)
            row.setdefault("n_samples", header.frames)
    return rows


def warn_of_unused_keys(directory: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    """Log the keys of a hand-written `rirs.jsonl` that have no meaning, each with the known key most like it."""
    if read_stamp(directory) is not None:
        return
    known = sorted(RirRow.__annotations__)
    texts = []
    for key in sorted({key for row in rows for key in row} - set(known)):
        close = difflib.get_close_matches(key, known, n=1, cutoff=_LIKENESS)
        texts.append(f"{key} (did you mean {close[0]}?)" if close else key)
    if texts:
        logger.warning("%s: keys not used: %s", Path(directory) / ROWS_FILE, ", ".join(texts))


def _read_checked(path: Path, problem_of: Callable[[dict], str | None]) -> list[dict]:
    """Read rows, each without a problem and with an id that sorts after the one before."""
    rows, previous_id = read_jsonl(path), ""
    for number, row in enumerate(rows, start=1):
        problem = problem_of(row)
        if not problem and row["id"] <= previous_id:
            problem = f"id {row['id']!r} must sort after {previous_id!r} (duplicate or unsorted)"
        if problem:
            raise ValueError(f"{path}:{number}: {problem}: correct the line or make the file again")
        previous_id = row["id"]
    return rows


def write_rirs(directory: Path, rows: Iterable[Mapping[str, Any]], final_directory: Path | None = None) -> None:
    """Write `rirs.jsonl`, sorted by id, and Kaldi's `rir_list` beside it.

    Parameters
    ----------
    directory : Path
        Where the files go.
    rows : iterable of mappings
        See `roomeq.records.schema.RirRow`.
    final_directory : Path, optional
        Path of the directory that `rir_list` refers to, where the directory is renamed once it is complete.

    Raises
    ------
    ValueError
        A row breaks the contract or two rows share an id.
    """
    directory = Path(directory)
    sorted_rows = sorted(map(dict, rows), key=lambda row: row.get("id", ""))
    previous_id = None
    for row in sorted_rows:
        problem = row_problem(json.loads(json.dumps(row)))  # as it will be read: NumPy's numbers are plain ones then
        if not problem and row["id"] == previous_id:
            problem = f"id {row['id']!r} occurs twice: ids must be unique"
        if problem:
            raise ValueError(f"{directory / ROWS_FILE}: {problem}")
        previous_id = row["id"]
    write_jsonl(directory / ROWS_FILE, sorted_rows)
    base = Path(final_directory or directory)
    write_text(directory / "rir_list", "".join(
        f"--rir-id {row['id']} --room-id {row['room_id']} "
        f"{shlex.quote(_as_16_bit(base / row['wav'], n_channels(row)))}\n"
        for row in sorted_rows if not row.get("noise_for")))


def _as_16_bit(path: Path, channels: int) -> str:
    """Return the pipe through which Kaldi reads an RIR; of an array, that of the first microphone.

    `wav-reverberate` takes 16-bit PCM only, and its output does not depend on the RIR's level: sox scales the RIR to
    full scale.
    """
    first = "remix 1 " if channels > 1 else ""
    return f"sox -D {shlex.quote(without_detour(path))} -b 16 -e signed-integer -t wav - {first}gain -n -1 |"


def without_detour(path: Path) -> str:
    """Return a path such as ``out/../folder/a.wav`` as ``folder/a.wav``, if that is the same file."""
    short = os.path.normpath(path)
    if os.path.realpath(short) != os.path.realpath(path):  # `..` leads out of a linked directory
        return str(path)
    return short


def require_16_khz(directory: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    """Raise a `ValueError` unless all rows are at the one rate of the EQ, the closed loop and Kaldi's data."""
    for row in rows:
        if row.get("fs_hz", FS_HZ) != FS_HZ:
            raise ValueError(f"{directory}: RIR {row['id']} has fs_hz={row['fs_hz']} and must have {FS_HZ} in this "
                             f"step: make the RIRs at {FS_HZ} Hz")


def rir_path(directory: Path, row: Mapping[str, Any]) -> Path:
    """Return the path of a row's audio."""
    return Path(directory) / row["wav"]


def n_channels(row: Mapping[str, Any]) -> int:
    """Return the number of channels of a row's audio: the microphones of an array, else 1."""
    return len(row.get("channel_pos_m") or (None,))


def relocated(rows: Iterable[Mapping[str, Any]], directory: Path, out: Path) -> list[dict[str, Any]]:
    """Return rows of RIRs or noises of `directory` with `wav` and `mesh` relative to `out`, for the same files."""
    return [{**row, "wav": path_from(rir_path(directory, row), out)}
            for row in with_meshes_relocated(rows, directory, out)]


def with_meshes_relocated(rows: Iterable[Mapping[str, Any]], directory: Path, out: Path) -> list[dict[str, Any]]:
    """Return rows of RIRs with `mesh`, which is relative to `directory`, made relative to `out`."""
    return [{**row, "mesh": path_from(Path(directory) / row["mesh"], out)} if row.get("mesh") else dict(row)
            for row in rows]


def mesh_files(directory: Path) -> list[Path]:
    """Return the files of the meshes of an RIR directory, and those of the buffers of glTF files, sorted.

    Buffers that are missing or malformed are left to the reader of meshes. A directory of another kind has none.
    """
    if not (Path(directory) / ROWS_FILE).is_file():
        return []
    found = {Path(directory) / mesh for row in read_rirs(directory) if (mesh := row.get("mesh"))}
    for path in sorted(found):
        if path.suffix.lower() == ".gltf":
            with contextlib.suppress(OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
                uris = [buffer["uri"] for buffer in json.loads(path.read_bytes())["buffers"] if "uri" in buffer]
                found |= {path.parent / name for uri in uris if not uri.lower().startswith("data:")
                          for name in {uri, unquote(uri)} if (path.parent / name).is_file()}
    return sorted(found)


def load_rir(directory: Path, row: Mapping[str, Any], fs_hz: int = FS_HZ) -> FloatArray:
    """Read the RIR of a row, shape (n_samples,); row and file must have the sample rate `fs_hz`, such as row["fs_hz"].

    Of an array (`channel_pos_m`), the RIR is that of the first microphone.

    Raises
    ------
    ValueError
        See `roomeq.core.audio.read_audio`; also when the RIR is silent or its length is not the row's.
    """
    from roomeq.core.audio import read_audio

    path = rir_path(directory, row)
    if row.get("fs_hz", fs_hz) != fs_hz:
        raise ValueError(f"{path}: RIR {row['id']} has fs_hz={row['fs_hz']} where {fs_hz} is expected: make the RIRs "
                         f"at {fs_hz} Hz, or give load_rir their rate")
    rir = read_audio(path, fs_hz=fs_hz, resample=False, channel=0 if row.get("channel_pos_m") else None)
    if len(rir) != row["n_samples"]:
        raise ValueError(f"{path}: {len(rir)} samples where {ROWS_FILE} says {row['n_samples']}: make it again")
    if not rir.any():
        raise ValueError(f"{path}: RIR {row['id']} is silent (all samples 0): leave it out or record it again")
    return rir


def load_channels(directory: Path, row: Mapping[str, Any]) -> FloatArray:
    """Read the RIRs of all microphones of a row, shape (n_samples, n_channels), or (n_samples,) of a single one.

    Raises
    ------
    ValueError
        See `load_rir`.
    """
    from roomeq.core.audio import read_audio

    first = load_rir(directory, row)
    if n_channels(row) == 1:
        return first
    import numpy as np

    return np.column_stack([first, *(read_audio(rir_path(directory, row), fs_hz=FS_HZ, resample=False, channel=channel)
                                     for channel in range(1, n_channels(row)))])


class DecayRange(NamedTuple):
    """Shortest and longest decay time of several rooms [s]."""

    shortest_s: float
    longest_s: float


def decay_range_s(rows: Sequence[RirRow]) -> DecayRange:
    """Return the range of the rooms' decay times, each the median T20 at 1 kHz of the room's RIRs.

    T20 is less often invalid through noise than T30, and a median does not follow a single RIR.

    Raises
    ------
    ValueError
        No room has a valid T20.
    """
    times_of_room: dict[str, list[float]] = {}
    for row in rows:
        if (t20_s := value_of(row.get("acoustic_parameters") or {}, "t20")) is not None:
            times_of_room.setdefault(row["room_id"], []).append(t20_s)
    if not times_of_room:
        raise ValueError("no RIR has a valid T20 at 1 kHz among its acoustic parameters: run roomeq characterise "
                         "first, or give two times [s]")
    from statistics import median

    medians_s = [float(median(times_s)) for times_s in times_of_room.values()]
    return DecayRange(min(medians_s), max(medians_s))


def read_noises(directory: Path) -> list[NoiseRow]:
    """Read and check the rows of `noises.jsonl`; a directory without the file has none.

    Raises
    ------
    ValueError
        Another version of roomeq wrote the directory, or a row breaks the contract; the message names the first line
        that does.
    """
    path = Path(directory) / NOISES_FILE
    read_stamp(directory)
    return cast(list[NoiseRow], _read_checked(path, noise_problem)) if path.is_file() else []


def write_noises(directory: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    """Write `noises.jsonl`, sorted by id."""
    write_jsonl(Path(directory) / NOISES_FILE, sorted(map(dict, rows), key=lambda row: row["id"]))


def validate_rirs(directory: Path) -> int:
    """Check every row, audio file and noise of an RIR directory, and return the number of RIRs.

    Raises
    ------
    ValueError
        The first line that breaks the contract, or the first audio file that does not fit its row.
    """
    from roomeq.core.audio import audio_info

    rows = read_rirs(directory)
    for row in rows:
        try:
            require_fs(row["fs_hz"])
            require_air(**stated_air(row))
        except ValueError as error:
            raise ValueError(f"{Path(directory) / ROWS_FILE}: RIR {row['id']}: {error}") from None
        info = audio_info(rir_path(directory, row))
        if (info.samplerate, info.frames, info.channels) != (row["fs_hz"], row["n_samples"], n_channels(row)):
            raise ValueError(f"{rir_path(directory, row)}: {info.channels} channels of {info.frames} samples at "
                             f"{info.samplerate} Hz do not fit row {row['id']}: make it again")
        load_rir(directory, row, row["fs_hz"])
    ids = {row["id"] for row in rows}
    for number, row in enumerate(rows, start=1):
        if row.get("noise_for") and row["noise_for"] not in ids:
            raise ValueError(f"{Path(directory) / ROWS_FILE}:{number}: noise_for={row['noise_for']!r} must be the id "
                             "of another RIR of the directory: make it again")
    validate_noises(directory)
    return len(rows)


def validate_noises(directory: Path) -> int:
    """Check every noise row and audio file of a directory, and return the number of noises.

    Raises
    ------
    ValueError
        The first line that breaks the contract, or the first audio file that does not fit its row.
    """
    from roomeq.core.audio import audio_info, read_audio, sounds

    noises = read_noises(directory)
    for noise in noises:
        path = Path(directory) / noise["wav"]
        info = audio_info(path)
        stated_s, rate_hz = noise.get("duration_s"), noise.get("fs_hz") or info.samplerate
        if info.samplerate != rate_hz or (stated_s is not None and abs(info.frames / rate_hz - stated_s) > 1e-3):
            raise ValueError(f"{path}: {info.frames / info.samplerate:g} s at {info.samplerate} Hz do not fit row "
                             f"{noise['id']} ({stated_s} s at {rate_hz} Hz): make it again")
        if not sounds(read_audio(path, fs_hz=info.samplerate, dtype="float32")):
            raise ValueError(f"{path}: noise {noise['id']} is silent (all samples the same): leave it out")
    return len(noises)
