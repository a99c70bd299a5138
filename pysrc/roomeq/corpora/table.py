"""A CSV of measured RIRs (or noises) beside their audio files.

Columns (any order, upper or lower case, separated by comma, semicolon or tab); only `file` is needed:

`file`
    Relative to the CSV. A SOFA file states its positions itself; other cells come before what it states.
`rir_id` or `id`, `dataset` or `corpus`, `room` or `room_id`, `room_type`, `source_id`, `mic_id`, `session`
    Names. An unknown id (``?`` or empty) is made from the file's path; an unknown room is the file's folder.
`room_dims_m`, `source_pos_m`, `mic_pos_m`
    Three numbers [m] from one lower corner of the room, e.g. ``4.71 2.75 ?``; ``?`` or empty is unknown.
`source_dir`, `mic_dir`
    Unit vectors that they face, no angles.
`distance_m`, `temperature_c`, `humidity_pct`, `documented_t60_s`
    Numbers, each may be unknown.
`binaural`, `tof_removed`, `unreliable_geometry`, `uncommon`
    0 or 1 (also true/false, yes/no): recorded with a dummy head; time of flight cut off; positions are unreliable; a
    space that should not be simulated (stairs). Without the column, recordings with a dummy head are recognised by
    words such as *BRIR* in id or path, and stairs by the words of `room_type`.
`excitation`
    ``sweep``, ``clap``, ...; without the column, recognised by the words *clap* and *sweep* in id or file name.
`kind`
    Noises only: ``ambient`` or ``point``.

Other columns are ignored; the log lists them.
"""

import csv
import logging
import os
import re
import unicodedata
from collections.abc import Callable, Iterable, Set
from itertools import zip_longest
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from roomeq.core.constants import MAX_ROOM_M, require_air
from roomeq.corpora.record import (
    UNKNOWN,
    Corpus,
    DistinctIds,
    Recording,
    excitation_of,
    folder_name,
    id_of_path,
    is_binaural_name,
    is_sofa,
    is_unknown,
    noise_kind_of,
    parse_amount,
    parse_number,
    parse_vector,
    rir_row,
)
from roomeq.corpora.reverbdb import is_uncommon, is_unreliable
from roomeq.records.schema import make_id, may_be_unit_vector, stated_air

logger = logging.getLogger(__name__)

MANIFEST = "manifest.csv"
_SPREADSHEETS = (".xlsx", ".xls", ".ods")
_NO_ROW = re.compile(r'("?sep=)?[\s,;]*"?[\s,;]*', re.IGNORECASE)
"""An empty line, or the ``sep=;`` by which a spreadsheet states the separator."""
_ALIASES = {"path": "file", "wav": "file", "audio": "file", "filename": "file", "id": "rir_id",
            "noise_id": "rir_id", "room": "room_id", "dataset": "corpus"}
_NAMES = ("corpus", "room_id", "room_type", "source_id", "mic_id", "session")
_VECTORS = ("room_dims_m", "source_pos_m", "mic_pos_m", "source_dir", "mic_dir")
_NUMBERS = ("distance_m", "temperature_c", "humidity_pct", "documented_t60_s")
_FLAGS = ("binaural", "tof_removed", "unreliable_geometry", "uncommon")
_OF_ONE_RIR = ("source_pos_m", "mic_pos_m", "distance_m")
_LENIENT = ("documented_t60_s",)
_AMOUNTS = ("distance_m", "documented_t60_s")
_MAY_BE_UNKNOWN = {*_NAMES, "rir_id", "utt_id", "speaker", "set"}
_KNOWN = {"file", "rir_id", "excitation", *_NAMES, *_VECTORS, *_NUMBERS, *_FLAGS}
_KNOWN_OF_NOISES = {"file", "rir_id", "room_id", "kind"}
_TRUE, _FALSE = {"1", "true", "yes"}, {"0", "false", "no"}


class TableRow(NamedTuple):
    """A row of a CSV: where it stands (``file:line``) and its cells by column."""

    where: str
    cells: dict[str, str]


class Table(NamedTuple):
    """A CSV: its columns (aliases replaced) and rows."""

    columns: list[str]
    rows: list[TableRow]


Value = TypeVar("Value")


def find_manifest(source: Path) -> Path | None:
    """Return the `manifest.csv` of a folder, in upper or lower case, or None."""
    if not source.is_dir():
        return None
    names = sorted(name for name in os.listdir(source) if name.lower() == MANIFEST)
    return next((path for name in (MANIFEST, *names) if (path := source / name).is_file()), None)


def refuse_spreadsheet(source: Path) -> None:
    """Refuse a spreadsheet, or a folder with one where its `manifest.csv` should be.

    Raises
    ------
    ValueError
    """
    folder, stem = source.is_dir() and not find_manifest(source), Path(MANIFEST).stem
    for path in [source / f"{stem}{suffix}" for suffix in _SPREADSHEETS] if folder else [source]:
        if path.suffix.lower() in _SPREADSHEETS and path.is_file():
            raise ValueError(f"{path}: is a spreadsheet, and a table must be a CSV file: export it as CSV"
                             + (f", called {MANIFEST}" if folder else ""))


