"""Read the Kaldi data directory of any recipe.

All files are tables. A line holds an id, a blank, and values; lines are sorted by id in byte order (``LC_ALL=C``), and
every id occurs once. Checks as strict as Kaldi's own are in `roomeq.kaldi.validate`, writing in `roomeq.kaldi.write`,
and the entries of `wav.scp` in `roomeq.kaldi.wavscp`.
"""

import math
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from roomeq.core.arrays import Array
from roomeq.core.files import read_text
from roomeq.kaldi.wavscp import Entry, parse_entry, read_entry
from roomeq.records.transcripts import symbol_in

_RULES: dict[str, tuple[Callable[[str], object], str]] = {
    "spk2gender": (lambda value: value in ("m", "f"), "m or f"),
    "utt2dur": (lambda value: 0 < _number(value) < math.inf, "a positive number of seconds"),
    "reco2dur": (lambda value: 0 < _number(value) < math.inf, "a positive number of seconds"),
    "utt2num_frames": (lambda value: re.fullmatch(r"0*[1-9]\d*", value), "a positive whole number"),
    "utt2warp": (lambda value: 0.5 < _number(value) < 1.5, "a number between 0.5 and 1.5"),
    "spk2warp": (lambda value: 0.5 < _number(value) < 1.5, "a number between 0.5 and 1.5"),
    "utt2snr": (lambda value: value == "inf" or math.isfinite(_number(value)), "a number of decibels, or inf"),
    "reco2file_and_channel": (lambda value: re.fullmatch(r"\S+\s+[AB1]", value), "a file and a channel A or B"),
}


class Utterance(NamedTuple):
    """One utterance: its speaker, its recording, and its segment of the recording."""

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
        Transcripts by utterance id; None without `text`.
    spk2gender : dict of str
        ``"m"`` or ``"f"`` by speaker id; empty without `spk2gender`.
    utt2uniq : dict of str
        The original utterance by utterance id; empty without `utt2uniq`.
    utt2lang : dict of str
        The language by utterance id; empty without `utt2lang`.
    utt2dur : dict of float
        Durations that the directory states [s], unchecked; may be empty.
    segmented : bool
        The directory has `segments`.
    """

    path: Path
    utterances: dict[str, Utterance]
    recordings: dict[str, Entry]
    text: dict[str, str] | None
    spk2gender: dict[str, str]
    utt2uniq: dict[str, str]
    utt2lang: dict[str, str]
    utt2dur: dict[str, float]
    segmented: bool


def read_data_dir(directory: Path, *, pipes: bool = False) -> DataDir:
    """Read and check a Kaldi data directory of any recipe; no audio is read.

    Paths in `wav.scp` are relative to the current folder, as in Kaldi. `text`, `spk2utt`, `spk2gender`,
    `utt2uniq` and `utt2lang` may be absent. A segment's end of -1 is the end of its recording.

    Parameters
    ----------
    pipes
        Accept commands other than ``flac -c -d -s FILE |`` in `wav.scp`; reading their audio runs them.

    Raises
    ------
    ValueError
        A file is missing, unsorted or malformed, ids differ between files, a transcript is empty, or `wav.scp`
        holds a command and `pipes` is false. The message names file, line, value and remedy.
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
        _require_same_ids(directory / "utt2spk", utt2spk, directory / "text", text)
    _check_spk2utt(directory, utt2spk)
    spk2gender = read_optional_table(directory, "spk2gender", dict.fromkeys(utt2spk.values()))
    utt2uniq, utt2lang = (read_optional_table(directory, name, utt2spk) for name in ("utt2uniq", "utt2lang"))
    utt2dur = read_optional_table(directory, "utt2dur", utt2spk)
    return DataDir(directory, utterances, recordings, text, segmented=segmented, spk2gender=spk2gender,
                   utt2uniq=utt2uniq, utt2lang=utt2lang,
                   utt2dur={key: float(duration_s) for key, duration_s in utt2dur.items()})


def read_utterance(data: DataDir, utterance: Utterance, *, pipes: bool = False) -> Array:
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


def read_lines(path: Path) -> list[str]:
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
    """Read a table as a dict in the order of the file: entry n is line n + 1."""
    table: dict[str, str] = {}
    previous = ""
    for number, line in enumerate(read_lines(path), start=1):
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


def _read_segments(directory: Path, utt2spk: dict[str, str],
                   recordings: Mapping[str, Entry]) -> dict[str, Utterance]:
    path, utterances = directory / "segments", {}
    table = _read_table(path)
    _require_same_ids(directory / "utt2spk", utt2spk, path, table)
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


def _whole_recordings(directory: Path, utt2spk: dict[str, str],
                      recordings: Mapping[str, Entry]) -> dict[str, Utterance]:
    _require_same_ids(directory / "utt2spk", utt2spk, directory / "wav.scp", recordings)
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


def _require_same_ids(first: Path, first_ids: Collection[str], second: Path, second_ids: Collection[str]) -> None:
    if set(first_ids) == set(second_ids):
        return
    for path, ids, other, other_ids in ((first, first_ids, second, second_ids), (second, second_ids, first, first_ids)):
        for number, key in enumerate(ids, start=1):
            if key not in other_ids:
                raise ValueError(f"{path}:{number}: {key!r} is not in {other.name}: every id must be in both: "
                                 "run Kaldi's utils/fix_data_dir.sh, or prepare the directory again")


def _check_spk2utt(directory: Path, utt2spk: dict[str, str]) -> None:
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


def read_optional_table(directory: Path, name: str, ids: Collection[str]) -> dict[str, str]:
    """Read a table that may be absent ({}).

    Raises
    ------
    ValueError
        The ids of the table are not `ids`, or a value breaks the rule of the table.
    """
    path = directory / name
    if not path.is_file():
        return {}
    table = _read_table(path)
    if list(table) != list(ids):
        main = {"spk": "spk2utt", "cmv": "spk2utt", "rec": "wav.scp"}.get(name[:3], "utt2spk")
        _require_same_ids(directory / main, ids, path, table)
    if name in _RULES:
        fits, rule = _RULES[name]
        for number, (key, value) in enumerate(table.items(), start=1):
            if not fits(value):
                raise ValueError(f"{path}:{number}: value {value!r} of {key!r} must be {rule}: correct the line")
    return table


def _number(text: str) -> float:
    """Return the number that a text states; NaN, which fails all comparisons, if it states none."""
    try:
        return float(text) if re.fullmatch(r"[-+]?[\d.]+(?:[eE][-+]?\d+)?", text) else math.nan
    except ValueError:
        return math.nan
