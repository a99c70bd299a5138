"""Reading and writing audio files, with checks for truncated, empty, silent and hostile ones.

Conventions: mono, float in [-1, 1), `FS_HZ` unless a caller says otherwise.
"""

import io
import logging
from pathlib import Path

import numpy as np
import soundfile

from roomeq.core.arrays import Array
from roomeq.core.constants import FS_HZ
from roomeq.core.files import write_bytes
from roomeq.core.limits import AUDIO_HOURS, max_audio_samples

logger = logging.getLogger(__name__)

MAX_RATE_HZ = 768000
"""Highest sample rate that a header may state [Hz]."""
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
    _check_riff_length(path)
    try:
        file = soundfile.SoundFile(str(path))
    except (soundfile.LibsndfileError, RuntimeError, TypeError) as error:  # TypeError: a name that ends in .raw
        raise ValueError(f"{path}: cannot be read as audio ({error}): convert it to WAV or FLAC") from None
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
            file.seek(start)
            samples = file.read(stop - start, dtype=dtype, always_2d=True)
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
    _write(Path(path), samples, fs_hz, "WAV", "FLOAT")


def write_flac(path: Path, samples: Array, fs_hz: int = FS_HZ, subtype: str = "PCM_16") -> None:
    """Write speech or noise as a FLAC file, atomically.

    Parameters
    ----------
    samples : ndarray, shape (n_samples,)
        In [-1, 1]; larger values would clip and are refused.

    Raises
    ------
    ValueError
        A sample is not finite or is out of range.
    """
    require_full_scale(samples, path)
    _write(Path(path), samples, fs_hz, "FLAC", subtype)


def require_full_scale(samples: Array, name: Path | str) -> None:
    """Raise a `ValueError` if a sample would clip in a FLAC file; the name begins the message."""
    peak = np.abs(samples).max(initial=0.0)
    if not peak <= 1.0:
        raise ValueError(f"{name}: peak {peak:.3g} must be at most 1 in a FLAC file: scale the signal down")


def _write(path: Path, samples: Array, fs_hz: int, fmt: str, subtype: str) -> None:
    data: bytes | memoryview
    if fmt == "WAV":  # not by libsndfile, whose PEAK chunk holds the time of writing: equal samples, other bytes
        data = _float_wav(np.asarray(samples, dtype="<f4"), fs_hz)
    else:  # in memory first: on a full disk libsndfile leaves a shorter FLAC file without an error
        buffer = io.BytesIO()
        soundfile.write(buffer, samples, fs_hz, format=fmt, subtype=subtype)
        data = buffer.getbuffer()
    write_bytes(path, data)


def _float_wav(samples: Array, fs_hz: int) -> bytes:
    """Return an IEEE-float WAV file."""
    from scipy.io import wavfile

    buffer = io.BytesIO()
    wavfile.write(buffer, fs_hz, samples)
    return buffer.getvalue()


def _check_riff_length(path: Path) -> None:
    with open(path, "rb") as stream:
        require_whole_riff(stream.read(8), path.stat().st_size, path)


def require_whole_riff(head: bytes, n_bytes: int, name: Path | str) -> None:
    """Refuse a WAV file that is shorter than its header says; libsndfile would read the part that is left.

    Parameters
    ----------
    head : bytes
        The first eight; of any other format, nothing is checked.
    n_bytes : int
        Length of the file.
    name : Path or str
        With which the message begins.

    Raises
    ------
    ValueError
        Bytes are missing.
    """
    stated = stated_riff_length(head)
    if stated is not None and n_bytes < stated - 1:  # the last chunk may lack its padding byte
        raise ValueError(f"{name}: truncated: {n_bytes} bytes of {stated}: copy it again")


def stated_riff_length(head: bytes) -> int | None:
    """Return the length of a WAV file that its first eight bytes state; None if they state none, or of other formats.

    A program that cannot seek back states a length that no file has: sox 0x7ffff024, others 0 or the largest number.
    """
    if head[:4] != b"RIFF" or len(head) < 8:
        return None
    stated = int.from_bytes(head[4:8], "little")
    return None if stated == 0 or 0x7FFFF000 <= stated <= 0x7FFFFFFF or stated > 0xFFFFFFE8 else stated + 8
