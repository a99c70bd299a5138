"""Limits of the energy of single rays, where late sound would be left to a few of them.

Under an absorbing ceiling, sound that stays horizontal between hard walls decays most slowly. If few rays carry it, it
is silent for most of the time, and where one of them crosses a receiver, it is a loud single echo. The energy of rays
is therefore winsorized (Dixon, Ann. Math. Stat. 31 (1960) 385): no ray has more than the share of one in `FEWEST_RAYS`
of the energy in the room. What more rays carry remains as it is.

What the limit takes from rays is shared by all of them, so that the energy in the room decays as it was traced. Its
decay is a sum over all rays, and needs fewer of them than the sound at a receiver does. But one or two rays do not tell
it: of that energy, too, no ray has more than the share of one in `FEWEST_FOR_DECAY`.
"""

from typing import NamedTuple

import numpy as np

from roomeq.core.arrays import Array, FloatArray, IntArray, Number
from roomeq.core.jit import N_CHUNKS, compiled, for_chunks, inlined
from roomeq.sim.trace import Paths

FEWEST_RAYS = 25
"""Rays that must carry the energy in a room, or one in `_RAYS_PER_LIMIT` rays where those are fewer."""
FEWEST_FOR_DECAY = 8
"""Rays that must carry the energy in a room for its decay to be that of the response."""
FEW_RAYS_DB = 2.0
"""Gain of all rays in a decay (`few_rays_db`) from which on a few of them tell it. In 60 rooms, of which most had an
absorbing ceiling, T30 with 10,000 rays differed from that with 320,000 by 1 to 5 % (rms) in octaves with less, and by
10 % with more."""
LARGEST_GAIN = 100.0
"""Of all rays. Where they would need more, a few rays carry nearly all energy, and the others are no model of them."""
_RAYS_PER_LIMIT = 400
FEWEST_TO_TELL = (FEWEST_FOR_DECAY + 1) * _RAYS_PER_LIMIT
"""Rays of a trace from which on `few_rays_db` is known: of fewer, the limits ask for no more than `FEWEST_FOR_DECAY`
that carry the energy, and their gain is 1 whatever the room."""
_FIRST_SORTED = 6  # of the largest energies in a chunk of rays
_STEP = 64  # frames between the times at which energies are compared
_T30_RANGE = 10.0 ** -3.5
_NEGLIGIBLE = 1e-6  # share of the energy at the beginning
_LEAST = 1e-30


class RayLimits(NamedTuple):
    """Limits of the energy of single rays, shape (n_frames, n_bands) each, float32.

    Attributes
    ----------
    largest
        Energy that a ray may have, relative to that of a ray as it leaves the source. Infinite if there are too few
        rays to tell.
    gain
        Of the energy of all rays, so that they carry together what the limits took from some.
    """

    largest: Array
    gain: Array


