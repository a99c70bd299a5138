"""Reading and writing audio files, with checks for truncated, empty, silent and hostile ones.

Conventions: mono, float in [-1, 1), `FS_HZ` unless a caller says otherwise.
"""

import io
import logging
from pathlib import Path
from typing import BinaryIO

import numpy as np
import soundfile

from roomeq.core.arrays import Array
from roomeq.core.constants import FS_HZ
from roomeq.core.files import write_bytes
from roomeq.core.limits import AUDIO_HOURS, max_audio_samples

logger = logging.getLogger(__name__)

HEAD_BYTES = 28
"""Of a file, in which every format that is known states its length."""
MAX_RATE_HZ = 768000
"""Highest sample rate that a header may state [Hz]."""
_UNKNOWN_FRAMES = 2 ** 62
LARGEST_SAMPLE = 1e10
"""Largest sample, full scale being 1: above that of 32-bit integers, and its square is a number in single precision."""


def audio_info(path: Path) -> soundfile.SoundFile:
    """Return a closed audio file, whose attributes `samplerate`, `frames` and `channels` tell its header.

    Raises
    ------
    ValueError
        The file is missing, empty, truncated, too long (`roomeq.core.limits`) or not audio.
    """
    with _opened(path) as file:
        return file


def _opened(path: Path) -> soundfile.SoundFile:
    """Open an audio file and check that its header is plausible."""
    path = Path(path)
    if not path.is_file():
        raise ValueError(f"{path}: no such audio file: check the path")
    if path.stat().st_size == 0:
        raise ValueError(f"{path}: audio file is empty (0 bytes): copy or record it again")
    _require_whole_file(path)
    try:
        file = soundfile.SoundFile(str(path))
    except (soundfile.LibsndfileError, RuntimeError, TypeError) as error:  # TypeError: a name that ends in .raw
        raise ValueError(f"{path}: cannot be read as audio ({error}): convert it to WAV or FLAC") from None
    if file.frames > _UNKNOWN_FRAMES:
        raise ValueError(f"{path}: its header does not state its length, as after encoding to a pipe: encode it again")
    if file.frames == 0:
        raise ValueError(f"{path}: holds 0 samples: copy or record it again")
    if file.samplerate > MAX_RATE_HZ:
        raise ValueError(f"{path}: sample rate {file.samplerate} Hz must be at most {MAX_RATE_HZ} Hz: "
                         "correct the header")
    if file.frames * file.channels > max_audio_samples():
        raise ValueError(f"{path}: {file.frames} samples in {file.channels} channels must be at most "
                         f"{max_audio_samples()} ({AUDIO_HOURS.value():g} h at {FS_HZ} Hz): split the file, or raise "
                         f"the bound with roomeq --{AUDIO_HOURS.option}")
    return file


def read_audio(path: Path, *, fs_hz: int = FS_HZ, start: int = 0, stop: int | None = None,
               channel: int | None = None, resample: bool = True, dtype: str = "float64") -> Array:
    """Read one channel of an audio file at a given sample rate.

    Parameters
    ----------
    path : Path
        WAV, FLAC or whatever else libsndfile reads.
    fs_hz : int
        Sample rate of the result [Hz]. A file with a higher rate is resampled with soxr, which the log mentions.
    start, stop : int
        Range of samples at the file's own rate.
    channel : int, optional
        Channel, counted from 0; by default the file must be mono.
    resample : bool
        If false, a file with another sample rate is refused.
    dtype : str
        ``"float64"`` or ``"float32"``.

    Returns
    -------
    samples : ndarray, shape (n_samples,)

    Raises
    ------
    ValueError
        The file is missing, empty, truncated or not mono, its rate is too low (or another one, if `resample` is
        false), or its samples are not plausible (`require_plausible`).
    """
    with _opened(path) as file:
        if channel is None and file.channels != 1:
            raise ValueError(f"{path}: {file.channels} channels where one is expected: choose one, or split the file")
        if channel is not None and not 0 <= channel < file.channels:
            raise ValueError(f"{path}: channel {channel} of {file.channels}: count from 0")
        if file.samplerate < fs_hz:
            rule = f"at least {fs_hz} Hz" if resample else f"{fs_hz} Hz"
            raise ValueError(f"{path}: sample rate {file.samplerate} Hz must be {rule}: the missing band cannot be "
                             "restored: record or convert it at that rate")
        if file.samplerate != fs_hz and not resample:
            raise ValueError(f"{path}: sample rate {file.samplerate} Hz must be {fs_hz} Hz: convert it")
        stop = file.frames if stop is None else stop
        if not 0 <= start < stop <= file.frames:
            raise ValueError(f"{path}: samples {start} to {stop} must lie within its {file.frames}: correct the "
                             "segment")
        try:
            # in one read: soundfile seeks after each
            skipped = 0 if _seeks_exactly(file) else min(start, file.samplerate if file.seekable() else start)
            if start > skipped:
                file.seek(start - skipped)
            samples = file.read(stop - start + skipped, dtype=dtype, always_2d=True)[skipped:]
        except (soundfile.LibsndfileError, RuntimeError) as error:
            raise ValueError(f"{path}: broken audio ({error}): copy or record it again") from None
    if len(samples) != stop - start:
        raise ValueError(f"{path}: truncated: {len(samples)} samples of {stop - start}: copy it again")
    samples = np.ascontiguousarray(samples[:, channel or 0])
    require_plausible(samples, path)
    if file.samplerate != fs_hz:
        import soxr

        logger.info("%s: resampled from %d to %d Hz", path, file.samplerate, fs_hz)
        samples = soxr.resample(samples, file.samplerate, fs_hz, quality="VHQ")
    return samples


