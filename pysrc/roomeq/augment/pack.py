"""Which utterances lie together in which recording, and the files they are written to."""

import hashlib
import io
import re
from collections.abc import Iterable, Iterator
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import numpy as np
import soundfile

from roomeq.core.constants import FS_HZ
from roomeq.core.files import write_bytes
from roomeq.kaldi.datadir import DataDir, Utterance
from roomeq.kaldi.wavscp import Entry, n_samples
from roomeq.records.schema import is_id, make_id

MAX_RECORDING_S = 900.0
UNKNOWN_S = 15.0  # planning length of an utterance that only decoding a whole archive or pipe would tell
FLAC_LEVEL = 0.25  # libsndfile's scale 0 to 1; higher gains 2 % of size for 15 % of time


class Planned(NamedTuple):
    """One utterance to make: its new id, and the clean one with where its audio lies."""

    id: str
    clean: Utterance
    entry: Entry


def plan_recordings(data: DataDir, copies: int, *, pipes: bool = False) -> dict[str, list[Planned]]:
    """Decide which utterances lie together in a recording of at most 15 minutes.

    Neighbours (in the order of the new ids) of the same speaker and chapter lie together. A chapter is a recording
    of the input where it has `segments`, else what precedes the last number of the utterance id, else the speaker.

    Returns
    -------
    plan : dict
        Utterances by recording id. All recordings one after the other hold the new ids in byte order.
    """
    outputs = [Planned(f"{key}-rvb{copy}" if copies > 1 else key, utterance, data.recordings[utterance.recording])
               for key, utterance in data.utterances.items() for copy in range(1, copies + 1)]
    outputs.sort(key=lambda planned: planned.id)
    if len({planned.id for planned in outputs}) < len(outputs):
        raise ValueError(f"{data.path}: ids with and without -rvb1 clash: use copies=1, or rename the utterances")

    def chapter(planned: Planned) -> tuple[str, str]:
        if data.segmented:
            return planned.clean.recording, planned.clean.speaker
        found = re.fullmatch(r"(.+)[-_.]\d+", planned.clean.id)
        return found[1] if found else planned.clean.speaker, planned.clean.speaker

    taken, plan = {chapter(planned)[0] for planned in outputs}, {}
    for (name, _), together in groupby(outputs, key=chapter):
        for piece in _pieces(data, together, pipes):
            number, free = 1, name
            while free in plan or (number > 1 and free in taken):
                number += 1
                free = f"{name}-{number}"
            plan[free] = piece
    return plan


def _pieces(data: DataDir, together: Iterable[Planned], pipes: bool) -> Iterator[list[Planned]]:
    """Cut a chapter into pieces of at most `MAX_RECORDING_S` (one utterance may be longer)."""
    piece, length_s = [], 0.0
    for planned in together:
        duration_s = _duration_s(data, planned, pipes)
        if piece and length_s + duration_s > MAX_RECORDING_S:
            yield piece
            piece, length_s = [], 0.0
        piece.append(planned)
        length_s += duration_s
    yield piece


def _duration_s(data: DataDir, planned: Planned, pipes: bool) -> float:
    utterance = planned.clean
    if utterance.end_s is not None:
        return utterance.end_s - utterance.start_s
    if utterance.id in data.utt2dur:
        return data.utt2dur[utterance.id]
    if planned.entry.kind != "file":
        return UNKNOWN_S
    try:
        length, rate = n_samples(planned.entry, pipes=pipes)
    except ValueError as error:
        raise ValueError(f"{data.path}: utterance {utterance.id}: {error}") from None
    return length / rate - utterance.start_s


def write_recording(work: Path, speaker: str, name: str, pieces: list[np.ndarray]) -> dict:
    """Write a recording below the work directory (encoded in memory first: a full disk must be an error)."""
    buffer, samples = io.BytesIO(), np.concatenate(pieces)
    soundfile.write(buffer, samples, FS_HZ, format="FLAC", subtype="PCM_16", compression_level=FLAC_LEVEL)
    file = f"audio/{file_name(speaker)}/{file_name(name)}.flac"
    write_bytes(work / file, buffer.getbuffer())
    return dict(recording=name, file=file, n_samples=len(samples))


def file_name(name: str) -> str:
    """Return a safe file name for an id of a data directory, which may hold anything but blanks."""
    if is_id(name) and len(name) <= 100:
        return name
    return f"{make_id(name)[:80]}+{hashlib.sha256(name.encode()).hexdigest()[:12]}"
