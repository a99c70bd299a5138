"""Echograms: squared pressure that traced rays contribute at microphones, per octave band and millisecond.

`compute_echograms` follows all stored paths for one set of absorption coefficients; the rules of what counts are those
of `roomeq.sim.paths`. Where absorption changes again and again, `roomeq.sim.path_sample` is faster.
"""

from functools import partial
from typing import NamedTuple

import numpy as np

from roomeq.core.arrays import Array, FloatArray, Number
from roomeq.core.jit import N_CHUNKS, compiled, for_chunks
from roomeq.sim.paths import (
    BEHIND,
    SEEN,
    Rules,
    at_source,
    chord,
    cross_spheres,
    follow,
    receiver_spheres,
    reflection_visibility,
    scatter,
    segment_counts,
)
from roomeq.sim.ray_limits import ray_limits
from roomeq.sim.room import Room
from roomeq.sim.trace import Paths

FRAME_S = 1e-3
MICS_PER_PASS = 32
"""Microphones that one pass over the rays serves."""
NEGLIGIBLE = np.float32(1e-10)  # share of a ray's energy below which it is given up, 40 dB below -60 dB
BANDS_PER_PASS = 8
"""Octave bands that the kernels serve at once; at a sample rate with nine, the highest takes another pass."""
_NO_GAIN = np.zeros((0, BANDS_PER_PASS), np.float32)


def eight_bands(values: Array, first: int) -> Array:
    """Return eight of the bands on the last axis, from `first` on; beyond the highest it is repeated.

    Returns
    -------
    ndarray of float32, shape (..., 8)
    """
    if first == 0 and values.shape[-1] == BANDS_PER_PASS and values.dtype == np.float32:
        return values
    return np.asarray(values[..., np.minimum(np.arange(first, first + BANDS_PER_PASS), values.shape[-1] - 1)],
                      dtype=np.float32)


class Echograms(NamedTuple):
    """Energy of rays per frame.

    Attributes
    ----------
    energy
        Squared pressure, shape (n_mics, n_frames, n_bands).
    gain
        Of the energy of all rays, which makes up for the limits of single ones (`roomeq.sim.ray_limits.RayLimits`),
        shape (n_frames, n_bands).
    """

    energy: FloatArray
    gain: Array


def compute_echograms(paths: Paths, room: Room, absorption: FloatArray, mics_m: Array, *, ism_order: int,
                      n_frames: int, speed_m_s: float, visible: Array | None = None,
                      ray_gain: Array | None = None) -> Echograms:
    """Compute the echograms of all rays at some microphones.

    Parameters
    ----------
    paths
    room
    absorption
        Shape (n_surfaces, n_bands).
    mics_m
        Shape (n_mics, 3).
    ism_order
        Purely specular paths with at most this many reflections are left out.
    n_frames
        Frames of 1 ms from the emission on.
    speed_m_s
    visible
        From `reflection_visibility`; computed where it is not given.
    ray_gain
        Energy gain of each ray at the source, shape (n_rays, n_bands); 1 by default.

    Returns
    -------
    Echograms
        Relative to a direct sound of ``1 / (4 pi r)^2``; without air absorption.
    """
    mics_m = np.atleast_2d(np.asarray(mics_m, dtype=np.float64))
    single = partial(np.asarray, dtype=np.float32)
    reflection = (1.0 - absorption)[paths.face_surface]
    scattering = single(paths.scattering[paths.face_surface])
    if visible is None:
        visible = reflection_visibility(paths, room, mics_m, max_path_m=n_frames * FRAME_S * speed_m_s)
    n_rays, spheres = len(paths.counts), receiver_spheres(room, mics_m)
    n_bands = absorption.shape[1]
    result, gains = np.empty((len(mics_m), n_frames, n_bands)), np.empty((n_frames, n_bands), np.float32)
    frames_per_m = np.float32(1.0 / (speed_m_s * FRAME_S))
    for band in range(0, n_bands, BANDS_PER_PASS):
        bands, reflected = slice(band, min(band + BANDS_PER_PASS, n_bands)), eight_bands(reflection, band)
        gain = _NO_GAIN if ray_gain is None else eight_bands(ray_gain, band)
        limits = ray_limits(paths, reflected, gain, n_frames=n_frames, frames_per_m=float(frames_per_m))
        for first in range(0, len(mics_m), MICS_PER_PASS):
            batch = slice(first, first + MICS_PER_PASS)
            parts = np.zeros((N_CHUNKS, len(mics_m[batch]), n_frames, BANDS_PER_PASS), dtype=np.float32)
            constant = (Rules(ism_order, np.float32(paths.late_m)), paths.hits, paths.codes, paths.first, paths.counts,
                        single(paths.normals), paths.curved, reflected, scattering,
                        single(mics_m[batch].T, order="C"), visible[batch], single(spheres.radius_m[batch] ** 2),
                        single(1.0 / spheres.volume_m3[batch]), frames_per_m, gain, limits.largest)
            for_chunks(n_rays, lambda chunk, low, high: _accumulate(*constant, low, high, parts[chunk]))  # noqa: B023
            energy = parts.sum(axis=0, dtype=np.float64) * limits.gain
            result[batch, :, bands] = energy[..., :bands.stop - band]
        gains[:, bands] = limits.gain[:, :bands.stop - band]
    return Echograms(result / (4.0 * np.pi * n_rays), gains)


