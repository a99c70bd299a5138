"""RIRs of a model for every row of the data, and their cells: measured in the same way as the recordings' own."""

from dataclasses import dataclass, replace

import numpy as np
from joblib import Parallel, delayed

from roomeq.constants import FS_HZ
from roomeq.effects.model import behind_rendering, direct_gain, extend_scene, path_gain
from roomeq.loop.cells import measure_cells
from roomeq.loop.tables import level_slots
from roomeq.rng import rng_for
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
    """Render each row of the data.

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
    list of Raw
    """
    rows = range(len(data.rows)) if rows is None else rows
    return Parallel(n_jobs=nj, prefer="threads")(
        delayed(_render_one)(data, n, 1.0 - np.exp(-absorption[n]), effects[n], seed) for n in rows)


def _render_one(data, n, alpha, effects, seed):
    row, place, traced = data.rows[n], data.places[n], data.traced[n]
    scene = extend_scene(effects, traced.scene)
    surfaces = alpha[level_slots(scene.room).astype(int)]
    gain = path_gain(effects, row.get("source_dir"))
    (response,) = render_responses(replace(traced, scene=scene), [place.mic_pos_m],
                                   [rng_for(seed, "loop tail", row["id"])], absorption=surfaces, path_gain=gain)
    direct = direct_gain(scene, place.source_pos_m, place.mic_pos_m, gain)
    return Raw(response.rir, with_absorption(scene, surfaces), direct * response.direct_visible)


def finished(data, n, raw, effects, seed):
    """The RIR of one row with all its effects."""
    place = data.places[n]
    return behind_rendering(effects, raw.rir, raw.scene, place.source_pos_m, place.mic_pos_m, raw.direct_gain,
                            rng_for(seed, "loop effects", data.rows[n]["id"]), data.white[n])


def rendered_cells(data, raws, effects, *, seed, nj=1, rows=None):
    """Cells of rows as rendered, shape (n_rows, n_cells); NaN where there is nothing to measure."""
    def one(n, raw):
        rir = finished(data, n, raw, effects[n], seed)
        expected = data.distance_m[n] / raw.scene.air.speed_m_s * FS_HZ
        return measure_cells(rir, expected, white=data.white[n]).values

    return np.array(Parallel(n_jobs=nj, prefer="threads")(
        delayed(one)(n, raw) for n, raw in zip(range(len(data.rows)) if rows is None else rows, raws, strict=True)))