def _seeks_exactly(file: soundfile.SoundFile) -> bool:
    """Tell whether the samples after a seek are those of the file.

    A frame of MP3 may need data of those before it, which libsndfile does not read when it seeks: silence or wrong
    samples follow. In Ogg Vorbis, other samples follow. After a second, they are right again, in MP3 but for rounding.
    Some telephone codecs cannot seek at all.
    """
    return file.seekable() and not file.subtype.startswith(("MPEG", "VORBIS"))


def sounds(x: Array) -> bool:
    """Tell whether samples differ; a constant is no sound."""
    return bool(np.any(x != x[0]))


def require_plausible(samples: Array, name: Path | str) -> None:
    """Raise a `ValueError` if a sample is NaN, infinite or beyond `LARGEST_SAMPLE`; the name begins the message."""
    if not np.isfinite(samples).all():
        raise ValueError(f"{name}: holds NaN or infinite samples: convert it again")
    peak = np.abs(samples).max(initial=0.0)
    if peak > LARGEST_SAMPLE:
        raise ValueError(f"{name}: peak {peak:.3g} must be at most {LARGEST_SAMPLE:g}: convert it again, full scale "
                         "being 1")


def write_wav(path: Path, samples: Array, fs_hz: int = FS_HZ) -> None:
    """Write an RIR as a 32-bit float WAV file, atomically: levels are exact and nothing clips.

    The samples of several channels have the shape (n_samples, n_channels).
    """
    # not by libsndfile, whose PEAK chunk holds the time of writing: equal samples, other bytes
    write_bytes(Path(path), _float_wav(np.asarray(samples, dtype="<f4"), fs_hz))


def write_flac(path: Path, samples: Array) -> None:
    """Write speech or noise at `FS_HZ` as a FLAC file of 16 bits, atomically; samples lie in [-1, 1].

    Raises
    ------
    ValueError
        A sample is not finite or is out of range.
    """
    require_full_scale(samples, path)
    buffer = io.BytesIO()  # in memory first: on a full disk libsndfile leaves a shorter FLAC file without an error
    soundfile.write(buffer, samples, FS_HZ, format="FLAC", subtype="PCM_16")
    write_bytes(Path(path), buffer.getbuffer())


def require_full_scale(samples: Array, name: Path | str) -> None:
    """Raise a `ValueError` if a sample would clip in a FLAC file; the name begins the message."""
    peak = np.abs(samples).max(initial=0.0)
    if not peak <= 1.0:
        raise ValueError(f"{name}: peak {peak:.3g} must be at most 1 in a FLAC file: scale the signal down")


def _float_wav(samples: Array, fs_hz: int) -> bytes:
    """Return an IEEE-float WAV file."""
    from scipy.io import wavfile

    buffer = io.BytesIO()
    wavfile.write(buffer, fs_hz, samples)
    return buffer.getvalue()


def _require_whole_file(path: Path) -> None:
    n_bytes = path.stat().st_size
    with open(path, "rb") as stream:
        head = stream.read(HEAD_BYTES)
        if head[:4] == b"RIFF" and n_bytes == int.from_bytes(head[4:8], "little") and _has_all_data(stream, n_bytes):
            return  # some programs state the length of the file where that of the rest belongs
    require_whole(head, n_bytes, path)


def _has_all_data(stream: BinaryIO, n_bytes: int) -> bool:
    """Tell whether a WAV file of `n_bytes` holds the whole of its chunk of samples."""
    at = 12
    while at + 8 <= n_bytes:
        stream.seek(at)
        head = stream.read(8)
        at += 8 + int.from_bytes(head[4:], "little")
        if head[:4] == b"data":
            return at <= n_bytes
        at += at % 2
    return False


def require_whole(head: bytes, n_bytes: int, name: Path | str) -> None:
    """Refuse an audio file that is shorter than its header says; libsndfile would read the part that is left.

    Parameters
    ----------
    head : bytes
        The first `HEAD_BYTES`, or as many as there are; of formats that `stated_length` does not know, nothing is
        checked.
    n_bytes : int
        Length of the file.
    name : Path or str
        With which the message begins.

    Raises
    ------
    ValueError
        Bytes are missing.
    """
    stated = stated_length(head)
    if stated is not None and n_bytes < stated - 1:  # the last chunk may lack its padding byte
        raise ValueError(f"{name}: truncated: {n_bytes} bytes of {stated}: copy it again")


def stated_length(head: bytes) -> int | None:
    """Return the length that the first bytes of a WAV, RF64, W64, AIFF or AU file state; None if they state none.

    A program that cannot seek back states a length that no file has: sox 0x7ffff024, others 0 or the largest number.
    """
    kind = head[:4]
    if kind == b"RF64" and head[12:16] == b"ds64":
        stated, more = int.from_bytes(head[20:28], "little"), 8
    elif kind == b"riff":  # W64
        stated, more = int.from_bytes(head[16:24], "little"), 0
    elif kind == b".snd":
        stated, more = int.from_bytes(head[8:12], "big"), int.from_bytes(head[4:8], "big")
    elif kind in (b"RIFF", b"FORM"):
        stated, more = int.from_bytes(head[4:8], "little" if kind == b"RIFF" else "big"), 8
    else:
        return None
    unknown = stated == 0 or 0x7FFFF000 <= stated <= 0x7FFFFFFF or 0xFFFFFFE8 < stated <= 0xFFFFFFFF
    return None if unknown or stated >= _UNKNOWN_FRAMES else stated + more
