"""Limits of the energy of single rays, where late sound would be left to a few of them.

Under an absorbing ceiling, sound that stays horizontal between hard walls decays most slowly. If few rays carry it, it
is silent for most of the time, and where one of them crosses a receiver, it is a loud single echo. The energy of rays
is therefore winsorized (Dixon, Ann. Math. Stat. 31 (1960) 385): no ray has more than the share of one in `FEWEST_RAYS`
of the energy in the room. What more rays carry remains as it is. The slow decay that fewer rays carry is lost below
that of the others; with more rays, more of it is kept.
"""

import numpy as np

from roomeq.core.arrays import Array, FloatArray, Number
from roomeq.core.jit import compiled, for_chunks
from roomeq.sim.trace import Paths

FEWEST_RAYS = 25
"""Rays that must carry the energy in a room, or one in `_RAYS_PER_LIMIT` rays where those are fewer."""
_RAYS_PER_LIMIT = 400
_STEP = 64  # frames between the times at which energies are compared
_LEAST = 1e-30


def ray_limits(paths: Paths, reflected: Array, emitted: Array, *, n_frames: int, frames_per_m: float) -> Array:
    """Return the largest energy that a ray may have in each frame, relative to that of a ray as it leaves the source.

    Parameters
    ----------
    paths
    reflected
        Share of the energy that each face reflects, shape (n_faces, n_bands), float32.
    emitted
        Energy of each ray as it leaves the source, shape (n_rays, n_bands), float32; of no rays if all have 1.
    n_frames
    frames_per_m
        Of length of path.

    Returns
    -------
    ndarray of float32, shape (n_frames, n_bands)
        Infinite if there are too few rays to tell.
    """
    n_rays, n_bands = len(paths.counts), reflected.shape[1]
    fewest = min(FEWEST_RAYS, n_rays // _RAYS_PER_LIMIT)
    if fewest < 2:
        return np.full((n_frames, n_bands), np.inf, np.float32)
    at_m = np.minimum(np.arange(0, n_frames + _STEP, _STEP) / frames_per_m, paths.max_length_m).astype(np.float32)
    energy = np.zeros((len(at_m), n_bands, n_rays), np.float32)
    for_chunks(n_rays, lambda chunk, low, high: _find_energies(paths.hits, paths.codes, paths.first, paths.counts,
                                                              reflected, emitted, at_m, low, high, energy))
    log_limit = np.log(np.maximum(_winsorized(energy, fewest), _LEAST))
    place = np.arange(n_frames) / _STEP
    return np.exp([np.interp(place, np.arange(len(at_m)), of_band) for of_band in log_limit.T]).T.astype(np.float32)


@compiled
def _find_energies(hits: Array, codes: Array, first: Array, counts: Array, reflected: Array, emitted: Array,
                   at_m: Array, low: Number, high: Number, energy: Array) -> None:
    """Find the energy of rays `low` to `high` at some lengths of path [m], shape (n_lengths, n_bands, n_rays)."""
    n_bands = reflected.shape[1]
    left = np.empty(n_bands, np.float32)
    for ray in range(low, high):
        for band in range(n_bands):
            left[band] = emitted[ray, band] if len(emitted) else np.float32(1.0)
        place = 0
        for at in range(first[ray], first[ray] + counts[ray]):
            while place < len(at_m) and at_m[place] <= hits[at, 3]:
                for band in range(n_bands):
                    energy[place, band, ray] = left[band]
                place += 1
            face, twice = codes[at] >> 2, np.float32(2.0) if codes[at] & 2 == 2 else np.float32(1.0)
            for band in range(n_bands):
                left[band] *= twice * reflected[face, band]


@compiled
def _winsorized(energy: Array, fewest: Number) -> FloatArray:
    """Return the largest limits c with which ``sum(min(energy, c)) >= fewest * c``, shape (n_lengths, n_bands)."""
    n_lengths, n_bands, n_rays = energy.shape
    limit = np.zeros((n_lengths, n_bands))
    largest = np.empty(fewest, np.float32)  # in falling order
    for place in range(n_lengths):
        for band in range(n_bands):
            largest[:] = np.float32(0.0)
            of_rays, total = energy[place, band], 0.0
            for ray in range(n_rays):
                total += np.float64(of_rays[ray])
                if of_rays[ray] > largest[fewest - 1]:
                    n = fewest - 1
                    while n > 0 and of_rays[ray] > largest[n - 1]:
                        largest[n] = largest[n - 1]
                        n -= 1
                    largest[n] = of_rays[ray]
            for n_limited in range(fewest):
                if largest[n_limited] * (fewest - n_limited) <= total:
                    limit[place, band] = total / (fewest - n_limited)
                    break
                total -= np.float64(largest[n_limited])
    return limit
