"""Kaldi data directories in: reading any recipe's, and checking them as strictly as Kaldi does.

All files are tables: an id, a blank, the rest of the line; sorted by id in byte order (``LC_ALL=C``), each id
once. Writing lies in `roomeq.kaldi.write`, one line of `wav.scp` in `roomeq.kaldi.wavscp`.
"""

import logging
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from roomeq.core.audio import read_audio
from roomeq.core.files import read_text
from roomeq.kaldi.wavscp import Entry, n_samples, parse_entry, read_entry, segment_samples
from roomeq.records.transcripts import symbol_in, unprintable_in

logger = logging.getLogger(__name__)

MAX_DURATION_ERROR_S = 0.1
"""Durations that Kaldi takes from numbers of frames are that far off [s]."""
_PER_UTTERANCE = ("utt2dur", "utt2num_frames", "utt2uniq", "utt2lang", "utt2warp", "utt2rir", "utt2snr",
                  "feats.scp", "vad.scp")
_PER_SPEAKER = ("spk2gender", "spk2warp", "cmvn.scp")
_PER_RECORDING = ("reco2dur", "reco2file_and_channel")
_VALUES = {
    "spk2gender": (lambda value: value in ("m", "f"), "m or f"),
    "utt2dur": (lambda value: 0 < _number(value) < math.inf, "a positive number of seconds"),
    "reco2dur": (lambda value: 0 < _number(value) < math.inf, "a positive number of seconds"),
    "utt2num_frames": (lambda value: re.fullmatch(r"0*[1-9]\d*", value), "a positive whole number"),
    "utt2warp": (lambda value: 0.5 < _number(value) < 1.5, "a number between 0.5 and 1.5"),
    "spk2warp": (lambda value: 0.5 < _number(value) < 1.5, "a number between 0.5 and 1.5"),
    "reco2file_and_channel": (lambda value: re.fullmatch(r"\S+\s+[AB1]", value), "a file and a channel A or B"),
}


class Utterance(NamedTuple):
    """One utterance: where it lies in which recording, and who speaks."""

    id: str
    speaker: str
    recording: str
    start_s: float
    end_s: float | None
    """End of the segment [s], or None for the end of the recording."""


@dataclass(frozen=True)
class DataDir:
    """A Kaldi data directory, read and checked.

    Attributes
    ----------
    path : Path
    utterances : dict of Utterance
        By id, in byte order.
    recordings : dict of Entry
        By recording id; without `segments` each utterance is its own recording.
    text : dict of str, or None
        Transcripts by utterance id; None where the directory has none.
    spk2gender : dict of str
        ``"m"`` or ``"f"`` by speaker id; empty where the directory does not say.
    utt2uniq : dict of str
        The original utterance by utterance id; empty where the directory does not say.
    utt2dur : dict of float
        What the directory says of durations [s], unchecked; may be empty.
    segmented : bool
        The directory has `segments`.
    """

    path: Path
    utterances: dict[str, Utterance]
    recordings: dict[str, Entry]
    text: dict[str, str] | None
    spk2gender: dict[str, str]
    utt2uniq: dict[str, str]
    utt2dur: dict[str, float]
    segmented: bool


def read_data_dir(directory: Path, *, pipes: bool = False) -> DataDir:
    """Read and check a Kaldi data directory of any recipe; no audio is touched.

    Paths in `wav.scp` are relative to the current folder, as in Kaldi. `text`, `spk2utt`, `spk2gender` and
    `utt2uniq` may be absent. A segment's end of -1 is the end of its recording.

    Parameters
    ----------
    directory : Path
    pipes : bool
        Accept commands other than ``flac -c -d -s FILE |`` in `wav.scp`; reading their audio runs them.

    Raises
    ------
    ValueError
        A file is missing, unsorted or malformed, ids differ between files, a transcript is empty, or `wav.scp`
        holds a command and `pipes` is false; the message names file, line, value and remedy.
    """
    directory = Path(directory)
    if not directory.is_dir():
        raise ValueError(f"{directory}: no such data directory: check the path, or run the step that makes it")
    utt2spk = _read_utt2spk(directory)
    recordings = _read_wav_scp(directory / "wav.scp", pipes)
    segmented = (directory / "segments").is_file()
    utterances = (_read_segments(directory, utt2spk, recordings) if segmented
                  else _whole_recordings(directory, utt2spk, recordings))
    text = _read_text(directory / "text") if (directory / "text").is_file() else None
    if text is not None:
        _same_ids(directory / "utt2spk", utt2spk, directory / "text", text)
    speakers = {utterance.speaker: "" for utterance in utterances.values()}
    _check_spk2utt(directory, utt2spk)
    return DataDir(directory, utterances, recordings, text, segmented=segmented,
                   spk2gender=_optional(directory, "spk2gender", speakers),
                   utt2uniq=_optional(directory, "utt2uniq", utt2spk),
                   utt2dur={key: float(value) for key, value in _optional(directory, "utt2dur", utt2spk).items()})


