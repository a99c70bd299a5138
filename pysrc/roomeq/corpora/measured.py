"""Write a measured corpus of any kind as an RIR directory."""

import logging
import os
from collections import Counter
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal, NamedTuple

from roomeq.core.build import Build
from roomeq.core.constants import FS_HZ
from roomeq.core.digests import Listed
from roomeq.core.files import path_from, physical, write_json
from roomeq.core.limits import AUDIO_HOURS
from roomeq.corpora.listing import list_corpus, list_noises, require_existing
from roomeq.corpora.record import Corpus, Recording, by_stamp, is_sofa
from roomeq.records.geometry import are_unlike
from roomeq.records.rir_dir import without_detour, write_noises, write_rirs

logger = logging.getLogger(__name__)

REPORT_FILE = "corpus.json"
_CHUNK = 64
_REPORTED_NULLS = ("room_dims_m", "source_pos_m", "mic_pos_m", "distance_m", "temperature_c", "documented_t60_s")
_LOGGED_CONTRADICTIONS = 5
_REPORTED_FLAGS = ("binaural", "unreliable_geometry", "uncommon", "repeat_of", "tof_removed")


def read_measured(source: Path, out: Path, *, kind: str | None = None, noises: Path | None = None,
                  skip_bad: bool = False, keep_suspicious: bool = False, nj: int = 1) -> Path:
    """Make an RIR directory from a corpus of measured RIRs.

    The rows refer to mono files at 16 kHz; everything else (several channels, higher sample rates, SOFA, paths that a
    shell would split) is written to `out/wav` as 32-bit float. The log counts the RIRs, rooms and irregularities.

    Parameters
    ----------
    source : Path
        BUT ReverbDB as released, RIRS_NOISES, a CSV or a folder with `manifest.csv` (columns: see
        `roomeq.corpora.table`), a SOFA file or a folder of them, or any folder of audio files.
    out : Path
        RIR directory to make: `rirs.jsonl`, `rir_list`, `noises.jsonl`, and `corpus.json` with the counts.
    kind : str, optional
        Key of `roomeq.corpora.listing.READERS`: ``reverbdb``, ``slr28``, ``table``, ``sofa`` or ``folder``; by default
        recognised by the files.
    noises : Path, optional
        Folder or CSV of noise recordings to add to those of the corpus; see `read_noises`.
    skip_bad : bool
        Leave out and report recordings, or single channels and measurements of a file, that cannot be used (broken,
        silent, sampled below 16 kHz) instead of stopping at the first.
    keep_suspicious : bool
        Do not mark recordings that are no RIR by their acoustics (`roomeq.acoustics.plausibility`). Marked ones have
        the reason in their row's `suspicious`, and later steps leave them out.
    nj : int
        Number of processes.

    Returns
    -------
    out : Path

    Raises
    ------
    ValueError
        There is no recording, two recordings share an id, or (without `skip_bad`) a recording cannot be used.
    """
    source, out = require_existing(source), Path(out)
    noises = require_existing(noises) if noises else None
    corpus = list_corpus(source, kind)
    listed = {source: corpus.rirs + corpus.noises}
    if noises:
        found = list_noises(noises)
        listed[noises] = listed.get(noises, []) + found  # it may be the source
        corpus.noises += found
    build = _build(out, "read-measured", listed, kind=corpus.kind, name=corpus.name, notes=dict(corpus.notes),
                   skip_bad=skip_bad, keep_suspicious=keep_suspicious)
    if build.done:
        return out
    logger.info("%s: %s with %d RIR files, %d noises", source, corpus.kind, len(corpus.rirs), len(corpus.noises))
    return _write(build, corpus, skip_bad, nj, keep_suspicious)


