"""Rendering of the responses at the microphones of a traced source, for any absorption coefficients.

What does not depend on absorption is computed once, because the search for a target T60 renders repeatedly.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from roomeq.core.arrays import Array, FloatArray
from roomeq.core.constants import bands_hz
from roomeq.core.jit import on_threads
from roomeq.sim.array_noise import make_coherent
from roomeq.sim.boundary import NearImages, near_images
from roomeq.sim.defaults import ISM_ORDER
from roomeq.sim.diffraction import Diffracted, diffract
from roomeq.sim.echogram import FRAME_S, Echograms, compute_echograms
from roomeq.sim.images import SpecularPaths, specular_paths
from roomeq.sim.path_sample import PathSample, sample_paths
from roomeq.sim.paths import reflection_visibility
from roomeq.sim.ray_limits import few_rays_db
from roomeq.sim.render import is_cut, render, response_length_s, tail_noise
from roomeq.sim.scene import check_positions
from roomeq.sim.target import decay_times_s
from roomeq.sim.trace import late_after_s

if TYPE_CHECKING:
    from roomeq.sim.response import TracedSource

Directivity = Callable[[FloatArray], FloatArray]
"""Of a source or microphone: maps unit vectors away from it, shape (n, 3), to gains of pressure, shape (n, n_bands)."""
_SMOOTHING_FRAMES = 7  # length of the moving average over the late echogram


class NotFiniteError(ValueError):
    """A response contains infinity or what is not a number."""


@dataclass(frozen=True)
class Response:
    """One simulated impulse response.

    Attributes
    ----------
    rir
        Sound pressure, sampled at the scene's rate, shape (n_samples,). The source emits a unit pulse at sample 0, so
        the direct sound at distance r has the pressure ``1 / (4 pi r)`` before air absorption.
    direct_sample
        Arrival time of the direct sound in samples, ``fs r / c``; not rounded.
    direct_visible
        Whether the line from the source to the microphone is unobstructed.
    diffracted
        Whether `rir` contains diffracted sound.
    fs_hz
        Sample rate.
    absorption
        Absorption coefficients used, after scaling to a target T60 if there was one, shape (n_surfaces, n_bands).
    leaked_share
        Share of the rays that left the room through a gap between faces.
    is_cut
        Whether the response ends, at the length that was asked for, less than `roomeq.sim.render.CUT_DB` below its
        whole energy in some octave.
    few_rays_db
        How much few rays tell of the decay (`roomeq.sim.ray_limits.few_rays_db`): above `FEW_RAYS_DB` there, T30 of an
        octave is uncertain by 10 %, and more rays would tell it better. With fewer than 10,000 rays it is lower all the
        same; None with fewer than 3600, which do not tell.
    """

    rir: FloatArray
    direct_sample: float
    direct_visible: bool
    diffracted: bool
    fs_hz: int
    absorption: FloatArray
    leaked_share: float
    is_cut: bool
    few_rays_db: float | None

    @property
    def t20_s(self) -> float | None:
        """T20 at 1 kHz of `rir`; None if it does not decay by 25 dB."""
        return self._decay_times_s[0]

    @property
    def t30_s(self) -> float | None:
        """T30 at 1 kHz of `rir`; None if it does not decay by 35 dB."""
        return self._decay_times_s[1]

    @cached_property
    def _decay_times_s(self) -> tuple[float | None, float | None]:
        return decay_times_s(self.rir, self.direct_sample, self.fs_hz, is_cut=self.is_cut)


@dataclass(frozen=True)
class RenderContext:
    """Inputs of rendering that do not depend on absorption.

    Attributes
    ----------
    traced
        The source, with the paths of its rays.
    mics_m
        Positions, shape (n_mics, 3).
    images
        Specular paths to each microphone, from image sources.
    diffracted
        Diffracted sound at each microphone; None for a microphone that no diffracted sound reaches.
    noises
        Noise signal from which the late part of each microphone's response is rendered.
    path_samples
        Random sample of the paths to each microphone; None to follow all stored paths in each rendering.
    visible
        Result of `reflection_visibility` for each trace; empty if there are path samples.
    length_s
        Largest length of a response.
    ism_order
        Largest number of reflections of image sources.
    source_directivity
        None if the source is omnidirectional.
    mic_directivities
        One per microphone, None for an omnidirectional one. They need path samples, which know where sound comes from.
    near_source, near_mics
        Images of source and microphones in the surfaces next to them.
    """

    traced: "TracedSource"
    mics_m: FloatArray
    images: list[SpecularPaths]
    diffracted: list[Diffracted | None]
    noises: list[Array]
    path_samples: list[PathSample] | None
    visible: list[Array]
    length_s: float
    ism_order: int
    source_directivity: Directivity | None
    mic_directivities: Sequence[Directivity | None]
    near_source: NearImages
    near_mics: list[NearImages]

    @property
    def n_frames(self) -> int:
        """Number of echogram frames in `length_s`."""
        return int(np.ceil(self.length_s / FRAME_S))

    @cached_property
    def ray_gain(self) -> Array | None:
        """Energy gain of each ray at a directive source, shape (n_rays, n_bands); None for an omnidirectional one.

        That of rays of which no path is in the samples is not computed, and 0.
        """
        if self.source_directivity is None:
            return None
        directions = self.traced.paths[0].directions  # of all traces
        used = np.full(len(directions), self.path_samples is None)
        for sample in self.path_samples or ():
            used[sample.rays.ravel()] = True
        of_used = np.square(self.source_directivity(directions[used]))
        gain = np.zeros((len(directions), of_used.shape[1]), np.float32)
        gain[used] = of_used
        return gain

    def image_gains(self, absorption: FloatArray, bands: list[int]) -> list[FloatArray]:
        """Return the pressure of the image sources at each microphone, with directivities, shape (n_paths, n_bands)."""
        scene, of_mics = self.traced.scene, []
        for images, mic_directivity in zip(self.images, self.mic_directivities, strict=True):
            gains = images.gains(absorption[:, bands], scene.scattering[:, bands], scene.attenuation_per_m[bands])
            for directivity, directions in ((self.source_directivity, images.departure),
                                            (mic_directivity, images.arrival)):
                if directivity is not None:
                    gains = gains * directivity(directions)[:, bands]
            of_mics.append(gains)
        return of_mics

    def with_all_paths(self) -> "RenderContext":
        """Return a context that follows all stored paths in each rendering."""
        scene = self.traced.scene
        max_path_m = self.n_frames * FRAME_S * scene.air.speed_m_s
        return replace(self, path_samples=None, visible=[
            reflection_visibility(paths, scene.room, self.mics_m, max_path_m=max_path_m)
            for paths in self.traced.paths])

    def of_mics(self, mics: Sequence[int]) -> "RenderContext":
        """Return a context of some of the microphones."""
        return replace(
            self, mics_m=self.mics_m[list(mics)], images=[self.images[mic] for mic in mics],
            diffracted=[self.diffracted[mic] for mic in mics], noises=[self.noises[mic] for mic in mics],
            path_samples=None if self.path_samples is None else [self.path_samples[mic] for mic in mics],
            visible=[visible[list(mics)] if len(visible) else visible for visible in self.visible],
            mic_directivities=[self.mic_directivities[mic] for mic in mics],
            near_mics=[self.near_mics[mic] for mic in mics])

    def sample_paths(self, absorption: FloatArray, rngs: Sequence[np.random.Generator]) -> list[PathSample]:
        """Draw a sample of the paths to each microphone, for absorption of shape (n_surfaces,) in all bands."""
        in_all_bands = np.tile(absorption[:, None], self.traced.scene.n_bands)
        return sample_paths(self.traced, self.mics_m, in_all_bands, rngs, ism_order=self.ism_order,
                            n_frames=self.n_frames, visible=self.visible)


def make_render_context(traced: "TracedSource", mics_m: ArrayLike, rngs: Sequence[np.random.Generator], *,
                        length_s: float | None = None, ism_order: int = ISM_ORDER, diffraction: bool = True,
                        source_directivity: Directivity | None = None,
                        mic_directivities: Sequence[Directivity | None] | None = None,
                        path_samples: list[PathSample] | None = None,
                        arrays: Sequence[int] | None = None) -> RenderContext:
    """Compute the inputs of rendering that do not depend on absorption; see `render_responses` for the parameters."""
    mics_m = np.atleast_2d(np.asarray(mics_m, dtype=np.float64))
    mic_directivities = [None] * len(mics_m) if mic_directivities is None else mic_directivities
    if path_samples is None and any(mic_directivities):
        raise ValueError("a directive microphone needs path samples, which know where sound comes from: give them")
    for mic_m in mics_m:
        check_positions(traced.scene.room, traced.source_pos_m, mic_m)
    length_s = traced.max_length_s if length_s is None else min(length_s, traced.max_length_s)
    room, speed_m_s, fs_hz = traced.scene.room, traced.scene.air.speed_m_s, traced.scene.fs_hz
    to_mic = partial(specular_paths, room, traced.source_pos_m, order=ism_order)
    images = [to_mic(mics_m[0])]  # finds, in a mesh, the image sources of all
    images += on_threads(to_mic, [(mic_m,) for mic_m in mics_m[1:]])
    n_samples = int(np.ceil(length_s * fs_hz)) + 1
    diffracted: list[Diffracted | None] = [None] * len(mics_m)
    if diffraction:
        diffracted = on_threads(
            lambda mic_m, paths, mic_directivity: diffract(
                room, traced.source_pos_m, mic_m, speed_m_s=speed_m_s, fs_hz=fs_hz, n_samples=n_samples,
                direct_visible=paths.has_direct,
                directions=source_directivity is not None or mic_directivity is not None),
            list(zip(mics_m, images, mic_directivities, strict=True)))
    noises = [tail_noise(n_samples, room.volume_m3, speed_m_s, rng, fs_hz) for rng in rngs]
    of_arrays = [] if arrays is None else list(arrays)
    for array in set(of_arrays):
        members = [mic for mic, of_array in enumerate(of_arrays) if of_array == array]
        if len(members) > 1:
            mixed = make_coherent([noises[mic] for mic in members], mics_m[members], speed_m_s, fs_hz,
                                  [mic_directivities[mic] for mic in members])
            for mic, noise in zip(members, mixed, strict=True):
                noises[mic] = noise
    near_source, *near_mics = (
        near_images(traced.scene, point_m, directivity) for point_m, directivity in zip(
            [traced.source_pos_m, *mics_m], [source_directivity, *mic_directivities], strict=True))
    context = RenderContext(traced, mics_m, images, diffracted, noises, path_samples, [], length_s, ism_order,
                            source_directivity, mic_directivities, near_source, near_mics)
    return context if path_samples is not None else context.with_all_paths()


def ray_echograms(context: RenderContext, absorption: FloatArray, bands: Sequence[int]) -> Echograms:
    """Return the energy per frame of the traced rays.

    Air absorption and the gain at surfaces (`roomeq.sim.boundary`) are included, image sources are not.
    """
    scene, paths, bands = context.traced.scene, context.traced.paths, list(bands)
    if not context.traced.serves(absorption):
        raise ValueError("the surfaces absorb far less than was expected when the source was traced: trace it again "
                         "with the absorption of now")
    ray_gain = context.ray_gain
    result = np.zeros((len(context.mics_m), context.n_frames, len(bands)))
    gain = np.ones((context.n_frames, len(bands)), np.float32)
    if context.path_samples is not None:
        def from_sample(sample: PathSample, mic_m: FloatArray, directivity: Directivity | None) -> Array:
            arrival_gain = None if directivity is None else sample.gain_of_arrivals(paths, mic_m, directivity)
            energy = sample.echogram(absorption, bands=bands, ray_gain=ray_gain, arrival_gain=arrival_gain)[:, bands]
            return _in_frames_of(energy, scene.air.speed_m_s * FRAME_S / sample.frame_m)[:context.n_frames]

        # microphones of an array that hear alike have one echogram
        heard = [(id(sample), mic if directivity is not None else None)
                 for mic, (sample, directivity) in enumerate(zip(context.path_samples, context.mic_directivities,
                                                                 strict=True))]
        jobs = dict(zip(heard, zip(context.path_samples, context.mics_m, context.mic_directivities, strict=True),
                        strict=True))
        echograms = dict(zip(jobs, on_threads(from_sample, list(jobs.values())), strict=True))
        for energy, key in zip(result, heard, strict=True):
            energy[:len(echograms[key])] = echograms[key]
        limited = context.path_samples[0].limited_gain(absorption, bands)[:context.n_frames]
        gain[:len(limited)] = limited
    else:
        trace_of_band = np.array(context.traced.trace_of_band)[bands]
        for trace in np.unique(trace_of_band):
            of_trace = compute_echograms(paths[trace], scene.room, absorption, context.mics_m,
                                         ism_order=context.ism_order, n_frames=context.n_frames,
                                         speed_m_s=scene.air.speed_m_s, visible=context.visible[trace],
                                         ray_gain=ray_gain)
            served = trace_of_band == trace
            result[:, :, served], gain[:, served] = (values[..., bands][..., served] for values in of_trace)
    result = _smooth_late(result, late_after_s(scene.room.volume_m3, scene.air.speed_m_s))
    length_m = (np.arange(context.n_frames) + 0.5) * FRAME_S * scene.air.speed_m_s
    of_source, *of_mics = (near.gain(scene, absorption)[bands] for near in (context.near_source, *context.near_mics))
    return Echograms(result * np.exp(-length_m[:, None] * scene.attenuation_per_m[bands])
                     * of_source * np.array(of_mics)[:, None, :], gain)


def _in_frames_of(energy: Array, length: float) -> Array:
    """Return an echogram, shape (n_frames, n_bands), in frames of another length, relative to that of its own."""
    if abs(length - 1.0) < 1e-9:
        return energy
    so_far = np.concatenate([np.zeros((1, energy.shape[1])), np.cumsum(energy, axis=0, dtype=np.float64)])
    place = np.minimum(length * np.arange(len(energy) + 1), len(energy))
    whole = np.minimum(place.astype(int), len(energy) - 1)
    return np.diff(so_far[whole] + (place - whole)[:, None] * energy[whole], axis=0)


def _smooth_late(energy: FloatArray, late_s: float) -> FloatArray:
    """Apply a moving average of `_SMOOTHING_FRAMES` to the frames later than `late_s`, in place.

    It changes an exponential decay by at most 0.1 dB where its T60 is 0.13 s or more, and by 0.6 dB at 0.05 s.
    """
    half = _SMOOTHING_FRAMES // 2
    first = int(late_s / FRAME_S) + 2 * half
    if first + 2 * half < energy.shape[1]:
        total = np.cumsum(energy[:, first - half - 1:], axis=1)
        mean = (total[:, _SMOOTHING_FRAMES:] - total[:, :-_SMOOTHING_FRAMES]) / _SMOOTHING_FRAMES
        energy[:, first:first + mean.shape[1]] = mean
    return energy


def add_image_sources(context: RenderContext, energy: FloatArray, gains: Sequence[FloatArray]) -> FloatArray:
    """Return echograms with the energy of the image sources added; `gains` of each microphone's."""
    speed_m_s, result = context.traced.scene.air.speed_m_s, energy.copy()
    for echogram, images, pressure in zip(result, context.images, gains, strict=True):
        frame = (images.distance_m / speed_m_s / FRAME_S).astype(int)
        inside = frame < len(echogram)
        np.add.at(echogram, frame[inside], pressure[inside] ** 2)
    return result