def read_utterance(data: DataDir, utterance: Utterance, *, pipes: bool = False) -> np.ndarray:
    """Read the audio of one utterance of a data directory, float32 at `FS_HZ`, shape (n_samples,).

    Raises
    ------
    ValueError
        See `roomeq.kaldi.wavscp.read_entry`; the message names the utterance.
    """
    try:
        return read_entry(data.recordings[utterance.recording], utterance.start_s, utterance.end_s, pipes=pipes)
    except ValueError as error:
        raise ValueError(f"{data.path}: utterance {utterance.id}: {error}") from None


def validate_data_dir(directory: Path, *, pipes: bool = False, audio: bool = True) -> int:
    """Check a data directory as strictly as Kaldi's `validate_data_dir.sh --no-feats`, and its audio too.

    Parameters
    ----------
    directory : Path
    pipes : bool
        Also run the commands in `wav.scp` to check what they give; by default such recordings are taken on trust.
    audio : bool
        Look whether every recording can be opened and every segment lies within it.

    Returns
    -------
    n_utterances : int

    Raises
    ------
    ValueError
        The first line that breaks a rule.
    """
    data = read_data_dir(directory, pipes=True)
    for name in ("spk2utt", "text"):
        if not (data.path / name).is_file():
            raise ValueError(f"{data.path / name}: no such file: Kaldi's scripts need it: write it")
    for number, line in enumerate(_lines(data.path / "text"), start=1):
        _check_printable(line, f"{data.path / 'text'}:{number}")
    if data.segmented:
        _check_segments_strictly(data)
    for number, line in enumerate(_lines(data.path / "wav.scp"), start=1):
        if re.match(r"\S+\s+~", line):
            raise ValueError(f"{data.path / 'wav.scp'}:{number}: path in {line!r} must not start with '~': "
                             "write the whole path")
    speakers = {utterance.speaker: "" for utterance in data.utterances.values()}
    for names, ids in ((_PER_UTTERANCE, data.utterances), (_PER_SPEAKER, speakers),
                       (_PER_RECORDING, data.recordings)):
        for name in names:
            _optional(data.path, name, ids)
    if audio:
        _check_audio(data, pipes)
    return len(data.utterances)


def _lines(path: Path) -> list[str]:
    """Return the lines of a table without their line ends."""
    if not path.is_file():
        raise ValueError(f"{path}: no such file: every Kaldi data directory has it: prepare the directory again")
    lines = read_text(path).split("\n")
    if lines == [""]:
        raise ValueError(f"{path}: file is empty: prepare the directory again")
    if lines.pop():
        raise ValueError(f"{path}:{len(lines) + 1}: last line must end in a line break: the file may be cut off")
    return lines


def _read_table(path: Path, *, empty_ok: bool = False) -> dict[str, str]:
    """Read a table as a dict in the order of the file, so that entry n stands in line n + 1."""
    table, previous = {}, ""
    for number, line in enumerate(_lines(path), start=1):
        key, _, rest = line.replace("\t", " ").partition(" ")
        where = f"{path}:{number}"
        if not key:
            raise ValueError(f"{where}: {line[:60]!r} must start with an id: remove the line or correct it")
        if "\r" in line:
            raise ValueError(f"{where}: line ends as on Windows (\\r): convert the file with dos2unix")
        if key in table:
            raise ValueError(f"{where}: id {key!r} occurs twice: ids must be unique: remove one")
        if key < previous:
            raise ValueError(f"{where}: id {key!r} must not come after {previous!r}: "
                             "sort the file with LC_ALL=C sort")
        rest = line[len(key) + 1:].strip()
        if not rest and not empty_ok:
            raise ValueError(f"{where}: nothing stands after id {key!r}: complete the line or remove it")
        table[key] = rest
        previous = key
    return table


