"""Samples of the paths that reach a microphone, for materials that are not known yet.

`roomeq.sim.echogram` follows all stored paths for one set of absorption coefficients. Here one pass over them keeps,
per microphone and millisecond, `PATHS_PER_FRAME` of the paths that arrive, drawn with probabilities proportional to
their energy at a reference absorption (weighted reservoir sampling with jumps, Efraimidis and Spirakis, Inf. Process.
Lett. 97 (2006) 181). Each kept path stores how often each surface reflected it, so that the echogram for any other
absorption is a small matrix product.

A path that is improbable at the reference would represent others with a weight without bound. Half of the paths are
therefore drawn at the least absorption that a surface has in any band, half at the greatest, and all are weighted by
the mixture of both densities (defensive importance sampling, Hesterberg, Technometrics 37 (1995) 185; the balance
heuristic of Veach and Guibas, SIGGRAPH 1995, 419). No path then represents more than all paths together carry at the
least absorption, in any band. The estimate is unbiased, and exact where all bands absorb alike,
but for the energy of single rays that is limited at both references (`roomeq.sim.ray_limits`).

Every chunk of rays keeps its own share of the paths: the chunks are strata, and no two threads write to the same one.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import ArrayLike

from roomeq.core.arrays import Array, BoolArray, FloatArray, IntArray, Number
from roomeq.core.jit import N_CHUNKS, compiled, for_chunks, inlined, mix, on_threads
from roomeq.sim.echogram import BANDS_PER_PASS, FRAME_S, MICS_PER_PASS, eight_bands
from roomeq.sim.paths import (
    BEHIND,
    SEEN,
    Rules,
    Spheres,
    at_source,
    chord,
    cross_spheres,
    follow,
    receiver_spheres,
    reflection_visibility,
    scatter,
    segment_counts,
)
from roomeq.sim.ray_limits import LARGEST_GAIN, ray_limits
from roomeq.sim.room import Room
from roomeq.sim.scene import Scene
from roomeq.sim.trace import Paths

if TYPE_CHECKING:
    from roomeq.sim.mesh import MeshRoom
    from roomeq.sim.response import TracedSource

_PER_CHUNK = 2  # one for each reference; the kernels rely on this number
PATHS_PER_FRAME = _PER_CHUNK * N_CHUNKS
MAX_ABSORPTION = 0.999
"""Of a reference: a path without any energy there could not represent others elsewhere."""
SHARING_M = 0.1
"""Microphones this close to one another share a sample: receiver spheres are larger, and sound goes further in 1 ms."""
_FARTHEST = 1.5  # decay, relative to that of a reference, to which the gain of limited rays is extrapolated
_LOG_LARGEST_GAIN = np.float32(np.log(LARGEST_GAIN))
_ROUNDING_M = 1e-6  # of the coordinates of arrays that are turned
_NO_GAIN = np.zeros((0, 0, 0), np.float32)
_NO_EMITTED = np.zeros((0, BANDS_PER_PASS), np.float32)  # gains of rays at the source: all 1
_NEGLIGIBLE = np.float32(1e-25)  # share of a ray's energy at a reference that counts as none
_SPECULAR = np.uint32(1 << 31)  # added to the last reflection of a path that ends specularly
_EMPTY = np.float32(1e-20)  # energy of a frame at a reference that counts as none: what was neglected may show


@dataclass(frozen=True, eq=False)
class LimitedGain:
    """Gain of the energy in each frame where that of single rays is limited (`roomeq.sim.ray_limits.RayLimits`).

    Attributes
    ----------
    log_gain
        Its logarithm at both references, shape (n_traces, n_frames, 2), float32.
    decay
        ``-ln(1 - alpha)`` of the mean absorption at both references, shape (n_traces, 2).
    surface_share
        Of the area, shape (n_surfaces,).
    """

    log_gain: Array
    decay: FloatArray
    surface_share: FloatArray
    _newest: dict[tuple[int, int], tuple[Array, Array]] = field(default_factory=dict, init=False, repr=False)

    def of(self, trace: int, first: int, reflected: Array) -> Array | None:
        """Return the gain in eight bands from `first` on, shape (n_frames, 8); None if it is 1.

        Surfaces reflect shares of shape (n_surfaces, 8). All microphones get the same gain, and the newest is kept.
        """
        if not self.log_gain[trace].any():
            return None
        known, gain = self._newest.get((trace, first), (_NO_GAIN, _NO_GAIN))
        if not np.array_equal(known, reflected):
            gain = self._compute(trace, reflected)
            self._newest[trace, first] = reflected, gain
        return gain

    def _compute(self, trace: int, reflected: Array) -> Array:
        """Return the gain, shape (n_frames, 8).

        As the variance of the logarithm of the energies of rays does, its logarithm grows with the square of the decay:
        over this it is interpolated between both references, and extrapolated up to `_FARTHEST` times the decay.
        """
        decay2, (low, high) = _mean_decay(self.surface_share, reflected) ** 2, self.decay[trace] ** 2
        within = np.clip(decay2, low, high)
        share = (within - low) / (high - low) if high > low else np.full_like(decay2, 0.5)
        of_references = np.array([1.0 - share, share]) * np.minimum(decay2 / within, _FARTHEST ** 2)
        # in single precision, whose exponential takes a fraction of the time
        return np.exp(np.minimum(self.log_gain[trace] @ of_references.astype(np.float32), _LOG_LARGEST_GAIN))


@dataclass(frozen=True)
class PathSample:
    """Sample of the paths that reach one microphone, without those of the image sources.

    Attributes
    ----------
    weight
        Squared pressure that each path represents before any absorption, relative to a direct sound of
        ``1 / (4 pi r)^2``; 0 where there is none. Shape (n_traces, n_frames, PATHS_PER_FRAME), float32.
    reflection_counts
        How often each surface reflected it, shape (n_traces, n_frames, PATHS_PER_FRAME, n_surfaces), unsigned.
    last_reflection
        Index of its last reflection among those that the trace's `Paths` stores, shape (n_traces, n_frames,
        PATHS_PER_FRAME), uint32.
    specular
        Whether it ends specularly, on the way to the next reflection, shape (n_traces, n_frames, PATHS_PER_FRAME).
    rays
        Index of its ray among `Paths.directions` of the trace, shape (n_traces, n_frames, PATHS_PER_FRAME), uint32.
    trace_of_band
        Which trace serves each band.
    frame_m
        Way of the sound in a frame [m]: where the speed of sound changes, so does the length of the frames.
    limited
        What all samples of a source share.
    """

    weight: Array
    reflection_counts: Array
    last_reflection: Array
    specular: BoolArray
    rays: Array
    trace_of_band: tuple[int, ...]
    frame_m: float
    limited: LimitedGain

    def gain_of_arrivals(self, paths: Sequence[Paths], mic_m: FloatArray,
                         directivity: Callable[[FloatArray], FloatArray]) -> list[Array]:
        """Return the energy gain of each path at a directive microphone.

        Scattered sound comes from its last reflection. Specular sound comes along the ray, which passes within the
        receiver sphere: where that reflection is close, it lies in another direction.

        Parameters
        ----------
        paths
            The traces that were sampled.
        mic_m
            Shape (3,).
        directivity
            From unit vectors away from the microphone, shape (n, 3), to gains of pressure, shape (n, n_bands).

        Returns
        -------
        list of ndarray of float32, shape (n_frames, PATHS_PER_FRAME, n_bands)
            One per trace.
        """
        gains = []
        for trace, last, specular in zip(paths, self.last_reflection, self.specular, strict=True):
            at, along_ray = last.ravel(), specular.ravel()
            way_m = trace.hits[at, :3] - np.where(along_ray[:, None], trace.hits[at + along_ray, :3], mic_m)
            gain = np.square(directivity(way_m / np.maximum(np.linalg.norm(way_m, axis=1, keepdims=True), 1e-9)))
            gains.append(gain.reshape(*last.shape, -1).astype(np.float32))
        return gains

    def echogram(self, absorption: FloatArray, *, bands: ArrayLike | None = None, ray_gain: Array | None = None,
                 arrival_gain: list[Array] | None = None) -> Array:
        """Estimate what `roomeq.sim.echogram.compute_echograms` would return, for any absorption.

        Parameters
        ----------
        absorption
            Shape (n_surfaces, n_bands).
        bands
            Indices of the bands to compute; the others are 0. All by default.
        ray_gain
            Energy gain of each ray at the source, shape (n_rays, n_bands); 1 by default.
        arrival_gain
            Of each path at the microphone, from `gain_of_arrivals`; 1 by default.

        Returns
        -------
        ndarray of float32, shape (n_frames, n_bands)
            Squared pressure per frame, without air absorption.
        """
        trace_of_band = np.asarray(self.trace_of_band)
        bands = np.arange(len(trace_of_band)) if bands is None else np.asarray(bands)
        result = np.zeros((self.weight.shape[1], len(trace_of_band)), dtype=np.float32)
        energy = np.empty((len(result), BANDS_PER_PASS), np.float32)
        for trace, first in sorted({(int(trace_of_band[n]), int(n) // BANDS_PER_PASS * BANDS_PER_PASS) for n in bands}):
            of_rays = _NO_EMITTED if ray_gain is None else eight_bands(ray_gain, first)
            of_arrivals = _NO_GAIN if arrival_gain is None else eight_bands(arrival_gain[trace], first)
            counts = self.reflection_counts[trace]
            reflected = eight_bands(1.0 - absorption, first)
            _absorb(self.weight[trace], counts, self._most_reflections[trace], reflected, self.rays[trace], of_rays,
                    of_arrivals, energy)
            if (limited := self.limited.of(trace, first, reflected)) is not None:
                energy *= limited
            served = bands[(trace_of_band[bands] == trace) & (first <= bands) & (bands < first + BANDS_PER_PASS)]
            if len(served) == result.shape[1] == BANDS_PER_PASS:
                return energy
            result[:, served] = energy[:, served - first]
        return result

    def limited_gain(self, absorption: FloatArray, bands: Sequence[int]) -> Array:
        """Return the gain of all rays (`roomeq.sim.ray_limits.RayLimits`) in `echogram`, shape (n_frames, len(bands)).

        `absorption` is of all bands, shape (n_surfaces, n_bands).
        """
        result = np.ones((self.weight.shape[1], len(bands)), np.float32)
        for place, band in enumerate(bands):
            first = band // BANDS_PER_PASS * BANDS_PER_PASS
            gain = self.limited.of(self.trace_of_band[band], first, eight_bands(1.0 - absorption, first))
            if gain is not None:
                result[:, place] = gain[:, band - first]
        return result

    @cached_property
    def _most_reflections(self) -> list[int]:
        """The largest count of each trace."""
        return [int(counts.max()) for counts in self.reflection_counts]


def sample_paths(traced: "TracedSource", mics_m: Array, absorption: FloatArray, rngs: Sequence[np.random.Generator], *,
                 ism_order: int, n_frames: int, visible: Sequence[Array] | None = None) -> list[PathSample]:
    """Sample the paths that reach some microphones; those of a small array share a sample (`SHARING_M`).

    At 0.1 m, the energies of the sampled paths differ so little that T20 and EDT change by 0.2 % (rms) and C50 by
    0.02 dB: the exact image sources, which are not sampled, tell the microphones apart.

    Parameters
    ----------
    traced
    mics_m
        Shape (n_mics, 3).
    absorption
        About that for which the samples will be used, shape (n_surfaces, n_bands).
    rngs
        One per microphone; the sample of one does not depend on those further away.
    ism_order
        Purely specular paths with at most this many reflections are left out.
    n_frames
        Frames of 1 ms from the emission on.
    visible
        From `reflection_visibility`, for each trace; computed where it is not given.

    Returns
    -------
    list of PathSample
        One per microphone.
    """
    mics_m = np.atleast_2d(np.asarray(mics_m, dtype=np.float64))
    leaders, sample_of_mic = np.unique(sharing(traced.scene.room, mics_m), return_inverse=True)
    mics_m = mics_m[leaders]
    seeds = np.array([rngs[mic].integers(2 ** 63) for mic in leaders], dtype=np.uint64)
    spheres = receiver_spheres(traced.scene.room, mics_m)
    frame_m = FRAME_S * traced.scene.air.speed_m_s
    share = traced.scene.room.surface_area_m2 / traced.scene.room.surface_area_m2.sum()
    limited = LimitedGain(np.zeros((len(traced.paths), n_frames, 2), np.float32), np.zeros((len(traced.paths), 2)),
                          share)
    result = [_empty_sample(traced.paths, n_frames, len(absorption), traced.trace_of_band, frame_m, limited)
              for _ in mics_m]
    for trace, paths in enumerate(traced.paths):
        references = _references(absorption[:, np.equal(traced.trace_of_band, trace)])
        limits = ray_limits(paths, eight_bands((1.0 - references).T[paths.face_surface], 0),
                            _NO_EMITTED, n_frames=n_frames, frames_per_m=float(np.float32(1.0 / frame_m)),
                            n_bands=_PER_CHUNK)
        limited.log_gain[trace] = np.log(limits.gain)
        limited.decay[trace] = _mean_decay(share, (1.0 - references).T)
        for start in range(0, len(mics_m), MICS_PER_PASS):
            batch = slice(start, start + MICS_PER_PASS)
            _sample_trace(paths, traced.scene, mics_m[batch], references, limits.largest, seeds[batch],
                          Spheres(spheres.radius_m[batch], spheres.volume_m3[batch]), ism_order, n_frames,
                          None if visible is None or not len(visible[trace]) else visible[trace][leaders[batch]],
                          [(sample.weight[trace], sample.reflection_counts[trace], sample.last_reflection[trace],
                            sample.specular[trace], sample.rays[trace]) for sample in result[batch]])
    return [result[n] for n in sample_of_mic]


def sharing(room: Room, mics_m: FloatArray) -> IntArray:
    """Return for each microphone the first one that is close to it and seen from it, shape (n_mics,).

    Only those that share with no earlier one can be the first, so that no two are further apart than `SHARING_M`
    from the microphone whose sample they share.
    """
    first = np.arange(len(mics_m))
    for mic in range(1, len(mics_m)):
        before = np.unique(first[:mic])
        near = before[np.linalg.norm(mics_m[before] - mics_m[mic], axis=1) <= SHARING_M + _ROUNDING_M]
        if not room.convex and len(near):
            near = near[cast("MeshRoom", room).sees(mics_m[near], mics_m[mic])]
        first[mic] = near[0] if len(near) else mic
    return first


def _references(absorption: FloatArray) -> FloatArray:
    """Return the least and the greatest absorption of each surface in any band, shape (2, n_surfaces).

    Each band lies between them, so a path never has more energy in a band than at the first reference.
    """
    return np.minimum([absorption.min(axis=1), absorption.max(axis=1)], MAX_ABSORPTION)


def _mean_decay(surface_share: FloatArray, reflected: Array) -> FloatArray:
    """Return ``-ln(1 - alpha)`` of the mean absorption, for reflected shares of shape (n_surfaces, n), shape (n,)."""
    return -np.log(np.clip(surface_share @ reflected, 1e-6, 1.0 - 1e-6))


def _empty_sample(traces: Sequence[Paths], n_frames: int, n_surfaces: int, trace_of_band: tuple[int, ...],
                  frame_m: float, limited: LimitedGain) -> PathSample:
    """Allocate the sample of one microphone; nothing is filled in yet."""
    shape = (len(traces), n_frames, PATHS_PER_FRAME)
    counts_type = np.uint8 if max(paths.counts.max() for paths in traces) < 256 else np.uint16
    return PathSample(np.empty(shape, np.float32), np.empty((*shape, n_surfaces), counts_type),
                      np.empty(shape, np.uint32), np.empty(shape, np.bool_), np.empty(shape, np.uint32), trace_of_band,
                      frame_m, limited)


def _sample_trace(paths: Paths, scene: Scene, mics_m: FloatArray, references: FloatArray,
                  limits: Array, seeds: Array, spheres: Spheres, ism_order: int, n_frames: int,
                  visible: Array | None, results: list[tuple[Array, Array, Array, Array, Array]]) -> None:
    """Sample one trace into the (weight, counts, last, specular, rays) of each microphone."""
    single = partial(np.asarray, dtype=np.float32)
    n_rays, speed_m_s = len(paths.counts), scene.air.speed_m_s
    if visible is None:
        visible = reflection_visibility(paths, scene.room, mics_m, max_path_m=n_frames * FRAME_S * speed_m_s)
    shape = (N_CHUNKS, len(mics_m), n_frames)
    sums = np.zeros((*shape, 2 * _PER_CHUNK), dtype=np.float32)
    kept, of_ray = np.zeros((2, *shape, _PER_CHUNK), dtype=np.uint32)
    constant = (Rules(ism_order, np.float32(paths.late_m)), paths.hits, paths.codes, paths.first, paths.counts,
                single(paths.normals), paths.curved, paths.face_surface,
                single(1.0 - references), single(paths.scattering),
                single(mics_m.T, order="C"), visible, single(spheres.radius_m ** 2), single(1.0 / spheres.volume_m3),
                np.float32(1.0 / (speed_m_s * FRAME_S)), seeds, limits)
    for_chunks(n_rays, lambda chunk, low, high: _sample(*constant, low, high, sums[chunk], kept[chunk],
                                                        of_ray[chunk]))
    power = (1.0 - references[..., None]) ** np.arange(1.0 + paths.counts.max())
    scale = 1.0 / (4.0 * np.pi * n_rays)
    increments = _increments(paths.face_surface, len(paths.scattering), 8 * results[0][1].itemsize)
    on_threads(lambda m, arrays: _unpack(sums[:, m], kept[:, m], of_ray[:, m], paths.first, paths.codes, increments,
                                         power, scale, *arrays), list(enumerate(results)))


def _increments(face_surface: IntArray, n_surfaces: int, n_bits: int) -> Array:
    """Return what a reflection at each face adds to words of several counts each, one for each surface.

    Parameters
    ----------
    face_surface
        Surface of each face, shape (n_faces,).
    n_surfaces, n_bits
        How many counts there are, and how many bits each takes.

    Returns
    -------
    ndarray of uint64, shape (n_words, n_faces)
    """
    word, place = np.divmod(face_surface, 64 // n_bits)
    increments = np.zeros((-(-n_surfaces * n_bits // 64), len(face_surface)), np.uint64)
    increments[word, np.arange(len(face_surface))] = np.uint64(1) << (n_bits * place).astype(np.uint64)
    return increments


@compiled
def _unpack(sums: Array, kept: Array, of_ray: Array, first: Array, codes: Array, increments: Array, power: Array,
            scale: Number, weight: Array, counts: Array, last: Array, specular: Array, rays: Array) -> None:
    """Join the strata of one microphone: the weight is 1 over the sum of the densities at both references."""
    n_frames, n_places, n_surfaces = counts.shape
    n_bits = np.uint64(8 * counts.itemsize)
    per_word, mask = np.int64(np.uint64(64) // n_bits), (np.uint64(1) << n_bits) - np.uint64(1)
    for frame in range(n_frames):
        for place in range(n_places):
            chunk, n = place // kept.shape[2], place % kept.shape[2]
            at, ray, share0, share1 = kept[chunk, frame, n] & ~_SPECULAR, of_ray[chunk, frame, n], 1.0, 1.0
            rays[frame, place], last[frame, place] = ray, at
            specular[frame, place] = kept[chunk, frame, n] & _SPECULAR != 0
            for word in range(len(increments)):
                met = np.uint64(0)
                for reflection in range(np.uint64(first[ray]), np.uint64(at) + np.uint64(1)):  # unsigned is faster
                    met += increments[word, np.uint64(codes[reflection] >> 2)]
                for surface in range(word * per_word, min((word + 1) * per_word, n_surfaces)):
                    hits = met & mask
                    counts[frame, place, surface] = hits
                    share0 *= power[0, surface, hits]
                    share1 *= power[1, surface, hits]
                    met >>= n_bits
            total0, total1, density = sums[chunk, frame, 0], sums[chunk, frame, 1], 0.0
            if total0 > _EMPTY and share0 >= _NEGLIGIBLE:
                density += share0 / total0
            if total1 > _EMPTY and share1 >= _NEGLIGIBLE:
                density += share1 / total1
            weight[frame, place] = scale / density if sums[chunk, frame, n] > _EMPTY and density > 0.0 else 0.0


@compiled
def _absorb(weight: Array, counts: Array, most: Number, reflected: Array, rays: Array, ray_gain: Array,
            arrival_gain: Array, energy: Array) -> None:
    """Sum the paths of each frame, attenuated by each surface that they met, into `energy`, shape (n_frames, 8).

    Gains are those of `PathSample.echogram`, of eight bands, and empty where they are 1.

    The eight bands are eight variables, so that they are multiplied at once; powers come from a table.
    """
    n_frames, n_places, n_surfaces = counts.shape
    power = np.ones((n_surfaces, most + 1, 8), np.float32)
    for surface in range(n_surfaces):
        for n in range(most):
            for band in range(8):
                power[surface, n + 1, band] = power[surface, n, band] * reflected[surface, band]
    for frame in range(n_frames):
        e0 = e1 = e2 = e3 = e4 = e5 = e6 = e7 = np.float32(0.0)
        for place in range(n_places):
            g0 = g1 = g2 = g3 = g4 = g5 = g6 = g7 = weight[frame, place]
            for surface in range(n_surfaces):
                rho = power[surface, counts[frame, place, surface]]
                g0, g1, g2, g3 = g0 * rho[0], g1 * rho[1], g2 * rho[2], g3 * rho[3]
                g4, g5, g6, g7 = g4 * rho[4], g5 * rho[5], g6 * rho[6], g7 * rho[7]
            if len(ray_gain):
                rho = ray_gain[rays[frame, place]]
                g0, g1, g2, g3 = g0 * rho[0], g1 * rho[1], g2 * rho[2], g3 * rho[3]
                g4, g5, g6, g7 = g4 * rho[4], g5 * rho[5], g6 * rho[6], g7 * rho[7]
            if len(arrival_gain):
                rho = arrival_gain[frame, place]
                g0, g1, g2, g3 = g0 * rho[0], g1 * rho[1], g2 * rho[2], g3 * rho[3]
                g4, g5, g6, g7 = g4 * rho[4], g5 * rho[5], g6 * rho[6], g7 * rho[7]
            e0, e1, e2, e3, e4, e5, e6, e7 = e0 + g0, e1 + g1, e2 + g2, e3 + g3, e4 + g4, e5 + g5, e6 + g6, e7 + g7
        out = energy[frame]
        out[0], out[1], out[2], out[3], out[4], out[5], out[6], out[7] = e0, e1, e2, e3, e4, e5, e6, e7


@inlined
def _reflected(share: Number, reflection: Number) -> Number:
    """Return what is left of a share of energy; 0 if that is negligible."""
    left = share * reflection
    return left if left >= _NEGLIGIBLE else np.float32(0.0)


@inlined
def _add(sums: Array, m: Number, frame: Number, energy: Number, share0: Number, share1: Number) -> bool:
    """Add a path to the two sums of a frame; tell whether it takes a place of the reservoir."""
    sums[m, frame, 0] += energy * share0
    sums[m, frame, 1] += energy * share1
    return sums[m, frame, 0] > sums[m, frame, 2] or sums[m, frame, 1] > sums[m, frame, 3]


@compiled
def _replace(sums: Array, kept: Array, of_ray: Array, m: Number, frame: Number, seed: Number, ray: Number,
             counter: Number, at: Number) -> None:
    """Put a path that has just been added to the sums of a frame into the places of the reservoir that it wins.

    A new path replaces the one in a place with probability ``energy / sum so far``. The sum at which that happens next
    is drawn in advance: it exceeds the present one by a factor of more than x with probability 1 / x. Each half of one
    random number serves one place.
    """
    word = mix(mix(seed + np.uint64(ray)) + np.uint64(counter) * np.uint64(0x9E3779B97F4A7C15))
    for place in range(2):
        total = sums[m, frame, place]
        if total > sums[m, frame, 2 + place]:
            share = np.float32((word & np.uint64(0xFFFFFF)) + np.uint64(1)) * np.float32(2.0 ** -24)
            sums[m, frame, 2 + place] = total / share
            kept[m, frame, place], of_ray[m, frame, place] = at, ray
        word >>= np.uint64(32)


@compiled
def _sample(rules: Rules, hits: Array, codes: Array, first: Array, face_counts: Array, normals: Array, curved: Array,
            face_surface: Array, reflection: Array, scattering: Array, mics: Array, visible: Array, radius2: Array,
            per_volume: Array, frames_per_m: Number, seeds: Array, limits: Array, low: Number, high: Number,
            sums: Array, kept: Array, of_ray: Array) -> None:
    """Sample the paths of rays `low` to `high`.

    Parameters
    ----------
    reflection : ndarray of float32, shape (2, n_surfaces)
        Share of energy that is reflected at each reference.
    limits : ndarray of float32, shape (n_frames, 2)
        Of the energy of a ray at each reference (`roomeq.sim.ray_limits`).
    sums : ndarray of float32, shape (n_mics, n_frames, 2 * _PER_CHUNK)
        Energy so far at each reference, and the sums that must be exceeded to take the place that goes with it.
    kept : ndarray of uint32, shape (n_mics, n_frames, _PER_CHUNK)
        Last reflection of the path in each place, `_SPECULAR` added if it ends specularly.
    of_ray : ndarray of uint32, of the same shape
        Its ray.
    """
    n_mics, n_frames, _ = sums.shape
    all_visible = len(visible) == 0
    zero, one = np.float32(0.0), np.float32(1.0)
    along, weight, frame = np.empty(n_mics, np.float32), np.empty(n_mics, np.float32), np.empty(n_mics, np.float32)
    for ray in range(low, high):
        share0, share1 = one, one
        step, hit = at_source(), (zero, zero, zero, zero)
        for n in range(face_counts[ray]):
            at = first[ray] + n
            previous, hit = hit, (hits[at, 0], hits[at, 1], hits[at, 2], hits[at, 3])
            if segment_counts(step, rules, n):
                length = cross_spheres(previous, hit, mics, radius2, n_mics, along, weight)
                for m in range(n_mics):
                    if weight[m] > zero:
                        enter, leave = chord(along[m], weight[m], length)
                        middle = (previous[3] + np.float32(0.5) * (enter + leave)) * frames_per_m
                        if leave > enter and middle < n_frames and (all_visible or visible[m, at] & BEHIND == 0):
                            k = np.uint32(middle)
                            if _add(sums, m, k, (leave - enter) * per_volume[m], min(share0, limits[k, 0]),
                                    min(share1, limits[k, 1])):
                                _replace(sums, kept, of_ray, m, k, seeds[m], ray, 2 * n + 2,
                                         np.uint32(at - 1) | _SPECULAR)
            if n + 1 == face_counts[ray]:
                break
            face = codes[at] >> 2
            surface = face_surface[face]
            share0, share1 = _reflected(share0, reflection[0, surface]), _reflected(share1, reflection[1, surface])
            if share0 == zero or hit[3] * frames_per_m >= n_frames:
                break
            step = follow(step, rules, codes[at], hit[3], scattering[surface], curved[face])
            if step.represents_two:
                share0, share1 = share0 + share0, share1 + share1
            if step.scattered > zero:
                scatter(hit, normals, face, step.scattered, mics, frames_per_m, n_mics, weight, frame)
                for m in range(n_mics):
                    if weight[m] > zero and frame[m] < n_frames and (all_visible or visible[m, at] & SEEN):
                        k = np.uint32(frame[m])
                        if _add(sums, m, k, weight[m], min(share0, limits[k, 0]), min(share1, limits[k, 1])):
                            _replace(sums, kept, of_ray, m, k, seeds[m], ray, 2 * n + 1, np.uint32(at))