def read_table(path: Path) -> Table:
    """Read a CSV.

    Raises
    ------
    ValueError
        The file is missing, empty, not text, lacks the column `file`, or a row has more cells than columns.
    """
    if not path.is_file():
        raise ValueError(f"{path}: no such CSV file: check the path")
    refuse_spreadsheet(path)
    try:
        with open(path, encoding="utf-8-sig", newline="") as stream:
            head = next((line for line in stream if not _NO_ROW.fullmatch(line)), "")
            stream.seek(0)
            delimiter = max(",;\t", key=head.count)
            reader = csv.reader(stream, delimiter=delimiter)
            filled = [(f"{path}:{reader.line_num}", [cell.strip() for cell in cells]) for cells in reader
                      if not _NO_ROW.fullmatch(delimiter.join(cells))]
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{path}: not a CSV file in UTF-8 ({error}): export it again") from None
    names, rows = [cell.lower() for cell in filled[0][1]] if filled else [], filled[1:]
    columns = [_ALIASES.get(name, name) for name in names]
    while columns and not columns[-1] and not any(any(cells[len(columns) - 1:]) for _, cells in rows):
        columns.pop()  # spreadsheets write empty columns where cells were in use once
        rows = [(where, cells[:len(columns)]) for where, cells in rows]
    if "file" not in columns:
        raise ValueError(f"{path}: columns {','.join(names) or '(none)'} must include 'file', the column of the "
                         "paths: rename it")
    if len(set(columns)) < len(columns):
        twice = next(name for name in columns if columns.count(name) > 1)
        raise ValueError(f"{path}: column {twice!r} occurs twice (also under another name): rename one")
    if not rows:
        raise ValueError(f"{path}: no rows below the header: the corpus is empty")
    for where, cells in rows:
        if len(cells) > len(columns):
            raise ValueError(f"{where}: {len(cells)} cells under {len(columns)} columns: quote cells that hold "
                             f"{delimiter!r}")
    return Table(columns, [TableRow(where, _named(dict(zip_longest(columns, cells, fillvalue=""))))
                           for where, cells in rows])


def _named(cells: dict[str, str]) -> dict[str, str]:
    """Return the cells of a row, in which unknown names (``?``, ``NA``) are empty, and alike ones are the same."""
    return {key: "" if key in _MAY_BE_UNKNOWN and is_unknown(cell) else
            unicodedata.normalize("NFKC", cell) if key in _MAY_BE_UNKNOWN else cell for key, cell in cells.items()}


def list_table(path: Path) -> Corpus:
    """List the RIRs of a CSV.

    Raises
    ------
    ValueError
        See `read_table`; also if a cell does not fit its column or two names have the same id (the message names file
        and line), or there is a column with transcripts.
    """
    columns, rows = read_table(path)
    if "transcript" in columns:
        raise ValueError(f"{path}: column 'transcript' says that this is speech, but RIRs are expected here: pass it "
                         "as the speech corpus")
    corpus = Corpus(name=folder_name(path.parent), kind="table")
    log_unused(path, columns, _KNOWN)
    ids = DistinctIds()
    for where, cells in rows:
        try:
            file = resolve_file(path, cells)
            row = _row(path, file, cells, corpus)
            for key, default in (("room_id", folder_name(file.parent)), ("source_id", UNKNOWN), ("mic_id", UNKNOWN)):
                ids.add(key, row[key], cells.get(key) or default)
            if is_sofa(file):
                row = _stated(row, cells)
            elif not cells.get("room_id"):
                ids.add("folder of a room without a name in column 'room'", row["room_id"],
                        os.path.realpath(file.parent))
            corpus.rirs.append(Recording(file, _row_id(path, file, cells), row, where))
        except ValueError as error:
            raise ValueError(f"{where}: {error}: correct the cell") from None
    return corpus


def log_unused(path: Path, columns: Iterable[str], known: Set[str]) -> None:
    """Log the columns of a CSV that have no meaning."""
    if unused := sorted(set(columns) - known - {""}):
        logger.info("%s: columns not used: %s", path, ", ".join(unused))


def _stated(row: dict[str, Any], cells: dict[str, str]) -> dict[str, Any]:
    """Return what a CSV states of a SOFA file: the keys of a row whose cells say something."""
    for key in _OF_ONE_RIR:
        if row[key] is not None:
            raise ValueError(f"{key}={cells[key]!r} must be empty for a SOFA file, which states it for each RIR")
    marked = {key: True for key in ("unreliable_geometry", "uncommon") if row[key]}
    return {"corpus": row["corpus"], "excitation": row["excitation"], **marked,
            **{key: row[key] for key in row if cells.get(key) and row[key] is not None}}


