"""Far-field speech on the fly: a callable for training in Python.

    reverberate = Reverberate("data/rirs.sim.train", noises="data/noises", snr="uniform 5 25")
    far_field = reverberate(samples, sample_rate)

It is called as transforms of audiomentations, `augment_fn` of lhotse and functions in the `__getitem__` of a torch
`Dataset` are. The signal processing is that of `roomeq augment` (`roomeq.augment.mix`).
"""

import multiprocessing
import os
import sys
from collections.abc import Iterator, Sequence
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from roomeq.acoustics.direct import find_direct, require_samples
from roomeq.augment.audio_cache import AudioCache, ShiftedRir, at_rate
from roomeq.augment.distribution import parse_distribution
from roomeq.augment.draw import DrawRules, Noise, Pool, read_pool
from roomeq.augment.mix import convolve, mean_power, mix, spectra_of, without_rumble
from roomeq.core.arrays import Array
from roomeq.core.audio import sounds
from roomeq.core.constants import FS_HZ, is_number, is_whole, require_fs
from roomeq.core.rng import rng_for

PathLike = str | os.PathLike[str]

_MIN_SAMPLES = 100
"""More are the samples of an array of several recordings, and not the channels of one."""
_RANKS = ("RANK", "SLURM_PROCID", "OMPI_COMM_WORLD_RANK", "PMI_RANK", "NODE_RANK", "LOCAL_RANK")
"""Environment variables by which launchers of distributed training number its processes."""
_INSTANCES = count()
_CALLS: dict[tuple[int, str], Iterator[int]] = {}
"""Numbers of the calls to come, by instance and worker. They belong to the process: a pool may copy an instance to it
for every task, and each copy goes on where the one before ended."""


class Reverberate:
    """Convolve speech with room impulse responses and add noise, keeping alignment, length and level.

    Parameters
    ----------
    rirs
        RIR directory (`roomeq.read_rirs`; RIRs of noise sources serve point noises of their room), or arrays of shape
        (n_samples,), such as `roomeq.simulate_rir` returns.
    noises
        Directory with noises.jsonl (`roomeq read-noises`), or arrays of ambient noise. An RIR directory may hold noises
        of its own.
    snr, point_snr
        SNR of the ambient noise and of a point noise [dB]: ``"uniform 5 25"``, ``"normal 15 5"``, ``"list 20,15,10"``,
        a number, or ``"none"``.
    point_noise_prob
        Probability of a point noise, where there are any.
    p
        Probability that a call changes anything.
    fs
        Sample rate of the arrays [Hz]. The rows of an RIR directory state their own. Speech may have a lower rate, to
        which RIRs and noises are resampled, but no higher one.
    seed
        Worker processes, and the ranks of distributed training, draw independently of each other. Within a process,
        call number n gives the same draws in every run. A process pool deals out its calls differently from run to run:
        give the `key` of a call for the same draws. In the workers of a torch `DataLoader`, which begin anew in each
        epoch, draws follow torch's seed.

    Raises
    ------
    ValueError
        There is no RIR, or an option is out of range.
    """

    def __init__(self, rirs: PathLike | Sequence[ArrayLike], noises: PathLike | Sequence[ArrayLike] | None = None, *,
                 snr: str | float = "uniform 5 25", point_snr: str | float = "uniform 5 25",
                 point_noise_prob: float = 0.5, p: float = 1.0, fs: int = FS_HZ, seed: int = 0) -> None:
        fs = require_fs(fs)
        for name, value in (("p", p), ("point_noise_prob", point_noise_prob)):
            if not (is_number(value) and 0.0 <= value <= 1.0):
                raise ValueError(f"{name}={value!r} must lie in [0, 1]: correct it")
        if not is_whole(seed):
            raise ValueError(f"seed={seed!r} must be a whole number: correct it")
        parse_distribution(snr, "snr")
        parse_distribution(point_snr, "point_snr")
        self.p, self.fs, self.seed = p, fs, seed
        self.snr, self.point_snr, self.point_noise_prob = snr, point_snr, point_noise_prob
        self._rir_dir = Path(rirs) if isinstance(rirs, str | os.PathLike) else None
        self._rirs = {} if isinstance(rirs, str | os.PathLike) else _with_direct_sound(rirs, fs)
        self._pool = self._make_pool(noises)
        self._number = next(_INSTANCES)
        self._caches: dict[int, AudioCache] = {}

    def _make_pool(self, noises: PathLike | Sequence[ArrayLike] | None) -> Pool:
        if self._rir_dir is not None:
            pool = read_pool(self._rir_dir, [Path(noises)] if isinstance(noises, str | os.PathLike) else [])
        elif isinstance(noises, str | os.PathLike):
            raise ValueError(f"noises={str(noises)!r} go with an RIR directory: give arrays of noise with arrays of "
                             "RIRs")
        else:
            rows: dict[str, Any] = {name: dict(id=name, room_id="room", fs_hz=self.fs) for name in self._rirs}
            pool = Pool(rows, list(rows), {name: [] for name in rows})
        if noises is not None and not isinstance(noises, str | os.PathLike):
            _require_several(noises, "noises")
            pool.ambient.extend(Noise(f"noise {n}", Path(), None, "ambient", _sounding(noise, f"noise {n}"), self.fs)
                                for n, noise in enumerate(noises))
        return pool

    def __call__(self, samples: ArrayLike, sample_rate: int, *, key: str | None = None) -> Array:
        """Return far-field speech.

        Parameters
        ----------
        samples
            Shape (n_samples,) or (1, n_samples).
        sample_rate
        key
            Draw by this text, such as an utterance's id, instead of by the number of the call: the same key always
            gives the same draws.

        Returns
        -------
        ndarray of float32
            Shape of `samples`. The direct sound is where the clean speech was, the RMS is that of the clean speech from
            20 Hz on; only where the peak would exceed 0.99, or that of the clean speech where it is larger, is it
            reduced. Silence is returned as it is. The result is never the array that was given.

        Raises
        ------
        ValueError
            The samples are not finite or of several channels, or the sample rate is higher than that of the RIRs
            or the noises.
        """
        require_samples(samples, "samples")
        sample_rate = require_fs(sample_rate)
        given = np.asarray(samples)
        clean = _one_channel(given[0] if given.ndim == 2 and len(given) == 1 else given, "samples")
        name = self._next_call() if key is None else key
        if not sounds(clean) or rng_for(self.seed, "reverberate", name).random() >= self.p:
            return clean.reshape(given.shape).copy()  # which the caller may change
        speech = without_rumble(clean, sample_rate)
        if not mean_power(speech) > 0.0:
            return clean.reshape(given.shape).copy()
        cache = self._cache(sample_rate)
        rules = DrawRules(self.seed, False, parse_distribution(self.snr, "snr"),
                          parse_distribution(self.point_snr, "point_snr"), self.point_noise_prob, 1)
        rir_id, draws = rules.draw(name, self._pool)
        rir, shift = cache.rir(rir_id)
        reverberated = convolve(spectra_of(speech), rir, shift, len(speech))
        noises = [(cache.noise(draw, len(speech)).samples, draw.snr_db) for draw in draws]
        scale = max(np.float32(1.0), np.abs(speech).max())  # samples may be those of 16-bit audio
        return (scale * mix(speech / scale, reverberated / scale, noises).samples).reshape(given.shape)

    def _next_call(self) -> str:
        """Return the name of this call, which no other process and no other call has."""
        worker = _worker()
        return f"{worker} call {next(_CALLS.setdefault((self._number, worker), count()))}"

    def _cache(self, sample_rate: int) -> AudioCache:
        if sample_rate not in self._caches:
            self._caches[sample_rate] = (
                AudioCache(self._rir_dir, self._pool, sample_rate) if self._rir_dir is not None
                else _ArrayCache(self._rirs, self._pool, self.fs, sample_rate))
        return self._caches[sample_rate]

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | dict(_caches={})


