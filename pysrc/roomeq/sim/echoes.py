"""Echoes: a fair sample of the paths that reach a microphone, for materials that are not known yet.

`roomeq.sim.gather` walks along all stored paths for one set of absorption coefficients. Here one walk keeps, per
microphone and millisecond, `N_KEPT` of the paths that arrive, drawn with probabilities proportional to the energy
that they bring at a reference absorption (weighted reservoir sampling with jumps, as Efraimidis and Spirakis,
Inf. Process. Lett. 97 (2006) 181). A kept path knows what it met, so that the echogram for any other absorption is a
small matrix product: exact at the reference, unbiased elsewhere, and the noisier the further from it.

Every chunk of rays keeps its own share of the paths: strata, which no thread sees but one.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np

from roomeq.sim.gather import FRAME_S, spheres, visibility
from roomeq.sim.jit import N_CHUNKS, compiled, for_chunks, mix

_PER_CHUNK = 2  # as `_replace` has it
N_KEPT = _PER_CHUNK * N_CHUNKS  # per frame
MAX_ABSORPTION = 0.999  # of the reference: a path that it left nothing of could stand for no other
_LOG_NOTHING = -200.0  # what a surface keeps that absorbs all: its exponential is 0 in single precision
_GIVEN_UP = np.float32(1e-25)  # share of a ray's energy at the reference
_BATCH = 32  # microphones that are served in one pass over the rays


@dataclass(frozen=True)
class Echoes:
    """Paths that reach one microphone, without those of the image sources.

    Attributes
    ----------
    weight : ndarray of float32, shape (n_columns, n_frames, N_KEPT)
        Squared pressure that each stands for before anything was absorbed, relative to a direct sound of
        ``1 / (4 pi r)^2``; 0 where there is none. A column is one trace.
    counts : ndarray of unsigned int, shape (n_columns, n_frames, N_KEPT, n_slots)
        How often each was reflected by each slot.
    ray : ndarray of uint32, shape (n_columns, n_frames, N_KEPT)
        Index of the ray that it came with: it left the source in that of `Paths.directions`.
    column_of_band : tuple of 8 ints
    """

    weight: np.ndarray
    counts: np.ndarray
    ray: np.ndarray
    column_of_band: tuple


def keep_echoes(traced, mics_m, reference, rngs, *, ism_order, n_frames, visible=None):
    """Sample what reaches some microphones.

    Parameters
    ----------
    traced : TracedSource
    mics_m : ndarray, shape (n_mics, 3)
    reference : ndarray, shape (n_mics, n_slots)
        Absorption for which the sample is best, of each microphone; see `middle`.
    rngs : sequence of numpy.random.Generator
        One per microphone; the sample of one does not depend on the others.
    ism_order : int
        As for `gather`.
    n_frames : int or sequence of int
        Frames of 1 ms from the emission on, of all or of each microphone.
    visible : list of ndarray, optional
        From `visibility`, one for each column.

    Returns
    -------
    list of Echoes
        One per microphone.
    """
    mics_m = np.atleast_2d(np.asarray(mics_m, dtype=np.float64))
    seeds = np.array([rng.integers(2 ** 63) for rng in rngs], dtype=np.uint64)
    reference = np.minimum(reference, MAX_ABSORPTION)
    sphere = spheres(traced.scene.room, mics_m)
    n_frames = np.broadcast_to(n_frames, len(mics_m))
    by_frames = np.argsort(-n_frames, kind="stable")  # towards the end of a ray, only the first few still listen
    result = [None] * len(mics_m)
    for first in range(0, len(mics_m), _BATCH):
        batch = by_frames[first:first + _BATCH]
        columns = [_keep_column(paths, traced.scene, mics_m[batch], reference[batch], seeds[batch],
                                [values[batch] for values in sphere], ism_order, n_frames[batch],
                                None if visible is None or not len(visible[n]) else visible[n][batch])
                   for n, paths in enumerate(traced.paths)]
        for m, one in zip(batch, zip(*columns, strict=True), strict=True):
            result[m] = Echoes(*(np.stack(parts)[:, :n_frames[m]] for parts in zip(*one, strict=True)),
                               traced.path_of_band)
    return result


def middle(absorption):
    """Reference for all bands together: what is kept at each slot is their geometric mean.

    Parameters
    ----------
    absorption : ndarray, shape (..., n_slots, 8)

    Returns
    -------
    ndarray, shape (..., n_slots)
    """
    return 1.0 - np.exp(np.log1p(-np.minimum(absorption, MAX_ABSORPTION)).mean(axis=-1))


def echogram(echoes, absorption, *, bands=None, ray_gain=None):
    """Energy that reaches the microphone from all but image sources, for any absorption; compare `gather`.

    Parameters
    ----------
    echoes : Echoes
    absorption : ndarray, shape (n_slots, 8)
    bands : sequence of int, optional
        Leave the others 0.
    ray_gain : ndarray, shape (n_rays, 8), optional
        Energy gain of each ray, for sources that are not omnidirectional.

    Returns
    -------
    ndarray, shape (n_frames, 8)
        Squared pressure per frame, without air absorption.
    """
    bands = np.arange(len(echoes.column_of_band)) if bands is None else np.asarray(bands)
    column_of_band = np.asarray(echoes.column_of_band)[bands]
    with np.errstate(divide="ignore"):
        log_kept = np.maximum(np.log1p(-np.asarray(absorption)[:, bands]), _LOG_NOTHING).astype(np.float32)
    result = np.zeros((echoes.weight.shape[1], len(echoes.column_of_band)))
    for column in np.unique(column_of_band):
        members = np.flatnonzero(column_of_band == column)
        share = echoes.counts[column].astype(np.float32) @ log_kept[:, members]  # small ones, too small for threads
        np.exp(share, out=share)
        if ray_gain is not None:
            share *= ray_gain[echoes.ray[column]][:, :, bands[members]]
        energy = echoes.weight[column][:, None, :] @ share
        result[:, bands[members]] = energy[:, 0]
    return result


def _keep_column(paths, scene, mics_m, reference, seeds, sphere, ism_order, limits, visible):
    """Sample one trace: (weight, counts, ray) for each microphone; those with the most frames come first."""
    single = partial(np.asarray, dtype=np.float32)
    n_mics, n_slots, n_rays = len(mics_m), reference.shape[1], len(paths.counts)
    n_frames = int(limits[0])
    speed_m_s = scene.air.speed_m_s
    if visible is None:
        visible = visibility(paths, scene.room, mics_m, n_frames=n_frames, speed_m_s=speed_m_s)
    radius_m, volume_m3 = sphere
    count_type = np.dtype(np.uint8 if paths.counts.max() < 256 else np.uint16)
    per_word = 8 // count_type.itemsize
    shape = (N_CHUNKS, n_mics, n_frames)
    sums = np.zeros((*shape, 2 + _PER_CHUNK), dtype=np.float32)
    kept = np.zeros((*shape, _PER_CHUNK, 1 - (-n_slots // per_word)), dtype=np.uint64)
    reflection = np.ascontiguousarray((1.0 - reference).T, dtype=np.float32)
    given = (single(paths.source_pos_m), paths.hits, paths.codes, paths.first, paths.counts, single(paths.normals),
             paths.face_slot, reflection, single(paths.scattering), single(mics_m.T, order="C"), visible,
             single(radius_m ** 2), single(1.0 / volume_m3), ism_order, np.float32(1.0 / (speed_m_s * FRAME_S)),
             np.float32(paths.late_m), paths.stride, seeds, limits, per_word)
    for_chunks(n_rays, lambda chunk, low, high: _keep(*given, low, high, sums[chunk], kept[chunk]))
    # strata side by side: (n_mics, n_frames, N_KEPT, ...)
    sums, kept = (values.transpose(1, 2, 0, *range(3, values.ndim)) for values in (sums, kept))
    words = np.ascontiguousarray(kept[..., 1:]).reshape(n_mics, n_frames, N_KEPT, -1)
    counts = words.view(count_type)[..., :n_slots]
    logs = np.matmul(counts.reshape(n_mics, n_frames * N_KEPT, n_slots), np.log1p(-reference)[:, :, None],
                     dtype=np.float32).reshape(n_mics, n_frames, N_CHUNKS, _PER_CHUNK)
    with np.errstate(divide="ignore"):
        weight = np.exp(np.log(sums[..., :1] / np.float32(4.0 * np.pi * n_rays * _PER_CHUNK)) - logs)
    ray = kept[..., 0].reshape(n_mics, n_frames, N_KEPT).astype(np.uint32)
    return list(zip(weight.reshape(ray.shape), counts, ray, strict=True))


@compiled
def _replace(sums, kept, m, frame, stream, counter, met, ray):
    """Let a path that has just been added to the sum of a frame take the places that it wins.

    A place is lost to a new path with probability ``energy / sum so far``; the sum at which that happens next is drawn
    at once: it exceeds the present one by a factor of more than x with probability 1 / x. Both halves of one random
    number serve, one for each place.
    """
    total, word = sums[m, frame, 0], mix(stream + np.uint64(counter) * np.uint64(0x9E3779B97F4A7C15))
    for place in range(2):
        if total >= sums[m, frame, 2 + place]:
            share = np.float32((word & np.uint64(0xFFFFFF)) + np.uint64(1)) * np.float32(2.0 ** -24)
            sums[m, frame, 2 + place] = total / share
            kept[m, frame, place, 0] = ray
            for n in range(len(met)):
                kept[m, frame, place, 1 + n] = met[n]
        word >>= np.uint64(32)
    sums[m, frame, 1] = min(sums[m, frame, 2], sums[m, frame, 3])


@compiled
def _keep(source, hits, codes, first, face_counts, normals, face_slot, reflection, scattering, mics, visible, radius2,
          per_volume, ism_order, frames_per_m, late_m, stride, seeds, limits, per_word, low, high, sums,
          kept):
    """Sample rays `low` to `high`; the walk along them is that of `roomeq.sim.gather`.

    `sums`, shape (n_mics, n_frames, 2 + _PER_CHUNK): energy so far, the least sum at which a place changes hands, and
    that sum of each place. `kept`, shape (n_mics, n_frames, _PER_CHUNK, 1 + n_words): ray, and hits per slot packed
    `per_word` to a word.
    """
    n_mics = len(sums)
    bits, one_hit = np.uint64(64 // per_word), np.uint64(1)
    all_visible = len(visible) == 0
    zero, one = np.float32(0.0), np.float32(1.0)
    mx, my, mz = mics[0], mics[1], mics[2]
    along, weight, frame = np.empty(n_mics, np.float32), np.empty(n_mics, np.float32), np.empty(n_mics, np.float32)
    most = np.array([row.max() for row in reflection])
    share, met = np.empty(n_mics, np.float32), np.zeros(kept.shape[3] - 1, np.uint64)
    for ray in range(low, high):
        share[:] = one
        largest = one
        met[:] = np.uint64(0)
        px, py, pz, path = source[0], source[1], source[2], zero
        specular, late, n_active = True, stride == 1, n_mics
        was_diffuse = True
        for n in range(face_counts[ray]):
            at = first[ray] + n
            hx, hy, hz, new_path = hits[at, 0], hits[at, 1], hits[at, 2], hits[at, 3]
            if not was_diffuse and (n > ism_order or not specular):
                length = new_path - path
                scale = one / max(length, np.float32(1e-9))
                ux, uy, uz = (hx - px) * scale, (hy - py) * scale, (hz - pz) * scale
                near = np.int32(0)
                for m in range(n_active):
                    vx, vy, vz = mx[m] - px, my[m] - py, mz[m] - pz
                    along[m] = ux * vx + uy * vy + uz * vz
                    weight[m] = radius2[m] - (vx * vx + vy * vy + vz * vz - along[m] * along[m])
                    near += np.int32(weight[m] > zero)
                for m in range(n_active if near else 0):
                    if weight[m] > zero:
                        half = np.sqrt(weight[m])
                        start, stop = max(zero, along[m] - half), min(length, along[m] + half)
                        middle = (path + np.float32(0.5) * (start + stop)) * frames_per_m
                        if stop > start and middle < limits[m]:
                            k = np.uint32(middle)
                            total = sums[m, k, 0] + (stop - start) * per_volume[m] * share[m]
                            sums[m, k, 0] = total
                            if total >= sums[m, k, 1]:
                                _replace(sums, kept, m, k, mix(seeds[m] + np.uint64(ray)), 2 * n + 2, met, ray)
            px, py, pz, path = hx, hy, hz, new_path
            face = codes[at] >> 1
            slot = face_slot[face]
            met[slot // per_word] += one_hit << (bits * np.uint64(slot % per_word))
            while n_active > 0 and path * frames_per_m >= limits[n_active - 1]:
                n_active -= 1
            largest *= most[slot]
            if largest < _GIVEN_UP or n_active == 0:
                break
            for m in range(n_active):
                share[m] *= reflection[slot, m]
            if not late and path > late_m:
                if ray % stride != 0:
                    break
                late = True
                for m in range(n_active):
                    share[m] *= np.float32(stride)
            was_diffuse = (codes[at] & 1) == 1
            s = scattering[slot]
            if path > late_m:
                s = one if was_diffuse else zero
            if s > zero:
                nx, ny, nz = normals[face, 0], normals[face, 1], normals[face, 2]
                for m in range(n_active):
                    vx, vy, vz = mx[m] - hx, my[m] - hy, mz[m] - hz
                    d2 = vx * vx + vy * vy + vz * vz
                    d = np.sqrt(d2)
                    weight[m] = s * (vx * nx + vy * ny + vz * nz) / (np.float32(np.pi) * d2 * d)
                    frame[m] = (path + d) * frames_per_m
                for m in range(n_active):
                    if weight[m] > zero and frame[m] < limits[m] and (all_visible or visible[m, at]):
                        k = np.uint32(frame[m])
                        total = sums[m, k, 0] + weight[m] * share[m]
                        sums[m, k, 0] = total
                        if total >= sums[m, k, 1]:
                            _replace(sums, kept, m, k, mix(seeds[m] + np.uint64(ray)), 2 * n + 1, met, ray)
            if was_diffuse:
                specular = False
