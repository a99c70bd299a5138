"""The smallest size at which an effect that was not found would have been found.

An effect changes the features of the RIRs by some pattern d [JND]. What absorption, gains and the model's other effects
can imitate of it shows nothing; the rest, whitened by the scatter of the features, has the information I, the sum of
its squares. With a pattern of s times this size, the log densities of the held-out rooms grow by s^2 I / 2 on average,
with a standard deviation of s sqrt(I) (as a likelihood ratio: Kay, Fundamentals of Statistical Signal Processing II,
1998, sec. 6.5), less what it costs to estimate the effect's parameters.

A candidate that was rejected, or whose density helps and that was not added, such as beyond the largest number of
effects, was not found at the size that was fitted, whatever its density.
"""

from collections.abc import Collection, Sequence

import numpy as np
from scipy.special import ndtri

from roomeq.core.arrays import FloatArray
from roomeq.core.rng import rng_for
from roomeq.core.workers import share_out
from roomeq.effects.base import Effect
from roomeq.loop.fit import shared_prior
from roomeq.loop.likelihood import add_block, normal_equations
from roomeq.loop.packing import ParameterIndex
from roomeq.loop.rendered_model import in_order
from roomeq.loop.selection import LEVEL, MIN_SIZE_JND, Candidate, size_of_change_jnd
from roomeq.loop.session import Session

POWER = 0.8
"""Probability that the densities of held-out rooms show an effect of the stated size."""
_DRAWS = 5  # patterns of an effect; the median of their sizes is stated
_SMALL = 1e-3  # scale of patterns in the normal equations, below what Huber's loss takes for outliers


def detectable_sizes(session: Session, candidates: Sequence[Candidate], rejected: Collection[type[Effect]]
                     ) -> list[float | None]:
    """Return the smallest size at which each candidate would have been found [JND].

    None where no part of the effect's changes is visible in at least two rooms.

    Parameters
    ----------
    session : Session
        Of the model that lacks the candidates.
    candidates : sequence of Candidate
    rejected : collection of types
        Effects of those that were rejected, by their predicted or their rendered error.
    """
    quantile = float(ndtri(POWER))

    def size_jnd(candidate: Candidate) -> float | None:
        cost = max(0.0, max(candidate.gain.max(), 0.0) - candidate.total)
        # a^2 / 2 less the quantile of its scatter, a times `quantile`, reaches the threshold of `Candidate.helps`
        amplitude = quantile + np.sqrt(quantile ** 2 + 2.0 * (np.log(len(candidates) / LEVEL) + cost))
        found = []
        for change in _changes(session, candidate.effect):
            information = _information(session, change)[session.data.is_scored]
            left = information.sum() - information.max()  # the room that gains most is not counted
            if left > 0.0:
                found.append(size_of_change_jnd(session.data, amplitude / np.sqrt(left) * change))
        passed_over = candidate.effect in rejected or candidate.helps(len(candidates))
        least = max(MIN_SIZE_JND, candidate.size_jnd if passed_over else 0.0)
        return max(least, float(np.median(found))) if found else None

    return share_out(size_jnd, candidates, session.nj, first_here=False, label="effects that would be found")


def _changes(session: Session, effect: type[Effect]) -> list[FloatArray]:
    """Return changes of the features by an effect with parameters drawn from its prior, (n_rirs, n_features) each."""
    data, fitted, index = session.data, session.fit, session.index
    absorption, vectors = index.absorption(fitted.mean, fitted.local), index.vectors(fitted.mean, fitted.local)
    without = index.predict(absorption, vectors)
    effects = in_order([*index.effects, effect])
    with_effect, k = ParameterIndex(data, effects), effects.index(effect)
    rng, n_units = rng_for(session.seed, "loop power", effect.NAME), len(data.units(effect.SCOPE)[0])
    changes = []
    for n in range(_DRAWS):
        start = np.asarray(effect.STARTS[n % len(effect.STARTS)], dtype=float)
        drawn = start + rng.multivariate_normal(np.zeros(len(start)), effect.prior_covariance(), size=n_units)
        change = with_effect.predict(absorption, [*vectors[:k], drawn, *vectors[k:]]) - without
        changes.append(np.where(data.valid & np.isfinite(change), change, 0.0))
    return [change for change in changes if change.any()]


def _information(session: Session, change: FloatArray) -> FloatArray:
    """Return each room's information of a change of the features that no other parameters imitate, shape (n_rooms,)."""
    fitted, index = session.fit, session.index
    rooms = [normal_equations(index, r, _SMALL * change, session.data.valid, fitted.derivatives, fitted.sigma,
                              fitted.omega)
             for r in range(len(fitted.local))]
    inverses = [np.linalg.inv(room.own_own + of_prior) for room, of_prior in zip(rooms, fitted.precision, strict=True)]
    total = shared_prior(index).precision
    right = np.zeros(len(total))
    for room, inverse in zip(rooms, inverses, strict=True):
        add_block(total, room.columns, room.shared_shared - room.own_shared.T @ inverse @ room.own_shared, 1.0)
        right[room.columns] += room.shared_residual - room.own_shared.T @ inverse @ room.own_residual
    shared = np.linalg.solve(total, right)
    return np.array([room.residual_residual - room.shared_residual @ shared[room.columns]
                     - room.own_residual @ inverse @ (room.own_residual - room.own_shared @ shared[room.columns])
                     for room, inverse in zip(rooms, inverses, strict=True)]) / _SMALL ** 2
