"""Rendered RIRs of a model for every row of the data, and their features, measured like those of the recordings."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from roomeq.core.arrays import FloatArray, IntArray
from roomeq.core.constants import FS_HZ
from roomeq.core.rng import rng_for
from roomeq.core.workers import share_out
from roomeq.effects.base import Effect
from roomeq.effects.model import apply_to_rir, direct_gain, extend_scene, path_gain
from roomeq.loop.data import Data, is_timed
from roomeq.loop.features import N_FEATURES, Features, measure_features
from roomeq.loop.tables import level_surfaces
from roomeq.sim.response import render_responses
from roomeq.sim.scene import Scene, with_absorption


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


def render_rows(data: Data, absorption: FloatArray, effects: Sequence[Sequence[Effect]], *, seed: int, nj: int = 1,
                rows: Sequence[int] | IntArray | None = None) -> tuple[list[RawRir], FloatArray]:
    """Render rows of the data and measure their features.

    Parameters
    ----------
    data : roomeq.loop.data.Data
    absorption : ndarray, shape (n_rirs, 2, 8)
        ``-ln(1 - alpha)`` of walls, and of floor and ceiling.
    effects : sequence of sequence of Effect
        Of each row.
    seed : int
    nj : int
    rows : ndarray of int, optional
        Only these RIRs.

    Returns
    -------
    raw_rirs : list of RawRir
    features : ndarray, shape (n_rows, n_features)
        NaN where there is nothing to measure.
    """
    rows = range(len(data.rows)) if rows is None else rows
    scenes = {n: _scene(data.traced[n].scene, 1.0 - np.exp(-absorption[n]), effects[n]) for n in rows}

    def render_and_measure(n: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        raw = _render_row(data, n, scenes[n], effects[n], seed)
        return raw.rir, raw.direct_gain, measure_row(data, n, raw, effects[n], seed).values

    rendered = share_out(render_and_measure, rows, nj)  # a scene may be large and need not travel
    return ([RawRir(rir, scenes[n], direct) for n, (rir, direct, _) in zip(rows, rendered, strict=True)],
            np.array([features for *_, features in rendered]))


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
    features = share_out(lambda job: measure_row(data, job[0], raw_rirs[job[0]], job[1], seed).values, jobs, nj)
    return np.reshape(features, (len(variants), len(data.rows), N_FEATURES))


def finished_rir(data: Data, n: int, raw: RawRir, effects: Sequence[Effect], seed: int) -> FloatArray:
    """Return the RIR of row `n` with all its effects."""
    place = data.places[n]
    return apply_to_rir(effects, raw.rir, raw.scene, place.source_pos_m, place.mic_pos_m, raw.direct_gain,
                        rng_for(seed, "loop effects", data.rows[n]["id"]), data.white[n])


def measure_row(data: Data, n: int, raw: RawRir, effects: Sequence[Effect], seed: int) -> Features:
    """Measure the features of row `n` as rendered with all its effects."""
    expected_sample, missing = samples_ahead(data, n, raw)
    rir = np.concatenate([np.zeros(missing), finished_rir(data, n, raw, effects, seed)])
    return measure_features(rir, expected_sample + missing, white=data.white[n])


def samples_ahead(data: Data, n: int, raw: RawRir) -> tuple[float, int]:
    """Return the direct sample of a rendering, and the number of samples that it lacks ahead of its direct sound.

    A recording whose time of flight is unknown may have more samples there than the rendering, which then gets as many.
    """
    expected_sample = data.distance_m[n] / raw.scene.air.speed_m_s * FS_HZ
    missing = 0 if is_timed(data.rows[n]) else max(0, int(np.ceil(data.direct_sample[n] - expected_sample)))
    return float(expected_sample), missing


def _scene(scene: Scene, alpha: FloatArray, effects: Sequence[Effect]) -> Scene:
    """Scene of the traced source with effects and absorption coefficients of shape (2, 8)."""
    return with_absorption(extend_scene(effects, scene), alpha[level_surfaces(scene.room).astype(int)])


def _render_row(data: Data, n: int, scene: Scene, effects: Sequence[Effect], seed: int) -> RawRir:
    row, place = data.rows[n], data.places[n]
    gain = path_gain(effects, row.get("source_dir"))
    (response,) = render_responses(replace(data.traced[n].load(), scene=scene), [place.mic_pos_m],
                                   [rng_for(seed, "loop tail", row["id"])], path_gain=gain)
    direct = direct_gain(scene, place.source_pos_m, place.mic_pos_m, gain) * response.direct_visible
    return RawRir(response.rir, scene, direct)
