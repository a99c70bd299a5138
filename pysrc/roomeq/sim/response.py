"""Impulse responses of one room: trace a source once, then render any microphones, materials and target.

    room = Shoebox((6, 4, 3))
    scene = Scene(room, [Material("plaster", 0.1, 0.2)] * 6)
    (response,) = simulate_responses(scene, (2, 1.5, 1.5), (4, 3, 1.2), seed=0)
"""

import logging
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from roomeq.core.arrays import BoolArray, FloatArray, IntArray
from roomeq.core.constants import BAND_1KHZ
from roomeq.core.rng import rng_for
from roomeq.sim.context import (
    Directivity,
    RenderContext,
    Response,
    add_image_sources,
    make_render_context,
    ray_echograms,
    render_microphones,
)
from roomeq.sim.defaults import ISM_ORDER, NUM_RAYS, ORDER
from roomeq.sim.echogram import FRAME_S
from roomeq.sim.path_sample import PathSample, sample_paths, sharing
from roomeq.sim.pilot import PilotRays
from roomeq.sim.render import MAX_LENGTH_S, MIN_LENGTH_S
from roomeq.sim.scene import Scene, check_positions, eyring_time_s, needed_area_m2
from roomeq.sim.target import (
    STRAIGHT,
    TOLERANCE,
    Trial,
    bracketed,
    closest,
    decays_straight,
    next_exponent,
    noise_per_frame,
    scaled_absorption,
    solve_exponent,
    t30_of_echogram,
)
from roomeq.sim.trace import Paths, play_roulette, trace

logger = logging.getLogger(__name__)

_CLOSE_ENOUGH = 0.025  # relative error of the target at which nothing is rendered again
_MAX_RENDERINGS = 5
SLOW_BANDS_S = 3.0
"""Time up to which bands are followed that decay more slowly than 1 kHz [s]."""
LEAST_DECAY = 0.45
"""Of the decay that was expected when a source was traced: slower ones would be left to too few rays."""
SERVED = (0.7, 2.5)  # exponents that a path sample serves, relative to the one for which it is drawn


@dataclass(frozen=True)
class TracedSource:
    """The paths of one source: a trace for each distinct column of scattering coefficients.

    Attributes
    ----------
    scene
        As traced. Absorption may differ when rendering, scattering may not.
    source_pos_m
        Shape (3,).
    paths
        Of each trace.
    trace_of_band
        Which trace serves each band.
    expected_absorption
        Shape (n_surfaces, n_bands). Rays that it weakens end early.
    """

    scene: Scene
    source_pos_m: FloatArray
    paths: tuple[Paths, ...]
    trace_of_band: tuple[int, ...]
    expected_absorption: FloatArray

    def serves(self, absorption: FloatArray) -> bool:
        """Tell whether enough rays are left in all bands for absorption of shape (n_surfaces, n_bands)."""
        return bool(np.all(self._decay(absorption) >= LEAST_DECAY * self._expected_decay))

    def served(self, absorption: FloatArray) -> FloatArray:
        """Return absorption of shape (n_surfaces, n_bands), raised in bands where too few rays would be left."""
        least_decay = LEAST_DECAY * self._expected_decay * (1.0 + 1e-9)
        return np.where(self._decay(absorption) < least_decay, np.maximum(absorption, 1.0 - np.exp(-least_decay)),
                        absorption)

    @cached_property
    def _expected_decay(self) -> FloatArray:
        """Decay at each reflection in a diffuse field, with which rays were traced for each band, shape (n_bands,)."""
        traced = [np.equal(self.trace_of_band, trace) for trace in self.trace_of_band]
        return self._decay(np.array([self.expected_absorption[:, bands].min(axis=1) for bands in traced]).T)

    def _decay(self, absorption: FloatArray) -> FloatArray:
        area_m2 = self.scene.room.surface_area_m2
        return -np.log(np.maximum(1.0 - area_m2 @ absorption / area_m2.sum(), 1e-6))

    @property
    def leaked_share(self) -> float:
        """Share of the rays that left the room through a gap between faces."""
        return sum(path.n_leaked for path in self.paths) / sum(len(path.directions) for path in self.paths)

    def play_roulette(self, absorption: FloatArray, max_length_s: float) -> "TracedSource":
        """Return what `trace_source` traces for some absorption and length, from a source of `trace_every_ray`.

        `absorption` has shape (n_surfaces, n_bands), and `max_length_s` is at most that of this source.
        """
        max_length_m = max_length_s * self.scene.air.speed_m_s
        paths = [play_roulette(paths, self.scene.room, column, max_length_m) for paths, column in zip(
            self.paths, _expected_of_traces(absorption, self.trace_of_band), strict=True)]
        return replace(self, paths=tuple(paths), expected_absorption=absorption)

    @property
    def max_length_s(self) -> float:
        """Time up to which the rays were followed [s]."""
        return self.paths[0].max_length_m / self.scene.air.speed_m_s


