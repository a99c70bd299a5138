"""What the loop found, as it is written down."""

from dataclasses import asdict

import numpy as np

from roomeq.loop.leftout import leave_rooms_out
from roomeq.loop.packing import OWN

LEDGER_FILE = "ledger.json"


def values_of(session):
    """Parameters of each effect: list of (effect, {unit: effect}, typical vector, spread of the vector)."""
    packing, data = session.packing, session.data
    vectors = packing.vectors(session.fit.mean, session.fit.local)
    result = []
    for effect, one in zip(session.effects, vectors, strict=True):
        names = data.units(effect.SCOPE)[0]
        spread = one.std(axis=0, ddof=1) if len(one) > 1 else np.zeros(one.shape[1])
        result.append((effect, {name: effect.from_vector(vector) for name, vector in zip(names, one, strict=True)},
                       one.mean(axis=0), spread))
    return result


def _parameter_intervals(session, effect):
    """Parameters with intervals of 95 %: a jackknife over rooms of what all share, the rooms' own spread else."""
    packing, data = session.packing, session.data
    k = session.effects.index(effect)
    names = data.units(effect.SCOPE)[0]
    best = packing.vectors(session.fit.mean, session.fit.local)[k]
    if effect.SCOPE in OWN:
        low = high = None
    else:
        left = np.array([packing.vectors(one.mean, session.fit.local)[k]
                         for one in leave_rooms_out(data, session.fit)])
        half = 1.96 * np.sqrt((len(left) - 1) / len(left) * np.sum((left - left.mean(axis=0)) ** 2, axis=0))
        low, high = best - half, best + half
    return {name: {"best": asdict(effect.from_vector(best[u]))} | ({} if low is None else {
        "low": asdict(effect.from_vector(low[u])), "high": asdict(effect.from_vector(high[u]))})
        for u, name in enumerate(names)}


def ranked(candidate):
    """One candidate of a ranking."""
    return dict(effect=candidate.effect.NAME, gain=candidate.total, ci=list(candidate.interval), p=candidate.p,
                size_jnd=candidate.size_jnd)


def iteration_entry(winner, rivals, ranking, session, before, after, p):
    """One accepted effect; `p` is that of the error being lower, by way (`roomeq.loop.heldout.p_lower`)."""
    way = min(p, key=lambda one: (p[one], one))
    entry = dict(
        effect=winner.effect.NAME, scope=winner.effect.SCOPE, size_jnd=winner.size_jnd,
        parameters=_parameter_intervals(session, winner.effect), scored_on=f"unseen {way}",
        heldout_error_before=before.mean(way), heldout_error_after=after.mean(way),
        heldout_error_ci=after.interval(way), p=p[way],
        by_metric={"before": before.by_metric(way), "after": after.by_metric(way)},
        by_band={"before": before.by_band(way), "after": after.by_band(way)},
        ranking=[ranked(one) for one in ranking])
    if rivals:
        entry["cannot_tell"] = [winner.effect.NAME, *(one.effect.NAME for one in rivals)]
        entry["would_tell"] = sorted({one.effect.DISCRIMINATING_MEASUREMENT for one in (winner, *rivals)})
    return entry
