"""Impulse responses of one room: trace a source once, then render any microphone, material or target.

    room = Shoebox((6, 4, 3))
    scene = Scene(room, [Material("plaster", 0.1, 0.2)] * 6)
    (response,) = simulate_rir(scene, (2, 1.5, 1.5), (4, 3, 1.2), seed=0)
"""

from dataclasses import dataclass
from functools import partial

import numpy as np

from roomeq.constants import BAND_1KHZ, FS_HZ
from roomeq.rng import rng_for
from roomeq.sim.diffraction import Diffracted, diffract
from roomeq.sim.early import Images, specular_paths
from roomeq.sim.gather import FRAME_S, gather, visibility
from roomeq.sim.jit import on_threads
from roomeq.sim.render import MAX_LENGTH_S, MIN_LENGTH_S, render, response_length_s, tail_noise
from roomeq.sim.scene import Scene, check_positions, eyring_time_s, with_absorption
from roomeq.sim.target import (
    STRAIGHT,
    TOLERANCE,
    decays_straight,
    scaled_absorption,
    solve_exponent,
    t30_of_echogram,
    t30_s,
)
from roomeq.sim.trace import Paths, dense_after_s, trace

NUM_RAYS = 20000
ISM_ORDER = 6
ORDER = 200
_PILOT_RAYS = 4000
_SMOOTH_FRAMES = 7  # of 1 ms


@dataclass(frozen=True)
class TracedSource:
    """The paths of one source, and which of them serve which band.

    Attributes
    ----------
    scene : Scene
        As traced; the absorption may be another when rendering, the scattering may not.
    source_pos_m : ndarray, shape (3,)
    paths : tuple of Paths
        One for each distinct column of scattering coefficients.
    path_of_band : tuple of 8 ints
    """

    scene: Scene
    source_pos_m: np.ndarray
    paths: tuple[Paths, ...]
    path_of_band: tuple[int, ...]

    @property
    def leaked_share(self):
        """Share of the rays that slipped through the room's surface."""
        return sum(path.n_leaked for path in self.paths) / sum(len(path.counts) for path in self.paths)

    @property
    def max_length_s(self):
        """How far the rays were followed [s]."""
        return self.paths[0].max_length_m / self.scene.air.speed_m_s


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
    absorption : ndarray, shape (n_slots, 8)
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


def trace_source(scene, source_pos_m, *, num_rays=NUM_RAYS, max_length_s=MAX_LENGTH_S, rng):
    """Trace a source: once for all microphones and all absorption coefficients.

    Parameters
    ----------
    scene : Scene
    source_pos_m : array_like, shape (3,)
    num_rays : int
        For each distinct column of scattering coefficients.
    max_length_s : float
        Longest response that will be asked for [s].
    rng : numpy.random.Generator

    Returns
    -------
    TracedSource

    Raises
    ------
    ValueError
        `num_rays` is not positive, or the source lies outside the room.
    """
    if num_rays < 1:
        raise ValueError(f"num_rays={num_rays} must be at least 1: ask for some rays")
    scene.room.require_inside("source_pos_m", source_pos_m)
    columns, path_of_band = np.unique(scene.scattering, axis=1, return_inverse=True)
    seed = int(rng.integers(2 ** 63))
    max_length_m = max_length_s * scene.air.speed_m_s
    # the same random numbers for all columns: bands then differ by their scattering alone
    paths = tuple(trace(scene.room, source_pos_m, column, num_rays=num_rays, max_length_m=max_length_m,
                        speed_m_s=scene.air.speed_m_s, rng=np.random.default_rng(seed)) for column in columns.T)
    return TracedSource(scene, np.asarray(source_pos_m, dtype=np.float64), paths,
                        tuple(int(n) for n in np.ravel(path_of_band)))


