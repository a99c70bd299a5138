"""Which utterances lie together in which recording, and the files they are written to."""

import hashlib
import io
import re
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

import numpy as np
import soundfile

from roomeq.constants import FS_HZ
from roomeq.datadir import DataDir, Utterance
from roomeq.files import write_bytes
from roomeq.rirs import is_id, make_id
from roomeq.wavscp import n_samples

MAX_RECORDING_S = 900.0
UNKNOWN_S = 15.0  # planning length of an utterance that only decoding a whole archive or pipe would tell
FLAC_LEVEL = 0.25  # libsndfile's scale 0 to 1; higher gains 2 % of size for 15 % of time


def plan_recordings(data: DataDir, copies: int, *, pipes: bool = False) -> dict[str, list[tuple[str, str]]]:
    """Decide which utterances lie together in a recording of at most 15 minutes.

    Neighbours (in the order of the new ids) of the same speaker and chapter lie together. A chapter is a recording
    of the input where it has `segments`, else what precedes the last number of the utterance id, else the speaker.

    Returns
    -------
    plan : dict
        By recording id: pairs of new and clean utterance id. All recordings one after the other hold the new ids
        in byte order.
    """
    outputs = sorted((f"{key}-rvb{copy}" if copies > 1 else key, key)
                     for key in data.utterances for copy in range(1, copies + 1))
    if len({new for new, _ in outputs}) < len(outputs):
        raise ValueError(f"{data.path}: ids with and without -rvb1 clash: use copies=1, or rename the utterances")

    def chapter(pair: tuple[str, str]) -> tuple[str, str]:
        utterance = data.utterances[pair[1]]
        if data.segmented:
            return utterance.recording, utterance.speaker
        found = re.fullmatch(r"(.+)[-_.]\d+", utterance.id)
        return found[1] if found else utterance.speaker, utterance.speaker

    taken, plan = {chapter(pair)[0] for pair in outputs}, {}
    for (name, _), pairs in groupby(outputs, key=chapter):
        for piece in _pieces(data, list(pairs), pipes):
            number, free = 1, name
            while free in plan or (number > 1 and free in taken):
                number += 1
                free = f"{name}-{number}"
            plan[free] = piece
    return plan


def _pieces(data: DataDir, pairs: list[tuple[str, str]], pipes: bool) -> Iterator[list[tuple[str, str]]]:
    """Cut a chapter into pieces of at most `MAX_RECORDING_S` (one utterance may be longer)."""
    piece, length_s = [], 0.0
    for pair in pairs:
        duration_s = _planned_s(data, data.utterances[pair[1]], pipes)
        if piece and length_s + duration_s > MAX_RECORDING_S:
            yield piece
            piece, length_s = [], 0.0
        piece.append(pair)
        length_s += duration_s
    yield piece


def _planned_s(data: DataDir, utterance: Utterance, pipes: bool) -> float:
    if utterance.end_s is not None:
        return utterance.end_s - utterance.start_s
    if utterance.id in data.utt2dur:
        return data.utt2dur[utterance.id]
    entry = data.recordings[utterance.recording]
    if entry.kind != "file":
        return UNKNOWN_S
    try:
        length, rate = n_samples(entry, pipes=pipes)
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
