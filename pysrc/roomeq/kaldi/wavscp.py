"""One line of a Kaldi `wav.scp`: what it says, and the audio behind it.

Kaldi hands every entry that ends in ``|`` to a shell. Here the usual ``flac -c -d -s FILE |`` is recognised and
the file is read directly; any other pipe runs only if the user says so. Nothing is ever unpickled.
"""

import io
import re
import shlex
import subprocess
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import soundfile

from roomeq.core.audio import audio_info, read_audio
from roomeq.core.constants import FS_HZ
from roomeq.core.limits import AUDIO_HOURS, max_audio_samples

MAX_OVERSHOOT_S = 0.01
"""A segment may end this much after its recording (times rounded to 10 ms); it is cut there, as Kaldi does."""

_AUDIO_TAGS = (b"RIFF", b"fLaC", b"AUDIO")
_FLAC_FLAG = re.compile(r"-[cds]+|--stdout|--decode|--silent|--totally-silent")
# one shell word whose meaning is the text itself: no expansion, no operator, no glob
_PIECE = r"""'([^']*)'|"([^"$`\\!]*)"|\\([^\n])|([^\s'"\\$`|&;<>()*?\[\]#~{}!]+)"""
_WORD, _PIECE = re.compile(f"(?:{_PIECE})+"), re.compile(_PIECE)
_BLANK = re.compile(r"[ \t]*")


@dataclass(frozen=True, slots=True)
class Entry:
    """Where the audio of one recording comes from.

    Attributes
    ----------
    kind : str
        ``"file"``, ``"ark"`` or ``"pipe"``.
    text : str
        Path of the file or archive, or the command (without its ``|``).
    offset : int
        Byte at which the audio starts in an archive.
    """

    kind: str
    text: str
    offset: int = 0


def parse_entry(text: str) -> Entry:
    """Parse what stands after the id in a line of `wav.scp`.

    Raises
    ------
    ValueError
        The entry is empty, reads standard input, writes to a pipe, or selects a range.
    """
    text = text.strip()
    if text.endswith("|"):
        command = text[:-1].strip()
        path = _flac_file(command)
        return Entry("pipe", command) if path is None else Entry("file", path)
    if text in ("", "-") or text.startswith("|"):
        raise ValueError(f"{text!r} names no audio: give a file, FILE:OFFSET or a command that ends in '|'")
    if text.endswith("]") and re.search(r":\d+\[", text):
        raise ValueError(f"{text!r} selects a range, which audio does not have: use a segments file")
    found = re.fullmatch(r"(.+):([0-9]+)", text)
    if found and len(found[2]) > 18:
        raise ValueError(f"offset {found[2][:20]}... of {found[1]!r} must be that of a byte in it: correct the line")
    return Entry("ark", found[1], int(found[2])) if found else Entry("file", text)


def flac_entry(path: str) -> str:
    """Return the `wav.scp` entry that decodes a FLAC file, quoted for the shell that Kaldi gives it to.

    Raises
    ------
    ValueError
        The path holds a line break or is not UTF-8: no line of `wav.scp` can name it.
    """
    path = str(path)
    if "\n" in path or "\r" in path:
        raise ValueError(f"path {path!r} must not hold a line break: wav.scp cannot name it: choose another path")
    try:
        path.encode()
    except UnicodeEncodeError:
        raise ValueError(f"path {path!r} must be UTF-8: wav.scp cannot name it: choose another path") from None
    return f"flac -c -d -s {shlex.quote('./' + path if path.startswith('-') else path)} |"