def trace_source(scene: Scene, source_pos_m: ArrayLike, *, num_rays: int = NUM_RAYS,
                 max_length_s: float = SLOW_BANDS_S, rng: np.random.Generator,
                 absorption: ArrayLike | None = None) -> TracedSource:
    """Trace a source once for all microphones and absorption coefficients.

    Parameters
    ----------
    scene
    source_pos_m
        Shape (3,).
    num_rays
        For each distinct column of scattering coefficients.
    max_length_s
        Longest response that will be rendered.
    rng
    absorption
        About that for which responses will be rendered, shape (n_surfaces, n_bands) or one for all; by default that of
        the scene. The traced energy is right for any absorption, and least noisy for this one.

    Raises
    ------
    ValueError
        `num_rays` is not positive, or the source lies outside the room.
    """
    if num_rays < 1:
        raise ValueError(f"num_rays={num_rays} must be at least 1: ask for some rays")
    scene.room.require_inside("source_pos_m", np.asarray(source_pos_m))
    expected = np.broadcast_to(scene.absorption if absorption is None else absorption, scene.absorption.shape)
    return _trace_source(scene, source_pos_m, num_rays, max_length_s, rng, expected)


def trace_every_ray(scene: Scene, source_pos_m: ArrayLike, *, num_rays: int = NUM_RAYS, max_length_s: float,
                    rng: np.random.Generator) -> TracedSource:
    """Trace a source as `trace_source` does, but let no ray end early, whatever the absorption.

    `TracedSource.play_roulette` then finds the paths for one absorption after the other.
    """
    return _trace_source(scene, source_pos_m, num_rays, max_length_s, rng, None)


def _trace_source(scene: Scene, source_pos_m: ArrayLike, num_rays: int, max_length_s: float, rng: np.random.Generator,
                  expected: FloatArray | None) -> TracedSource:
    """Trace each distinct column of scattering coefficients, with roulette for expected absorption if it is given."""
    columns, inverse = np.unique(scene.scattering, axis=1, return_inverse=True)
    trace_of_band, seed = tuple(int(n) for n in np.ravel(inverse)), int(rng.integers(2 ** 63))
    of_traces = [None] * columns.shape[1] if expected is None else _expected_of_traces(expected, trace_of_band)
    # the same random numbers for all columns: bands then differ by their scattering alone
    paths: list[Paths] = []
    for column, absorption in zip(columns.T, of_traces, strict=True):
        paths.append(trace(scene.room, source_pos_m, column, num_rays=num_rays,
                           max_length_m=max_length_s * scene.air.speed_m_s, speed_m_s=scene.air.speed_m_s,
                           rng=np.random.default_rng(seed), absorption=absorption, like=paths[-1] if paths else None))
    return TracedSource(scene, np.asarray(source_pos_m, dtype=np.float64), tuple(paths), trace_of_band,
                        np.zeros_like(scene.absorption) if expected is None else expected)


def _expected_of_traces(absorption: FloatArray, trace_of_band: Sequence[int]) -> list[FloatArray]:
    """Return the least absorption of each surface in the bands of each trace, shape (n_surfaces,) each."""
    return [absorption[:, np.equal(trace_of_band, trace)].min(axis=1) for trace in range(max(trace_of_band) + 1)]


