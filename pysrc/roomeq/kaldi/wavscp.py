"""Parse an entry of a Kaldi `wav.scp`, and read its audio.

Kaldi passes every entry that ends in ``|`` to a shell. Here the usual ``flac -c -d -s FILE |`` is recognised and the
file is read directly; any other command runs only if the user allows it. Nothing is ever unpickled.
"""

import io
import re
import shlex
import subprocess
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import soundfile

from roomeq.core.arrays import Array
from roomeq.core.audio import HEAD_BYTES, audio_info, read_audio, require_plausible, require_whole, stated_length
from roomeq.core.constants import FS_HZ
from roomeq.core.digests import names_in_entry
from roomeq.core.kept_hashes import Look, quick_look
from roomeq.core.limits import AUDIO_HOURS, max_audio_samples

MAX_OVERSHOOT_S = 0.01
"""A segment may end this much after its recording, since times are rounded to 10 ms; it is cut there. Kaldi allows
0.5 s, in which a recording that lost its end goes unnoticed."""

_AUDIO_TAGS = (b"RIFF", b"fLaC", b"AUDIO")
_FLAC_FLAG = re.compile(r"-[cds]+|--stdout|--decode|--silent|--totally-silent")
# a part of a shell word that the shell takes literally: no expansion, no operator, no glob
_LITERAL_TEXT = r"""'([^']*)'|"([^"$`\\!]*)"|\\([^\n])|([^\s'"\\$`|&;<>()*?\[\]#~{}!]+)"""
_WORD, _LITERAL = re.compile(f"(?:{_LITERAL_TEXT})+"), re.compile(_LITERAL_TEXT)
_BLANKS = " \t"


class AudioLength(NamedTuple):
    """Number of samples, and sample rate [Hz]."""

    frames: int
    rate_hz: int


@dataclass(frozen=True, slots=True)
class Entry:
    """Source of the audio of one recording.

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
    """Parse the entry after the id in a line of `wav.scp`.

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
        raise ValueError(f"{text!r} selects a range, which is not supported for audio: use a segments file")
    archive = re.fullmatch(r"(.+):([0-9]+)", text)
    if archive and len(archive[2]) > 18:
        raise ValueError(f"offset {archive[2][:20]}... of {archive[1]!r} must be a byte position in the file: "
                         "correct the line")
    return Entry("ark", archive[1], int(archive[2])) if archive else Entry("file", text)


def flac_entry(path: Path | str) -> str:
    """Return the `wav.scp` entry that decodes a FLAC file, quoted for the shell that Kaldi passes it to.

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


def entry_for_kaldi(entry: Entry) -> str:
    """Return the entry with which Kaldi's stock scripts read a WAV or FLAC file from any folder.

    Raises
    ------
    ValueError
        It is another file, an archive or a command.
    """
    path = Path(entry.text).absolute()
    if entry.kind != "file" or path.suffix.lower() not in (".flac", ".wav"):
        raise ValueError(f"{entry.text!r} must be a FLAC or WAV file: convert the audio")
    if path.suffix.lower() == ".flac":
        return flac_entry(path)
    # stock scripts paste names of files into commands, but take commands as they are
    quoted = shlex.quote(str(path))
    return str(path) if quoted == str(path) else f"cat {quoted} |"


def _flac_file(command: str) -> str | None:
    """Return the file that a plain `flac` decoding command reads, or None for any other command."""
    words, position = [], 0
    while position < len(command):
        word = _WORD.match(command, position)
        if not word:
            return None
        words.append("".join("".join(literal) for literal in _LITERAL.findall(word[0])))
        position = word.end()
        while position < len(command) and command[position] in _BLANKS:
            position += 1
        if position == word.end() < len(command):
            return None
    if len(words) < 3 or words[0].rsplit("/", 1)[-1] != "flac":
        return None
    flags = {word for word in words[1:] if _FLAC_FLAG.fullmatch(word)}
    files = [word for word in words[1:] if word not in flags and word != "--"]
    letters = {"--stdout", "--decode"} & flags | set("".join(flag for flag in flags if flag[1] != "-"))
    decodes = letters & {"d", "--decode"} and letters & {"c", "--stdout"}
    if len(files) != 1 or files[0].startswith("-") or not decodes:
        return None
    return files[0]


def read_length(entry: Entry, *, pipes: bool = False) -> AudioLength:
    """Return the length of a recording. For a file, only the header is read.

    Raises
    ------
    ValueError
        The audio cannot be read, or is a pipe and `pipes` is false.
    """
    if entry.kind == "file":
        info = _file_info(entry.text, _looks(entry))
        return AudioLength(info.frames, info.samplerate)
    decoded = _decode(entry, pipes, _looks(entry))
    return AudioLength(len(decoded.samples), decoded.rate_hz)


def read_entry(entry: Entry, start_s: float = 0.0, end_s: float | None = None, *, pipes: bool = False) -> Array:
    """Read a recording or a segment of it at `FS_HZ`.

    Times are converted to sample indices as in Kaldi's `extract-segments`: ``int(t * rate + 0.5)``.

    Parameters
    ----------
    start_s, end_s
        Start and end of the segment [s]; None is the end of the recording.
    pipes
        Allow commands to run.

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
    if entry.kind == "file":
        start, stop = segment_samples(entry.text, read_length(entry), start_s, end_s)
        return read_audio(Path(entry.text), start=start, stop=stop, dtype="float32")
    rate_hz, samples = decode_entry(entry, start_s, end_s, pipes=pipes)
    if rate_hz == FS_HZ:
        return samples
    if rate_hz < FS_HZ:
        raise ValueError(f"{entry.text}: sample rate {rate_hz} Hz must be at least {FS_HZ} Hz: "
                         "the missing band cannot be restored: use other recordings")
    import soxr

    return soxr.resample(samples, rate_hz, FS_HZ, quality="VHQ")