def _flac_file(command: str) -> str | None:
    """Return the file that a plain `flac` decoding command reads, or None for any other command."""
    words, position = [], 0
    while position < len(command):
        found = _WORD.match(command, position)
        if not found:
            return None
        words.append("".join("".join(piece) for piece in _PIECE.findall(found[0])))
        position = found.end()
        blank = _BLANK.match(command, position).end()
        if blank == position < len(command):
            return None
        position = blank
    if len(words) < 3 or words[0].rsplit("/", 1)[-1] != "flac":
        return None
    flags = {word for word in words[1:] if _FLAC_FLAG.fullmatch(word)}
    files = [word for word in words[1:] if word not in flags and word != "--"]
    letters = {"--stdout", "--decode"} & flags | set("".join(flag for flag in flags if flag[1] != "-"))
    decodes = letters & {"d", "--decode"} and letters & {"c", "--stdout"}
    if len(files) != 1 or files[0].startswith("-") or not decodes:
        return None
    return files[0]


def n_samples(entry: Entry, *, pipes: bool = False) -> tuple[int, int]:
    """Return length [samples] and sample rate [Hz] of a recording; only a file's header is read.

    Raises
    ------
    ValueError
        The audio cannot be read, or is a pipe and `pipes` is false.
    """
    if entry.kind == "file":
        info = _file_info(entry.text)
        return info.frames, info.samplerate
    rate, samples = _decoded(entry, pipes)
    return len(samples), rate


def read_entry(entry: Entry, start_s: float = 0.0, end_s: float | None = None, *,
               pipes: bool = False) -> np.ndarray:
    """Read a recording or a segment of it at `FS_HZ`.

    Times become samples as in Kaldi's `extract-segments`: ``int(t * rate + 0.5)``.

    Parameters
    ----------
    entry : Entry
    start_s, end_s : float
        Segment [s]; an end of None is the end of the recording.
    pipes : bool
        Run commands.

    Returns
    -------
    samples : ndarray of float32, shape (n_samples,)

    Raises
    ------
    ValueError
        The audio cannot be read, the segment does not lie within it, or a command is not allowed or fails.
    """
    if entry.kind == "file" and start_s == 0.0 and end_s is None:
        return read_audio(Path(entry.text), dtype="float32")
    frames, rate = n_samples(entry, pipes=pipes)
    start, stop = segment_samples(entry.text, frames, rate, start_s, end_s)
    if entry.kind == "file":
        return read_audio(Path(entry.text), start=start, stop=stop, dtype="float32")
    samples = _decoded(entry, pipes)[1][start:stop]
    if rate == FS_HZ:
        return samples
    if rate < FS_HZ:
        raise ValueError(f"{entry.text}: sample rate {rate} Hz must be {FS_HZ} Hz: "
                         "the missing band cannot be restored: use other recordings")
    import soxr

    return soxr.resample(samples, rate, FS_HZ, quality="VHQ")


def segment_samples(name: str, frames: int, rate: int, start_s: float, end_s: float | None) -> tuple[int, int]:
    """Return the range of samples of a segment of a recording of `frames` samples.

    Raises
    ------
    ValueError
        The segment ends more than `MAX_OVERSHOOT_S` after the recording, or starts there.
    """
    start = int(start_s * rate + 0.5)
    stop = frames if end_s is None else int(end_s * rate + 0.5)
    if start >= frames or stop > frames + MAX_OVERSHOOT_S * rate:
        end_text = "its end" if end_s is None else f"{end_s:g} s"
        raise ValueError(f"{name}: segment from {start_s:g} s to {end_text} must lie within the recording's "
                         f"{frames / rate:g} s: correct segments, or the audio is cut off")
    return start, min(stop, frames)


@lru_cache(maxsize=256)
def _file_info(path: str):
    return audio_info(Path(path))


@lru_cache(maxsize=1)
def _decoded(entry: Entry, pipes: bool) -> tuple[int, np.ndarray]:
    """Decode a whole archive entry or pipe; the last one is kept, since segments come one after another."""
    rate, samples = _read_ark(entry) if entry.kind == "ark" else _run_pipe(entry.text, pipes)
    if samples.ndim == 2 and samples.shape[1] == 1:
        samples = samples[:, 0]
    if samples.ndim != 1:
        raise ValueError(f"{entry.text}: {samples.shape[1]} channels where one is expected: split the file")
    if not len(samples):
        raise ValueError(f"{entry.text}: holds 0 samples: make it again")
    if len(samples) > max_audio_samples():
        raise ValueError(f"{entry.text}: must hold at most {max_audio_samples()} samples ({AUDIO_HOURS.value():g} h at "
                         f"{FS_HZ} Hz): split it, or raise the bound with roomeq --{AUDIO_HOURS.option}")
    if not np.isfinite(samples).all():
        raise ValueError(f"{entry.text}: holds NaN or infinite samples: convert it again")
    samples.flags.writeable = False
    return rate, samples