def read_noises(source: Path, out: Path, *, skip_bad: bool = False, nj: int = 1) -> Path:
    """Make a directory with `noises.jsonl` from noise recordings.

    Parameters
    ----------
    source : Path
        Folder of audio files, with or without a `manifest.csv` (columns `file`, optional `id`, `room`, `kind`), or the
        CSV. Without the column `kind`, files named *room tone*, *silence*, *ambient* or *background* are ambient noises
        and all others are point noises.
    out : Path
        Directory to make.
    skip_bad, nj
        As in `read_measured`.

    Returns
    -------
    out : Path

    Raises
    ------
    ValueError
        As in `read_measured`.
    """
    source, out = require_existing(source), Path(out)
    corpus = Corpus(name=source.stem, kind="noises", noises=list_noises(source))
    build = _build(out, "read-noises", {source: corpus.noises}, skip_bad=skip_bad)
    if build.done:
        return out
    return _write(build, corpus, skip_bad, nj)


def _build(out: Path, step: str, listed: dict[Path, list[Recording]], *, skip_bad: bool, **options: Any) -> Build:
    """Return the build of an output that depends on recordings, listed by the source that they come from."""
    options["skip_bad"] = skip_bad
    if skip_bad:  # recordings that are too long are left out
        options["max_audio_hours"] = AUDIO_HOURS.value()
    # rows refer to audio by its path relative to `out`, with links resolved: they are out of date when the corpus has
    # moved, or a link leads elsewhere
    root_of = {source: Path(os.path.realpath(source)) for source in listed}
    ways = [path_from(root, out) for root in root_of.values()]
    inputs: list[Path | Listed] = []
    said = []
    for source, recordings in listed.items():  # the files that are listed, which may stand among many others
        stamped = by_stamp(source, (recording.path for recording in recordings))
        inputs += [*stamped.inputs, Listed(tuple(map(physical, stamped.others)), root=root_of[source])]
        rows = repr([(recording.id, recording.row) for recording in recordings])
        said.append(sha256(rows.encode(errors="surrogateescape")).hexdigest())
    return Build(out, step=step, options=dict(options, ways=ways, said=said), inputs=inputs, refers=True)


class _InTable(NamedTuple):
    """A recording and the table that it goes to."""

    table: Literal["rirs", "noises"]
    recording: Recording


def _write(build: Build, corpus: Corpus, skip_bad: bool, nj: int, keep_suspicious: bool = False) -> Path:
    from roomeq.core.audio import write_wav
    from roomeq.corpora.recordings import Unusable, rows_of

    for recordings in (corpus.rirs, corpus.noises):
        _check_ids(recordings)
    todo = [_InTable("rirs", recording) for recording in corpus.rirs]
    todo += [_InTable("noises", recording) for recording in corpus.noises]
    items = {f"{n:06d}": todo[n:n + _CHUNK] for n in range(0, len(todo), _CHUNK)}

    def make(name: str, chunk: list[_InTable]) -> dict[str, Any]:
        record: dict[str, Any] = dict(rirs=[], noises=[], skipped=[], converted=0, copied=0, multichannel=0)
        for table, recording in chunk:
            try:
                change, n_rows = "", 0
                for read in rows_of(recording, table, build.out):
                    if isinstance(read, Unusable):
                        if not skip_bad:
                            raise ValueError(read.reason)
                        if read.reason not in record["skipped"]:  # a reason may be that of the whole file
                            record["skipped"].append(read.reason)
                        continue
                    row, samples, converted = read
                    if keep_suspicious and table == "rirs":
                        row["suspicious"] = None
                    if samples is not None:
                        if table == "rirs" and not is_sofa(recording.path):
                            row["recording"] = row["wav"]
                        row["wav"] = f"wav/{row['id']}.wav" if table == "rirs" else f"wav/noise/{row['id']}.wav"
                        write_wav(build.work / row["wav"], samples)
                        change = "converted" if converted else "copied"
                    record[table].append(row)
                    n_rows += 1
                if change:
                    record[change] += 1
                record["multichannel"] += n_rows > 1 and not is_sofa(recording.path)
            except ValueError as error:
                if not skip_bad:
                    raise ValueError(f"{error} (or leave such files out with --skip-bad)") from None
                record["skipped"].append(str(error))
        return record

    def assemble(directory: Path, records: list[dict[str, Any]]) -> None:
        merged = {key: [row for record in records for row in record[key]] for key in ("rirs", "noises", "skipped")}
        files = {key: sum(record[key] for record in records) for key in ("converted", "copied", "multichannel")}
        report = _report(corpus, merged, files, build.out)
        _warn_of_one_position(corpus, merged["rirs"])
        if not merged["rirs"] and corpus.kind != "noises":
            raise ValueError(f"{build.out}: none of {len(corpus.rirs)} RIR files can be used, the first because: "
                             f"{merged['skipped'][0]}")
        for row_id, count in Counter(row["id"] for row in merged["rirs"]).items():
            if count > 1:  # `_check_ids` knows the files, not what their channels and measurements are called
                raise ValueError(f"{corpus.name}: the id {row_id!r} of a channel or measurement is also that of "
                                 "another RIR: ids must be unique: rename one file")
        if merged["rirs"]:
            write_rirs(directory, merged["rirs"], final_directory=build.out)
        write_noises(directory, merged["noises"])
        write_json(directory / REPORT_FILE, report)

    if build.run(items, make, nj=nj):
        build.finish(assemble)
    return build.out


