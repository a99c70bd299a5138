"""What `roomeq show` and `roomeq compare` are given: an RIR file, an RIR directory, output of the loop, or a mesh."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from roomeq.acoustics.direct import direct_of
from roomeq.acoustics.plausibility import find_implausibility
from roomeq.core.arrays import FloatArray
from roomeq.core.audio import audio_info, read_audio
from roomeq.core.groups import numbers_by
from roomeq.core.progress import progress
from roomeq.records.rir_dir import ROWS_FILE, read_rirs, rir_path
from roomeq.records.schema import RirRow
from roomeq.show.analysis import AnalysedRir, analyse, measure_parameters
from roomeq.sim.meshfile import FORMATS

Kind = Literal["rir", "set", "loop", "room"]
KEEP = "show it all the same with --keep-suspicious"
_SIMILAR = 3


@dataclass(frozen=True)
class ShownRir:
    """An RIR to show.

    Attributes
    ----------
    rir : AnalysedRir
    row : dict, optional
        Its row, for geometry.
    directory : Path, optional
        The RIR directory of the row.
    problem : str, optional
        Why the recording is no RIR by its acoustics.
    """

    rir: AnalysedRir
    row: RirRow | None = None
    directory: Path | None = None
    problem: str | None = None


@dataclass(frozen=True)
class RirSet:
    """The RIRs of a directory, without those of noise sources.

    Attributes
    ----------
    directory : Path
    rows : list of dict
    parameters : list of dict
        The acoustic parameters of each; recordings that are no RIR are left out.
    left_out : list of str
        Ids of recordings that are no RIR or cannot be analysed.
    """

    directory: Path
    rows: list[RirRow]
    parameters: list[dict[str, Any]]
    left_out: list[str]

    @property
    def label(self) -> str:
        """Name in figures and tables."""
        return readable(self.directory.resolve().name)

    @property
    def rooms(self) -> dict[str, list[int]]:
        """Numbers of the RIRs of each room."""
        return numbers_by(row["room_id"] for row in self.rows)


def kind_of(path: Path) -> Kind:
    """Tell what a path is.

    Raises
    ------
    ValueError
        It is absent, or a directory of another kind.
    """
    if (path / ROWS_FILE).is_file():
        return "set"
    if path.is_dir():
        from roomeq.loop.ledger import LEDGER_FILE  # takes seconds, with all that the loop computes with

        if (path / LEDGER_FILE).is_file():
            return "loop"
        raise ValueError(f"{path}: neither {ROWS_FILE} of an RIR directory nor {LEDGER_FILE} of roomeq close-loop in "
                         "it: give one of these directories or an RIR file; roomeq read-measured makes a directory of "
                         "a folder of RIRs")
    if not path.exists():
        raise ValueError(f"{path}: no such file or directory: check the path")
    return "room" if path.suffix.lower() in FORMATS else "rir"


def read_rir_file(path: Path, channel: int | None = None, keep_suspicious: bool = False) -> ShownRir:
    """Read an RIR file; its row is looked up in an RIR directory around it.

    Raises
    ------
    ValueError
        The file is no audio, has several channels where none is chosen, or is no RIR.
    """
    n_channels = audio_info(path).channels
    if channel is None and n_channels > 1:
        raise ValueError(f"{path}: {n_channels} channels where one is expected: choose one with --channel 0 to "
                         f"{n_channels - 1}")
    samples = read_audio(path, fs_hz=(fs_hz := audio_info(path).samplerate), channel=channel)
    directory, row = _row_of(path)
    if row is not None and channel:
        row = _row_of_channel(row, channel)
    name = readable(path.name) + ("" if channel is None else f", channel {channel}")
    return _shown(samples, fs_hz, name, path, keep_suspicious, row, directory)


def read_rir_of(directory: Path, ident: str, keep_suspicious: bool = False) -> ShownRir:
    """Read one RIR of a directory.

    Raises
    ------
    ValueError
        The directory has no RIR of this id, its audio cannot be read, or it is no RIR.
    """
    rows = {row["id"]: row for row in read_rirs(directory)}
    if ident not in rows:
        import difflib

        similar = difflib.get_close_matches(ident, list(rows), n=_SIMILAR, cutoff=0.4) or list(rows)[:_SIMILAR]
        raise ValueError(f"{directory}: no RIR {ident!r} among its {len(rows)}: give an id of {ROWS_FILE}, such as "
                         f"{', '.join(similar)}")
    row = rows[ident]
    return _shown(read_samples(directory, row), row["fs_hz"], ident, rir_path(directory, row), keep_suspicious, row,
                  directory)


def read_samples(directory: Path, row: RirRow) -> FloatArray:
    """Read the RIR of a row at its own sample rate, shape (n_samples,)."""
    path = rir_path(directory, row)
    samples = read_audio(path, fs_hz=row["fs_hz"], resample=False, channel=0 if row.get("channel_pos_m") else None)
    if len(samples) != row["n_samples"]:
        raise ValueError(f"{path}: {len(samples)} samples where {ROWS_FILE} says {row['n_samples']}: make it again")
    return samples


def read_set(directory: Path, keep_suspicious: bool = False) -> RirSet:
    """Read the RIRs of a directory with their acoustic parameters, which are measured where the rows lack them.

    Recordings that are no RIR are left out: those that are marked so, unless they are kept, and those without a direct
    sound.

    Raises
    ------
    ValueError
        The directory is invalid, or none of its recordings is an RIR.
    """
    given = [row for row in read_rirs(directory) if not row.get("noise_for")]
    rows, parameters, left_out = [], [], []
    for row in progress(given, len(given), "measure"):
        measured = None if row.get("suspicious") and not keep_suspicious else _parameters(directory, row)
        if measured is None:
            left_out.append(row["id"])
        else:
            rows.append(row)
            parameters.append(measured)
    if not rows:
        raise ValueError(f"{directory}: none of its {len(given)} recordings is an RIR: look at one with --id "
                         f"{given[0]['id'] if given else 'ID'} --keep-suspicious")
    return RirSet(directory, rows, parameters, left_out)


def readable(name: str) -> str:
    """Return a file name with everything that cannot be printed replaced."""
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in name)


def middle_of(of_set: RirSet) -> str:
    """Return the id of the RIR whose DRR is the median of a set, to show as its example."""
    known = [(parameters["drr_db"], row["id"]) for row, parameters in zip(of_set.rows, of_set.parameters, strict=True)
             if parameters.get("drr_db") is not None]
    return sorted(known)[len(known) // 2][1] if known else of_set.rows[0]["id"]


def _parameters(directory: Path, row: RirRow) -> dict[str, Any] | None:
    """Return the acoustic parameters of a row, measured unless they are stored; None if there is no direct sound."""
    stored = row.get("acoustic_parameters") or {}
    if "eq_db" in stored:
        return dict(stored)
    samples = read_samples(directory, row)
    try:
        return measure_parameters(samples, row["fs_hz"], direct_of(row, samples))
    except ValueError:
        return None


def _shown(samples: FloatArray, fs_hz: int, name: str, path: Path, keep_suspicious: bool, row: RirRow | None,
           directory: Path | None) -> ShownRir:
    problem = None if row is not None and row.get("seed") is not None else find_implausibility(samples, fs_hz)
    if problem and not keep_suspicious:
        raise ValueError(f"{path}: no RIR by its acoustics: {problem}; {KEEP}")
    try:
        direct = direct_of(row, samples) if row is not None else None
        rir = _with_stored_validity(analyse(samples, fs_hz, name, direct), row)
    except ValueError as error:
        raise ValueError(f"{path}: {str(error).removeprefix(f'{name}: ')}") from None
    return ShownRir(rir, row, directory, problem)


def _with_stored_validity(rir: AnalysedRir, row: RirRow | None) -> AnalysedRir:
    """Return an RIR with the validity that its row states: it knows the excitation of other RIRs of the source."""
    stored = (row.get("acoustic_parameters") if row is not None else None) or {}
    flags = {key: value for key, value in stored.items() if key.endswith("_valid") and value is not None}
    return replace(rir, parameters=rir.parameters | flags)


def _row_of_channel(row: RirRow, channel: int) -> RirRow:
    """Return the row of an array for another channel than the first, which alone its measured values are of."""
    positions_m = row.get("channel_pos_m") or []
    position_m = positions_m[channel] if channel < len(positions_m) else None
    return row | {"mic_pos_m": position_m, "distance_m": None, "direct_sample": None, "direct_polarity": None,
                  "acoustic_parameters": None}


def _row_of(path: Path) -> tuple[Path | None, RirRow | None]:
    """Return the RIR directory and the row that a file belongs to, if its folder or the one above is one."""
    for directory in (path.parent, path.parent.parent):
        if (directory / ROWS_FILE).is_file():
            try:
                rows: Sequence[RirRow] = read_rirs(directory)
            except ValueError:
                continue
            for row in rows:
                if rir_path(directory, row).resolve() == path.resolve():
                    return directory, row
    return None, None
