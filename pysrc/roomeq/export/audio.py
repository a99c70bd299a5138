"""Make the audio files of an export: copied, linked, cut out, or aligned."""

import io
import math
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np
import soundfile

from roomeq.augment.mix import direct_shift
from roomeq.core.arrays import Array
from roomeq.core.audio import audio_info, read_audio, require_full_scale, write_wav
from roomeq.core.files import write_bytes
from roomeq.export.align import align
from roomeq.export.plan import PlannedAudio
from roomeq.kaldi.wavscp import AudioLength, decode_entry, segment_samples
from roomeq.records.rir_dir import load_rir
from roomeq.records.schema import RirRow

_SUFFIXES = {"WAVEX": ".wav"}


class AudioRules(NamedTuple):
    """How the audio of a format is made.

    Attributes
    ----------
    align_rirs : bool
        RIRs begin shortly before their direct sound.
    positive_rirs : bool
        Their largest sample is that of the direct sound, as far as the polarity decides.
    with_direct : bool
        The direct sound of RIRs is stated.
    link : bool
        Files that stay as they are will be links, which `roomeq.export.write` makes.
    pipes : bool
        Commands of `wav.scp` may run.
    """

    align_rirs: bool
    positive_rirs: bool
    with_direct: bool
    link: bool
    pipes: bool


class MadeAudio(NamedTuple):
    """An audio file of the export.

    Attributes
    ----------
    planned : PlannedAudio
    file : str
        Path relative to the directory.
    rate_hz, n_samples, n_channels : int
    link_to : str, optional
        File that a link will lead to.
    direct_sample : int, optional
        Position of the direct sound of an RIR that was not aligned [samples].
    late_s : float, optional
        See `roomeq.export.align.AlignedRir`.
    """

    planned: PlannedAudio
    file: str
    rate_hz: int
    n_samples: int
    n_channels: int = 1
    link_to: str | None = None
    direct_sample: int | None = None
    late_s: float | None = None

    @property
    def duration_s(self) -> float:
        """Duration [s]."""
        return seconds(self.n_samples, self.rate_hz)


def seconds(n_samples: int, rate_hz: int) -> float:
    """Return the time of a number of samples [s], of which ``int(time * rate_hz)`` is that number again.

    NeMo and ESPnet compute samples so. The nearest time may lie just below it and lose the last sample: 16,005 samples
    at 16 kHz would become 16,004.
    """
    time_s = n_samples / rate_hz
    while int(time_s * rate_hz) < n_samples:
        time_s = math.nextafter(time_s, math.inf)
    return time_s


def make_audio(planned: PlannedAudio, work: Path, rules: AudioRules) -> MadeAudio:
    """Write one audio file below `work`, unless it will be a link.

    Raises
    ------
    ValueError
        The audio cannot be read, has several channels where one is expected, or an RIR has no direct sound.
    """
    try:
        return _make(planned, work, rules)
    except ValueError as error:
        if planned.row is None:  # the message names the file, and not who refers to it
            raise ValueError(f"{planned.directory}: {planned.id}: {error}") from None
        raise


def _make(planned: PlannedAudio, work: Path, rules: AudioRules) -> MadeAudio:
    if planned.entry.kind != "file":
        return _decoded(planned, work, rules.pipes)
    source = Path(planned.entry.text)
    info = audio_info(source)
    if not planned.is_rir and info.channels != 1:
        raise ValueError(f"{source}: {info.channels} channels where one is expected: split the file")
    if planned.is_rir and rules.align_rirs:
        return _aligned(planned, work, rules.positive_rirs)
    if planned.start_s or planned.end_s is not None:
        return _cut_out(planned, work, AudioLength(info.frames, info.samplerate), info.subtype)
    suffix = _SUFFIXES.get(info.format, f".{info.format.lower()}")  # the name may end in anything
    made = MadeAudio(planned, planned.file + suffix, info.samplerate, info.frames, info.channels)
    if planned.is_rir and rules.with_direct:
        made = made._replace(direct_sample=_read_rir(planned).direct)
    else:  # that a FLAC file was cut off shows only at its end
        read_audio(source, fs_hz=info.samplerate, start=info.frames - 1, channel=0)
    if rules.link:
        return made._replace(link_to=str(source.absolute()))
    write_bytes(work / made.file, source.read_bytes())
    return made


class _Rir(NamedTuple):
    """An RIR, the position of its direct sound [samples] and its sample rate [Hz]."""

    samples: Array
    direct: int
    rate_hz: int


def _read_rir(planned: PlannedAudio) -> _Rir:
    row = cast(RirRow, planned.row)
    rir = load_rir(planned.directory, row, row["fs_hz"])
    return _Rir(rir, direct_shift(row, rir), row["fs_hz"])


def _aligned(planned: PlannedAudio, work: Path, positive: bool) -> MadeAudio:
    rir = _read_rir(planned)
    aligned = align(*rir, positive=positive)
    file = f"{planned.file}.wav"
    write_wav(work / file, aligned.samples, rir.rate_hz)
    return MadeAudio(planned, file, rir.rate_hz, len(aligned.samples), late_s=aligned.late_s)


def _cut_out(planned: PlannedAudio, work: Path, length: AudioLength, subtype: str) -> MadeAudio:
    """Write a segment of a recording, with 16 bits if the recording has 16, else with 24."""
    start, stop = segment_samples(planned.entry.text, length, planned.start_s, planned.end_s)
    samples = read_audio(Path(planned.entry.text), fs_hz=length.rate_hz, start=start, stop=stop)
    return _write_flac(planned, work, samples, length.rate_hz, 16 if subtype == "PCM_16" else 24)


def _decoded(planned: PlannedAudio, work: Path, pipes: bool) -> MadeAudio:
    """Write the audio of an archive or a command, with 16 bits if they are enough, else with 24."""
    rate_hz, samples = decode_entry(planned.entry, planned.start_s, planned.end_s, pipes=pipes)
    exact = np.array_equal(np.rint(samples * 2.0 ** 15), samples * 2.0 ** 15)
    return _write_flac(planned, work, samples, rate_hz, 16 if exact else 24)


def _write_flac(planned: PlannedAudio, work: Path, samples: Array, rate_hz: int, bits: int) -> MadeAudio:
    """Write samples that are multiples of ``2 ** (1 - bits)`` as they are; libsndfile would scale them."""
    require_full_scale(samples, planned.entry.text)
    pcm = np.rint(samples * 2.0 ** (bits - 1)).clip(-2.0 ** (bits - 1), 2.0 ** (bits - 1) - 1).astype(np.int32)
    buffer, file = io.BytesIO(), f"{planned.file}.flac"
    soundfile.write(buffer, pcm << 32 - bits, rate_hz, format="FLAC", subtype=f"PCM_{bits}")
    write_bytes(work / file, buffer.getbuffer())
    return MadeAudio(planned, file, rate_hz, len(samples))