def render_microphones(context: RenderContext, absorption: FloatArray) -> list[Response]:
    """Render the response at every microphone."""
    bands = list(range(context.traced.scene.n_bands))
    gains, rays = context.image_gains(absorption, bands), ray_echograms(context, absorption, bands)
    total_energy = add_image_sources(context, rays.energy, gains)
    return on_threads(partial(_render_microphone, context, absorption, rays.gain),
                      list(enumerate(zip(gains, rays.energy, total_energy, strict=True))))


def _render_microphone(context: RenderContext, absorption: FloatArray, limited_gain: Array, mic: int,
                       parts: tuple[FloatArray, FloatArray, FloatArray]) -> Response:
    """Render one microphone from the pressure of its image sources, and its energy per frame: of the rays, and all.

    `limited_gain` is the gain of all rays in each frame (`Echograms`).
    """
    traced, scene, mic_m, images = context.traced, context.traced.scene, context.mics_m[mic], context.images[mic]
    gains, ray_energy, total_energy = parts
    speed_m_s, fs_hz = scene.air.speed_m_s, scene.fs_hz
    distance_m = float(np.linalg.norm(mic_m - traced.source_pos_m))
    direct_sample = distance_m / speed_m_s * fs_hz
    length_s = min(response_length_s(total_energy, direct_sample / fs_hz + 0.1), context.length_s)
    rir = render(images.distance_m, gains, ray_energy, context.noises[mic], speed_m_s=speed_m_s,
                 n_samples=round(length_s * fs_hz), fs_hz=fs_hz,
                 hidden_m=None if images.has_direct else distance_m)
    if (diffracted := context.diffracted[mic]) is not None:
        rir = rir + diffracted.response(absorption, scene, len(rir), context.source_directivity,
                                        context.mic_directivities[mic])
    if not np.all(np.isfinite(rir)):
        raise NotFiniteError(_not_finite(mic_m, absorption, total_energy, fs_hz))
    return Response(rir, direct_sample, images.has_direct, diffracted is not None, fs_hz, absorption,
                    traced.leaked_share, is_cut(total_energy),
                    few_rays_db(total_energy, limited_gain, len(traced.paths[0].counts)))


def _not_finite(mic_m: FloatArray, absorption: FloatArray, energy: FloatArray, fs_hz: float) -> str:
    """Say where a response is not finite: energy of shape (n_frames, n_bands) tells the octaves."""
    bands = list(range(energy.shape[1]))
    octaves = [band for band in bands if not np.all(np.isfinite(energy[:, band]))] or bands
    names = ", ".join(f"{bands_hz(fs_hz)[band]:g}" for band in octaves)
    return (f"the response at mic_pos_m={[round(float(x), 3) for x in mic_m]} is not finite in the octaves at {names} "
            f"Hz, where surfaces absorb up to {absorption[:, octaves].max():.4g}: choose other materials, another "
            "range of T60 or another seed")
