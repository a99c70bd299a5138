"""PathSample: a fair sample of the paths that reach a microphone, for materials that are not known yet.

`roomeq.sim.echogram` walks along all stored paths for one set of absorption coefficients. Here one walk keeps, per
microphone and millisecond, `PATHS_PER_FRAME` of the paths that arrive, drawn with probabilities proportional to the energy
that they bring at a reference absorption (weighted reservoir sampling with jumps, as Efraimidis and Spirakis,
Inf. Process. Lett. 97 (2006) 181). A kept path knows what it met, so that the echogram for any other absorption is a
small matrix product: exact at the reference, unbiased elsewhere, and the noisier the further from it.

Every chunk of rays keeps its own share of the paths: strata, which no thread sees but one.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np

from roomeq.core.jit import N_CHUNKS, compiled, for_chunks, mix, on_threads
from roomeq.sim.echogram import FRAME_S, receiver_spheres, reflection_visibility

_PER_CHUNK = 2  # as `_replace` has it
PATHS_PER_FRAME = _PER_CHUNK * N_CHUNKS  # per frame
MAX_ABSORPTION = 0.999  # of the reference: a path that it left nothing of could stand for no other
_NO_GAIN = np.zeros((0, 0, 0), np.float32)
_GIVEN_UP = np.float32(1e-25)  # share of a ray's energy at the reference
_BATCH = 32  # microphones that are served in one pass over the rays


@dataclass(frozen=True)
class PathSample:
    """Paths that reach one microphone, without those of the image sources.

    Attributes
    ----------
    weight : ndarray of float32, shape (n_columns, n_frames, PATHS_PER_FRAME)
        Squared pressure that each stands for before anything was absorbed, relative to a direct sound of
        ``1 / (4 pi r)^2``; 0 where there is none. A column is one trace.
    counts : ndarray of unsigned int, shape (n_columns, n_frames, PATHS_PER_FRAME, n_surfaces)
        How often each was reflected by each surface.
    last : ndarray of uint32, shape (n_columns, n_frames, PATHS_PER_FRAME)
        Index of its last reflection among those that are stored of the column's `Paths`.
    first : tuple of ndarray
        `Paths.first` of each column.
    column_of_band : tuple of 8 ints
    """

    weight: np.ndarray
    counts: np.ndarray
    last: np.ndarray
    first: tuple
    column_of_band: tuple

    def ray(self, column):
        """Index of the ray that each came with: it left the source in that of `Paths.directions`."""
        return np.searchsorted(self.first[column], self.last[column], side="right") - 1

    def echogram(self, absorption, *, bands=None, ray_gain=None):
        """Energy that reaches the microphone from all but image sources, for any absorption; compare `compute_echograms`.

        Parameters
        ----------
        absorption : ndarray, shape (n_surfaces, 8)
        bands : sequence of int, optional
            Leave the others 0.
        ray_gain : ndarray, shape (n_rays, 8), optional
            Energy gain of each ray, for sources that are not omnidirectional.

        Returns
        -------
        ndarray, shape (n_frames, 8)
            Squared pressure per frame, without air absorption.
        """
        bands = np.arange(len(self.column_of_band)) if bands is None else np.asarray(bands)
        column_of_band = np.asarray(self.column_of_band)
        kept = np.asarray(1.0 - absorption, dtype=np.float32)
        result = np.zeros((self.weight.shape[1], len(column_of_band)), dtype=np.float32)
        for column in np.unique(column_of_band[bands]):
            gain = _NO_GAIN if ray_gain is None else np.asarray(ray_gain, np.float32)[self.ray(column)]
            energy = np.empty(result.shape, np.float32)
            _absorb(self.weight[column], self.counts[column], int(self.counts[column].max()), kept, gain, energy)
            members = bands[column_of_band[bands] == column]
            result[:, members] = energy[:, members]
        return result


def sample_paths(traced, mics_m, reference, rngs, *, ism_order, n_frames, visible=None):
    """Sample what reaches some microphones.

    Parameters
    ----------
    traced : TracedSource
    mics_m : ndarray, shape (n_mics, 3)
    reference : ndarray, shape (n_mics, n_surfaces)
        Absorption for which the sample is best, of each microphone; see `reference_absorption`.
    rngs : sequence of numpy.random.Generator
        One per microphone; the sample of one does not depend on the others.
    ism_order : int
        As for `compute_echograms`.
    n_frames : int or sequence of int
        Frames of 1 ms from the emission on, of all or of each microphone.
    visible : list of ndarray, optional
        From `reflection_visibility`, one for each column.

    Returns
    -------
    list of PathSample
        One per microphone.
    """
    mics_m = np.atleast_2d(np.asarray(mics_m, dtype=np.float64))
    seeds = np.array([rng.integers(2 ** 63) for rng in rngs], dtype=np.uint64)
    reference = np.minimum(reference, MAX_ABSORPTION)
    sphere = receiver_spheres(traced.scene.room, mics_m)
    n_frames = np.broadcast_to(n_frames, len(mics_m))
    by_frames = np.argsort(-n_frames, kind="stable")  # towards the end of a ray, only the first few still listen
    first = tuple(paths.first for paths in traced.paths)
    result = [PathSample(*_room_for(traced.paths, count, reference.shape[1]), first, traced.path_of_band)
              for count in n_frames]
    for column, paths in enumerate(traced.paths):
        met = _tallied(paths, reference.shape[1])
        for start in range(0, len(mics_m), _BATCH):
            batch = by_frames[start:start + _BATCH]
            _keep_column(paths, met, traced.scene, mics_m[batch], reference[batch], seeds[batch],
                         [values[batch] for values in sphere], ism_order, n_frames[batch],
                         None if visible is None or not len(visible[column]) else visible[column][batch],
                         [(result[m].weight[column], result[m].counts[column], result[m].last[column])
                          for m in batch])
    return result


def _room_for(columns, n_frames, n_surfaces):
    """Arrays of the paths of one microphone, not filled yet: weight, counts, last."""
    shape = (len(columns), n_frames, PATHS_PER_FRAME)
    return np.empty(shape, np.float32), np.empty((*shape, n_surfaces), _count_type(columns)), np.empty(shape, np.uint32)


def _count_type(columns):
    return np.uint8 if max(paths.counts.max() for paths in columns) < 256 else np.uint16


def reference_absorption(absorption):
    """Reference for all bands together: what is kept at each surface is their geometric mean.

    Parameters
    ----------
    absorption : ndarray, shape (..., n_surfaces, 8)

    Returns
    -------
    ndarray, shape (..., n_surfaces)
    """
    return 1.0 - np.exp(np.log1p(-np.minimum(absorption, MAX_ABSORPTION)).mean(axis=-1))


def _tallied(paths, n_surfaces):
    """How often each surface was met up to each stored reflection, packed into words, shape (n_stored, n_words)."""
    bits = 8 * np.dtype(_count_type([paths])).itemsize
    met = np.empty((len(paths.hits), -(-n_surfaces * bits // 64)), np.uint64)
    for_chunks(len(paths.counts), lambda chunk, low, high: _tally(
        paths.codes, paths.face_surface, paths.first, paths.counts, bits, met, low, high))
    return met, bits


def _keep_column(paths, met, scene, mics_m, reference, seeds, sphere, ism_order, limits, visible, results):
    """Sample one trace into the (weight, counts, last) of each microphone; those with the most frames come first."""
    single = partial(np.asarray, dtype=np.float32)
    n_rays, n_frames, speed_m_s = len(paths.counts), int(limits[0]), scene.air.speed_m_s
    if visible is None:
        visible = reflection_visibility(paths, scene.room, mics_m, n_frames=n_frames, speed_m_s=speed_m_s)
    radius_m, volume_m3 = sphere
    shape = (N_CHUNKS, len(mics_m), n_frames)
    sums = np.zeros((*shape, 2 + _PER_CHUNK), dtype=np.float32)
    kept = np.zeros((*shape, _PER_CHUNK), dtype=np.uint32)
    given = (single(paths.source_pos_m), paths.hits, paths.codes, paths.first, paths.counts, single(paths.normals),
             paths.face_surface, np.ascontiguousarray((1.0 - reference).T, dtype=np.float32), single(paths.scattering),
             single(mics_m.T, order="C"), visible, single(radius_m ** 2), single(1.0 / volume_m3), ism_order,
             np.float32(1.0 / (speed_m_s * FRAME_S)), np.float32(paths.late_m), paths.stride, seeds, limits)
    for_chunks(n_rays, lambda chunk, low, high: _keep(*given, low, high, sums[chunk], kept[chunk]))
    power = (1.0 - reference[:, :, None]) ** np.arange(1.0 + paths.counts.max())
    scale = 1.0 / (4.0 * np.pi * n_rays * _PER_CHUNK)
    on_threads(lambda m, one: _unpack(sums[:, m], kept[:, m], *met, power[m], scale, *one), list(enumerate(results)))


@compiled
def _tally(codes, face_surface, first, counts, bits, met, low, high):
    """Count hits per surface along rays `low` to `high`, in `bits` bits each."""
    per_word, one = 64 // bits, np.uint64(1)
    so_far = np.empty(met.shape[1], np.uint64)
    for ray in range(low, high):
        so_far[:] = np.uint64(0)
        for at in range(first[ray], first[ray] + counts[ray]):
            surface = face_surface[codes[at] >> 1]
            so_far[surface // per_word] += one << np.uint64(bits * (surface % per_word))
            for word in range(len(so_far)):
                met[at, word] = so_far[word]


@compiled
def _unpack(sums, kept, met, bits, power, scale, weight, counts, last):
    """Put the strata of one microphone side by side; take out of the weights what was absorbed at the reference."""
    n_frames, n_surfaces = len(weight), len(power)
    per_word, mask = 64 // bits, (np.uint64(1) << np.uint64(bits)) - np.uint64(1)
    for frame in range(n_frames):
        for place in range(weight.shape[1]):
            chunk, n = place // kept.shape[2], place % kept.shape[2]
            at, share = kept[chunk, frame, n], 1.0
            last[frame, place] = at
            for surface in range(n_surfaces):
                hits = (met[at, surface // per_word] >> np.uint64(bits * (surface % per_word))) & mask
                counts[frame, place, surface] = hits
                share *= power[surface, hits]
            total = sums[chunk, frame, 0]
            weight[frame, place] = scale * total / share if total > 0.0 else 0.0


@compiled
def _absorb(weight, counts, most, kept, gain, energy):
    """Sum the paths of each frame, shape (n_frames, 8), less what each surface took of them.

    The eight bands are eight variables, so that they are multiplied at once; powers come from a table.
    """
    n_frames, n_places, n_surfaces = counts.shape
    power = np.ones((n_surfaces, most + 1, 8), np.float32)
    for surface in range(n_surfaces):
        for n in range(most):
            for band in range(8):
                power[surface, n + 1, band] = power[surface, n, band] * kept[surface, band]
    for frame in range(n_frames):
        e0 = e1 = e2 = e3 = e4 = e5 = e6 = e7 = np.float32(0.0)
        for place in range(n_places):
            g0 = g1 = g2 = g3 = g4 = g5 = g6 = g7 = weight[frame, place]
            for surface in range(n_surfaces):
                rho = power[surface, counts[frame, place, surface]]
                g0, g1, g2, g3 = g0 * rho[0], g1 * rho[1], g2 * rho[2], g3 * rho[3]
                g4, g5, g6, g7 = g4 * rho[4], g5 * rho[5], g6 * rho[6], g7 * rho[7]
            if len(gain):
                rho = gain[frame, place]
                g0, g1, g2, g3 = g0 * rho[0], g1 * rho[1], g2 * rho[2], g3 * rho[3]
                g4, g5, g6, g7 = g4 * rho[4], g5 * rho[5], g6 * rho[6], g7 * rho[7]
            e0, e1, e2, e3, e4, e5, e6, e7 = e0 + g0, e1 + g1, e2 + g2, e3 + g3, e4 + g4, e5 + g5, e6 + g6, e7 + g7
        out = energy[frame]
        out[0], out[1], out[2], out[3], out[4], out[5], out[6], out[7] = e0, e1, e2, e3, e4, e5, e6, e7


@compiled
def _replace(sums, kept, m, frame, stream, counter, at):
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
            kept[m, frame, place] = at
        word >>= np.uint64(32)
    sums[m, frame, 1] = min(sums[m, frame, 2], sums[m, frame, 3])


@compiled
def _keep(source, hits, codes, first, face_counts, normals, face_surface, reflection, scattering, mics, visible, radius2,
          per_volume, ism_order, frames_per_m, late_m, stride, seeds, limits, low, high, sums, kept):
    """Sample rays `low` to `high`; the walk along them is that of `roomeq.sim.echogram`.

    `sums`, shape (n_mics, n_frames, 2 + _PER_CHUNK): energy so far, the least sum at which a place changes hands, and
    that sum of each place. `kept`, shape (n_mics, n_frames, _PER_CHUNK): the last reflection of the path.
    """
    n_mics = len(sums)
    all_visible = len(visible) == 0
    zero, one = np.float32(0.0), np.float32(1.0)
    mx, my, mz = mics[0], mics[1], mics[2]
    along, weight, frame = np.empty(n_mics, np.float32), np.empty(n_mics, np.float32), np.empty(n_mics, np.float32)
    most = np.array([row.max() for row in reflection])
    share = np.empty(n_mics, np.float32)
    for ray in range(low, high):
        share[:] = one
        largest = one
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
                                _replace(sums, kept, m, k, mix(seeds[m] + np.uint64(ray)), 2 * n + 2, at - 1)
            px, py, pz, path = hx, hy, hz, new_path
            face = codes[at] >> 1
            surface = face_surface[face]
            while n_active > 0 and path * frames_per_m >= limits[n_active - 1]:
                n_active -= 1
            largest *= most[surface]
            if largest < _GIVEN_UP or n_active == 0:
                break
            for m in range(n_active):
                share[m] *= reflection[surface, m]
            if not late and path > late_m:
                if ray % stride != 0:
                    break
                late = True
                for m in range(n_active):
                    share[m] *= np.float32(stride)
            was_diffuse = (codes[at] & 1) == 1
            s = scattering[surface]
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
                            _replace(sums, kept, m, k, mix(seeds[m] + np.uint64(ray)), 2 * n + 1, at)
            if was_diffuse:
                specular = False