def _echograms(job, absorption, *, n_rays=None, bands=None):
    """Energy of all but the image sources, with air absorption, shape (n_mics, n_frames, 8); see `gather`."""
    traced, air = job.traced, job.traced.scene.air
    n_frames = _n_frames(job.length_s)
    wanted = range(len(traced.path_of_band)) if bands is None else bands
    result = np.zeros((len(job.mics_m), n_frames, len(traced.path_of_band)))
    for group in sorted({traced.path_of_band[band] for band in wanted}):
        members = [band for band in wanted if traced.path_of_band[band] == group]
        energy = gather(traced.paths[group], traced.scene.room, absorption, job.mics_m, ism_order=job.ism_order,
                        n_frames=n_frames, speed_m_s=air.speed_m_s, n_rays=n_rays, visible=job.visible[group],
                        ray_gain=None if job.path_gain is None else job.path_gain(traced.paths[group].directions))
        result[:, :, members] = energy[:, :, members]
    result = _smooth_late(result, dense_after_s(traced.scene.room.volume_m3, air.speed_m_s, FS_HZ))
    length_m = (np.arange(n_frames) + 0.5) * FRAME_S * air.speed_m_s
    return result * np.exp(-length_m[:, None] * air.attenuation_per_m)


def _smooth_late(energy, late_s):
    """Average the frames after a time over `_SMOOTH_FRAMES`; an exponential decay stays what it is to 0.1 dB."""
    half = _SMOOTH_FRAMES // 2
    first = int(late_s / FRAME_S) + 2 * half
    if first + 2 * half < energy.shape[1]:
        total = np.cumsum(energy[:, first - half - 1:], axis=1)
        mean = (total[:, _SMOOTH_FRAMES:] - total[:, :-_SMOOTH_FRAMES]) / _SMOOTH_FRAMES
        energy[:, first:first + mean.shape[1]] = mean
    return energy


def render_responses(traced, mics_m, rngs, *, absorption=None, length_s=None, ism_order=ISM_ORDER,
                     diffraction=True, path_gain=None):
    """Render the responses of a traced source at some microphones.

    Parameters
    ----------
    traced : TracedSource
    mics_m : array_like, shape (n_mics, 3)
    rngs : sequence of numpy.random.Generator
        One per microphone, for the noise of its tail.
    absorption : ndarray, shape (n_slots, 8), optional
        Instead of that of the traced scene.
    length_s : float, optional
        Longest response [s]; by default as long as the rays were followed.
    ism_order : int
    diffraction : bool
        Whether sound comes around the edges of a mesh (`roomeq.sim.diffraction`).
    path_gain : callable, optional
        Takes the directions in which paths leave the source, shape (n, 3), and gives their energy, shape (n, 8): a
        directivity. Diffracted sound has none.

    Returns
    -------
    list of Response

    Raises
    ------
    ValueError
        A microphone lies outside the room or on top of the source.
    """
    job = _job(traced, mics_m, rngs, length_s, ism_order, diffraction, path_gain)
    return _render(job, traced.scene.absorption if absorption is None else absorption)


def render_to_target(traced, mics_m, rngs, target_s, *, absorption=None, length_s=None, ism_order=ISM_ORDER,
                     diffraction=True, path_gain=None):
    """Render responses whose mean T30 at 1 kHz is the target, by scaling the absorption of all surfaces.

    Parameters are those of `render_responses`, and

    target_s : float
        T30 at 1 kHz [s].

    Raises
    ------
    ValueError
        No scaling was found that brings T30 within 5 % of the target, with T20 about the same: the room, its air
        or the direct sound don't allow it.
    """
    job = _job(traced, mics_m, rngs, length_s, ism_order, diffraction, path_gain)
    base = traced.scene.absorption if absorption is None else absorption

    def pilot(exponent):
        absorption = scaled_absorption(base, exponent)
        energy = _echograms(job, absorption, n_rays=_PILOT_RAYS, bands=[BAND_1KHZ])
        _add_images(energy, job, absorption)
        return t30_of_echogram(energy[:, :, BAND_1KHZ].mean(axis=0))

    rendered = {}

    def measure(exponent):
        rendered.clear()
        rendered[exponent] = _render(job, scaled_absorption(base, exponent))
        times_s = [response.t30_s for response in rendered[exponent]]
        return None if None in times_s else float(np.mean(times_s))

    guess, _ = solve_exponent(pilot, target_s, eyring_exponent(traced.scene, target_s, base))
    exponent, time_s = solve_exponent(measure, target_s, guess)
    if time_s is None or abs(time_s / target_s - 1.0) > TOLERANCE:
        found = "cannot be measured" if time_s is None else f"comes to {time_s:.3g} s"
        raise ValueError(f"target_t60_s={target_s:.3g} is out of reach: T30 at 1 kHz {found} with these materials, "
                         "however scaled: choose other materials or another target")
    if exponent not in rendered:
        measure(exponent)
    if not all(decays_straight(response.rir, response.direct_sample) for response in rendered[exponent]):
        raise ValueError(f"target_t60_s={target_s:.3g} was met by a decay that is no straight line: T20 and T30 at "
                         f"1 kHz differ by more than {STRAIGHT:.0%}: choose other materials or another target")
    return rendered[exponent]


