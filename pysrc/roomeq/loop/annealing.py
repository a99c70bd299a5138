"""Posterior samples of a few dozen unknowns whose likelihood has many modes: sequential Monte Carlo.

Particles are drawn from the prior. The likelihood is raised to a power that grows from 0 to 1, in steps that leave half
of the effective particles; after each step the particles are resampled and moved (Del Moral, Doucet and Jasra, J. R.
Stat. Soc. B 68 (2006) 411). Moves are along the difference of two other particles (ter Braak, Stat. Comput. 16 (2006)
239), so that they follow correlations and jump between modes, and change one block of unknowns at a time.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from roomeq.core.arrays import FloatArray, IntArray

SWEEPS, LAST_SWEEPS = 2, 4
JUMP = 0.1
"""Share of the moves that are a whole difference, from one mode to another."""
SMALLEST_STEP = 1e-3
JITTER = 1e-3
"""Standard deviation of what is added to each move, relative to the spread of the prior."""


class Block(NamedTuple):
    """Unknowns that are moved together.

    Attributes
    ----------
    unknowns : ndarray of int
    data : ndarray of int
        The data whose likelihood depends on them.
    """

    unknowns: IntArray
    data: IntArray


def anneal(particles: FloatArray, log_prior: Callable[[FloatArray], FloatArray],
           log_likelihood: Callable[[FloatArray, IntArray], FloatArray], blocks: Sequence[Block],
           symmetries: Sequence[Callable[[FloatArray], FloatArray]], n_data: int,
           rng: np.random.Generator) -> FloatArray:
    """Return samples of the posterior, shape (n_particles, n_unknowns).

    Parameters
    ----------
    particles : ndarray, shape (n_particles, n_unknowns)
        Samples of the prior.
    log_prior : callable
        Of particles, shape (n_particles,); minus infinity where they are impossible.
    log_likelihood : callable
        Of possible particles and some of the data, shape (n_particles, n_some).
    blocks : sequence of Block
    symmetries : sequence of callable
        Changes of particles that are their own inverse, keep volumes and lead from one mode to another.
    n_data : int
    rng : Generator
    """
    particles = particles.copy()
    n_particles, all_data = len(particles), np.arange(n_data)
    jitter = JITTER * particles.std(axis=0)
    prior, likelihood, power = log_prior(particles), log_likelihood(particles, all_data), 0.0

    def move_to(moved: FloatArray, data: IntArray) -> None:
        """Move each particle or leave it (Metropolis)."""
        moved_prior = log_prior(moved)
        impossible = np.isinf(moved_prior)
        moved[impossible] = particles[impossible]
        moved_likelihood = log_likelihood(moved, data)
        gain = moved_prior - prior + power * (moved_likelihood - likelihood[:, data]).sum(axis=1)
        accepted = np.log(rng.random(n_particles)) < gain
        particles[accepted], prior[accepted] = moved[accepted], moved_prior[accepted]
        likelihood[np.ix_(accepted, data)] = moved_likelihood[accepted]

    while power < 1.0:
        total = likelihood.sum(axis=1)
        step = _step(total, 1.0 - power)
        power = 1.0 if step == 1.0 - power else power + step
        weight = np.exp(step * (total - total.max()))
        drawn = np.searchsorted(np.cumsum(weight / weight.sum()), (np.arange(n_particles) + rng.random()) / n_particles)
        drawn = np.minimum(drawn, n_particles - 1)
        particles, prior, likelihood = particles[drawn], prior[drawn], likelihood[drawn]
        for _ in range(SWEEPS if power < 1.0 else LAST_SWEEPS):
            for unknowns, data in blocks:
                first, second = rng.integers(n_particles, size=(2, n_particles))
                best = 2.38 / np.sqrt(2.0 * len(unknowns)) * rng.uniform(0.3, 1.2, n_particles)
                stride = np.where(rng.random(n_particles) < JUMP, 1.0, best)[:, None]
                moved = particles.copy()
                moved[:, unknowns] += (stride * (particles[first] - particles[second])[:, unknowns]
                                       + jitter[unknowns] * rng.standard_normal((n_particles, len(unknowns))))
                move_to(moved, data)
        for symmetry in symmetries:
            half = rng.random((n_particles, 1)) < 0.5  # all of them would only exchange the modes
            move_to(np.where(half, symmetry(particles), particles), all_data)
    return particles


def _step(log_likelihood: FloatArray, most: float) -> float:
    """Return the largest step of the power, at most `most`, that leaves half of the effective particles."""
    def leaves_half(step: float) -> bool:
        weight = np.exp(step * (log_likelihood - log_likelihood.max()))
        return bool(weight.sum() ** 2 >= 0.5 * len(weight) * (weight ** 2).sum())

    if leaves_half(most):
        return most
    low, high = SMALLEST_STEP, most
    for _ in range(20):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if leaves_half(middle) else (low, middle)
    return low
