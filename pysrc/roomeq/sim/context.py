"""Rendering some microphones of a traced source, again and again while absorption is searched for."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from roomeq.core.constants import FS_HZ
from roomeq.core.jit import on_threads
from roomeq.sim.diffraction import Diffracted, diffract
from roomeq.sim.echogram import FRAME_S, compute_echograms
from roomeq.sim.images import SpecularPaths, specular_paths
from roomeq.sim.path_sample import PathSample, sample_paths
from roomeq.sim.paths import reflection_visibility
from roomeq.sim.render import render, response_length_s, tail_noise
from roomeq.sim.scene import check_positions
from roomeq.sim.target import t30_s
from roomeq.sim.trace import dense_after_s

_SMOOTH_FRAMES = 7  # of 1 ms
ALL_BANDS = tuple(range(8))


@dataclass(frozen=True)
class Response:
    """One impulse response and what is known about it.

    Attributes
    ----------
    rir : ndarray, shape (n_samples,)
        At `FS_HZ`, sample 0 is the emission; a direct sound at distance r has the level ``1 / (4 pi r)``.
    direct_sample : float
        ``fs r / c``.
    direct_visible : bool
        Whether the source is seen from the microphone.
    diffracted : bool
        Whether sound that came around edges is part of it.
    t30_s : float or None
        T30 at 1 kHz of `rir`.
    absorption : ndarray, shape (n_surfaces, 8)
        As used: scaled to the target if there was one.
    leaked_share : float
        Rays that slipped through the surface.
    """

    rir: np.ndarray
    direct_sample: float
    direct_visible: bool
    diffracted: bool
    t30_s: float | None
    absorption: np.ndarray
    leaked_share: float


@dataclass(frozen=True)
class RenderContext:
    """What stays the same while absorption changes.

    Attributes
    ----------
    traced : TracedSource
    mics_m : ndarray, shape (n_mics, 3)
    images : list of SpecularPaths
    diffracted : list of Diffracted or None
    noises : list of ndarray
        Of the tails.
    path_samples : list of PathSample or None
        Sampled paths; without them all stored paths are gathered for each absorption.
    visible : list of ndarray
        From `reflection_visibility`, for each trace.
    length_s : float
    ism_order : int
    path_gain : callable or None
        Directivity of the source; see `render_responses`.
    """

    traced: object
    mics_m: np.ndarray
    images: list[SpecularPaths]
    diffracted: list[Diffracted | None]
    noises: list[np.ndarray]
    path_samples: list[PathSample] | None
    visible: list[np.ndarray]
    length_s: float
    ism_order: int
    path_gain: Callable | None

    @property
    def n_frames(self):
        return int(np.ceil(self.length_s / FRAME_S))

    def image_gains(self, images, absorption, bands):
        """Pressure of image sources with the directivity of the source, shape (n_paths, n_bands)."""
        scene = self.traced.scene
        gains = images.gains(absorption[:, bands], scene.scattering[:, bands], scene.air.attenuation_per_m[bands])
        return gains if self.path_gain is None else gains * np.sqrt(self.path_gain(images.departure)[:, bands])

    def sample_paths(self, reference, rngs):
        """Sample the paths of each microphone for absorption around a reference, shape (n_surfaces,)."""
        return sample_paths(self.traced, self.mics_m, np.tile(reference, (len(self.mics_m), 1)), rngs,
                           ism_order=self.ism_order, n_frames=self.n_frames, visible=self.visible)


def make_render_context(traced, mics_m, rngs, *, length_s, ism_order, diffraction, path_gain, path_samples=None):
    """Find what does not depend on absorption; the arguments are those of `render_responses`."""
    mics_m = np.atleast_2d(np.asarray(mics_m, dtype=np.float64))
    for mic_m in mics_m:
        check_positions(traced.scene.room, traced.source_pos_m, mic_m)
    length_s = traced.max_length_s if length_s is None else min(length_s, traced.max_length_s)
    room, speed_m_s = traced.scene.room, traced.scene.air.speed_m_s
    images = [specular_paths(room, traced.source_pos_m, mic_m, ism_order) for mic_m in mics_m]
    n_samples = int(np.ceil(length_s * FS_HZ)) + 1
    diffracted = on_threads(
        lambda mic_m, found: diffract(room, traced.source_pos_m, mic_m, speed_m_s=speed_m_s, n_samples=n_samples,
                                      direct_visible=found.has_direct) if diffraction else None,
        list(zip(mics_m, images, strict=True)))
    noises = [tail_noise(n_samples, room.volume_m3, speed_m_s, rng) for rng in rngs]
    n_frames = int(np.ceil(length_s / FRAME_S))
    visible = [] if path_samples is not None else [reflection_visibility(paths, room, mics_m, max_path_m=n_frames * FRAME_S * speed_m_s)
                                             for paths in traced.paths]
    return RenderContext(traced, mics_m, images, diffracted, noises, path_samples, visible, length_s, ism_order, path_gain)


def ray_echograms(context, absorption, bands):
    """Energy of all but the image sources, with air absorption, shape (n_mics, n_frames, n_bands)."""
    scene, paths, bands = context.traced.scene, context.traced.paths, list(bands)
    ray_gain = None if context.path_gain is None else context.path_gain(paths[0].directions)  # the same in all traces
    result = np.zeros((len(context.mics_m), context.n_frames, len(bands)))
    if context.path_samples is not None:
        found = on_threads(lambda sample: sample.echogram(absorption, bands=bands, ray_gain=ray_gain)[:context.n_frames, bands],
                           [(sample,) for sample in context.path_samples])
        for energy, one in zip(result, found, strict=True):
            energy[:len(one)] = one
    else:
        group_of_band = np.array(context.traced.trace_of_band)[bands]
        for group in np.unique(group_of_band):
            energy = compute_echograms(paths[group], scene.room, absorption, context.mics_m, ism_order=context.ism_order,
                            n_frames=context.n_frames, speed_m_s=scene.air.speed_m_s, visible=context.visible[group],
                            ray_gain=ray_gain)[:, :, bands]
            result[:, :, group_of_band == group] = energy[:, :, group_of_band == group]
    result = _smooth_late(result, dense_after_s(scene.room.volume_m3, scene.air.speed_m_s, FS_HZ))
    length_m = (np.arange(context.n_frames) + 0.5) * FRAME_S * scene.air.speed_m_s
    return result * np.exp(-length_m[:, None] * scene.air.attenuation_per_m[bands])


def _smooth_late(energy, late_s):
    """Average the frames after a time over `_SMOOTH_FRAMES`; an exponential decay stays what it is to 0.1 dB."""
    half = _SMOOTH_FRAMES // 2
    first = int(late_s / FRAME_S) + 2 * half
    if first + 2 * half < energy.shape[1]:
        total = np.cumsum(energy[:, first - half - 1:], axis=1)
        mean = (total[:, _SMOOTH_FRAMES:] - total[:, :-_SMOOTH_FRAMES]) / _SMOOTH_FRAMES
        energy[:, first:first + mean.shape[1]] = mean
    return energy


def add_image_sources(context, energy, absorption, bands):
    """Echograms with the energy of the image sources added."""
    speed_m_s, result = context.traced.scene.air.speed_m_s, energy.copy()
    for one, images in zip(result, context.images, strict=True):
        frame = (images.distance_m / speed_m_s / FRAME_S).astype(int)
        inside = frame < len(one)
        np.add.at(one, frame[inside], context.image_gains(images, absorption, bands)[inside] ** 2)
    return result


def render_microphones(context, absorption, bands=ALL_BANDS):
    """Render every microphone: list of Response; of a few neighbouring bands, only their share of the response."""
    bands = list(bands)
    energy = ray_echograms(context, absorption, bands)
    whole = add_image_sources(context, energy, absorption, bands)
    return on_threads(partial(_render_one, context, absorption, bands),
                      list(zip(context.mics_m, energy, whole, context.images, context.diffracted, context.noises, strict=True)))


def _render_one(context, absorption, bands, mic_m, energy, whole, images, diffracted, noise):
    traced, air = context.traced, context.traced.scene.air
    direct_sample = float(np.linalg.norm(mic_m - traced.source_pos_m) / air.speed_m_s * FS_HZ)
    length_s = min(response_length_s(whole, direct_sample / FS_HZ + 0.1), context.length_s)
    rir = render(images.distance_m, context.image_gains(images, absorption, bands), energy, noise,
                 speed_m_s=air.speed_m_s, n_samples=round(length_s * FS_HZ), bands=bands)
    if diffracted is not None:
        rir = rir + diffracted.response(absorption, traced.scene.scattering, air, len(rir))
    return Response(rir, direct_sample, images.has_direct, diffracted is not None, t30_s(rir, direct_sample),
                    absorption, traced.leaked_share)