def render_responses(traced: TracedSource, mics_m: ArrayLike, rngs: Sequence[np.random.Generator], *,
                     absorption: FloatArray | None = None, length_s: float | None = None,
                     ism_order: int = ISM_ORDER, diffraction: bool = True,
                     source_directivity: Directivity | None = None,
                     mic_directivities: Sequence[Directivity | None] | None = None,
                     path_samples: list[PathSample] | None = None,
                     arrays: Sequence[int] | None = None) -> list[Response]:
    """Render the responses of a traced source at some microphones.

    Parameters
    ----------
    traced
    mics_m
        Shape (n_mics, 3).
    rngs
        One per microphone, for the noise of its tail.
    absorption
        In place of that of the traced scene, shape (n_surfaces, n_bands).
    length_s
        Longest response; by default as long as the rays were followed.
    ism_order
        Order up to which specular reflections are exact image sources.
    diffraction
        Whether edges of a mesh diffract (`roomeq.sim.diffraction`).
    source_directivity, mic_directivities
        Of the source, and of each microphone; None is omnidirectional. Those of microphones need `path_samples`.
    path_samples
        Of the microphones, from `sample_paths` with the same `ism_order`. They replace following all stored paths and
        take a fraction of its time.
    arrays
        Number of the array that each microphone belongs to: the late reverberation of its microphones is coherent as in
        a diffuse field (`roomeq.sim.array_noise`). By default that of all microphones is independent.

    Raises
    ------
    ValueError
        A microphone lies outside the room or on top of the source, or is directive without a path sample.
    """
    context = make_render_context(traced, mics_m, rngs, length_s=length_s, ism_order=ism_order, diffraction=diffraction,
                                  source_directivity=source_directivity, mic_directivities=mic_directivities,
                                  path_samples=path_samples, arrays=arrays)
    return render_microphones(context, traced.scene.absorption if absorption is None else absorption)


def render_to_target(traced: TracedSource, mics_m: ArrayLike, rngs: Sequence[np.random.Generator], target_s: float, *,
                     absorption: FloatArray | None = None, exponent: float | None = None,
                     **options: Any) -> list[Response]:
    """Render responses whose mean T30 at 1 kHz is the target, by scaling the absorption of all surfaces.

    Echograms of a path sample and the noise of the tail predict how T30 changes with absorption. Where T30 of the
    rendered responses is another one, they are rendered again. All paths are followed where the absorption is far from
    that for which the samples were drawn, unless microphones are directive. Microphones so close to the source that its
    direct sound hides the decay (`hides_decay`) do not count, unless all are.

    Parameters
    ----------
    traced, mics_m, rngs, absorption, **options
        As for `render_responses`.
    target_s
        T30 at 1 kHz.
    exponent
        About the one that meets the target, for which path samples were drawn. By default that of Eyring's formula.

    Returns
    -------
    list of Response
        One per microphone.

    Raises
    ------
    ValueError
        No scaling brings T30 within 5 % of the target with T20 about the same, because of the room, its air or the
        direct sound.
    """
    context = make_render_context(traced, mics_m, rngs, **options)
    base = traced.scene.absorption if absorption is None else absorption
    guess = eyring_exponent(traced.scene, target_s, base) if exponent is None else exponent
    close = hides_decay(traced.scene, np.linalg.norm(context.mics_m - traced.source_pos_m, axis=1), target_s)
    used = np.arange(len(rngs)) if close.all() else np.flatnonzero(~close)
    predict = _t30_prediction(context, used, rngs, base, guess)

    @cache
    def follow_all() -> RenderContext:
        return context.with_all_paths()

    def render(exponent: float) -> list[Response]:
        served = (context.path_samples is None or any(context.mic_directivities)
                  or SERVED[0] <= exponent / guess <= SERVED[1])
        return render_microphones(context if served else follow_all(), scaled_absorption(base, exponent))

    tried, aim_s = guess, target_s
    rendered: list[Trial] = []
    best: Trial | None = None
    for _ in range(_MAX_RENDERINGS):
        if bracketed(rendered, target_s):  # the prediction is not smooth there, or it would have met the target
            tried = next_exponent(rendered, target_s)
        else:
            predicted = solve_exponent(predict, aim_s, tried)
            if predicted is None:
                break
            tried = predicted.exponent
        made = render(tried)
        time_s = _mean_t30_s([made[mic] for mic in used])
        if time_s is None:
            break
        rendered.append(Trial(tried, time_s))
        best = closest(rendered, target_s)
        if best is rendered[-1]:
            responses = made
        if abs(time_s / target_s - 1.0) <= _CLOSE_ENOUGH:
            break
        aim_s *= target_s / time_s
    if best is None or abs(best.time_s / target_s - 1.0) > TOLERANCE:
        result = "cannot be measured" if best is None else f"comes to {best.time_s:.3g} s at best"
        raise ValueError(f"target_t60_s={target_s:.3g} is out of reach: T30 at 1 kHz {result} with these materials, "
                         f"scaled {len(rendered)} times: {_remedy(close)}")
    if not all(decays_straight(responses[mic].t20_s, responses[mic].t30_s) for mic in used):
        raise ValueError(f"target_t60_s={target_s:.3g} was met by a decay that is no straight line: T20 and T30 at "
                         f"1 kHz differ by more than {STRAIGHT:.0%}: {_remedy(close)}")
    return responses