def simulate_rir(scene, source_pos_m, mics_m, *, num_rays=NUM_RAYS, ism_order=ISM_ORDER, order=ORDER,
                 target_t60_s=None, diffraction=True, seed=0):
    """Simulate impulse responses from a source to one or more microphones.

    Parameters
    ----------
    scene : Scene
        Room, materials and air.
    source_pos_m : array_like, shape (3,)
    mics_m : array_like, shape (3,) or (n_mics, 3)
    num_rays : int
    ism_order : int
        Order up to which specular reflections are exact image sources.
    order : int
        Reflections that rays are followed for on average, more where the response needs more (see
        `needed_length_s`).
    target_t60_s : float, optional
        Scale the materials until T30 at 1 kHz (mean over the microphones) is this.
    diffraction : bool
        Whether sound comes around the edges of a mesh (`roomeq.sim.diffraction`); convex rooms have none.
    seed : int

    Returns
    -------
    list of Response
        One per microphone.

    Raises
    ------
    ValueError
        Positions outside the room or on top of each other; a target that cannot be met.
    """
    mics_m = np.atleast_2d(np.asarray(mics_m, dtype=np.float64))
    for mic_m in mics_m:
        check_positions(scene.room, source_pos_m, mic_m)
    traced = trace_source(scene, source_pos_m, num_rays=num_rays,
                          max_length_s=needed_length_s(scene, target_t60_s, order), rng=rng_for(seed, "trace", ""))
    rngs = [rng_for(seed, "tail", str(n)) for n in range(len(mics_m))]
    if target_t60_s is None:
        return render_responses(traced, mics_m, rngs, ism_order=ism_order, diffraction=diffraction)
    return render_to_target(traced, mics_m, rngs, target_t60_s, ism_order=ism_order, diffraction=diffraction)


def eyring_exponent(scene, target_s, absorption=None):
    """Exponent with which Eyring's formula meets a target at 1 kHz; a first guess.

    `absorption`, shape (n_slots, 8), stands for that of the scene if given.
    """
    absorption = scene.absorption if absorption is None else absorption
    air_area_m2 = 4.0 * scene.air.attenuation_per_m[BAND_1KHZ] * scene.room.volume_m3
    wanted_m2 = 24.0 * np.log(10.0) * scene.room.volume_m3 / (scene.air.speed_m_s * target_s) - air_area_m2
    area_m2 = scene.room.slot_area_m2
    now_m2 = -np.log(1.0 - min(0.99, area_m2 @ absorption[:, BAND_1KHZ] / area_m2.sum())) * area_m2.sum()
    return float(np.clip(wanted_m2 / max(now_m2, 1e-6), 1e-2, 1e2))


