"""RIRs and noises as augmentation needs them, in bounded memory."""

from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path

import numpy as np

from roomeq.augment.draw import Noise, NoiseDraw, Pool, excerpt_start
from roomeq.augment.mix import convolve, direct_shift, loop
from roomeq.core.audio import read_audio
from roomeq.core.constants import FS_HZ
from roomeq.records.rir_dir import load_rir

CACHE_BYTES = 128 << 20


class Sounds:
    """RIRs and noises as they are needed, the last used ones kept in memory up to a bound."""

    def __init__(self, rir_dir: Path, pool: Pool):
        self.rir_dir, self.pool = rir_dir, pool
        self._kept: OrderedDict[str, tuple[object, int]] = OrderedDict()
        self._bytes = 0
        total = sum(noise.length[0] for noise in (*pool.ambient, *pool.point))
        self._keep_noises = total * 4 < CACHE_BYTES // 2

    def rir(self, rir_id: str) -> tuple[np.ndarray, int]:
        """Return an RIR (float32) and the delay of its direct sound [samples]."""
        def make() -> tuple[tuple[np.ndarray, int], int]:
            row = self.pool.rows[rir_id]
            rir = load_rir(self.rir_dir, row)
            return (rir.astype(np.float32), direct_shift(row, rir)), 4 * len(rir)

        return self._recent(f"rir {rir_id}", make)

    def noise(self, draw: NoiseDraw, length: int) -> tuple[np.ndarray, int]:
        """Return a noise as it arrives at the microphone, and where its excerpt starts.

        A point noise has been on for as long as its RIR lasts.
        """
        if draw.rir_id is None:
            return self.excerpt(draw.noise, draw.offset_u, length)
        rir, _ = self.rir(draw.rir_id)
        samples, start = self.excerpt(draw.noise, draw.offset_u, length + len(rir) - 1)
        return convolve(samples, rir, len(rir) - 1, length), start

    def excerpt(self, noise: Noise, u: float, length: int) -> tuple[np.ndarray, int]:
        """Return samples of a noise and where they start; a silent stretch gives way to one that is not.

        Raises
        ------
        ValueError
            The whole noise is silent.
        """
        frames, rate = noise.length
        if rate == FS_HZ and frames >= length and not self._keep_noises:
            start = excerpt_start(u, frames, length)
            samples = read_audio(noise.path, start=start, stop=start + length, dtype="float32")
            if np.any(samples):
                return samples, start
        whole = self._recent(f"noise {noise.id}", lambda: _read_whole(noise.path))
        start = excerpt_start(u, len(whole), length)
        if len(whole) >= length and not np.any(whole[start:start + length]):
            start = min(max(0, _sounding(whole, noise, u) - length // 2), len(whole) - length)
        samples = whole[start:start + length] if len(whole) >= length else loop(whole, start, length)
        return samples, start

    def _recent(self, key: str, make: Callable):
        if key not in self._kept:
            self._kept[key] = made = make()
            self._bytes += made[1]
            while self._bytes > CACHE_BYTES and len(self._kept) > 1:
                self._bytes -= self._kept.popitem(last=False)[1][1]
        self._kept.move_to_end(key)
        return self._kept[key][0]


def _sounding(samples: np.ndarray, noise: Noise, u: float) -> int:
    """Return one of the samples that are not 0."""
    places = np.flatnonzero(samples)
    if not len(places):
        raise ValueError(f"{noise.path}: noise {noise.id} is silent (all samples 0): leave it out")
    return int(places[int(u * len(places))])


def _read_whole(path: Path) -> tuple[np.ndarray, int]:
    samples = read_audio(path, dtype="float32")
    return samples, samples.nbytes