def _read_utt2spk(directory: Path) -> dict[str, str]:
    path = directory / "utt2spk"
    utt2spk, previous = _read_table(path), ""
    for number, (utterance, speaker) in enumerate(utt2spk.items(), start=1):
        if len(speaker.split()) != 1:
            raise ValueError(f"{path}:{number}: speaker {speaker!r} of {utterance!r} must be one word")
        if speaker < previous:
            raise ValueError(f"{path}:{number}: speaker {speaker!r} must not come after {previous!r}: "
                             "make the speaker id the start of the utterance id")
        previous = speaker
    return utt2spk


def _read_wav_scp(path: Path, pipes: bool) -> dict[str, Entry]:
    recordings = {}
    for number, (recording, text) in enumerate(_read_table(path).items(), start=1):
        try:
            entry = parse_entry(text)
        except ValueError as error:
            raise ValueError(f"{path}:{number}: {error}") from None
        if entry.kind == "pipe" and not pipes:
            raise ValueError(f"{path}:{number}: {text!r} is a command other than 'flac -c -d -s FILE |', and "
                             "those run only with --pipes: allow them, or convert the audio to files")
        recordings[recording] = entry
    return recordings


def _read_segments(directory: Path, utt2spk: dict, recordings: dict) -> dict[str, Utterance]:
    path, utterances = directory / "segments", {}
    table = _read_table(path)
    _same_ids(directory / "utt2spk", utt2spk, path, table)
    for number, (utterance, rest) in enumerate(table.items(), start=1):
        where, fields = f"{path}:{number}", rest.split()
        if len(fields) != 3:
            raise ValueError(f"{where}: {rest!r} must be RECORDING START END: correct the line")
        recording, start_s, end_s = fields[0], _number(fields[1]), _number(fields[2])
        if recording not in recordings:
            raise ValueError(f"{where}: recording {recording!r} is not in wav.scp: add it, or remove the segment")
        if not 0 <= start_s < math.inf or not (end_s == -1 or start_s < end_s < math.inf):
            raise ValueError(f"{where}: segment from {fields[1]} to {fields[2]} must be 0 <= START < END in "
                             "seconds (or END -1): correct the line")
        utterances[utterance] = Utterance(utterance, utt2spk[utterance], recording, start_s,
                                          None if end_s == -1 else end_s)
    return utterances


def _whole_recordings(directory: Path, utt2spk: dict, recordings: dict) -> dict[str, Utterance]:
    _same_ids(directory / "utt2spk", utt2spk, directory / "wav.scp", recordings)
    return {key: Utterance(key, speaker, key, 0.0, None) for key, speaker in utt2spk.items()}


def _read_text(path: Path) -> dict[str, str]:
    text = _read_table(path, empty_ok=True)
    for number, (utterance, words) in enumerate(text.items(), start=1):
        if not words:
            raise ValueError(f"{path}:{number}: transcript of {utterance!r} is empty: write it, or remove the "
                             "utterance from every file")
        if symbol := symbol_in(words):
            raise ValueError(f"{path}:{number}: {symbol!r} in the transcript of {utterance!r} is a symbol of "
                             "Kaldi's own: remove it")
    return text


def _same_ids(path_a: Path, ids_a: dict, path_b: Path, ids_b: dict) -> None:
    if ids_a.keys() == ids_b.keys():
        return
    for path, ids, other_path, other in ((path_a, ids_a, path_b, ids_b), (path_b, ids_b, path_a, ids_a)):
        for number, key in enumerate(ids, start=1):
            if key not in other:
                raise ValueError(f"{path}:{number}: {key!r} is not in {other_path.name}: every id must stand in "
                                 "both: run Kaldi's utils/fix_data_dir.sh, or prepare the directory again")