def _check_ids(recordings: list[Recording]) -> None:
    first: dict[str, Recording] = {}
    for recording in recordings:
        namesake = first.setdefault(recording.id, recording)
        if namesake is recording:
            continue
        if namesake.path == recording.path:
            line = f"{recording.where}: " if recording.where else ""
            first_line = f" (first in {namesake.where})" if namesake.where else ""
            raise ValueError(f"{line}{recording.path} is listed twice{first_line}: list every file once")
        raise ValueError(f"{recording.path}: id {recording.id!r} is also that of {namesake.path}: "
                         "ids must be unique: rename one file or id")


def _warn_of_one_position(corpus: Corpus, rirs: list[dict[str, Any]]) -> None:
    """Say that the channels of a file have the one position that is stated for it."""
    stated = {recording.id for recording in corpus.rirs
              if not is_sofa(recording.path) and recording.row.get("mic_pos_m") and not recording.row["binaural"]}
    second = {f"{recording_id}_ch1" for recording_id in stated} - {recording.id for recording in corpus.rirs}
    if several := [row["id"] for row in rirs if row["id"] in second]:
        logger.warning("%s: files with several channels, all of which have the one stated microphone position: %d "
                       "(first %s): where the microphones are more than some centimetres apart, give a mono file and "
                       "a position for each", corpus.name, len(several), several[0].removesuffix("_ch1"))


