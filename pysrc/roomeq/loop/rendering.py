"""Rendered RIRs of a model for every row of the data, and their features, measured like those of the recordings."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import numpy as np

from roomeq.core.arrays import FloatArray, IntArray
from roomeq.core.constants import FS_HZ
from roomeq.core.rng import rng_for
from roomeq.core.workers import share_out
from roomeq.effects.base import Effect
from roomeq.effects.model import apply_to_rir, direct_gain, extend_scene, path_gain
from roomeq.loop.data import Data
from roomeq.loop.features import N_FEATURES, Features, feature_slice, measure_features
from roomeq.loop.tables import level_surfaces
from roomeq.records.schema import is_timed
from roomeq.sim.response import render_responses
from roomeq.sim.scene import Scene, with_absorption

Result = TypeVar("Result")


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


class RowModel(NamedTuple):
    """A row of the data, and the model of its RIR.

    Attributes
    ----------
    n : int
    absorption : ndarray, shape (2, 8)
        ``-ln(1 - alpha)`` of walls, and of floor and ceiling.
    effects : sequence of Effect
    """

    n: int
    absorption: FloatArray
    effects: Sequence[Effect]


def map_rendered(work: Callable[[RowModel, RawRir], Result], data: Data, models: Sequence[RowModel], *, seed: int,
                 nj: int = 1) -> list[Result]:
    """Render rows of the data and return ``work(model, raw_rir)`` of each; only its results leave the processes."""
    return share_out(lambda model: work(model, _render(data, model, seed)), models, nj, label="render RIRs")


def render_rows(data: Data, models: Sequence[RowModel], *, seed: int, nj: int = 1) -> tuple[list[RawRir], FloatArray]:
    """Render rows of the data and measure their features.

    Returns
    -------
    raw_rirs : list of RawRir
    features : ndarray, shape (n_rows, n_features)
        NaN where there is nothing to measure.
    """
    def parts(model: RowModel, raw: RawRir) -> tuple[FloatArray, FloatArray, FloatArray]:  # a scene may be large
        return raw.rir, raw.direct_gain, measure_row(data, model.n, raw, model.effects, seed).values

    rirs, direct_gains, features = zip(*map_rendered(parts, data, models, seed=seed, nj=nj), strict=True)
    scenes = (_scene_of(data, model) for model in models)
    return [RawRir(*raw) for raw in zip(rirs, scenes, direct_gains, strict=True)], np.array(features)


def rendered_features(data: Data, models: Sequence[RowModel], *, seed: int, nj: int = 1) -> FloatArray:
    """Return the features of `render_rows` alone."""
    return np.array(map_rendered(lambda model, raw: measure_row(data, model.n, raw, model.effects, seed).values, data,
                                 models, seed=seed, nj=nj))


def row_models(data: Data, absorption: FloatArray, effects: Sequence[Sequence[Effect]],
               rows: Sequence[int] | IntArray | None = None) -> list[RowModel]:
    """Return the models of rows of the data, all of them by default.

    Parameters
    ----------
    data : roomeq.loop.data.Data
    absorption : ndarray, shape (n_rooms, 2, 8)
        ``-ln(1 - alpha)`` of walls, and of floor and ceiling.
    effects : sequence of sequence of Effect
        Of each row of the data.
    rows : sequence of int, optional
    """
    return [RowModel(int(n), absorption[data.room[n]], effects[n])
            for n in (range(len(data.rows)) if rows is None else rows)]


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


def _scene_of(data: Data, model: RowModel) -> Scene:
    """Return the scene of a row with its absorption and its effects.

    An octave without valid decay times may be fitted with a decay that is longer than the traced rays can show.
    """
    traced, alpha = data.traced[model.n].bare, 1.0 - np.exp(-model.absorption)
    absorption = traced.served(alpha[level_surfaces(traced.scene.room).astype(int)])
    return with_absorption(extend_scene(model.effects, traced.scene), absorption)


def _render(data: Data, model: RowModel, seed: int) -> RawRir:
    n, scene, place = model.n, _scene_of(data, model), data.places[model.n]
    gain = path_gain(model.effects, data.rows[n].get("source_dir"))
    (response,) = render_responses(replace(data.traced[n].load(), scene=scene), [place.mic_pos_m],
                                   [rng_for(seed, "loop tail", data.rows[n]["id"])], source_directivity=gain,
                                   path_samples=[data.path_samples[n].load()])
    return RawRir(response.rir, scene, response.direct_visible * direct_gain(
        scene, place.source_pos_m, place.mic_pos_m, gain))