class _ArrayCache(AudioCache):
    """RIRs and noises that are in memory."""

    def __init__(self, rirs: dict[str, ShiftedRir], pool: Pool, fs_hz: int, wanted_hz: int) -> None:
        super().__init__(Path(), pool, wanted_hz)
        self._rirs = {name: rir if wanted_hz == fs_hz else at_rate(rir, fs_hz, wanted_hz)
                      for name, rir in rirs.items()}

    def rir(self, rir_id: str) -> ShiftedRir:
        return self._rirs[rir_id]


def _with_direct_sound(rirs: Sequence[ArrayLike], fs_hz: int) -> dict[str, ShiftedRir]:
    """Return RIRs by name, each with the delay of its direct sound."""
    _require_several(rirs, "rirs")
    found = {}
    for n, rir in enumerate(rirs):
        samples = _audible(rir, f"RIR {n}")
        try:
            found[f"rir {n}"] = ShiftedRir(samples, round(find_direct(samples.astype(np.float64), fs_hz)[0]))
        except ValueError as error:
            raise ValueError(f"RIR {n}: {error}") from None
    if not found:
        raise ValueError("rirs is empty: give at least one RIR")
    return found


def _require_several(recordings: Sequence[ArrayLike], name: str) -> None:
    """Raise ValueError for an array that is one recording, of one channel or of several side by side."""
    shape = tuple(getattr(recordings, "shape", ()))
    if len(shape) == 1:
        raise ValueError(f"{name}: shape {shape} is that of one recording, and a list is expected: give [samples]")
    if len(shape) == 2 and shape[1] < min(shape[0], _MIN_SAMPLES):
        raise ValueError(f"{name}: shape {shape} is that of one recording of {shape[1]} channels, and a list is "
                         "expected: give the channels one after the other, as in samples.T")


def _one_channel(values: ArrayLike, name: str) -> Array:
    require_samples(values, name)
    samples = np.asarray(values, dtype=np.float32)
    if not samples.size:
        raise ValueError(f"{name}: holds no samples: leave it out")
    if samples.ndim != 1:
        raise ValueError(f"{name}: shape {samples.shape} must be that of one channel, (n_samples,): choose a channel")
    if not np.all(np.isfinite(samples)):
        raise ValueError(f"{name}: holds NaN or infinite samples: correct them")
    return samples


def _audible(values: ArrayLike, name: str) -> Array:
    samples = _one_channel(values, name)
    if not samples.any():
        raise ValueError(f"{name}: silent (all samples 0): leave it out")
    return samples


def _sounding(values: ArrayLike, name: str) -> Array:
    samples = _one_channel(values, name)
    if not sounds(samples):
        raise ValueError(f"{name}: silent (all samples the same): leave it out")
    return samples


def _worker() -> str:
    """Return what tells this process from others: its rank, and its place among started processes.

    In place of the latter, torch's workers have a seed: each epoch starts others. All ranks may have the same seed.
    """
    ranks = [os.environ.get(name, "0") for name in _RANKS]
    rank = f"rank {' '.join(ranks)} " if set(ranks) != {"0"} else ""
    place = multiprocessing.current_process()._identity
    data = sys.modules.get("torch.utils.data")
    worker = data.get_worker_info() if data is not None else None
    if worker is not None:
        started_by = f"{'.'.join(map(str, place[:-1]))} " if place[:-1] else ""
        return f"{rank}{started_by}torch worker {worker.seed}"
    return f"{rank}process {'.'.join(map(str, place))}"