def _report(corpus: Corpus, merged: dict[str, list[Any]], files: dict[str, int], out: Path) -> dict[str, Any]:
    """Return the counts of RIRs, rooms, unknown values and irregularities, and log them."""
    rirs = merged["rirs"]
    suspicious = {row["id"]: row["suspicious"] for row in rirs if row["suspicious"]}
    report: dict[str, Any] = dict(
        corpus=corpus.name, kind=corpus.kind, rirs=len(rirs), noises=len(merged["noises"]), **files,
        rooms=dict(sorted(Counter(row["room_id"] for row in rirs).items())),
        unknown={key: n for key in _REPORTED_NULLS if (n := sum(row[key] is None for row in rirs))},
        marked={key: n for key in _REPORTED_FLAGS if (n := sum(bool(row[key]) for row in rirs))},
        geometry_problems=dict(sorted(Counter(row["room_id"] for row in rirs if row["geometry_problem"]).items())),
        excitation=dict(sorted(Counter(str(row["excitation"]) for row in rirs).items())),
        notes=dict(sorted(corpus.notes.items())), suspicious=suspicious,
        skipped=merged["skipped"])
    copied = f", {files['copied']} copied (path with blanks or special characters)" if files["copied"] else ""
    logger.info("%s: %d RIRs of %d rooms, %d noises; %d files converted to %d Hz mono%s, %d left out", corpus.name,
                len(rirs), len(report["rooms"]), report["noises"], files["converted"], FS_HZ, copied,
                len(merged["skipped"]))
    if files["multichannel"]:
        logger.info("%s: %d files have several channels: each channel is an RIR of its own (ID_ch0, ID_ch1, ...)",
                    corpus.name, files["multichannel"])
    for label in ("unknown", "marked", "geometry_problems", "notes"):
        if report[label]:
            logger.info("%s: %s: %s", corpus.name, label.replace("_", " "),
                        ", ".join(f"{key} {n}" for key, n in report[label].items()))
    _log_contradictions(corpus)
    _warn_of_unlike_rooms(corpus.name, rirs)
    if any(is_sofa(recording.path) for recording in corpus.rirs):
        _log_unused_positions(corpus.name, rirs)
    for line in merged["skipped"]:
        logger.warning("left out: %s", line)
    for row in rirs:
        if row["suspicious"]:
            recorded = without_detour(out / (row.get("recording") or row["wav"]))
            logger.warning("no RIR: %s (%s): %s", recorded, row["id"], row["suspicious"])
    if suspicious:
        logger.warning("%s: %d of %d recordings are no RIR; later steps leave them out (--keep-suspicious keeps them)",
                       corpus.name, len(suspicious), len(rirs))
    return report


def _log_contradictions(corpus: Corpus) -> None:
    """Say for the first recordings of different problems what contradicts what, and how many more there are."""
    contradictory = [recording for recording in corpus.rirs if recording.row.get("geometry_problem")]
    first: dict[str, Recording] = {}
    for recording in contradictory:
        first.setdefault(recording.row["geometry_problem"], recording)
    logged = list(first.items())[:_LOGGED_CONTRADICTIONS]
    for problem, recording in logged:
        logger.warning("%s: %s: the positions are not used: correct the geometry",
                       recording.where or recording.path, problem)
    if more := len(contradictory) - len(logged):
        logger.warning("%s: positions of %d more recordings are not used: see geometry_problem in rirs.jsonl",
                       corpus.name, more)


def _warn_of_unlike_rooms(name: str, rirs: list[dict[str, Any]]) -> None:
    """Say of which rooms the RIRs state different dimensions."""
    first: dict[str, dict[str, Any]] = {}
    unlike: dict[str, str] = {}
    for row in rirs:
        begin = first.setdefault(row["room_id"], row) if row["room_dims_m"] else row
        if are_unlike(begin["room_dims_m"], row["room_dims_m"]):
            unlike.setdefault(row["room_id"], f"room {row['room_id']}: RIR {begin['id']} states room_dims_m="
                              f"{begin['room_dims_m']}, and RIR {row['id']} {row['room_dims_m']}")
    for detail in list(unlike.values())[:_LOGGED_CONTRADICTIONS]:
        logger.warning("%s: %s (%d such rooms): the closed loop leaves it out: correct the row, or give different "
                       "rooms or states of a room different names", name, detail, len(unlike))


def _log_unused_positions(name: str, rirs: list[dict[str, Any]]) -> None:
    """Say why positions in SOFA files are not used."""
    for problem, n in sorted(Counter(row["geometry_problem"] for row in rirs if row["geometry_problem"]).items()):
        logger.warning("%s: positions of %d RIRs are not used: %s", name, n, problem)
    if n_distances := sum(row["distance_m"] is not None and row["source_pos_m"] is None for row in rirs):
        logger.warning("%s: positions of %d RIRs are not used, only their distance: RoomCornerA and RoomCornerB, which "
                       "place them in the room, are absent or those of the convention's example", name, n_distances)
