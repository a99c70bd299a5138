"""A plain Kaldi data directory as a speech corpus: its lines are copied, its audio is not touched."""

import logging
import re
from dataclasses import dataclass
from pathlib import Path

from roomeq.core.files import read_text
from roomeq.records.transcripts import words_problem

logger = logging.getLogger(__name__)

BY_UTTERANCE = ("segments", "text", "utt2spk", "utt2dur", "utt2lang", "utt2uniq")
BY_RECORDING = ("wav.scp", "reco2dur")
BY_SPEAKER = ("spk2gender",)
_REMEDY = "complete the data directory (utils/fix_data_dir.sh)"


@dataclass(frozen=True)
class KaldiDir:
    """Tables of a data directory as {file: {key: rest of the line}}."""

    path: Path
    files: dict[str, dict[str, str]]

    def voices(self) -> dict[str, str]:
        """Return the voice of each utterance: its speaker, or the reader of a LibriSpeech speaker reader-chapter.

        Speakers of copies of one utterance (`utt2uniq`), as speed perturbation makes them, are one voice.
        """
        speaker_of = {utt: re.sub(r"^(\d+)-\d+$", r"\1", spk) for utt, spk in self.files["utt2spk"].items()}
        same = {speaker: speaker for speaker in speaker_of.values()}

        def voice(speaker: str) -> str:
            while same[speaker] != speaker:
                speaker = same[speaker]
            return speaker

        first: dict[str, str] = {}
        for utt, original in self.files.get("utt2uniq", {}).items():
            if utt in speaker_of:
                other = first.setdefault(original, speaker_of.get(original, speaker_of[utt]))
                kept, joined = sorted((voice(other), voice(speaker_of[utt])))
                same[joined] = kept
        return {utt: voice(speaker) for utt, speaker in speaker_of.items()}

    def subset(self, utterances: set[str]) -> dict[str, dict[str, str]]:
        """Return the tables with only the lines that these utterances need."""
        segments = self.files.get("segments")
        recordings = {segments[utt].split()[0] for utt in utterances} if segments else utterances
        speakers = {self.files["utt2spk"][utt] for utt in utterances}
        wanted = dict.fromkeys(BY_UTTERANCE, utterances) | dict.fromkeys(BY_RECORDING, recordings) | dict.fromkeys(
            BY_SPEAKER, speakers)
        return {name: {key: rest for key, rest in lines.items() if key in wanted[name]}
                for name, lines in self.files.items()}


def find_kaldi_dirs(source: Path) -> dict[str, Path]:
    """Return the data directories at a path: the path itself, as set ``""``, or those below it by name."""
    if (source / "wav.scp").is_file():
        return {"": source}
    return {path.parent.name: path.parent for path in sorted(source.glob("*/wav.scp"))}


def read_kaldi_dir(path: Path) -> KaldiDir:
    """Read those tables of a data directory that are copied; there may be no `text`.

    Raises
    ------
    ValueError
        A required table is missing or empty, a line has no value, a key occurs twice, or the tables do not match.
    """
    files = {name: _read_lines(path / name) for name in (*BY_UTTERANCE, *BY_RECORDING, *BY_SPEAKER)
             if (path / name).is_file()}
    for name in ("wav.scp", "utt2spk", "text"):
        if not files.get(name) and (name != "text" or name in files):
            raise ValueError(f"{path / name}: missing or empty: {_REMEDY}")
    if "text" not in files:
        logger.warning("%s: no text: no transcripts are written", path)
    for utt, words in files.get("text", {}).items():
        if problem := words_problem(words.replace("\t", " ")):
            raise ValueError(f"{path / 'text'}: transcript of {utt}: {problem}")
    audio_of = files.get("segments", files["wav.scp"])
    for utt in files["utt2spk"]:
        if utt not in audio_of or utt not in files.get("text", audio_of):
            lacking = "text" if utt in audio_of else "segments" if "segments" in files else "wav.scp"
            raise ValueError(f"{path / lacking}: utterance {utt} of utt2spk is not in it: {_REMEDY}")
        if "segments" in files and (recording := audio_of[utt].split()[0]) not in files["wav.scp"]:
            raise ValueError(f"{path / 'wav.scp'}: recording {recording} of segments is not in it: {_REMEDY}")
    return KaldiDir(path, files)


def _read_lines(path: Path) -> dict[str, str]:
    lines: dict[str, str] = {}
    for number, line in enumerate(read_text(path).split("\n"), start=1):
        if not line.strip():
            continue
        key, *rest = line.strip().split(maxsplit=1)
        if not rest:
            raise ValueError(f"{path}:{number}: {key!r} has no value: correct the line")
        if key in lines:
            raise ValueError(f"{path}:{number}: {key} occurs twice: ids must be unique: remove one line")
        lines[key] = rest[0]
    return lines
