"""RIRs of a model for every row of the data, and their features: measured in the same way as the recordings' own."""

from dataclasses import dataclass, replace

import numpy as np

from roomeq.core.constants import FS_HZ
from roomeq.core.rng import rng_for
from roomeq.core.workers import share_out
from roomeq.effects.model import apply_to_rir, direct_gain, extend_scene, path_gain
from roomeq.loop.features import N_FEATURES, measure_features
from roomeq.loop.tables import level_surfaces
from roomeq.sim.response import render_responses
from roomeq.sim.scene import with_absorption


@dataclass(frozen=True)
class Raw:
    """An RIR before effects that act behind the rendering.

    Attributes
    ----------
    rir : ndarray, shape (n_samples,)
    scene : Scene
    direct_gain : ndarray, shape (8,)
        Pressure of the direct sound; 0 where it is obstructed by the room itself.
    """

    rir: np.ndarray
    scene: object
    direct_gain: np.ndarray


def render_rows(data, absorption, effects, *, seed, nj=1, rows=None):
    """Render rows of the data and measure what comes of it.

    Parameters
    ----------
    data : roomeq.loop.data.Data
    absorption : ndarray, shape (n_rirs, 2, 8)
        ``-ln(1 - alpha)`` of walls, and of floor and ceiling.
    effects : list of list of Effect
        Of each row.
    seed : int
    nj : int
    rows : ndarray of int, optional
        Only these RIRs.

    Returns
    -------
    raws : list of Raw
    features : ndarray, shape (n_rows, n_features)
        NaN where there is nothing to measure.
    """
    rows = range(len(data.rows)) if rows is None else rows
    scenes = {n: _scene(data.traced[n].scene, 1.0 - np.exp(-absorption[n]), effects[n]) for n in rows}

    def one(n):
        rir, direct = _render_one(data, n, scenes[n], effects[n], seed)
        return rir, direct, _features(data, n, Raw(rir, scenes[n], direct), effects[n], seed)

    rendered = share_out(one, rows, nj)  # a scene may be large, and need not travel
    return ([Raw(rir, scenes[n], direct) for n, (rir, direct, _) in zip(rows, rendered, strict=True)],
            np.array([features for *_, features in rendered]))


def features_with_effects(data, raws, variants, *, seed, nj=1):
    """Features of all rows with other effects behind the rendering.

    Parameters
    ----------
    data : roomeq.loop.data.Data
    raws : list of Raw
    variants : list of list of list of Effect
        In each, the effects of each row.
    seed, nj : int

    Returns
    -------
    ndarray, shape (n_variants, n_rirs, n_features)
    """
    jobs = [(n, effects[n]) for effects in variants for n in range(len(data.rows))]
    features = share_out(lambda job: _features(data, job[0], raws[job[0]], job[1], seed), jobs, nj)
    return np.reshape(features, (len(variants), len(data.rows), N_FEATURES))


def _scene(scene, alpha, effects):
    return with_absorption(extend_scene(effects, scene), alpha[level_surfaces(scene.room).astype(int)])


def _render_one(data, n, scene, effects, seed):
    """An RIR and the pressure of its direct sound, as in `Raw`."""
    row, place = data.rows[n], data.places[n]
    gain = path_gain(effects, row.get("source_dir"))
    (response,) = render_responses(replace(data.traced[n], scene=scene), [place.mic_pos_m],
                                   [rng_for(seed, "loop tail", row["id"])], path_gain=gain)
    return response.rir, direct_gain(scene, place.source_pos_m, place.mic_pos_m, gain) * response.direct_visible


def finished_rir(data, n, raw, effects, seed):
    """The RIR of a row with all its effects."""
    place = data.places[n]
    return apply_to_rir(effects, raw.rir, raw.scene, place.source_pos_m, place.mic_pos_m, raw.direct_gain,
                            rng_for(seed, "loop effects", data.rows[n]["id"]), data.white[n])


def _features(data, n, raw, effects, seed):
    expected = data.distance_m[n] / raw.scene.air.speed_m_s * FS_HZ
    return measure_features(finished_rir(data, n, raw, effects, seed), expected, white=data.white[n]).values
