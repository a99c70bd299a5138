"""Pack utterances into recordings, and write the recordings."""

import hashlib
import io
import re
from collections.abc import Iterable, Iterator
from itertools import groupby, pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import soundfile

from roomeq.core.arrays import Array
from roomeq.core.constants import FS_HZ
from roomeq.core.files import write_bytes
from roomeq.kaldi.datadir import DataDir, Utterance
from roomeq.kaldi.wavscp import Entry, read_length
from roomeq.kaldi.write import GRID_SAMPLES
from roomeq.records.schema import is_id, make_id

MAX_RECORDING_S = 900.0
ASSUMED_DURATION_S = 15.0  # of an utterance in an archive or pipe, which would have to be decoded to measure it
FLAC_LEVEL = 0.25  # libsndfile's scale, 0 to 1; higher levels save 2 % of size for 15 % of time


class PlannedUtterance(NamedTuple):
    """A far-field utterance to make.

    Attributes
    ----------
    id : str
    clean : Utterance
    entry : Entry
        The `wav.scp` entry of the clean recording.
    stated_s : float, optional
        Duration of the clean utterance in `utt2dur` [s].
    """

    id: str
    clean: Utterance
    entry: Entry
    stated_s: float | None = None


def plan_recordings(data: DataDir, copies: int, *, pipes: bool = False) -> dict[str, list[PlannedUtterance]]:
    """Group utterances into recordings of at most 15 minutes.

    Consecutive utterances (sorted by new id) of the same speaker and chapter share a recording. The chapter of an
    utterance is its recording if the input has `segments`, else its id without the last number, else its speaker.

    Returns
    -------
    plan : dict
        Utterances by recording id. Over all recordings in turn, the new ids are sorted by byte value.

    Raises
    ------
    ValueError
        The new ids clash, or do not sort like their speakers; or the audio of an utterance cannot be read.
    """
    outputs = [PlannedUtterance(f"{utterance_id}-rvb{copy}" if copies > 1 else utterance_id, utterance,
                                data.recordings[utterance.recording], data.utt2dur.get(utterance_id))
               for utterance_id, utterance in data.utterances.items() for copy in range(1, copies + 1)]
    outputs.sort(key=lambda planned: planned.id)
    if len({planned.id for planned in outputs}) < len(outputs):
        raise ValueError(f"{data.path}: ids with and without -rvb1 clash: use copies=1, or rename the utterances")
    for before, planned in pairwise(outputs):
        if planned.clean.speaker < before.clean.speaker:
            raise ValueError(f"{data.path}: copies={copies}: with the suffix -rvbN, utterance {before.clean.id!r} of "
                             f"{before.clean.speaker!r} sorts before {planned.clean.id!r} of "
                             f"{planned.clean.speaker!r}, and ids must sort like speakers: use copies=1, or rename "
                             f"utterance {planned.clean.id!r} so that no other id begins with it")

    def chapter_and_speaker(planned: PlannedUtterance) -> tuple[str, str]:
        if data.segmented:
            return planned.clean.recording, planned.clean.speaker
        match = re.fullmatch(r"(.+)[-_.]\d+", planned.clean.id)
        return match[1] if match else planned.clean.speaker, planned.clean.speaker

    chapters = {chapter_and_speaker(planned)[0] for planned in outputs}
    plan: dict[str, list[PlannedUtterance]] = {}
    for (chapter, _), utterances in groupby(outputs, key=chapter_and_speaker):
        for piece in _split_chapter(data, utterances, pipes):
            number, name = 1, chapter
            while name in plan or (number > 1 and name in chapters):
                number += 1
                name = f"{chapter}-{number}"
            plan[name] = piece
    return plan


def _split_chapter(data: DataDir, utterances: Iterable[PlannedUtterance],
                   pipes: bool) -> Iterator[list[PlannedUtterance]]:
    """Cut a chapter into pieces of at most `MAX_RECORDING_S`; a single utterance may be longer."""
    piece: list[PlannedUtterance] = []
    length_s = 0.0
    for planned in utterances:
        duration_s = _duration_s(data, planned, pipes)
        if piece and length_s + duration_s > MAX_RECORDING_S:
            yield piece
            piece, length_s = [], 0.0
        piece.append(planned)
        length_s += duration_s
    yield piece


def _duration_s(data: DataDir, planned: PlannedUtterance, pipes: bool) -> float:
    utterance = planned.clean
    if utterance.end_s is not None:
        return utterance.end_s - utterance.start_s
    if utterance.id in data.utt2dur:
        return data.utt2dur[utterance.id]
    if planned.entry.kind != "file":
        return ASSUMED_DURATION_S
    try:
        length = read_length(planned.entry, pipes=pipes)
    except ValueError as error:
        raise ValueError(f"{data.path}: utterance {utterance.id}: {error}") from None
    return length.frames / length.rate_hz - utterance.start_s


class RecordingFile:
    """FLAC file of a recording, encoded utterance by utterance; in memory, since libsndfile may not report a full disk.

    Attributes
    ----------
    n_samples : int
        Length so far.
    """

    def __init__(self, speaker: str, name: str) -> None:
        self.n_samples = 0
        self._file = f"audio/{file_name(speaker)}/{file_name(name)}.flac"
        self._buffer = io.BytesIO()
        self._flac = soundfile.SoundFile(self._buffer, "w", FS_HZ, 1, "PCM_16", format="FLAC",
                                         compression_level=FLAC_LEVEL)

    def append(self, samples: Array) -> int:
        """Append an utterance, int16, at the next sample on the grid; return where it starts."""
        start = -(-self.n_samples // GRID_SAMPLES) * GRID_SAMPLES
        self._flac.write(np.zeros(start - self.n_samples, np.int16))
        self._flac.write(samples)
        self.n_samples = start + len(samples)
        return start

    def save(self, work: Path) -> dict:
        """Write the file below `work`."""
        self._flac.close()
        write_bytes(work / self._file, self._buffer.getbuffer())
        return dict(file=self._file, n_samples=self.n_samples)


def file_name(name: str) -> str:
    """Return a safe file name for an id of a data directory, which may contain any character except blanks."""
    if is_id(name) and len(name) <= 100:
        return name
    return f"{make_id(name)[:80]}+{hashlib.sha256(name.encode()).hexdigest()[:12]}"