def needed_length_s(scene, target_s=None, order=ORDER):
    """How far to follow the rays [s].

    Until every band has decayed by 60 dB, by Eyring and with something to spare, and for `order` mean free
    paths ``4 V / S``; never beyond `MAX_LENGTH_S`.
    """
    area_m2 = scene.room.slot_area_m2.sum()
    depth_s = order * 4.0 * scene.room.volume_m3 / (area_m2 * scene.air.speed_m_s)
    if target_s is not None:
        scene = with_absorption(scene, scaled_absorption(scene.absorption, eyring_exponent(scene, target_s)))
    decay_s = 1.3 * eyring_time_s(scene).max() + 0.1
    return float(np.clip(max(decay_s, depth_s), MIN_LENGTH_S, MAX_LENGTH_S))


@dataclass(frozen=True)
class _Job:
    """What stays the same while absorption is searched for."""

    traced: TracedSource
    mics_m: np.ndarray
    images: list[Images]
    diffracted: list[Diffracted | None]
    noises: list[np.ndarray]
    visible: list[np.ndarray]
    length_s: float
    ism_order: int
    path_gain: object

    def image_gains(self, images, absorption):
        """Pressure of image sources, as they leave the source."""
        scene = self.traced.scene
        gains = images.gains(absorption, scene.scattering, scene.air.attenuation_per_m)
        return gains if self.path_gain is None else gains * np.sqrt(self.path_gain(images.departure))


def _job(traced, mics_m, rngs, length_s, ism_order, diffraction, path_gain):
    mics_m = np.atleast_2d(np.asarray(mics_m, dtype=np.float64))
    for mic_m in mics_m:
        check_positions(traced.scene.room, traced.source_pos_m, mic_m)
    length_s = traced.max_length_s if length_s is None else min(length_s, traced.max_length_s)
    room, air = traced.scene.room, traced.scene.air
    images = [specular_paths(room, traced.source_pos_m, mic_m, ism_order) for mic_m in mics_m]
    n_samples = int(np.ceil(length_s * FS_HZ)) + 1
    diffracted = on_threads(
        lambda mic_m, found: diffract(room, traced.source_pos_m, mic_m, speed_m_s=air.speed_m_s, n_samples=n_samples,
                                      direct_visible=found.has_direct) if diffraction else None,
        list(zip(mics_m, images, strict=True)))
    noises = [tail_noise(n_samples, room.volume_m3, air.speed_m_s, rng) for rng in rngs]
    visible = [visibility(paths, room, mics_m, n_frames=_n_frames(length_s), speed_m_s=air.speed_m_s)
               for paths in traced.paths]
    return _Job(traced, mics_m, images, diffracted, noises, visible, length_s, ism_order, path_gain)


def _n_frames(length_s):
    return int(np.ceil(length_s / FRAME_S))


def _add_images(energy, job, absorption):
    """Add the energy of image sources to echograms, in place."""
    air = job.traced.scene.air
    for echogram, found in zip(energy, job.images, strict=True):
        frame = (found.distance_m / air.speed_m_s / FRAME_S).astype(int)
        gains = job.image_gains(found, absorption)
        inside = frame < len(echogram)
        np.add.at(echogram, frame[inside], gains[inside] ** 2)


def _render(job, absorption):
    energy = _echograms(job, absorption)
    whole = energy.copy()
    _add_images(whole, job, absorption)
    return on_threads(partial(_render_one, job, absorption),
                      list(zip(job.mics_m, energy, whole, job.images, job.diffracted, job.noises, strict=True)))


def _render_one(job, absorption, mic_m, echogram, whole, images, diffracted, noise):
    traced, air = job.traced, job.traced.scene.air
    direct_sample = float(np.linalg.norm(mic_m - traced.source_pos_m) / air.speed_m_s * FS_HZ)
    length_s = min(response_length_s(whole, direct_sample / FS_HZ + 0.1), job.length_s)
    gains = job.image_gains(images, absorption)
    rir = render(images.distance_m, gains, echogram, noise, speed_m_s=air.speed_m_s,
                 n_samples=round(length_s * FS_HZ))
    if diffracted is not None:
        rir = rir + diffracted.response(absorption, traced.scene.scattering, air, len(rir))
    return Response(rir, direct_sample, images.has_direct, diffracted is not None, t30_s(rir, direct_sample),
                    absorption, traced.leaked_share)
