"""Find candidates for the effect that a model lacks: densities of held-out rooms rank them.

Each room is held out once: the shared parameters are fitted to the others (`roomeq.loop.splitters.leave_rooms_out`).
Candidates are ranked by the probability density that they give to held-out rooms; held-out errors of their rendering
accept them (`roomeq.loop.acceptance`).
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from roomeq.core.arrays import FloatArray
from roomeq.core.workers import share_out
from roomeq.effects.base import Effect
from roomeq.effects.source_directivity import SourceDirectivity
from roomeq.loop.data import Data
from roomeq.loop.features import METRIC, SHOW_DIRECT_SOUND
from roomeq.loop.fit import Fit, fit, with_scatter
from roomeq.loop.heldout_errors import interval_of_mean, one_sided_p
from roomeq.loop.packing import OWN_SCOPES, ParameterIndex
from roomeq.loop.rendered_model import change_by, in_order
from roomeq.loop.session import Session, effects_lacking
from roomeq.loop.splitters import leave_rooms_out

LEVEL = 0.05
MIN_SIZE_JND = 0.5
"""Smallest mean change of the features that an effect touches: half of what can be heard."""
TOUCHED_JND = 0.25
"""Change of a feature from which on an effect touches it."""
_PROBE_ITERATIONS = 2  # after which the fits from different starts are compared


@dataclass(frozen=True)
class Candidate:
    """An effect that the model lacks.

    Attributes
    ----------
    effect : type
    fit : Fit
        Of the model with the effect: its parameters (`Fit.parameters`).
    gain : ndarray, shape (n_scored_rooms,)
        Increase of the log density of each held-out room. A room with RIRs of a single place, in which a device
        cannot be told from the room, does not count.
    size_jnd : float
        Effect size: mean change of the features that it touches.
    """

    effect: type[Effect]
    fit: Fit
    gain: FloatArray
    size_jnd: float

    @property
    def total(self) -> float:
        return float(self.gain.sum())

    @property
    def interval(self) -> list[float] | None:
        """Confidence interval of 95 % of the mean gain over rooms (t); None for a single room."""
        return interval_of_mean(self.gain)

    @property
    def p(self) -> float:
        """One-sided p value of a gain over rooms (paired t test)."""
        return one_sided_p(self.gain)

    def helps(self, n_candidates: int) -> bool:
        """Tell whether held-out rooms are predicted better, corrected for the number of candidates.

        The threshold is that of a likelihood ratio, which exceeds x without an effect with a probability of at most
        1 / x (Markov's inequality). Densities of held-out rooms are no likelihood ratio, but exceed it more rarely:
        with one parameter and 11 candidates in 0.035 % of the cases. The room that gains most is not counted, so that
        no single room, whose rows may be wrong, decides; what can be read off the recordings themselves may be in a
        single room. Rooms may gain little: rooms where all distances are short say little about the speed of sound. Of
        an effect that all rooms share, half of them must gain; a desk or a noise may be in a few rooms only.
        """
        counted = self.total - (0.0 if self.effect.MEASURED else max(self.gain.max(), 0.0))
        return bool(counted > np.log(n_candidates / LEVEL) and self.size_jnd >= MIN_SIZE_JND
                    and (self.effect.SCOPE in OWN_SCOPES or np.mean(self.gain > 0.0) >= 0.5))


class Choice(NamedTuple):
    """The best candidate, or None if none helps, and those that the data cannot distinguish from it."""

    winner: Candidate | None
    rivals: list[Candidate]


def rank(session: Session, eliminated: Collection[type[Effect]] = ()) -> list[Candidate]:
    """Fit each effect that the model lacks and did not lose, and rank them by the densities of held-out rooms."""
    data = session.data
    base = fit(data, session.correction, session.effects, initial=session.fit, known=session.fit.derivatives)
    before = _densities(data, base)
    longest_first = sorted(effects_lacking(data, [*session.effects, *eliminated]),  # no process waits for the last one
                           key=lambda effect: -len(effect.STARTS))
    candidates = share_out(lambda effect: _candidate(session, effect, base, before), longest_first, session.nj,
                           first_here=False, label=f"effect {len(session.effects) + 1}: fit candidates")
    return sorted(candidates, key=lambda candidate: -candidate.total)


def _densities(data: Data, fitted: Fit) -> FloatArray:
    """Return the log density that a fit gives to each room when it is held out, shape (n_rooms,)."""
    return np.array([room.log_density for room in leave_rooms_out(data, fitted)])


def _candidate(session: Session, effect: type[Effect], base: Fit, before: FloatArray) -> Candidate:
    """Fit a model with one more effect than that of the fit `base`, and compare the densities of held-out rooms.

    The density of `base` is that with its own scatter, `before`, or with that of the larger model, whichever gives more
    to the room. All rooms share the scatter: where an effect fits one room alone, whose rows may be wrong, the larger
    scatter of `base` would speak for the effect in all other rooms.
    """
    data, effects = session.data, in_order([*session.effects, effect])
    initial = session.fit
    if len(effect.STARTS) > 1:
        probes = []
        for start in effect.STARTS:
            starts = [start if kind is effect else kind.STARTS[0] for kind in effects]
            probe = fit(data, session.correction, effects, start=starts, initial=session.fit,
                        known=session.fit.derivatives, iterations=_PROBE_ITERATIONS)
            probes.append((probe, _densities(data, probe)))
        initial = _best_start(ParameterIndex(data, effects), effect, probes)
    fitted = fit(data, session.correction, effects, initial=initial, known=session.fit.derivatives)
    alike = _densities(data, with_scatter(data, base, fitted.sigma, fitted.omega))
    gain = (_densities(data, fitted) - np.maximum(before, alike))[data.is_scored]
    return Candidate(effect, fitted.parameters(), gain, size_of_change_jnd(data, change_by(data, effect, fitted)))


def helps_beside(model: Session, candidate: Candidate, n_candidates: int) -> bool:
    """Tell whether a candidate helps a model that has another candidate: whether it explains something else."""
    return _candidate(model, candidate.effect, model.fit, _densities(model.data, model.fit)).helps(n_candidates)


def _best_start(index: ParameterIndex, effect: type[Effect], probes: list[tuple[Fit, FloatArray]]) -> Fit:
    """Return the best of fits from different starts; for an effect of rooms, combine each room's own best.

    Each probe is a fit and the log density of each held-out room.
    """
    best = max(probes, key=lambda probe: probe[1].sum())[0]
    if effect.SCOPE != "room":
        return best
    k = index.effects.index(effect)
    best_of_room = np.argmax([densities for _, densities in probes], axis=0)
    chosen = np.array([index.vectors(probes[start][0].mean, probes[start][0].local)[k][r]
                       for r, start in enumerate(best_of_room)])
    mean, local = best.mean.copy(), [own.copy() for own in best.local]
    mean[index.shared[k].part] = chosen.mean(axis=0)
    for r, vector in enumerate(chosen):
        local[r][index.local[r].slices[k]] = vector - chosen.mean(axis=0)
    return replace(best, mean=mean, local=local)


def weights_of(effect: type[Effect], session: Session) -> FloatArray:
    """Return how much each feature tells of an effect of a session's model, shape (n_rirs, n_features).

    The weight is the predicted change over the variance of the feature, as in a matched filter; 0 for what the effect
    does not touch. Where the direct sounds of RIRs told the axis of their source, a directivity matches them for that
    alone: their weight is 0 for it, and what the axis makes of the reflections must tell.
    """
    data, fitted = session.data, session.fit
    change = np.abs(change_by(data, effect, fitted))
    if effect is SourceDirectivity:
        change[np.ix_(np.flatnonzero(data.axis >= 0), np.flatnonzero(SHOW_DIRECT_SOUND))] = 0.0
    return np.where(change > TOUCHED_JND, change, 0.0) / (fitted.sigma ** 2 + fitted.omega ** 2)


def size_of_change_jnd(data: Data, change: FloatArray) -> float:
    """Return the mean of a change of the features over those that it touches, for the metric that changes most [JND].

    The change has a shape of (n_rirs, n_features).
    """
    change = np.abs(np.where(data.valid, change, 0.0))
    by_metric = [change[:, METRIC == metric] for metric in np.unique(METRIC)]
    return float(max(of_metric[of_metric > TOUCHED_JND].mean() if np.any(of_metric > TOUCHED_JND) else 0.0
                     for of_metric in by_metric))


def choose(ranking: Sequence[Candidate], n_candidates: int) -> Choice:
    """Choose among candidates in their ranked order; `n_candidates` counts those already rejected as well."""
    helping = [candidate for candidate in ranking if candidate.helps(n_candidates)]
    if not helping:
        return Choice(None, [])
    close = [candidate for candidate in helping
             if candidate is helping[0] or one_sided_p(helping[0].gain - candidate.gain) > LEVEL]
    close.sort(key=lambda candidate: (not candidate.effect.NAMES_CAUSE, -candidate.total))
    alike = close[0].total - np.log(n_candidates / LEVEL)  # of effects in few rooms, the test over rooms says little
    return Choice(close[0], [candidate for candidate in close[1:]
                             if candidate.effect.NAMES_CAUSE and candidate.total > alike])
