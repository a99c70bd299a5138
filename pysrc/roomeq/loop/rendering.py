"""Rendered RIRs of a model for every row of the data, and their features, measured like those of the recordings."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from roomeq.core.arrays import FloatArray, IntArray
from roomeq.core.constants import FS_HZ
from roomeq.core.rng import rng_for
from roomeq.core.workers import share_out
from roomeq.effects.base import Effect
from roomeq.effects.model import apply_to_rir, direct_gain, extend_scene, is_directive, path_gain
from roomeq.loop.data import Data, is_timed
from roomeq.loop.features import N_FEATURES, Features, feature_slice, measure_features
from roomeq.loop.tables import level_surfaces
from roomeq.sim.response import render_responses
from roomeq.sim.scene import Scene, with_absorption

Result = TypeVar("Result")
_LARGEST_GROUP = 8  # rows that are rendered together


@dataclass(frozen=True)
class RawRir:
    """An RIR before the effects that act on it as a whole (`Effect.on_rir`).

    Attributes
    ----------
    rir : ndarray, shape (n_samples,)
    scene : roomeq.sim.scene.Scene
    direct_gain : ndarray, shape (8,)
        Pressure of the direct sound; 0 where it is obstructed by the room itself.
    """

    rir: FloatArray
    scene: Scene
    direct_gain: FloatArray


def map_rendered(work: Callable[[int, RawRir], Result], data: Data, absorption: FloatArray,
                 effects: Sequence[Sequence[Effect]], *, seed: int, nj: int = 1,
                 rows: Sequence[int] | IntArray | None = None) -> list[Result]:
    """Render rows of the data and return ``work(row, raw_rir)`` of each; only its results leave the processes.

    Parameters
    ----------
    work : callable
    data : roomeq.loop.data.Data
    absorption : ndarray, shape (n_rirs, 2, 8)
        ``-ln(1 - alpha)`` of walls, and of floor and ceiling.
    effects : sequence of sequence of Effect
        Of each row.
    seed : int
    nj : int
    rows : ndarray of int, optional
        Only these RIRs.
    """
    rows = range(len(data.rows)) if rows is None else rows

    def render_group(group: list[int]) -> list[Result]:
        first = group[0]
        scene = _scene(data.traced[first].scene, 1.0 - np.exp(-absorption[first]), effects[first])
        return [work(n, raw) for n, raw in zip(group, _render_group(data, group, scene, effects[first], seed),
                                               strict=True)]

    groups = _groups_of_paths(data, absorption, effects, rows)
    done = share_out(render_group, groups, nj, label="render sources")
    of_row = {n: result for group, results in zip(groups, done, strict=True)
              for n, result in zip(group, results, strict=True)}
    return [of_row[n] for n in rows]


def render_rows(data: Data, absorption: FloatArray, effects: Sequence[Sequence[Effect]], *, seed: int, nj: int = 1,
                rows: Sequence[int] | IntArray | None = None) -> tuple[list[RawRir], FloatArray]:
    """Render rows of the data and measure their features; see `map_rendered` for the parameters.

    Returns
    -------
    raw_rirs : list of RawRir
    features : ndarray, shape (n_rows, n_features)
        NaN where there is nothing to measure.
    """
    rows = range(len(data.rows)) if rows is None else rows

    def parts(n: int, raw: RawRir) -> tuple[FloatArray, FloatArray, FloatArray]:  # a scene may be large
        return raw.rir, raw.direct_gain, measure_row(data, n, raw, effects[n], seed).values

    rirs, direct_gains, features = zip(*map_rendered(parts, data, absorption, effects, seed=seed, nj=nj, rows=rows),
                                       strict=True)
    scenes = (_scene(data.traced[n].scene, 1.0 - np.exp(-absorption[n]), effects[n]) for n in rows)
    return [RawRir(*raw) for raw in zip(rirs, scenes, direct_gains, strict=True)], np.array(features)


def rendered_features(data: Data, absorption: FloatArray, effects: Sequence[Sequence[Effect]], *, seed: int,
                      nj: int = 1, rows: Sequence[int] | IntArray | None = None) -> FloatArray:
    """Return the features of `render_rows` alone."""
    return np.array(map_rendered(lambda n, raw: measure_row(data, n, raw, effects[n], seed).values, data, absorption,
                                 effects, seed=seed, nj=nj, rows=rows))


def _groups_of_paths(data: Data, absorption: FloatArray, effects: Sequence[Sequence[Effect]],
                     rows: Sequence[int] | IntArray) -> list[list[int]]:
    """Group rows that have the same paths with the same gains but for the microphone: one pass over rays serves them.

    Groups have at most `_LARGEST_GROUP` rows, so that there is work for several processes. Results do not depend on
    the groups.
    """
    groups: dict[tuple, list[list[int]]] = {}
    for n in rows:
        scene = data.traced[n].scene
        before_paths = tuple(effect for effect in effects[n]
                             if is_directive(effect) or extend_scene([effect], scene) is not scene)
        of_key = groups.setdefault((data.traced[n], absorption[n].tobytes(), before_paths,
                                    tuple(data.rows[n].get("source_dir") or ())), [[]])
        if len(of_key[-1]) == _LARGEST_GROUP:
            of_key.append([])
        of_key[-1].append(int(n))
    return [group for of_key in groups.values() for group in of_key]


def features_with_effects(data: Data, raw_rirs: Sequence[RawRir], variants: Sequence[Sequence[Sequence[Effect]]], *,
                          seed: int, nj: int = 1) -> FloatArray:
    """Measure the features of all rows with other effects on the rendered RIRs.

    Parameters
    ----------
    data : roomeq.loop.data.Data
    raw_rirs : sequence of RawRir
        Of every row.
    variants : sequence of sequence of sequence of Effect
        In each variant, the effects of each row.
    seed, nj : int

    Returns
    -------
    ndarray, shape (n_variants, n_rirs, n_features)
    """
    jobs = [(n, effects[n]) for effects in variants for n in range(len(data.rows))]
    features = share_out(lambda job: measure_row(data, job[0], raw_rirs[job[0]], job[1], seed).values, jobs, nj,
                         label="render RIRs with other parameters")
    return np.reshape(features, (len(variants), len(data.rows), N_FEATURES))


def finished_rir(data: Data, n: int, raw: RawRir, effects: Sequence[Effect], seed: int) -> FloatArray:
    """Return the RIR of row `n` with all its effects."""
    place = data.places[n]
    return apply_to_rir(effects, raw.rir, raw.scene, place.source_pos_m, place.mic_pos_m, raw.direct_gain,
                        rng_for(seed, "loop effects", data.rows[n]["id"]), data.white[n])


def measure_row(data: Data, n: int, raw: RawRir, effects: Sequence[Effect], seed: int) -> Features:
    """Measure the features of row `n` as rendered with all its effects.

    Nobody can tell the noise at the end of a recording from a decay that is not over there. Any level between that of
    the rendering's noise alone and that of its noise and its decay agrees with the model.
    """
    rir, direct_sample, end = on_recording_time(data, n, raw, finished_rir(data, n, raw, effects, seed))
    features, at = measure_features(rir, direct_sample, white=data.white[n], end=end), feature_slice("floor")
    recorded, alone = data.features[n, at], features.values[at]
    features.values[at] = np.where(recorded > alone, np.minimum(recorded, features.end_level), alone)
    return features


def on_recording_time(data: Data, n: int, raw: RawRir, rir: FloatArray) -> tuple[FloatArray, float, int]:
    """Return a rendering of row `n`, its direct sample, and the sample at which its recording ends.

    A recording whose time of flight is unknown may have more samples ahead of its direct sound than the rendering,
    which then gets as many.
    """
    direct_sample = float(data.distance_m[n] / raw.scene.air.speed_m_s * FS_HZ)
    missing = 0 if is_timed(data.rows[n]) else max(0, int(np.ceil(data.direct_sample[n] - direct_sample)))
    direct_sample += missing
    end = round(direct_sample + data.n_samples[n] - data.direct_sample[n])
    return np.concatenate([np.zeros(missing), rir]), direct_sample, end


def _scene(scene: Scene, alpha: FloatArray, effects: Sequence[Effect]) -> Scene:
    """Scene of the traced source with effects and absorption coefficients of shape (2, 8)."""
    return with_absorption(extend_scene(effects, scene), alpha[level_surfaces(scene.room).astype(int)])


def _render_group(data: Data, group: list[int], scene: Scene, effects: Sequence[Effect], seed: int) -> list[RawRir]:
    """Render rows of `_groups_of_paths`, with the scene and the effects of any of them."""
    gain = path_gain(effects, data.rows[group[0]].get("source_dir"))
    responses = render_responses(replace(data.traced[group[0]].load(), scene=scene),
                                 [data.places[n].mic_pos_m for n in group],
                                 [rng_for(seed, "loop tail", data.rows[n]["id"]) for n in group],
                                 source_directivity=gain)
    return [RawRir(response.rir, scene, response.direct_visible * direct_gain(
        scene, data.places[n].source_pos_m, data.places[n].mic_pos_m, gain))
        for n, response in zip(group, responses, strict=True)]