def _t30_prediction(context: RenderContext, mics: IntArray, rngs: Sequence[np.random.Generator], base: FloatArray,
                    guess: float) -> Callable[[float], float | None]:
    """Return a function that predicts the T30 at 1 kHz of some microphones, rendered with `base` to an exponent [s].

    The path samples are drawn for the exponent `guess`. The prediction is None where too few rays are left, or where
    the decay is too long to measure.
    """
    traced = context.traced
    # of microphones that hear alike, one is enough
    hears_like = mics if any(context.mic_directivities) else mics[sharing(traced.scene.room, context.mics_m[mics])]
    chosen, n_alike = np.unique(hears_like, return_counts=True)
    search = context.of_mics(chosen.tolist())
    if search.path_samples is None:
        search = replace(search, path_samples=search.sample_paths(
            scaled_absorption(base, guess)[:, BAND_1KHZ], [rngs[mic] for mic in chosen]))
    of_noises = np.array([noise_per_frame(context.noises[mic], context.n_frames, traced.scene.fs_hz) for mic in mics])
    of_noise = np.array([of_noises[hears_like == mic].mean(axis=0) for mic in chosen])

    def predict(exponent: float) -> float | None:
        absorption = scaled_absorption(base, exponent)
        if not traced.serves(absorption):
            return None
        ray_energy = ray_echograms(search, absorption, [BAND_1KHZ]).energy * of_noise[:, :, None]
        energy = add_image_sources(search, ray_energy, search.image_gains(absorption, [BAND_1KHZ]))
        return t30_of_echogram(n_alike @ energy[:, :, 0])

    return predict


def hides_decay(scene: Scene, distance_m: FloatArray, t60_s: float) -> BoolArray:
    """Tell at which distances from a source its direct sound lies 20 dB or more above the diffuse sound of a room.

    T20 then holds 5 dB of the decay or less. Both are equal at the critical distance, ``sqrt(A / (16 pi))`` (Kuttruff,
    Room Acoustics, ch. 5), with the absorption area A by Sabine's formula.
    """
    area_m2 = needed_area_m2(scene.room.volume_m3, t60_s, scene.air.speed_m_s)
    return area_m2 / (16.0 * np.pi * np.square(distance_m)) >= 100.0


def _remedy(close: BoolArray) -> str:
    if close.all():
        return ("the direct sound hides the decay at all microphones: add one further away, which may be dropped, or "
                "choose another target")
    return "choose other materials, another target or more rays (--num-rays)"


def _mean_t30_s(responses: Sequence[Response]) -> float | None:
    times_s = [response.t30_s for response in responses if response.t30_s is not None]
    return float(np.mean(times_s)) if len(times_s) == len(responses) else None


