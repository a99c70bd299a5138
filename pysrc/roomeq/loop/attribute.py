"""Which effect is it: each candidate is fitted with the model and judged by rooms that took no part."""

from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from roomeq.core.workers import share_out
from roomeq.effects.catalogue import CATALOGUE
from roomeq.effects.room_eq import RoomEq
from roomeq.loop.features import METRIC
from roomeq.loop.fit import Fit, fit
from roomeq.loop.leftout import leave_rooms_out
from roomeq.loop.packing import ParameterIndex
from roomeq.loop.rendered_model import in_order
from roomeq.loop.session import look_ahead

MIN_ROOMS = 3
LEVEL = 0.05
MIN_SIZE_JND = 0.5  # what an effect must change on average in what it touches: half of what can be heard
TOUCHED_JND = 0.25
_PROBE = 2  # iterations after which starts are compared


@dataclass(frozen=True)
class Candidate:
    """An effect that the model lacks, and what it would be worth.

    Attributes
    ----------
    effect : type
    fit : Fit
        Of the model with it.
    gain : ndarray, shape (n_rooms,)
        By how much it raises the logarithm of the density given to each left-out room.
    size_jnd : float
        Mean change of the features that it touches.
    """

    effect: type
    fit: Fit
    gain: np.ndarray
    size_jnd: float

    @property
    def total(self):
        return float(self.gain.sum())

    @property
    def interval(self):
        """Interval of 95 % of the mean gain over rooms."""
        half = stats.t.ppf(0.975, len(self.gain) - 1) * self.gain.std(ddof=1) / np.sqrt(len(self.gain))
        return float(self.gain.mean() - half), float(self.gain.mean() + half)

    @property
    def p(self):
        """One-sided p value of a gain over rooms (paired t test)."""
        return one_sided_p(self.gain)

    def helps(self, n_candidates):
        """Whether rooms that took no part are predicted better, for so many candidates tried.

        By chance the densities of all rooms together grow by a factor of x with a probability of at most 1 / x
        (Markov's inequality). No single room may decide it, where something went wrong, but rooms may tell little: of
        the speed of sound those in which all stands close together.
        """
        without_best = self.total - max(self.gain.max(), 0.0)
        return (without_best > np.log(n_candidates / LEVEL) and self.size_jnd >= MIN_SIZE_JND
                and np.mean(self.gain > 0.0) >= 0.5)


def one_sided_p(difference):
    """p value of a mean above zero (t test); 1 for a single value or no scatter and no gain."""
    if len(difference) < 2 or not np.any(difference):
        return 1.0
    spread = difference.std(ddof=1) / np.sqrt(len(difference))
    return float(stats.t.sf(difference.mean() / max(spread, 1e-12), len(difference) - 1))


def rank(session):
    """All effects that the model lacks, the most helpful first.

    Returns
    -------
    list of Candidate
    """
    data = session.data
    before = leave_rooms_out(data, fit(data, session.correction, session.effects, like=session.fit))
    known = {*session.effects, *data.given_kinds}
    candidates = [effect for effect in CATALOGUE.values() if effect not in known and effect.applies(data)]
    look_ahead(session, candidates)
    found = share_out(lambda effect: _candidate(session, effect, before), candidates, session.nj,
                      first_here=False)
    return sorted(found, key=lambda one: -one.total)


def _candidate(session, effect, before):
    data, effects = session.data, in_order([*session.effects, effect])
    like = session.fit
    if len(effect.STARTS) > 1:
        tried = []
        for start in effect.STARTS:
            starts = [start if one is effect else one.STARTS[0] for one in effects]
            found = fit(data, session.correction, effects, start=starts, like=session.fit, iterations=_PROBE)
            tried.append((found, np.array([one.log_density for one in leave_rooms_out(data, found)])))
        like = _best_starts(data, effects, effect, tried)
    found = fit(data, session.correction, effects, like=like)
    after = leave_rooms_out(data, found)
    gain = np.array([b.log_density - a.log_density for a, b in zip(before, after, strict=True)])
    return Candidate(effect, found, gain, size_of(session, effect, found))


def _best_starts(data, effects, effect, tried):
    """The fit from the best start; of an effect of rooms, each room's own best."""
    best = max(tried, key=lambda one: one[1].sum())[0]
    if effect.SCOPE != "room":
        return best
    packing, k = ParameterIndex(data, effects), effects.index(effect)
    of_room = np.argmax([densities for _, densities in tried], axis=0)
    chosen = np.array([packing.vectors(tried[start][0].mean, tried[start][0].local)[k][r]
                       for r, start in enumerate(of_room)])
    mean, local = best.mean.copy(), [one.copy() for one in best.local]
    mean[packing.shared[k][0]] = chosen.mean(axis=0)
    for r, vector in enumerate(chosen):
        local[r][packing.own_slices[r][0][k]] = vector - chosen.mean(axis=0)
    return replace(best, mean=mean, local=local)


def size_of(session, effect, found):
    """Mean change of the features that an effect touches, of the metric that it changes most [JND]."""
    data, packing = session.data, ParameterIndex(session.data, found.effects)
    without = ParameterIndex(data, [one for one in found.effects if one is not effect])
    absorption, vectors = packing.absorption(found.mean, found.local), packing.vectors(found.mean, found.local)
    silent = np.zeros(len(data.rows))
    change = packing.predict(absorption, vectors, silent, 0.0) - without.predict(
        absorption, [one for one, kind in zip(vectors, found.effects, strict=True) if kind is not effect], silent, 0.0)
    change = np.abs(np.where(data.valid, change, 0.0))
    by_metric = [change[:, METRIC == metric] for metric in np.unique(METRIC)]
    return float(max(one[one > TOUCHED_JND].mean() if np.any(one > TOUCHED_JND) else 0.0 for one in by_metric))


def choose(ranking, n_candidates):
    """The winner among candidates that help, and those that cannot be told from it.

    Parameters
    ----------
    ranking : list of Candidate
        In their order.
    n_candidates : int
        How many were tried, with those that are out.

    Returns
    -------
    winner : Candidate or None
    rivals : list of Candidate
        Not significantly worse than the winner on the left-out rooms.
    """
    helping = [one for one in ranking if one.helps(n_candidates)]
    if not helping:
        return None, []
    close = [one for one in helping if one is helping[0] or one_sided_p(helping[0].gain - one.gain) > LEVEL]
    # an equaliser explains nothing: whatever has a cause goes first
    close.sort(key=lambda one: (one.effect is RoomEq, -one.total))
    return close[0], [one for one in close[1:] if one.effect is not RoomEq]
