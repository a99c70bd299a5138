"""Plan the Kaldi data directory of one role: its items, the function that makes one, and the tables at the end."""

import logging
import math
import os
import re
import shlex
from collections.abc import Callable, Iterable, Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

from roomeq.core.build import Build
from roomeq.core.constants import FS_HZ
from roomeq.core.files import write_text
from roomeq.corpora.kaldi_dir import KaldiDir
from roomeq.corpora.utterance import Utterance
from roomeq.records.transcripts import words_problem

logger = logging.getLogger(__name__)

_PLAIN_PATH = re.compile(r"[A-Za-z0-9_./+@,=%~^-]+")
_READABLE = ("FLAC", "WAV")


class KaldiPart(NamedTuple):
    """A Kaldi data directory and those of its utterances that belong to a role."""

    directory: KaldiDir
    utterances: set[str]


class Plan(NamedTuple):
    """How `roomeq.core.build.Build` makes a data directory: see `Build.run` and `Build.finish`."""

    items: Mapping[str, list[Utterance]]
    make: Callable[[str, Any], Any]
    assemble: Callable[[Path, list[Any]], None]


class _Audio(NamedTuple):
    """Entry of an utterance in `wav.scp`, its length, the number of channels of its file, and how it was scaled."""

    utterance: str
    entry: str
    n_samples: int
    n_channels: int
    attenuated_db: float = 0.0
    """By how much samples of the file beyond full scale were reduced."""


def _limited(ids: Iterable[str], limit: int | None) -> set[str]:
    """Choose ids by their hash: they are spread over the corpus, and a larger limit adds to the same choice."""
    return set(sorted(ids, key=lambda name: sha256(name.encode()).digest())[:limit])


def plan_kaldi(parts: Iterable[KaldiPart], limit: int | None) -> Plan:
    """Plan a directory from Kaldi data directories: only their lines are copied.

    Raises
    ------
    ValueError
        Directories share an utterance or recording, only some have segments, or the order of utterances is not that of
        their speakers.
    """
    parts = list(parts)
    kept = _limited((utterance for part in parts for utterance in part.utterances), limit)
    files: dict[str, dict[str, str]] = {}
    for part in parts:
        for name, lines in part.directory.subset(part.utterances & kept).items():
            target = files.setdefault(name, {})
            if name in ("wav.scp", "utt2spk") and (twice := set(lines) & set(target)):
                raise ValueError(f"{part.directory.path / name}: {min(twice)} is in another set of the same role too: "
                                 "ids must be unique: rename one")
            target.update(lines)
    _require_segments_in_all(parts)
    _check_order(files["utt2spk"])

    def assemble(directory: Path, records: list[Any]) -> None:
        complete = {name: lines for name, lines in files.items() if _is_complete(name, lines, files)}
        if "segments" not in complete and "utt2dur" in complete:  # an utterance is a recording of its own
            complete["reco2dur"] = complete["utt2dur"]
        _write_dir(directory, complete)

    return Plan({}, lambda name, item: None, assemble)


def _require_segments_in_all(parts: list[KaldiPart]) -> None:
    with_segments = ["segments" in part.directory.files for part in parts]
    for part, has_segments in zip(parts, with_segments, strict=True):
        if not has_segments and any(with_segments):
            raise ValueError(f"{part.directory.path}: has no segments, but another set of the same role has: make them "
                             "with utils/data/get_segments_for_data.sh, or use sets of one kind")


def _is_complete(name: str, lines: dict[str, str], files: dict[str, dict[str, str]]) -> bool:
    """Tell whether an optional table covers all utterances, speakers or recordings, as Kaldi requires."""
    if name == "wav.scp":
        return True
    required = {"spk2gender": set(files["utt2spk"].values()), "reco2dur": set(files["wav.scp"])}
    return set(lines) >= required.get(name, set(files["utt2spk"]))


def plan_utterances(build: Build, utterances: list[Utterance], limit: int | None, channel: int) -> Plan:
    """Plan a directory from utterances; an item holds those of one speaker.

    Files with several channels give the one of number `channel`, counted from 0.

    Raises
    ------
    ValueError
        There are no utterances, two share an id, a transcript is unusable, or the order of utterances is not that of
        their speakers.
    """
    _check(utterances, build.out)
    kept = _limited((utterance.id for utterance in utterances), limit)
    utterances = [utterance for utterance in utterances if utterance.id in kept]
    items: dict[str, list[Utterance]] = {}
    for utterance in utterances:
        items.setdefault(utterance.speaker, []).append(utterance)

    def make(speaker: str, spoken: list[Utterance]) -> list[_Audio]:
        return [_audio(utterance, build, channel) for utterance in spoken]

    def assemble(directory: Path, records: list[list[list[Any]]]) -> None:
        audio = [_Audio(*made) for record in records for made in record]
        entries = {made.utterance: (made.entry, made.n_samples) for made in audio}
        genders = {utterance.speaker: utterance.gender for utterance in utterances}
        known_genders = {speaker: gender for speaker, gender in genders.items() if gender is not None}
        durations = {name: seconds(n_samples) for name, (_, n_samples) in entries.items()}
        files = {"wav.scp": {name: entry for name, (entry, _) in entries.items()},
                 "utt2spk": {utterance.id: utterance.speaker for utterance in utterances},
                 "utt2dur": durations, "reco2dur": durations}  # an utterance is a recording of its own
        if texts := {utterance.id: utterance.text for utterance in utterances if utterance.text is not None}:
            files["text"] = texts
        if len(known_genders) == len(genders):
            files["spk2gender"] = known_genders
        elif known_genders:
            logger.warning("%s: the gender of %d speakers is unknown: spk2gender left out", build.out,
                           len(genders) - len(known_genders))
        _write_dir(directory, files)
        converted = sum((directory / "audio").is_dir() and f"/audio/{name}.flac" in entry
                        for name, (entry, _) in entries.items())
        hours = sum(n_samples for _, n_samples in entries.values()) / FS_HZ / 3600
        logger.info("%s: %d utterances of %d speakers, %.2f h%s", build.out, len(utterances), len(genders), hours,
                    f", {converted} converted to {FS_HZ} Hz FLAC" if converted else "")
        if attenuated := [made for made in audio if made.attenuated_db > 0.0]:
            worst = max(attenuated, key=lambda made: made.attenuated_db)
            logger.warning("%s: %d files exceed full scale and were reduced to it, by up to %.1f dB (%s): scale all "
                           "files by one factor if their levels matter", build.out, len(attenuated),
                           worst.attenuated_db, worst.utterance)
        if n_multichannel := sum(made.n_channels > 1 for made in audio):
            logger.info("%s: %d files have several channels: channel %d is used, counted from 0 (choose with "
                        "--channel)", build.out, n_multichannel, channel)

    return Plan(items, make, assemble)


