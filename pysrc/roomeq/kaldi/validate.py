"""Check a Kaldi data directory as strictly as Kaldi does, and its audio."""

import logging
import re
from collections.abc import Collection
from pathlib import Path

from roomeq.core.audio import read_audio
from roomeq.core.constants import FS_HZ
from roomeq.kaldi.datadir import DataDir, read_data_dir, read_lines, read_optional_table
from roomeq.kaldi.wavscp import AudioLength, read_length, segment_samples
from roomeq.records.transcripts import unprintable_in

logger = logging.getLogger(__name__)

MAX_DURATION_ERROR_S = 0.1
"""Error of durations that Kaldi computes from numbers of frames [s]."""
MIN_SEGMENT_S = 0.1
"""Kaldi's `extract-segments` leaves out segments that are not longer (``--min-segment-length``)."""
_PER_UTTERANCE = ("utt2dur", "utt2num_frames", "utt2uniq", "utt2lang", "utt2warp", "utt2rir", "utt2snr",
                  "feats.scp", "vad.scp")
_PER_SPEAKER = ("spk2gender", "spk2warp", "cmvn.scp")
_PER_RECORDING = ("reco2dur", "reco2file_and_channel")


def validate_data_dir(directory: Path, *, audio: bool = True) -> int:
    """Check a data directory as strictly as Kaldi's `validate_data_dir.sh --no-feats`, and its audio.

    Parameters
    ----------
    audio
        Check that every recording can be read and that every segment lies within its recording. Commands in `wav.scp`
        are not run.

    Returns
    -------
    n_utterances : int

    Raises
    ------
    ValueError
        The first line that breaks a rule.
    """
    data = read_data_dir(directory, pipes=True)
    if not (data.path / "spk2utt").is_file():
        raise ValueError(f"{data.path / 'spk2utt'}: no such file: Kaldi's scripts need it: write it")
    if data.text is None:
        logger.warning("%s: no text: recognisers cannot be trained with it, and Kaldi's validate_data_dir.sh needs "
                       "--no-text", data.path)
    else:
        for number, line in enumerate(read_lines(data.path / "text"), start=1):
            _check_printable(line, f"{data.path / 'text'}:{number}")
    if data.segmented:
        _check_segments_strictly(data)
    for number, line in enumerate(read_lines(data.path / "wav.scp"), start=1):
        if re.match(r"\S+\s+~", line):
            raise ValueError(f"{data.path / 'wav.scp'}:{number}: path in {line!r} must not start with '~': "
                             "write the whole path")
    speakers = {utterance.speaker: "" for utterance in data.utterances.values()}
    for names, ids in ((_PER_UTTERANCE, data.utterances), (_PER_SPEAKER, speakers),
                       (_PER_RECORDING, data.recordings)):
        for name in names:
            read_optional_table(data.path, name, ids)
    if audio:
        _check_audio(data)
    return len(data.utterances)


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
    if short := [utterance.id for utterance in data.utterances.values() if utterance.end_s is not None
                 and int(utterance.end_s * FS_HZ) <= int(utterance.start_s * FS_HZ) + int(MIN_SEGMENT_S * FS_HZ)]:
        logger.warning("%s: %d segments are not longer than %g s, such as %s: Kaldi leaves them out, so that sets of "
                       "the same speech without segments differ from this one: leave them out of all", path,
                       len(short), MIN_SEGMENT_S, short[0])
    used = {utterance.recording for utterance in data.utterances.values()}
    for number, recording in enumerate(data.recordings, start=1):
        if recording not in used:
            raise ValueError(f"{data.path / 'wav.scp'}:{number}: recording {recording!r} has no segment: "
                             "remove it, or add its segments")


def _check_audio(data: DataDir) -> None:
    lengths: dict[str, AudioLength] = {}
    for number, (recording, entry) in enumerate(data.recordings.items(), start=1):
        if entry.kind == "pipe":
            continue
        try:
            length = lengths[recording] = read_length(entry, pipes=False)
            if entry.kind == "file":  # that a FLAC file was cut off shows only at its end
                read_audio(Path(entry.text), fs_hz=length.rate_hz, start=length.frames - 1)
        except ValueError as error:
            raise ValueError(f"{data.path / 'wav.scp'}:{number}: {error}") from None
    if len(lengths) < len(data.recordings):
        logger.info("%s: %d recordings are commands, not run and not checked", data.path,
                    len(data.recordings) - len(lengths))
    recording_s = {recording: length.frames / length.rate_hz for recording, length in lengths.items()}
    utterance_s: dict[str, float] = {}
    for number, utterance in enumerate(data.utterances.values(), start=1):
        if utterance.recording not in lengths:
            continue
        length = lengths[utterance.recording]
        where = f"{data.path / 'segments'}:{number}: recording {utterance.recording}"
        start, stop = segment_samples(where, length, utterance.start_s, utterance.end_s)
        utterance_s[utterance.id] = (stop - start) / length.rate_hz
    _check_durations(data.path / "utt2dur", data.utterances, utterance_s)
    _check_durations(data.path / "reco2dur", data.recordings, recording_s)


def _check_durations(path: Path, ids: Collection[str], audio_s: dict[str, float]) -> None:
    """Compare the durations that a table states with those of the audio, where they are known."""
    for number, (key, value) in enumerate(read_optional_table(path.parent, path.name, ids).items(), start=1):
        if key in audio_s and abs(audio_s[key] - float(value)) > MAX_DURATION_ERROR_S:
            raise ValueError(f"{path}:{number}: {value} s of {key!r} where its audio lasts {audio_s[key]:.3f} s: make "
                             "the file again, or put the right audio there")