def _check_spk2utt(directory: Path, utt2spk: dict) -> None:
    path = directory / "spk2utt"
    if not path.is_file():
        return
    listed = _read_table(path)
    remedy = "make it again with utils/utt2spk_to_spk2utt.pl"
    pairs = iter(utt2spk.items())
    for number, (speaker, rest) in enumerate(listed.items(), start=1):
        for utterance in rest.split():
            if (expected := next(pairs, None)) != (utterance, speaker):
                raise ValueError(f"{path}:{number}: utterance {utterance!r} of {speaker!r} where utt2spk has "
                                 f"{expected and ' of '.join(map(repr, expected))}: {remedy}")
    if left := next(pairs, None):
        raise ValueError(f"{path}: utterance {left[0]!r} of utt2spk is not in it: {remedy}")


def _optional(directory: Path, name: str, ids: dict) -> dict[str, str]:
    """Read a table that may be absent ({}), whose ids must be just these and whose values must fit."""
    path = directory / name
    if not path.is_file():
        return {}
    table = _read_table(path)
    if list(table) != list(ids):
        main = {"spk": "spk2utt", "cmv": "spk2utt", "rec": "wav.scp"}.get(name[:3], "utt2spk")
        _same_ids(directory / main, dict.fromkeys(ids), path, table)
    fits, rule = _VALUES.get(name, (None, ""))
    for number, (key, value) in enumerate(table.items() if fits else (), start=1):
        if not fits(value):
            raise ValueError(f"{path}:{number}: value {value!r} of {key!r} must be {rule}: correct the line")
    return table


def _number(text: str) -> float:
    """Return a number, NaN where there is none: it passes no comparison."""
    try:
        return float(text) if re.fullmatch(r"[-+]?[\d.]+(?:[eE][-+]?\d+)?", text) else math.nan
    except ValueError:
        return math.nan


def _check_printable(line: str, where: str) -> None:
    character = unprintable_in(line.replace("\t", " "))
    if character is not None:
        raise ValueError(f"{where}: character {character!r} must be printable, or a plain blank: replace it")


def _check_segments_strictly(data: DataDir) -> None:
    path = data.path / "segments"
    for number, utterance in enumerate(data.utterances.values(), start=1):
        if utterance.end_s is None:
            raise ValueError(f"{path}:{number}: end -1 of {utterance.id!r} must be a time [s] for Kaldi's "
                             "validator: write it")
    used = {utterance.recording for utterance in data.utterances.values()}
    for number, recording in enumerate(data.recordings, start=1):
        if recording not in used:
            raise ValueError(f"{data.path / 'wav.scp'}:{number}: recording {recording!r} has no segment: "
                             "remove it, or add its segments")


def _check_audio(data: DataDir, pipes: bool) -> None:
    lengths: dict[str, tuple[int, int]] = {}
    for number, (recording, entry) in enumerate(data.recordings.items(), start=1):
        if entry.kind == "pipe" and not pipes:
            continue
        try:
            lengths[recording] = frames, rate = n_samples(entry, pipes=pipes)
            if entry.kind == "file":  # a cut FLAC file shows only at its end
                read_audio(Path(entry.text), fs_hz=rate, start=frames - 1)
        except ValueError as error:
            raise ValueError(f"{data.path / 'wav.scp'}:{number}: {error}") from None
    if len(lengths) < len(data.recordings):
        logger.info("%s: %d recordings are commands, not run and not checked", data.path,
                    len(data.recordings) - len(lengths))
    recording_s = {recording: frames / rate for recording, (frames, rate) in lengths.items()}
    utterance_s = {}
    for number, utterance in enumerate(data.utterances.values(), start=1):
        if utterance.recording not in lengths:
            continue
        frames, rate = lengths[utterance.recording]
        where = f"{data.path / 'segments'}:{number}: recording {utterance.recording}"
        start, stop = segment_samples(where, frames, rate, utterance.start_s, utterance.end_s)
        utterance_s[utterance.id] = (stop - start) / rate
    for name, known_s, ids in (("utt2dur", utterance_s, data.utterances), ("reco2dur", recording_s, data.recordings)):
        for number, (key, value) in enumerate(_optional(data.path, name, ids).items(), start=1):
            if key in known_s and abs(known_s[key] - float(value)) > MAX_DURATION_ERROR_S:
                raise ValueError(f"{data.path / name}:{number}: {value} s of {key!r} where its audio lasts "
                                 f"{known_s[key]:.3f} s: make the file again, or put the right audio there")