class Decoded(NamedTuple):
    """Sample rate [Hz], and samples, float32, shape (n_samples,)."""

    rate_hz: int
    samples: Array


def decode_entry(entry: Entry, start_s: float = 0.0, end_s: float | None = None, *, pipes: bool = False) -> Decoded:
    """Read a recording of an archive or command, or a segment of it, at its own rate; see `read_entry`."""
    rate_hz, samples = _decode(entry, pipes, _looks(entry))
    start, stop = segment_samples(entry.text, AudioLength(len(samples), rate_hz), start_s, end_s)
    return Decoded(rate_hz, samples[start:stop])


def segment_samples(name: str, length: AudioLength, start_s: float, end_s: float | None) -> tuple[int, int]:
    """Return the start and stop sample index of a segment; the stop index is exclusive.

    Parameters
    ----------
    name
        Name of the recording, for the error message.

    Raises
    ------
    ValueError
        The segment ends more than `MAX_OVERSHOOT_S` after the end of the recording, starts at or after that end, or is
        so short that it holds no sample.
    """
    frames, rate = length
    start = int(start_s * rate + 0.5)
    stop = frames if end_s is None else int(end_s * rate + 0.5)
    if start >= frames or stop > frames + MAX_OVERSHOOT_S * rate:
        end_text = "its end" if end_s is None else f"{end_s:g} s"
        raise ValueError(f"{name}: segment from {start_s:g} s to {end_text} must lie within the recording's "
                         f"{frames / rate:g} s: correct the segments file, or copy the audio again if it is truncated")
    if start >= stop:
        raise ValueError(f"{name}: segment from {start_s:.10g} s to {end_s:.10g} s holds no sample at {rate} Hz: "
                         "remove the utterance")
    return start, min(stop, frames)


def _looks(entry: Entry) -> tuple[Look | None, ...]:
    """Return how the files look that an entry reads; of a command, those that are words of it."""
    names = sorted(names_in_entry(entry.text)) if entry.kind == "pipe" else [entry.text]
    return tuple(quick_look(Path(name)) for name in names)


@lru_cache(maxsize=256)
def _file_info(path: str, _: tuple[Look | None, ...]) -> Any:
    return audio_info(Path(path))


@lru_cache(maxsize=1)
def _decode(entry: Entry, pipes: bool, _: tuple[Look | None, ...]) -> Decoded:
    """Decode a whole archive entry or pipe. The last result is cached for the other segments of the recording.

    What is cached depends on how the files look that are read, so that a process notices when they change.
    """
    rate_hz, samples = _read_ark(entry) if entry.kind == "ark" else _run_pipe(entry.text, pipes)
    if samples.ndim == 2 and samples.shape[1] == 1:
        samples = samples[:, 0]
    if samples.ndim != 1:
        raise ValueError(f"{entry.text}: {samples.shape[1]} channels where one is expected: split the file")
    if not len(samples):
        raise ValueError(f"{entry.text}: holds 0 samples: make it again")
    if len(samples) > max_audio_samples():
        raise ValueError(f"{entry.text}: must hold at most {max_audio_samples()} samples ({AUDIO_HOURS.value():g} h at "
                         f"{FS_HZ} Hz): split it, or raise the bound with roomeq --{AUDIO_HOURS.option}")
    require_plausible(samples, entry.text)
    samples.flags.writeable = False
    return Decoded(rate_hz, samples)


