"""What the manifests of an export are written from."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from roomeq.export.audio import MadeAudio, seconds
from roomeq.export.plan import RECORDINGS, SPEECH
from roomeq.kaldi.datadir import DataDir, Utterance, read_optional_table
from roomeq.kaldi.wavscp import AudioLength, segment_samples


class ExportedUtterance(NamedTuple):
    """An utterance with its place in the exported audio.

    Attributes
    ----------
    id, speaker : str
    audio : MadeAudio
        The recording, or the utterance's own file.
    start, stop : int
        Segment of the audio [samples]; `stop` is exclusive.
    text, gender, language : str, optional
        Transcript; ``"m"`` or ``"f"``; as in `utt2lang`.
    rir, uniq : str, optional
        RIR of far-field speech; the utterance that it was made of.
    snr_db : float, optional
        SNR [dB]; None also without noise.
    """

    id: str
    speaker: str
    audio: MadeAudio
    start: int
    stop: int
    text: str | None
    gender: str | None
    language: str | None
    rir: str | None
    uniq: str | None
    snr_db: float | None

    @property
    def start_s(self) -> float:
        """Start of the segment [s]."""
        return seconds(self.start, self.audio.rate_hz)

    @property
    def end_s(self) -> float:
        """End of the segment [s]."""
        return seconds(self.stop, self.audio.rate_hz)

    @property
    def duration_s(self) -> float:
        """Duration of the segment [s]."""
        return seconds(self.stop - self.start, self.audio.rate_hz)


class Content(NamedTuple):
    """All that an export holds.

    Attributes
    ----------
    source : Path
        The directory that is exported.
    work : Path
        Directory to write to.
    out : Path
        Where it will lie.
    audio : list of MadeAudio
    data : DataDir, optional
        The data directory that it comes from.
    utterances : list of ExportedUtterance
    """

    source: Path
    work: Path
    out: Path
    audio: list[MadeAudio]
    data: DataDir | None
    utterances: list[ExportedUtterance]

    def by_folder(self) -> dict[str, list[MadeAudio]]:
        """Return the audio files by folder."""
        folders: dict[str, list[MadeAudio]] = {}
        for audio in self.audio:
            folders.setdefault(audio.planned.folder, []).append(audio)
        return folders


def utterances_of(data: DataDir | None, audio: list[MadeAudio]) -> list[ExportedUtterance]:
    """Return the utterances of a data directory with their places in the exported audio.

    Raises
    ------
    ValueError
        A segment does not lie within its recording.
    """
    if data is None:
        return []
    by_id = {(made.planned.folder, made.planned.id): made for made in audio}
    per_utterance = any(folder == SPEECH for folder, _ in by_id)
    tables = {name: read_optional_table(data.path, name, data.utterances) for name in ("utt2rir", "utt2snr")}
    return [_exported(data, utterance, by_id[(SPEECH, utterance.id) if per_utterance
                                             else (RECORDINGS, utterance.recording)], tables)
            for utterance in data.utterances.values()]


def _exported(data: DataDir, utterance: Utterance, audio: MadeAudio,
              tables: Mapping[str, Mapping[str, str]]) -> ExportedUtterance:
    start, stop = 0, audio.n_samples
    if audio.planned.folder == RECORDINGS and data.segmented:
        start, stop = segment_samples(f"{data.path}: utterance {utterance.id}",
                                      AudioLength(audio.n_samples, audio.rate_hz), utterance.start_s, utterance.end_s)
    snr = tables["utt2snr"].get(utterance.id, "inf")
    return ExportedUtterance(
        utterance.id, utterance.speaker, audio, start, stop,
        text=data.text[utterance.id] if data.text else None, gender=data.spk2gender.get(utterance.speaker),
        language=data.utt2lang.get(utterance.id), rir=tables["utt2rir"].get(utterance.id),
        uniq=data.utt2uniq.get(utterance.id), snr_db=None if snr == "inf" else float(snr))
