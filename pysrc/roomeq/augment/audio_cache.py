"""RIRs and noises for augmentation, kept in bounded memory."""

from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple

import numpy as np

from roomeq.augment.draw import Noise, NoiseDraw, Pool, excerpt_start
from roomeq.augment.mix import convolve, direct_shift, loop, ring_length, spectra_of, without_rumble
from roomeq.core.arrays import Array
from roomeq.core.audio import read_audio, sounds
from roomeq.core.constants import FS_HZ
from roomeq.records.rir_dir import load_rir

CACHE_BYTES = 128 << 20


class ShiftedRir(NamedTuple):
    """An RIR (float32), and the delay of its direct sound in samples."""

    samples: Array
    shift: int


class Excerpt(NamedTuple):
    """Samples of a noise (float32), and where in the noise they start."""

    samples: Array
    start: int


class WholeNoise(NamedTuple):
    """Samples of a noise (float32), as recorded, and without rumble."""

    samples: Array
    filtered: Array


class AudioCache:
    """RIRs and noises at one sample rate; the most recently used ones stay in memory, up to `CACHE_BYTES`."""

    def __init__(self, rir_dir: Path, pool: Pool, fs_hz: int = FS_HZ) -> None:
        self.rir_dir, self.pool, self.fs_hz = rir_dir, pool, fs_hz
        self._cached: OrderedDict[str, tuple[Any, int]] = OrderedDict()
        self._bytes = 0
        self._lock = Lock()
        total = sum(noise.length.frames for noise in (*pool.ambient, *pool.point))
        self._keep_noises = 2 * total * 4 < CACHE_BYTES // 2  # as recorded and without rumble

    def rir(self, rir_id: str) -> ShiftedRir:
        """Return an RIR."""
        def read() -> tuple[ShiftedRir, int]:
            row = self.pool.rows[rir_id]
            fs_hz = row.get("fs_hz", FS_HZ)
            rir = load_rir(self.rir_dir, row, fs_hz)
            shifted = ShiftedRir(rir.astype(np.float32), direct_shift(row, rir))
            if fs_hz != self.fs_hz:
                shifted = at_rate(shifted, fs_hz, self.fs_hz)
            return shifted, 4 * len(shifted.samples)

        return self._get(f"rir {rir_id}", read)

    def noise(self, draw: NoiseDraw, length: int) -> Excerpt:
        """Return `length` samples of a noise as it arrives at the microphone, without rumble.

        A point noise starts early enough to fill the whole response of the room.
        """
        rir = None if draw.rir_id is None else self.rir(draw.rir_id).samples
        lead = 0 if rir is None else len(rir) - 1
        samples, start = self.excerpt(draw.noise, draw.offset_u, length + lead, lead)
        return Excerpt(samples if rir is None else convolve(spectra_of(samples), rir, lead, length), start)

    def excerpt(self, noise: Noise, u: float, length: int, lead: int = 0) -> Excerpt:
        """Return `length` samples of a noise without rumble; if all after the first `lead` are equal, others.

        A sound that ends in the lead would reach the utterance as reverberation alone, which the SNR would amplify. The
        others lie around a change.

        Raises
        ------
        ValueError
            The whole noise is silent, or in memory at a lower sample rate.
        """
        frames, rate = noise.length
        if rate == self.fs_hz and frames >= length and not self._keep_noises:
            start = excerpt_start(u, frames, length)
            samples = (read_audio(noise.path, fs_hz=rate, start=start, stop=start + length, dtype="float32")
                       if noise.samples is None else noise.samples[start:start + length])
            if sounds(samples[lead:]):
                return Excerpt(without_rumble(samples, self.fs_hz), start)
        whole, filtered = self._get(f"noise {noise.id}", lambda: _read_whole(noise, self.fs_hz))
        start = excerpt_start(u, len(whole), length)
        if len(whole) >= length and sounds(whole[start + lead:start + length]):
            return Excerpt(filtered[start:start + length], start)
        if len(whole) < length and sounds((samples := loop(filtered, start, length))[lead:]):
            return Excerpt(samples, start)
        wanted = _audible_sample(whole, noise, u) - (length + lead) // 2  # in the middle of what follows the lead
        start = min(max(0, wanted), len(whole) - length)
        if start >= 0 and sounds(whole[start + lead:start + length]):
            return Excerpt(filtered[start:start + length], start)
        start = wanted % ring_length(len(whole))
        return Excerpt(loop(filtered, start, length), start)

    def _get(self, key: str, read: Callable[[], tuple[Any, int]]) -> Any:
        """Return what `read` returned for a key (a value and its bytes), and drop what was not used for longest."""
        with self._lock:  # a loader of training data may have threads
            if key not in self._cached:
                self._cached[key] = read()
                self._bytes += self._cached[key][1]
                while self._bytes > CACHE_BYTES and len(self._cached) > 1:
                    _, (_, n_bytes) = self._cached.popitem(last=False)
                    self._bytes -= n_bytes
            self._cached.move_to_end(key)
            return self._cached[key][0]


def _audible_sample(samples: Array, noise: Noise, u: float) -> int:
    """Return the position of one of the samples that differ from the one before."""
    positions = np.flatnonzero(np.diff(samples)) + 1
    if not len(positions):
        name = f"{noise.path}: noise {noise.id}" if noise.path.name else noise.id
        raise ValueError(f"{name} is silent (all samples the same): leave it out")
    return int(positions[int(u * len(positions))])


def at_rate(rir: ShiftedRir, fs_hz: int, wanted_hz: int) -> ShiftedRir:
    """Return an RIR at a lower sample rate. Its samples are scaled, so that a convolution keeps its level.

    Raises
    ------
    ValueError
        The wanted rate is higher.
    """
    import soxr

    if wanted_hz > fs_hz:
        raise ValueError(f"RIRs at {fs_hz} Hz cannot serve audio at {wanted_hz} Hz, whose upper octaves they lack: "
                         f"simulate them with fs={wanted_hz}, or resample the audio")
    samples = soxr.resample(rir.samples, fs_hz, wanted_hz, quality="VHQ") * np.float32(fs_hz / wanted_hz)
    return ShiftedRir(samples, round(rir.shift * wanted_hz / fs_hz))


def _read_whole(noise: Noise, fs_hz: int) -> tuple[WholeNoise, int]:
    """Return a noise at a sample rate, and what is kept of it in bytes."""
    if noise.samples is None:
        samples = read_audio(noise.path, fs_hz=fs_hz, dtype="float32")
    else:
        samples = noise.samples if noise.fs_hz == fs_hz else _noise_at_rate(noise, fs_hz)
    filtered = without_rumble(samples, fs_hz)
    return WholeNoise(samples, filtered), samples.nbytes + filtered.nbytes


def _noise_at_rate(noise: Noise, wanted_hz: int) -> Array:
    import soxr

    assert noise.samples is not None
    if wanted_hz > noise.fs_hz:
        raise ValueError(f"noises at {noise.fs_hz} Hz cannot serve audio at {wanted_hz} Hz, whose upper octaves they "
                         f"lack: give noises with fs={wanted_hz}, or resample the audio")
    samples = soxr.resample(noise.samples, noise.fs_hz, wanted_hz, quality="VHQ")
    if not samples.any():
        raise ValueError(f"{noise.id}: nothing of it is left at {wanted_hz} Hz: leave it out, or give a longer one")
    return samples