def _read_ark(entry: Entry) -> Decoded:
    from kaldiio.matio import read_kaldi

    position = f"{entry.text}:{entry.offset}"
    if not Path(entry.text).is_file():
        raise ValueError(f"{entry.text}: no such archive: check the path")
    if entry.offset >= Path(entry.text).stat().st_size:
        raise ValueError(f"{position}: the offset must lie within the archive's {Path(entry.text).stat().st_size} "
                         "bytes: correct the line")
    with open(entry.text, "rb") as stream:
        stream.seek(entry.offset)
        head = stream.read(8)
        tag = head[:5]
        if not tag.startswith(_AUDIO_TAGS):
            raise ValueError(f"{position}: {tag!r} must be the start of WAV, FLAC or kaldiio AUDIO: matrices, "
                             "arrays and pickles are not supported: write the archive again with wav-copy or kaldiio")
        n_bytes = Path(entry.text).stat().st_size - entry.offset
        if tag.startswith(b"RIFF"):
            require_whole(head, n_bytes, position)  # of one that is cut off, the part that is left would be read
            stated = stated_length(head)
            if stated is None:
                raise ValueError(f"{position}: a WAV file in an archive must state its length: write the archive again "
                                 "with wav-copy or kaldiio")
            n_bytes = min(n_bytes, stated)
        try:
            if tag.startswith(b"AUDIO"):
                stream.seek(entry.offset)
                rate, samples = read_kaldi(stream, load_kwargs=dict(frames=_decoding_limit(), dtype="float32"))
            else:
                samples, rate = soundfile.read(_Part(stream, entry.offset, n_bytes), frames=_decoding_limit(),
                                               dtype="float32")
        except Exception as error:  # broken bytes can raise any exception in kaldiio
            raise ValueError(f"{position}: broken audio ({error or type(error).__name__}): "
                             "make the archive again") from None
    return Decoded(int(rate), _to_float(samples))


class _Part(io.RawIOBase):
    """A part of an open file as a file of its own, of which no more is read than is used."""

    def __init__(self, stream: BinaryIO, start: int, n_bytes: int) -> None:
        super().__init__()
        self._stream, self._start, self._n_bytes, self._position = stream, start, n_bytes, 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._position

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        self._position = offset + {io.SEEK_SET: 0, io.SEEK_CUR: self._position, io.SEEK_END: self._n_bytes}[whence]
        return self._position

    def readinto(self, buffer: Any) -> int:
        self._stream.seek(self._start + self._position)
        data = self._stream.read(max(0, min(len(buffer), self._n_bytes - self._position)))
        buffer[:len(data)] = data
        self._position += len(data)
        return len(data)


def _decoding_limit() -> int:
    """Return the number of samples after which decoding stops, one more than allowed.

    A few bytes of FLAC can decode to hours of silence.
    """
    return max_audio_samples() + 1


def _to_float(samples: Array) -> Array:
    """Return samples of any PCM type as float32 in [-1, 1)."""
    if samples.dtype == np.uint8:
        return (samples.astype(np.float32) - 128) / 128
    scale = -float(np.iinfo(samples.dtype).min) if samples.dtype.kind == "i" else 1.0
    return (samples / scale).astype(np.float32)

_BROKEN_PIPE = 128 + 13  # status of a command whose reader has what it needs


def _run_pipe(command: str, pipes: bool) -> Decoded:
    if not pipes:
        raise ValueError(f"{command!r} is a command, and commands run only with --pipes: allow it, or convert the "
                         "audio to files")
    # run the command in a shell, as Kaldi does and as the help of --pipes says
    result = subprocess.run(["bash", "-o", "pipefail", "-c", command], stdin=subprocess.DEVNULL, capture_output=True)
    if result.returncode not in (0, _BROKEN_PIPE):
        last_line = (result.stderr.decode(errors="replace").strip().splitlines() or ["no message"])[-1]
        raise ValueError(f"{command!r}: command failed with status {result.returncode} ({last_line[:200]}): "
                         "run it by hand")
    require_whole(result.stdout[:HEAD_BYTES], len(result.stdout), repr(command))
    try:
        samples, rate = soundfile.read(io.BytesIO(result.stdout), dtype="float32", frames=_decoding_limit())
    except (soundfile.LibsndfileError, RuntimeError, TypeError) as error:
        raise ValueError(f"{command!r}: its {len(result.stdout)} bytes of output cannot be read as audio "
                         f"({str(error).rsplit(': ', 1)[-1]}): make it write WAV") from None
    return Decoded(rate, samples)