def simulate_responses(scene: Scene, source_pos_m: ArrayLike, mics_m: ArrayLike, *, num_rays: int = NUM_RAYS,
                       ism_order: int = ISM_ORDER, order: int = ORDER, target_t60_s: float | None = None,
                       diffraction: bool = True, source_directivity: Directivity | None = None,
                       mic_directivities: Sequence[Directivity | None] | None = None,
                       arrays: Sequence[int] | None = None, seed: int = 0) -> list[Response]:
    """Simulate impulse responses from a source to one or more microphones.

    Parameters
    ----------
    scene
        Room, materials and air.
    source_pos_m
        Shape (3,).
    mics_m
        Shape (3,) or (n_mics, 3).
    num_rays
        For each distinct column of scattering coefficients.
    ism_order
        Order up to which specular reflections are exact image sources.
    order
        Reflections up to which rays are followed on average; more where the response needs more (see
        `needed_length_s`).
    target_t60_s
        Scale the materials until T30 at 1 kHz (mean over the microphones) has this value.
    diffraction
        Whether edges of a mesh diffract (`roomeq.sim.diffraction`); convex rooms have no such edges.
    source_directivity, mic_directivities
        Of the source, and of each microphone: a function from unit vectors away from it, shape (n, 3), to gains of
        pressure, shape (n, n_bands), such as ``partial(FirstOrder("cardioid", (1, 0, 0)).pressure, fs_hz=16000)``. None
        is omnidirectional.
    arrays
        Number of the array that each microphone belongs to; see `render_responses`.
    seed

    Returns
    -------
    list of Response
        One per microphone.

    Raises
    ------
    ValueError
        A position lies outside the room, source and microphone coincide, there is not one directivity or number of an
        array for each microphone, a directivity is no function, or the target cannot be met.
    """
    mics_m = np.atleast_2d(np.asarray(mics_m, dtype=np.float64))
    for mic_m in mics_m:
        check_positions(scene.room, source_pos_m, mic_m)
    for name, of_mics in (("mic_directivities", mic_directivities), ("arrays", arrays)):
        if of_mics is not None and (not isinstance(of_mics, Sequence | np.ndarray) or len(of_mics) != len(mics_m)):
            raise ValueError(f"{name}={of_mics!r:.80} must be a list with one for each of {len(mics_m)} microphones: "
                             "give that many")
    for directivity in (source_directivity, *(() if mic_directivities is None else mic_directivities)):
        if directivity is not None and not callable(directivity):
            raise ValueError(f"directivity={directivity!r:.80} must be a function of directions: give that of its "
                             "method pressure at the sample rate")
    # other rooms, sources and microphones have other rays and tails, also with the same seed; of microphones in one
    # place, which may be directive, the tails before mixing have to be independent too
    of_source = (scene.room.volume_m3, *map(float, scene.room.surface_area_m2), *map(float, np.ravel(source_pos_m)))
    before: Counter[tuple[float, ...]] = Counter()
    names = []
    for place_m in (tuple(map(float, mic_m)) for mic_m in mics_m):
        names.append(repr((of_source, *place_m, *[before[place_m]] * (place_m in before))))
        before[place_m] += 1
    options: dict[str, Any] = dict(ism_order=ism_order, diffraction=diffraction, source_directivity=source_directivity,
                                   arrays=arrays)
    length_s: float | None = needed_length_s(scene, target_t60_s, order)
    expected = least = scene.absorption
    if target_t60_s is not None:
        pilot = PilotRays(scene, source_pos_m, target_t60_s, rng_for(seed, "pilot", repr(of_source)))
        by_eyring = eyring_exponent(scene, target_t60_s)
        options["exponent"] = pilot.exponent(expected, target_t60_s, by_eyring)
        # rays are traced for the least that may be needed: more is served, too little is not
        least = scaled_absorption(expected, min(by_eyring, options["exponent"]))
        expected = scaled_absorption(expected, options["exponent"])
    while length_s is not None:
        traced = trace_source(scene, source_pos_m, num_rays=num_rays, absorption=least, max_length_s=length_s,
                              rng=rng_for(seed, "trace", repr(of_source)))
        rngs = [rng_for(seed, "tail", name) for name in names]
        if mic_directivities is not None and any(mic_directivities):
            options |= dict(mic_directivities=mic_directivities, path_samples=sample_paths(
                traced, mics_m, expected,
                [rng_for(seed, "path sample", name) for name in names], ism_order=ism_order,
                n_frames=int(np.ceil(traced.max_length_s / FRAME_S))))
        if target_t60_s is not None:
            return render_to_target(traced, mics_m, rngs, target_t60_s, **options)
        responses = render_responses(traced, mics_m, rngs, **options)
        length_s = longer_length_s(responses, length_s)
    return responses