def _read_ark(entry: Entry) -> tuple[int, np.ndarray]:
    from kaldiio.matio import read_kaldi

    where = f"{entry.text}:{entry.offset}"
    if not Path(entry.text).is_file():
        raise ValueError(f"{entry.text}: no such archive: check the path")
    with open(entry.text, "rb") as stream:
        stream.seek(entry.offset)
        tag = stream.read(5)
        if not tag.startswith(_AUDIO_TAGS):
            raise ValueError(f"{where}: {tag!r} must start WAV, FLAC or kaldiio AUDIO: matrices, arrays and "
                             "pickles are not read: write the archive again with wav-copy or kaldiio")
        stream.seek(entry.offset)
        try:
            if tag.startswith(b"fLaC"):
                samples, rate = soundfile.read(io.BytesIO(stream.read()), frames=_one_too_many(), dtype="float32")
            else:
                rate, samples = read_kaldi(stream, load_kwargs=dict(frames=_one_too_many(), dtype="float32"))
        except Exception as error:  # kaldiio lets anything through that broken bytes can raise
            raise ValueError(f"{where}: broken audio ({error or type(error).__name__}): "
                             "make the archive again") from None
    if tag.startswith(b"RIFF"):
        _check_ark_length(entry, samples)
    return int(rate), _to_float(samples)


def _one_too_many() -> int:
    """Return how many samples to decode at most: a few bytes of FLAC can hold hours of silence."""
    return max_audio_samples() + 1


def _check_ark_length(entry: Entry, samples: np.ndarray) -> None:
    """Refuse a WAV entry at the end of an archive that was cut off; `wave` would read what is left."""
    with open(entry.text, "rb") as stream:
        stream.seek(entry.offset + 4)
        promised = int.from_bytes(stream.read(4), "little") + 8
        left = stream.seek(0, io.SEEK_END) - entry.offset
    if promised < 0x7FFFFFFF and left < promised - 1:
        raise ValueError(f"{entry.text}:{entry.offset}: truncated: {left} bytes of {promised}: copy it again")


def _to_float(samples: np.ndarray) -> np.ndarray:
    """Return samples of any PCM type as float32 in [-1, 1)."""
    if samples.dtype == np.uint8:
        return (samples.astype(np.float32) - 128) / 128
    scale = -float(np.iinfo(samples.dtype).min) if samples.dtype.kind == "i" else 1.0
    return (samples / scale).astype(np.float32)


def _run_pipe(command: str, pipes: bool) -> tuple[int, np.ndarray]:
    if not pipes:
        raise ValueError(f"{command!r} is a command, and commands run only with --pipes: allow it, or convert the "
                         "audio to files")
    # what Kaldi does with it, and what --pipes says will be done: a shell runs the text
    result = subprocess.run(command, shell=True, stdin=subprocess.DEVNULL, capture_output=True)
    if result.returncode != 0:
        last = (result.stderr.decode(errors="replace").strip().splitlines() or ["no message"])[-1]
        raise ValueError(f"{command!r}: command failed with status {result.returncode} ({last[:200]}): "
                         "run it by hand")
    try:
        samples, rate = soundfile.read(io.BytesIO(result.stdout), dtype="float32", frames=_one_too_many())
    except (soundfile.LibsndfileError, RuntimeError, TypeError) as error:
        raise ValueError(f"{command!r}: its {len(result.stdout)} bytes of output cannot be read as audio "
                         f"({str(error).rsplit(': ', 1)[-1]}): let it write WAV") from None
    return rate, samples