def ray_limits(paths: Paths, reflected: Array, emitted: Array, *, n_frames: int, frames_per_m: float,
               n_bands: int = 8) -> RayLimits:
    """Find the limits of the energy of rays in each frame.

    Parameters
    ----------
    paths
    reflected
        Share of the energy that each face reflects, shape (n_faces, 8), float32.
    emitted
        Energy of each ray as it leaves the source, shape (n_rays, 8), float32; of no rays if all have 1.
    n_frames
    frames_per_m
        Of length of path.
    n_bands
        Of the eight bands, how many from the first on are needed.
    """
    n_rays = len(paths.counts)
    fewest = min(FEWEST_RAYS, n_rays // _RAYS_PER_LIMIT)
    if fewest < 2:
        return RayLimits(np.full((n_frames, n_bands), np.inf, np.float32), np.ones((n_frames, n_bands), np.float32))
    # in the frames alone: rays may have been followed further
    frames = np.unique(np.minimum(np.arange(0, n_frames + _STEP, _STEP), n_frames - 1))
    at_m = (frames / frames_per_m).astype(np.float32)

    def add_up(at_m: Array, n_largest: int) -> tuple[FloatArray, Array]:
        total = np.zeros((N_CHUNKS, len(at_m), 8), np.float32)
        largest = np.zeros((N_CHUNKS, len(at_m), n_bands, n_largest), np.float32)
        walk = paths.hits, paths.codes, paths.first, paths.counts, reflected, emitted, at_m
        for_chunks(n_rays, lambda chunk, low, high: _add_up(*walk, low, high, total[chunk], largest[chunk]))
        return total.sum(axis=0, dtype=np.float64)[:, :n_bands], np.concatenate([*largest], axis=-1)

    # to sort many takes longer than a second walk for the times at which some beyond the limit were left out
    n_sorted = min(_FIRST_SORTED, fewest)
    energy, of_rays = add_up(at_m, n_sorted)
    counts, known = energy > _NEGLIGIBLE * energy[0], min(FEWEST_FOR_DECAY, fewest)
    least = of_rays[..., n_sorted - 1::n_sorted].max(axis=-1)  # no ray that was left out has more
    limit = _winsorized(energy, of_rays, fewest)
    incomplete = np.flatnonzero(np.any(counts & (least > limit), axis=-1))
    if n_sorted < fewest and len(incomplete):
        of_rays = np.pad(of_rays, [(0, 0), (0, 0), (0, N_CHUNKS * (fewest - n_sorted))])
        of_rays[incomplete] = add_up(at_m[incomplete], fewest)[1]
        limit = _winsorized(energy, of_rays, fewest)
    limit = np.where(counts, limit, energy / fewest)
    # winsorized for n rays, all of them together carry n times the limit
    gain = np.where(counts, known * _winsorized(energy, of_rays, known) / np.maximum(fewest * limit, _LEAST), 1.0)
    return RayLimits(_in_frames(frames, limit), _in_frames(frames, np.clip(gain, 1.0, LARGEST_GAIN)))


def few_rays_db(energy: FloatArray, gain: Array, n_rays: int) -> float | None:
    """Return the largest gain of all rays where a decay is not below -35 dB, in octaves from 125 Hz on [dB].

    Fewer than 10,000 rays have wider limits, and a lower gain, although their decay is less certain. With fewer than
    `FEWEST_TO_TELL`, it is unknown: None.

    Parameters
    ----------
    energy
        Echogram, shape (n_frames, n_bands).
    gain
        See `RayLimits`, of the same shape.
    n_rays
        Of each trace.
    """
    if n_rays < FEWEST_TO_TELL:
        return None
    left = np.cumsum(energy[::-1], axis=0)[::-1]
    return float(10.0 * np.log10(np.max(gain, where=left > _T30_RANGE * left[0], initial=1.0, axis=0)[1:].max()))


def _in_frames(frames: IntArray, values: FloatArray) -> Array:
    """Interpolate the logarithm of values, shape (n_lengths, n_bands), between the frames at which they are known."""
    logarithm = np.log(np.maximum(values, _LEAST))
    in_frames = np.exp([np.interp(np.arange(frames[-1] + 1), frames, band) for band in logarithm.T])
    return np.ascontiguousarray(in_frames.T, np.float32)  # as kernels are compiled for


@compiled
def _add_up(hits: Array, codes: Array, first: Array, counts: Array, reflected: Array, emitted: Array, at_m: Array,
            low: Number, high: Number, total: Array, largest: Array) -> None:
    """Find the energy of rays `low` to `high` at some lengths of path: the total, and the largest of single rays.

    Shapes are (n_lengths, 8) and (n_lengths, n_bands, n_largest); the largest come in falling order.
    """
    one, n_bands, n_lengths = np.float32(1.0), largest.shape[1], np.uint64(len(at_m))
    least = np.full((len(at_m), 8), np.float32(np.inf))  # of the largest, side by side, since most rays exceed none
    least[:, :n_bands] = np.float32(0.0)
    once_or_twice = np.empty((2 * len(reflected), 8), np.float32)  # a ray may represent two from a reflection on
    for face in range(len(reflected)):
        once_or_twice[2 * face], once_or_twice[2 * face + 1] = reflected[face], reflected[face] + reflected[face]
    for ray in range(low, high):
        e0, e1, e2, e3, e4, e5, e6, e7 = one, one, one, one, one, one, one, one
        if len(emitted):
            e0, e1, e2, e3 = emitted[ray, 0], emitted[ray, 1], emitted[ray, 2], emitted[ray, 3]
            e4, e5, e6, e7 = emitted[ray, 4], emitted[ray, 5], emitted[ray, 6], emitted[ray, 7]
        # a signed index costs a comparison with 0
        at, end, place = np.uint64(first[ray]), np.uint64(first[ray] + counts[ray]), np.uint64(0)
        while at < end and place < n_lengths:
            if at_m[place] <= hits[at, 3]:
                total[place, 0], total[place, 1] = total[place, 0] + e0, total[place, 1] + e1
                total[place, 2], total[place, 3] = total[place, 2] + e2, total[place, 3] + e3
                total[place, 4], total[place, 5] = total[place, 4] + e4, total[place, 5] + e5
                total[place, 6], total[place, 7] = total[place, 6] + e6, total[place, 7] + e7
                if ((e0 > least[place, 0]) | (e1 > least[place, 1]) | (e2 > least[place, 2]) | (e3 > least[place, 3])
                        | (e4 > least[place, 4]) | (e5 > least[place, 5]) | (e6 > least[place, 6])
                        | (e7 > least[place, 7])):
                    energies = (e0, e1, e2, e3, e4, e5, e6, e7)
                    for band in range(n_bands):
                        if energies[band] > least[place, band]:
                            _insert(energies[band], largest[place, band])
                            least[place, band] = largest[place, band, -1]
                place += np.uint64(1)
            else:
                rho = once_or_twice[np.uint64(codes[at] >> 1)]
                e0, e1, e2, e3 = e0 * rho[0], e1 * rho[1], e2 * rho[2], e3 * rho[3]
                e4, e5, e6, e7 = e4 * rho[4], e5 * rho[5], e6 * rho[6], e7 * rho[7]
                at += np.uint64(1)


@inlined
def _insert(energy: Number, largest: Array) -> None:
    """Put an energy into a list in falling order, whose last one it exceeds and replaces."""
    n = len(largest) - 1
    while n > 0 and energy > largest[n - 1]:
        largest[n] = largest[n - 1]
        n -= 1
    largest[n] = energy


def _winsorized(total: FloatArray, largest: Array, fewest: int) -> FloatArray:
    """Return the largest limits c with which ``sum(min(energy, c)) >= fewest * c``, shape (n_lengths, n_bands).

    Parameters
    ----------
    total
        Energy of all rays, shape (n_lengths, n_bands).
    largest
        The `fewest` largest energies of rays, and others, shape (n_lengths, n_bands, n).
    fewest
    """
    largest = np.sort(largest.astype(np.float64), axis=-1)[..., ::-1][..., :fewest]
    n_left = fewest - np.arange(fewest)
    rest = total[..., None] - np.cumsum(largest, axis=-1) + largest  # without those before each
    holds = largest * n_left <= rest
    return np.where(holds.any(axis=-1), np.take_along_axis(rest / n_left, holds.argmax(axis=-1)[..., None], -1)[..., 0],
                    0.0)