def longer_length_s(responses: Sequence[Response], length_s: float) -> float | None:
    """Return how far rays have to be followed where they were followed for `length_s`; None if that is far enough.

    It is not where responses are cut off, as sound decays more slowly than in a diffuse field. The limits are those of
    `decay_length_s`, for T20 of the responses instead of Eyring's time.
    """
    decay_s = max((1.3 * response.t20_s + 0.1 for response in responses if response.t20_s is not None), default=0.0)
    longest_s = float(np.clip(decay_s, SLOW_BANDS_S, MAX_LENGTH_S))
    if length_s >= longest_s or not any(response.is_cut for response in responses):
        return None
    return min(2.0 * length_s, longest_s)


def eyring_exponent(scene: Scene, target_s: float, absorption: FloatArray | None = None) -> float:
    """Return the exponent with which Eyring's formula meets a target at 1 kHz; a first guess.

    `absorption`, shape (n_surfaces, n_bands), replaces that of the scene.
    """
    absorption = scene.absorption if absorption is None else absorption
    air_area_m2 = 4.0 * scene.attenuation_per_m[BAND_1KHZ] * scene.room.volume_m3
    wanted_m2 = needed_area_m2(scene.room.volume_m3, target_s, scene.air.speed_m_s) - air_area_m2
    area_m2 = scene.room.surface_area_m2
    now_m2 = -np.log(1.0 - min(0.99, area_m2 @ absorption[:, BAND_1KHZ] / area_m2.sum())) * area_m2.sum()
    return float(np.clip(wanted_m2 / max(now_m2, 1e-6), 1e-2, 1e2))


def needed_length_s(scene: Scene, target_s: float | None = None, order: int = ORDER) -> float:
    """Return the time up to which rays are followed [s].

    It covers the decay (`decay_length_s`), and `order` mean free paths ``4 V / S`` up to `SLOW_BANDS_S`.
    """
    area_m2 = scene.room.surface_area_m2.sum()
    depth_s = order * 4.0 * scene.room.volume_m3 / (area_m2 * scene.air.speed_m_s)
    exponent = 1.0 if target_s is None else eyring_exponent(scene, target_s)
    absorption = scaled_absorption(scene.absorption, exponent)
    decay_1khz_s = _decay_lengths_s(scene, absorption)[BAND_1KHZ]
    if decay_1khz_s > MAX_LENGTH_S + 1e-6:
        logger.warning("responses of %.1f s or less do not hold a decay by 60 dB, which takes %.1f s at 1 kHz",
                       MAX_LENGTH_S, decay_1khz_s)
    decay_s = decay_length_s(scene, absorption)
    return max(decay_s, min(depth_s, SLOW_BANDS_S))


def decay_length_s(scene: Scene, absorption: FloatArray) -> float:
    """Return the time in which every band decays by 60 dB, by Eyring and with a margin [s].

    Beyond `SLOW_BANDS_S`, bands are not followed that decay more slowly than 1 kHz, and none beyond `MAX_LENGTH_S`.
    """
    decay_s = _decay_lengths_s(scene, absorption)
    longest_s = max(SLOW_BANDS_S, min(float(decay_s[BAND_1KHZ]), MAX_LENGTH_S))
    return float(np.clip(decay_s.max(), MIN_LENGTH_S, longest_s))


def _decay_lengths_s(scene: Scene, absorption: FloatArray) -> FloatArray:
    """Return the time in which each band decays by 60 dB, by Eyring and with a margin [s], shape (n_bands,)."""
    return 1.3 * eyring_time_s(scene, absorption) + 0.1
