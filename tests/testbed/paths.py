"""What reaches each microphone of a room: image sources, and energy over path length."""

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from testbed.draws import N_BANDS, generator
from testbed.rooms import N_SOURCES, Room
from testbed.trace import COHERENT_ORDER, N_ANGLES, N_BINS, N_RAYS, NO_SCREEN, trace

COARSE = 8  # bins over which shares of the departure angles are kept
OWN = "testbed"
"""The base that this module traces."""


@dataclass(frozen=True)
class Images:
    """Specular paths of one pair, the direct one first.

    Attributes
    ----------
    length_m : ndarray, shape (n,)
    departure : ndarray, shape (n, 3)
        Unit vectors from the source.
    gain : ndarray, shape (8, n)
        Pressure reflected by all walls on the way, per octave.
    order : ndarray, shape (n,)
        Reflections on the way.
    """

    length_m: np.ndarray
    departure: np.ndarray
    gain: np.ndarray
    order: np.ndarray


@dataclass(frozen=True)
class Field:
    """Everything that reaches one microphone without any effect.

    Attributes
    ----------
    room : Room
    rir : Rir
    images : Images
    energy : ndarray, shape (8, N_BINS)
        Of all other paths.
    share : ndarray, shape (N_ANGLES, 8, N_BINS // COARSE)
        Part of it that left the source at each class of angle to where it faces.
    cache : Path or None
        Folder for what takes long.
    base : str
        What simulated it, see `testbed.bases`.
    """

    room: Room
    rir: object
    images: Images
    energy: np.ndarray
    share: np.ndarray
    cache: Path | None = None
    base: str = OWN


def image_sources(room, source, mic):
    """Image sources of a shoebox up to `COHERENT_ORDER` (Allen & Berkley, JASA 65 (1979) 943)."""
    n = COHERENT_ORDER
    grid = np.stack(np.meshgrid(*[np.arange(-n, n + 1)] * 3, indexing="ij"), -1).reshape(-1, 3)
    grid = grid[np.abs(grid).sum(axis=1) <= n]
    odd = grid % 2 == 1
    image = grid * room.dims_m + np.where(odd, room.dims_m - source, source)
    way = mic - image
    length = np.linalg.norm(way, axis=1)
    far, near = (np.abs(grid) + 1) // 2, np.abs(grid) // 2
    hits = np.stack([np.where(grid > 0, near, far), np.where(grid > 0, far, near)], -1).reshape(-1, 6)
    nepers = 0.5 * (np.log1p(-room.absorption) + np.log1p(-room.scattering)[:, None])
    departure = np.where(odd, -way, way) / length[:, None]
    nearest = np.argsort(length, kind="stable")
    return Images(length[nearest], departure[nearest], np.exp(hits @ nepers).T[:, nearest],
                  np.abs(grid).sum(axis=1)[nearest])


def rays(room, screen=NO_SCREEN):
    """Energy at each pair of a room, shape (2, 4, N_ANGLES, 8, N_BINS)."""
    result = []
    for s in range(N_SOURCES):
        facings = np.array([rir.facing for rir in room.rirs if rir.source == s])
        seed = int(generator(room.seed, "rays", room.room_id, s).integers(2 ** 31))
        result.append(trace(room.dims_m, room.sources_m[s], room.mics_m, facings, room.absorption, room.scattering,
                            *screen, N_RAYS, seed))
    return np.array(result)


def fields_of(room, cache=None):
    """Return the fields of a room's eight pairs, from a cache folder where they lie in it.

    Parameters
    ----------
    room : Room
    cache : Path, optional
    """
    energy, share = kept(cache and Path(cache) / f"{room.room_id}-{version()}.npz", lambda: condensed(rays(room)))
    return [Field(room, rir, image_sources(room, room.sources_m[rir.source], room.mics_m[rir.mic]),
                  energy[rir.source, rir.mic], share[rir.source, rir.mic], cache) for rir in room.rirs]


def kept(path, trace_room):
    """Return a room's energy and shares of the angles from a file, or trace it and write the file; None: no file."""
    if path and path.is_file():
        with np.load(path) as file:
            return file["energy"], file["share"].astype(np.float64)
    energy, share = trace_room()
    share = share.astype(np.float16)
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(f".{os.getpid()}.npz")
        np.savez_compressed(partial, energy=energy, share=share)
        partial.replace(path)
    return energy, share.astype(np.float64)


def condensed(traced):
    """Split traced energy into its total and the coarse shares of the angles."""
    energy = traced.sum(axis=2, dtype=np.float64)
    coarse = traced.reshape(*traced.shape[:-1], N_BINS // COARSE, COARSE).sum(axis=-1, dtype=np.float64)
    total = coarse.sum(axis=2, keepdims=True)
    share = np.divide(coarse, total, out=np.full_like(coarse, 1.0 / N_ANGLES), where=total > 0.0)
    return energy, share


def version(*more):
    """Changes with the code that cached numbers come from: of rays, and the modules named."""
    here = Path(__file__).parent
    code = b"".join((here / name).read_bytes() for name in ("draws.py", "rooms.py", "trace.py", "paths.py", *more))
    return hashlib.sha256(code).hexdigest()[:12]


def smoothed(energy):
    """Spread energy over bins by windows that grow with time, as the density of paths does: 1 ms to 8 ms."""
    total = np.concatenate([np.zeros((N_BANDS, 1)), np.cumsum(energy, axis=-1)], axis=-1)
    k = np.arange(energy.shape[-1])
    reach = np.clip(k // 40, 0, 4)
    low, high = np.maximum(k - reach, 0), np.minimum(k + reach + 1, energy.shape[-1])
    return (total[:, high] - total[:, low]) / (high - low)
