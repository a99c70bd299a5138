"""Read the recordings of a corpus: the rows of each file, and its samples where they are to be written anew."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from roomeq.acoustics.fade import length_before_last_bit, length_before_silence
from roomeq.acoustics.plausibility import find_implausibility
from roomeq.core.arrays import FloatArray
from roomeq.core.audio import audio_info, read_audio, require_plausible, sounds
from roomeq.core.constants import FS_HZ
from roomeq.core.files import path_from
from roomeq.corpora.record import UNKNOWN, Recording, is_sofa
from roomeq.corpora.sofa_file import sofa_signals

_SAFE_PATH = re.compile(r"[A-Za-z0-9_./+@,:=%~^-]+")


class Read(NamedTuple):
    """A complete row, and the samples to write, or None if the row refers to the file."""

    row: dict[str, Any]
    samples: FloatArray | None
    converted: bool
    """Whether the samples are not those of the file: resampled, one of several channels, or from SOFA."""


class Unusable(NamedTuple):
    """Why a channel or measurement of a file cannot be used; others may be good."""

    reason: str


def rows_of(recording: Recording, table: str, out: Path) -> Iterator[Read | Unusable]:
    """Yield what a file holds, channel by channel or measurement by measurement."""
    if is_sofa(recording.path) and table == "rirs":
        for row, samples, fs_hz in sofa_signals(recording):
            try:
                samples = _at_16k(_usable(samples, f"{recording.path} ({row['id']})"), fs_hz, recording.path)
            except ValueError as error:
                yield Unusable(str(error))
                continue
            yield Read(row | dict(fs_hz=FS_HZ, n_samples=len(samples),
                                  suspicious=find_implausibility(samples, FS_HZ)), samples, True)
        return
    info = audio_info(recording.path)
    relative_path = path_from(recording.path, out)
    converted = info.channels > 1 or info.samplerate != FS_HZ
    as_it_is = not converted and _SAFE_PATH.fullmatch(relative_path)
    if table == "noises":
        # noises are long, and channels of an array are alike: the first is taken
        noise = read_audio(recording.path, channel=0)
        require_plausible(noise, recording.path)
        if not sounds(noise):
            raise ValueError(f"{recording.path}: noise is silent (all samples the same): leave it out or record it "
                             "again")
        yield Read(recording.row | dict(id=recording.id, wav=relative_path, fs_hz=FS_HZ,
                                        duration_s=len(noise) / FS_HZ), None if as_it_is else noise, converted)
        return
    for channel in range(info.channels):
        name = f"{recording.path} (channel {channel})" if info.channels > 1 else recording.path
        try:
            samples = read_audio(recording.path, fs_hz=info.samplerate, channel=channel)
            samples = _at_16k(_usable(samples, name), info.samplerate, recording.path)
        except ValueError as error:
            yield Unusable(str(error))
            continue
        row = dict(recording.row, id=recording.id, wav=relative_path, fs_hz=FS_HZ, n_samples=len(samples),
                   suspicious=find_implausibility(samples, FS_HZ))
        if info.channels > 1:
            mic_id = "" if row["mic_id"] == UNKNOWN else f"{row['mic_id']}-"
            row.update(id=f"{recording.id}_ch{channel}", mic_id=f"{mic_id}ch{channel}")
        yield Read(row, None if as_it_is else samples, converted)


def _usable(samples: FloatArray, name: Path | str) -> FloatArray:
    require_plausible(samples, name)
    if not samples.any():
        raise ValueError(f"{name}: RIR is silent (all samples 0): leave it out or record it again")
    return samples


def _at_16k(samples: FloatArray, fs_hz: int, path: Path) -> FloatArray:
    if fs_hz < FS_HZ:
        raise ValueError(f"{path}: sample rate {fs_hz} Hz must be at least {FS_HZ} Hz: the missing band cannot be "
                         "restored: record or convert it at that rate")
    if fs_hz == FS_HZ:
        return samples
    import soxr

    if length_before_last_bit(samples, fs_hz) < len(samples):  # which cannot be told from noise afterwards
        samples = samples[:length_before_silence(samples, fs_hz)]
    resampled: FloatArray = soxr.resample(samples, fs_hz, FS_HZ, quality="VHQ")
    return resampled
