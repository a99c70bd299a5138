"""Errors on rooms that no fit has seen: what all rooms share comes from the fit, the room's own from half its RIRs."""

import numpy as np

from roomeq.loop.heldout import scored_errors
from roomeq.loop.leftout import solve_rooms
from roomeq.loop.packing import N_SURFACE, OWN, ParameterIndex
from roomeq.loop.rendered_model import clear_rendered_changes, effects_of_rows


def score_test_set(data, session, *, seed, nj):
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
    packing = ParameterIndex(data, session.effects)
    mean = _shared(packing, session)
    correction = np.tile(session.correction.mean(axis=0), (len(data.rows), 1))
    clear_rendered_changes(data, {*session.effects, *data.given_kinds})

    def calibrated(known, chosen):
        local = solve_rooms(packing, session.fit, mean, correction, known, chosen)
        vectors = packing.vectors(mean, local)
        return packing.absorption(mean, local), effects_of_rows(data, session.effects, vectors), packing.gains(local)

    return scored_errors(data, calibrated, seed=seed, nj=nj)


def _shared(packing, session):
    """The fit's shared unknowns for the units of other data; those that it does not know get the mean."""
    before = session.packing
    mean = np.zeros(packing.n_shared)
    mean[:N_SURFACE] = session.fit.mean[:N_SURFACE]
    for k, effect in enumerate(packing.effects):
        part, _, _, size = packing.shared[k]
        known = session.fit.mean[before.shared[k][0]].reshape(before.shared[k][1], size)
        if effect.SCOPE in OWN:
            mean[part] = known[0]
            continue
        names = session.data.units(effect.SCOPE)[0]
        mean[part] = np.concatenate([known[names.index(name)] if name in names else known.mean(axis=0)
                                     for name in packing.data.units(effect.SCOPE)[0]])
    return mean