@compiled
def _add(row: Array, limit: Array, weight: Number, g0: Number, g1: Number, g2: Number, g3: Number, g4: Number,
         g5: Number, g6: Number, g7: Number) -> None:
    row[0] += weight * min(g0, limit[0])
    row[1] += weight * min(g1, limit[1])
    row[2] += weight * min(g2, limit[2])
    row[3] += weight * min(g3, limit[3])
    row[4] += weight * min(g4, limit[4])
    row[5] += weight * min(g5, limit[5])
    row[6] += weight * min(g6, limit[6])
    row[7] += weight * min(g7, limit[7])


@compiled
def _accumulate(rules: Rules, hits: Array, codes: Array, first: Array, counts: Array, normals: Array, curved: Array,
                reflection: Array, scattering: Array, mics: Array, visible: Array, radius2: Array, per_volume: Array,
                frames_per_m: Number, ray_gain: Array, limits: Array, low: Number, high: Number, echo: Array) -> None:
    """Add what rays `low` to `high` contribute to `echo`, shape (n_mics, n_frames, 8), in single precision.

    The contribution of a reflection to every microphone comes first, in loops that are vectorised over microphones,
    then its accumulation. The eight bands are eight variables, so that they are added at once. `limits`, shape
    (n_frames, 8), are those of the energy of a ray (`roomeq.sim.ray_limits`).
    """
    n_mics, n_frames, _ = echo.shape
    all_visible = len(visible) == 0
    zero, one = np.float32(0.0), np.float32(1.0)
    along, weight, frame = np.empty(n_mics, np.float32), np.empty(n_mics, np.float32), np.empty(n_mics, np.float32)
    for ray in range(low, high):
        g0, g1, g2, g3, g4, g5, g6, g7 = one, one, one, one, one, one, one, one
        if len(ray_gain):
            g = ray_gain[ray]
            g0, g1, g2, g3, g4, g5, g6, g7 = g[0], g[1], g[2], g[3], g[4], g[5], g[6], g[7]
        step, hit = at_source(), (zero, zero, zero, zero)
        for n in range(counts[ray]):
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
                            _add(echo[m, k], limits[k], (leave - enter) * per_volume[m],
                                 g0, g1, g2, g3, g4, g5, g6, g7)
            if n + 1 == counts[ray]:
                break
            face = codes[at] >> 2
            rho = reflection[face]
            g0, g1, g2, g3 = g0 * rho[0], g1 * rho[1], g2 * rho[2], g3 * rho[3]
            g4, g5, g6, g7 = g4 * rho[4], g5 * rho[5], g6 * rho[6], g7 * rho[7]
            if max(max(max(g0, g1), max(g2, g3)), max(max(g4, g5), max(g6, g7))) < NEGLIGIBLE:
                break
            step = follow(step, rules, codes[at], hit[3], scattering[face], curved[face])
            if step.represents_two:
                g0, g1, g2, g3, g4, g5, g6, g7 = g0 + g0, g1 + g1, g2 + g2, g3 + g3, g4 + g4, g5 + g5, g6 + g6, g7 + g7
            if step.scattered > zero:
                scatter(hit, normals, face, step.scattered, mics, frames_per_m, n_mics, weight, frame)
                for m in range(n_mics):
                    if weight[m] > zero and frame[m] < n_frames and (all_visible or visible[m, at] & SEEN):
                        k = np.uint32(frame[m])
                        _add(echo[m, k], limits[k], weight[m], g0, g1, g2, g3, g4, g5, g6, g7)