def list_noise_table(path: Path) -> list[Recording]:
    """List the noises of a CSV with the column `file` and optional columns `id`, `room` and `kind`.

    Raises
    ------
    ValueError
        See `read_table`.
    """
    noises = []
    columns, rows = read_table(path)
    log_unused(path, columns, _KNOWN_OF_NOISES)
    for where, cells in rows:
        file = resolve_file(path, cells)
        kind = cells.get("kind") or noise_kind_of(cells["file"])
        if kind not in ("ambient", "point"):
            raise ValueError(f"{where}: kind={kind!r} must be 'ambient' or 'point': correct the cell")
        room = cells.get("room_id")
        noises.append(Recording(file, _row_id(path, file, cells),
                                dict(room_id=make_id(room) if room else None, kind=kind), where))
    return noises


def resolve_file(path: Path, cells: dict[str, str]) -> Path:
    """Return the audio file of a row.

    It is relative to the CSV's folder, or to the folder above if it starts with the name of the CSV's folder. Letters
    with an accent may be composed or decomposed, as systems and archives change them.
    """
    if not cells["file"]:
        raise ValueError("file='' must be the path of an audio file")
    names = [cells["file"], *(unicodedata.normalize(form, cells["file"]) for form in ("NFC", "NFD"))]
    file = next((path.parent / name for name in names if (path.parent / name).exists()), path.parent / names[0])
    if not file.exists() and Path(names[0]).parts[0] == path.parent.resolve().name:
        return path.parent.parent / names[0]
    return file


def _row_id(path: Path, file: Path, cells: dict[str, str]) -> str:
    if cells.get("rir_id"):
        return make_id(cells["rir_id"])
    try:
        return id_of_path(file, path.parent)
    except ValueError:  # outside the CSV's folder, from which no path may go into the id
        return make_id(f"{folder_name(file.parent)}-{file.stem}")


def _check_values(known: dict[str, Any]) -> None:
    """Refuse lengths, directions, a temperature or a humidity that cannot be; unknown ones are right.

    They are mistakes or in another unit.
    """
    for key in ("source_dir", "mic_dir"):
        if not may_be_unit_vector(known[key]):
            raise ValueError(f"{key}={known[key]} must be a unit vector, no angles")
    for axis, size_m in enumerate(known["room_dims_m"] or ()):
        if size_m is not None and size_m <= 0:
            raise ValueError(f"room_dims_m[{axis}]={size_m:g} must be positive: give metres, or ? where it is unknown")
    # coordinates may count from anywhere: what they are apart tells the unit
    apart_m = {f"mic_pos_m[{axis}] - source_pos_m[{axis}]": None if None in pair else pair[0] - pair[1]
               for axis, pair in enumerate(zip(known["mic_pos_m"] or (), known["source_pos_m"] or (), strict=False))}
    lengths_m = {f"room_dims_m[{axis}]": value for axis, value in enumerate(known["room_dims_m"] or ())} | apart_m | {
        "distance_m": known["distance_m"]}
    for name, length_m in lengths_m.items():
        if length_m is not None and abs(length_m) > MAX_ROOM_M:
            rule = f"lie in [{-MAX_ROOM_M:g}, {MAX_ROOM_M:g}]" if name in apart_m else f"be at most {MAX_ROOM_M:g}"
            raise ValueError(f"{name}={length_m:g} must {rule}: give metres")
    require_air(**stated_air(known))


def _row(path: Path, file: Path, cells: dict[str, str], corpus: Corpus) -> dict[str, Any]:
    known: dict[str, Any] = {key: cells[key] for key in _NAMES if cells.get(key)}
    for key in _VECTORS:
        known[key] = _parse(key, cells, parse_vector)
    for key in _NUMBERS:
        try:
            known[key] = _parse(key, cells, parse_amount if key in _AMOUNTS else parse_number)
        except ValueError:
            if key not in _LENIENT:
                raise
            known[key] = None
            corpus.notes[f"{key} that is no number, read as unknown"] += 1
    _check_values(known)
    for key in _FLAGS:
        if (flag := _parse(key, cells, _flag)) is not None:
            known[key] = flag
    known.setdefault("corpus", path.parent.resolve().name)
    room = known.setdefault("room_id", folder_name(file.parent))
    known["excitation"] = (cells["excitation"].lower() or None) if "excitation" in cells else \
        excitation_of(f"{cells.get('rir_id', '')} {file.stem}")
    if "binaural" not in cells and is_binaural_name(f"{cells.get('rir_id', '')} {cells['file']}"):
        known["binaural"] = True
    if "unreliable_geometry" not in known and is_unreliable(room):
        known["unreliable_geometry"] = True
    if "uncommon" not in known and is_uncommon(room, known.get("room_type")):
        known["uncommon"] = True
    return rir_row(**known)


def _parse(key: str, cells: dict[str, str], parse: Callable[[str | None], Value]) -> Value:
    try:
        return parse(cells.get(key))
    except ValueError as error:
        reason = str(error) if "must be" in str(error) else "must be a number or ?"
        raise ValueError(f"{key}={cells[key]!r}: {reason}") from None


def _flag(text: str | None) -> bool | None:
    text = (text or "").lower()
    if text in ("", "?"):
        return None
    if text not in _TRUE | _FALSE:
        raise ValueError("must be 0 or 1")
    return text in _TRUE
