"""Errors on rooms that no fit has seen: what all rooms share comes from the fit, the room's own from half its RIRs."""

import numpy as np

from roomeq.loop.cells import HAS_GAIN, LARGEST
from roomeq.loop.heldout import KNOWN, Errors, halves
from roomeq.loop.layout import N_SURFACE, OWN, Layout
from roomeq.loop.leftout import PEEKED, solve_rooms
from roomeq.loop.rendering import render_rows, rendered_cells
from roomeq.loop.session import effects_of_rows


def judge_errors(data, session, *, seed, nj):
    """Score a session's model on other data.

    Parameters
    ----------
    data : roomeq.loop.data.Data
        Rooms, and perhaps loudspeakers and microphones, that the session has not seen.
    session : Session
    seed, nj : int

    Returns
    -------
    roomeq.loop.heldout.Errors
    """
    layout = Layout(data, session.effects)
    mean = _shared(layout, session)
    offset = np.tile(session.offset.mean(axis=0), (len(data.rows), 1))
    for effect in session.effects:
        if effect.NODES:
            data.shifts[effect.NAME] = np.zeros((len(effect.NODES), *data.cells.shape))  # rendering tells
    first, second = halves(data)
    result = {}
    for way, chosen in KNOWN.items():
        cells = np.full(data.cells.shape, np.nan)
        for known, scored in ((first, second), (second, first)):
            rows = np.concatenate(scored)
            if not len(rows):  # every room has a single RIR
                continue
            local = solve_rooms(layout, session.fit, mean, offset, known, chosen)
            absorption, vectors = layout.absorption(mean, local), layout.vectors(mean, local)
            by_row = effects_of_rows(data, session.effects, vectors)
            raws = render_rows(data, absorption[data.room], by_row, seed=seed, nj=nj, rows=rows)
            rendered = rendered_cells(data, raws, by_row, seed=seed, nj=nj, rows=rows)
            error = np.abs(data.cells[rows] - rendered - np.outer(layout.gains(local)[rows], HAS_GAIN))
            error = np.where(np.isfinite(error), np.minimum(error, LARGEST), LARGEST)
            cells[rows] = np.where(data.valid[rows] & ~PEEKED, error, np.nan)
        result[way] = cells
    return Errors(result, data.room)


def _shared(layout, session):
    """The fit's shared unknowns for the units of other data; those that it does not know get the mean."""
    before = session.layout
    mean = np.zeros(layout.n_shared)
    mean[:N_SURFACE] = session.fit.mean[:N_SURFACE]
    for k, effect in enumerate(layout.effects):
        part, _, _, size = layout.shared[k]
        known = session.fit.mean[before.shared[k][0]].reshape(before.shared[k][1], size)
        if effect.SCOPE in OWN:
            mean[part] = known[0]
            continue
        names = session.data.units(effect.SCOPE)[0]
        mean[part] = np.concatenate([known[names.index(name)] if name in names else known.mean(axis=0)
                                     for name in layout.data.units(effect.SCOPE)[0]])
    return mean
