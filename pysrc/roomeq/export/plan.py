"""What there is to export in a directory: audio files by folder, and utterances."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from roomeq.augment.pack import file_name
from roomeq.corpora.suspicious import without_suspicious
from roomeq.kaldi.datadir import DataDir, read_data_dir
from roomeq.kaldi.wavscp import Entry
from roomeq.records.rir_dir import NOISES_FILE, ROWS_FILE, read_noises, read_rirs, rir_path

RIRS, NOISE_RIRS = "rirs", "noise_rirs"
NOISES = {"ambient": "ambient_noises", "point": "point_noises"}
"""Folder of each kind of noise."""
RECORDINGS, SPEECH = "recordings", "speech"
"""Folders of whole recordings, and of one file per utterance."""


class PlannedAudio(NamedTuple):
    """An audio file to make.

    Attributes
    ----------
    directory : Path
        The directory that is exported.
    id : str
        Id of the RIR, noise, recording or utterance.
    folder : str
        One of the folders above.
    file : str
        Path without suffix, relative to the directory to make.
    entry : Entry
        Where the audio comes from.
    start_s, end_s : float, optional
        Segment to cut out [s]; None is the end of the recording.
    row : mapping, optional
        Row of the RIR or noise.
    """

    directory: Path
    id: str
    folder: str
    file: str
    entry: Entry
    start_s: float = 0.0
    end_s: float | None = None
    row: Mapping[str, Any] | None = None

    @property
    def is_rir(self) -> bool:
        """Whether the audio is an RIR."""
        return self.folder in (RIRS, NOISE_RIRS)


class Plan(NamedTuple):
    """Audio files to make in the order of their ids, and the data directory that they come from, if any."""

    audio: list[PlannedAudio]
    data: DataDir | None


def plan_export(directory: Path, *, utterance_files: bool, all_rirs: bool, pipes: bool) -> Plan:
    """Read the tables of a directory; no audio is read, except of RIRs that nobody has characterised.

    Parameters
    ----------
    utterance_files
        Make one file per utterance; otherwise one per recording.
    all_rirs
        Keep recordings that are no RIR.
    pipes
        Accept commands in `wav.scp`.

    Raises
    ------
    ValueError
        The directory is of no kind that can be exported, or breaks its contract.
    """
    if (directory / "wav.scp").is_file():
        data = read_data_dir(directory, pipes=pipes)
        return Plan(list(_utterances(data) if utterance_files else _recordings(data)), data)
    if not (directory / ROWS_FILE).is_file() and not (directory / NOISES_FILE).is_file():
        raise ValueError(f"{directory}: neither an RIR directory ({ROWS_FILE}), nor one of noises ({NOISES_FILE}), nor "
                         "a data directory (wav.scp): check the path")
    return Plan([*_rirs(directory, all_rirs), *_noises(directory)], None)


def _rirs(directory: Path, all_rirs: bool) -> Iterator[PlannedAudio]:
    if not (directory / ROWS_FILE).is_file():
        return
    rows = read_rirs(directory)
    for row in rows if all_rirs else without_suspicious(directory, rows):
        folder = NOISE_RIRS if row.get("noise_for") else RIRS
        yield PlannedAudio(directory, row["id"], folder, f"{folder}/{row['id']}",
                           Entry("file", str(rir_path(directory, row))), row=row)


def _noises(directory: Path) -> Iterator[PlannedAudio]:
    for row in read_noises(directory):
        folder = NOISES[row["kind"]]
        yield PlannedAudio(directory, row["id"], folder, f"{folder}/{row['id']}",
                           Entry("file", str(directory / row["wav"])), row=row)


def _recordings(data: DataDir) -> Iterator[PlannedAudio]:
    """Yield the recordings that an utterance is of: Kaldi's `validate_data_dir.sh` refuses others beside `segments`."""
    speakers: dict[str, str] = {}
    for utterance in data.utterances.values():
        speakers.setdefault(utterance.recording, utterance.speaker)
    for recording, entry in data.recordings.items():
        if recording in speakers:
            yield PlannedAudio(data.path, recording, RECORDINGS,
                               f"{RECORDINGS}/{file_name(speakers[recording])}/{file_name(recording)}", entry)


def _utterances(data: DataDir) -> Iterator[PlannedAudio]:
    for utterance in data.utterances.values():
        yield PlannedAudio(data.path, utterance.id, SPEECH,
                           f"{SPEECH}/{file_name(utterance.speaker)}/{file_name(utterance.id)}",
                           data.recordings[utterance.recording], utterance.start_s, utterance.end_s)