def _check(utterances: list[Utterance], out: Path) -> None:
    if not utterances:
        raise ValueError(f"{out}: no utterances in its sets: choose others")
    first: dict[str, str] = {}
    for utterance in utterances:
        if utterance.id in first:
            raise ValueError(f"{utterance.where}: utterance {utterance.id} is also in {first[utterance.id]}: "
                             "ids must be unique: rename one")
        if utterance.text is not None and (problem := words_problem(utterance.text)):
            raise ValueError(f"{utterance.where}: transcript of {utterance.id}: {problem}")
        first[utterance.id] = utterance.where
    _check_order({utterance.id: utterance.speaker for utterance in utterances})


def _audio(utterance: Utterance, build: Build, channel: int) -> _Audio:
    """Return the `wav.scp` entry of an utterance and its length; convert audio that Kaldi could not read."""
    from roomeq.core.audio import audio_info, read_audio, write_flac

    try:
        path = Path(os.path.realpath(utterance.path.parent)) / utterance.path.name
        info = audio_info(path)
        as_it_is = (info.format in _READABLE and info.subtype == "PCM_16" and info.samplerate == FS_HZ
                    and info.channels == 1 and _fits_a_line(path))
        if as_it_is and (info.format == "FLAC" or _PLAIN_PATH.fullmatch(str(path))):
            read_audio(path, start=info.frames - 1, stop=info.frames)  # the end of a truncated FLAC is missing
            return _Audio(utterance.id, _flac_entry(path) if info.format == "FLAC" else str(path), info.frames, 1)
        samples = read_audio(path, channel=channel if info.channels > 1 else None)
        peak = max(float(abs(samples).max()), 1.0)
        write_flac(build.work / "audio" / f"{utterance.id}.flac", samples / peak)
        made = Path(os.path.realpath(build.out.parent)) / build.out.name / "audio" / f"{utterance.id}.flac"
        # resampling may exceed full scale by a little; samples of the file itself only where they are floating-point
        attenuated_db = 20.0 * math.log10(peak) if info.subtype in ("FLOAT", "DOUBLE") else 0.0
        return _Audio(utterance.id, _flac_entry(made), len(samples), info.channels, attenuated_db)
    except ValueError as error:
        raise ValueError(f"{error} (named by {utterance.where})") from None


def _fits_a_line(path: Path) -> bool:
    """Tell whether a path fits a line of a text file: it has no line break and is UTF-8."""
    try:
        return not {"\n", "\r"} & set(str(path)) and bool(str(path).encode())
    except UnicodeEncodeError:
        return False


def _flac_entry(path: Path) -> str:
    return f"flac -c -d -s {shlex.quote(str(path))} |"


def seconds(n_samples: int) -> str:
    """Return a duration [s] with enough decimals to distinguish single samples."""
    return f"{n_samples / FS_HZ:.7f}".rstrip("0").rstrip(".")


def _write_dir(directory: Path, files: dict[str, dict[str, str]]) -> None:
    """Write the tables of a data directory, sorted by bytes, and `spk2utt`."""
    spk2utt: dict[str, list[str]] = {}
    for utt in sorted(files["utt2spk"], key=str.encode):
        spk2utt.setdefault(files["utt2spk"][utt], []).append(utt)
    for name, lines in (files | {"spk2utt": {spk: " ".join(utts) for spk, utts in spk2utt.items()}}).items():
        write_text(directory / name, "".join(f"{key} {lines[key]}\n" for key in sorted(lines, key=str.encode)))


def _check_order(utt2spk: dict[str, str]) -> None:
    """Refuse utterances whose order differs from that of their speakers, as Kaldi does."""
    by_utterance = sorted(utt2spk, key=str.encode)
    by_speaker = sorted(utt2spk, key=lambda utt: (utt2spk[utt].encode(), utt.encode()))
    if by_utterance != by_speaker:
        utterance = next(a for a, b in zip(by_utterance, by_speaker, strict=True) if a != b)
        raise ValueError(f"utterance {utterance} of speaker {utt2spk[utterance]} sorts apart from "
                         "its speaker: utterance ids must start with the speaker's id and '-': rename one of them")
