"""Reference Monte Carlo: the energy left in a shoebox. It shares nothing with the simulator.

Rays leave the source in all directions with weight 1. At a wall the weight is multiplied by ``1 - alpha``; the
ray goes on specularly, or, with probability `scattering`, in a direction drawn from Lambert's law. No receiver,
no filter, no rendering: the mean weight at time t is the share of the emitted energy that is still in the room.
`analytic.py` says what it must give in the cases that can be solved otherwise.
"""

from dataclasses import dataclass

import numba
import numpy as np

SPEED_M_S = 343.2
"""Speed of sound that both simulators and the reference are run with [m/s]: 20 degrees Celsius."""

N_BATCHES = 32  # rays are traced in batches: the spread between them gives the standard error


@dataclass(frozen=True)
class Decay:
    """Energy left in a room.

    Attributes
    ----------
    time_s : ndarray, shape (n_steps,)
    energy : ndarray, shape (n_batches, n_steps)
        Mean weight of each batch of rays; 1 at time 0.
    hits_per_s : float
        Mean number of wall hits of a ray in a second.
    density_per_m3 : ndarray, shape (n_mics, n_steps)
        Energy in a sphere around each microphone divided by the sphere's volume, mean over each step.
    """

    time_s: np.ndarray
    energy: np.ndarray
    hits_per_s: float
    density_per_m3: np.ndarray


def trace_energy(dims_m, absorption, scattering, *, duration_s, source_pos_m=None, mics_m=(), radius_m=0.4,
                 n_rays=200_000, step_s=1e-3, seed=1, speed_m_s=SPEED_M_S):
    """Trace the energy that is left in a shoebox.

    Parameters
    ----------
    dims_m : array_like, shape (3,)
    absorption : float or array_like, shape (6,)
        Of x = 0, x = length, y = 0, y = width, z = 0, z = height, in [0, 1].
    scattering : float
        Probability of a diffuse reflection, in [0, 1].
    duration_s : float
    source_pos_m : array_like, shape (3,), optional
        Drawn uniformly in the room, for each ray anew, where not given.
    mics_m : array_like, shape (n_mics, 3)
        Centres of the spheres whose energy is counted too; each must clear the walls by `radius_m`.
    n_rays : int
    step_s : float
    seed : int

    Returns
    -------
    Decay
    """
    dims = np.array(dims_m, dtype=np.float64)
    keep = 1.0 - np.broadcast_to(np.asarray(absorption, dtype=np.float64), 6)
    source = np.full(3, np.nan) if source_pos_m is None else np.array(source_pos_m, dtype=np.float64)
    mics = np.array(mics_m, dtype=np.float64).reshape(-1, 3)
    n_steps = int(round(duration_s / step_s)) + 1
    per_batch = max(1, n_rays // N_BATCHES)
    energy, hits, dwell = _trace(dims, np.ascontiguousarray(keep), float(scattering), source, mics, radius_m,
                                 per_batch, n_steps, step_s * speed_m_s, seed)
    volume_m3 = 4.0 / 3.0 * np.pi * radius_m ** 3
    density = dwell.sum(axis=0) / (N_BATCHES * per_batch * step_s * speed_m_s * volume_m3)
    return Decay(np.arange(n_steps) * step_s, energy / per_batch,
                 float(hits.sum()) / (N_BATCHES * per_batch * (n_steps - 1) * step_s), density)


@numba.njit(cache=True, inline="always")
def _uniform(state):
    """One number in [0, 1) of the generator splitmix64 (Steele, Lea, Flood 2014), whose state is state[0]."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return float((z ^ (z >> np.uint64(31))) >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@numba.njit(cache=True, parallel=True)
def _trace(dims, keep, scattering, source, mics, radius_m, per_batch, n_steps, step_m, seed):
    energy = np.zeros((N_BATCHES, n_steps))
    hits = np.zeros(N_BATCHES, dtype=np.int64)
    dwell = np.zeros((N_BATCHES, len(mics), n_steps))
    for batch in numba.prange(N_BATCHES):
        state = np.empty(1, dtype=np.uint64)
        for ray in range(per_batch):
            state[0] = np.uint64(seed) * np.uint64(1 << 40) + np.uint64(batch * per_batch + ray)
            state[0] *= np.uint64(0xD1342543DE82EF95)
            hits[batch] += _follow(state, dims, keep, scattering, source, mics, radius_m, step_m,
                                   energy[batch], dwell[batch])
    return energy, hits, dwell


@numba.njit(cache=True)
def _follow(state, dims, keep, scattering, source, mics, radius_m, step_m, energy, dwell):
    """Follow one ray to the end of `energy`; return its number of wall hits."""
    position, direction = np.empty(3), np.empty(3)
    for axis in range(3):
        position[axis] = _uniform(state) * dims[axis] if np.isnan(source[0]) else source[axis]
    cos_polar, azimuth = 2.0 * _uniform(state) - 1.0, 2.0 * np.pi * _uniform(state)
    sin_polar = np.sqrt(1.0 - cos_polar * cos_polar)
    direction[0], direction[1] = sin_polar * np.cos(azimuth), sin_polar * np.sin(azimuth)
    direction[2] = cos_polar
    weight, travelled_m, n_hits = 1.0, 0.0, 0
    end_m = (energy.size - 1) * step_m
    while True:
        wall_axis, run_m = 0, np.inf
        for axis in range(3):
            goal = dims[axis] if direction[axis] > 0.0 else 0.0
            if direction[axis] != 0.0 and (goal - position[axis]) / direction[axis] < run_m:
                wall_axis, run_m = axis, (goal - position[axis]) / direction[axis]
        run_m = max(run_m, 0.0)
        for step in range(int(np.ceil(travelled_m / step_m)), energy.size):
            if step * step_m >= travelled_m + run_m:
                break
            energy[step] += weight
        for mic in range(len(mics)):
            _count(mics[mic], radius_m, position, direction, run_m, travelled_m, weight, step_m, dwell[mic])
        travelled_m += run_m
        if travelled_m > end_m:
            return n_hits
        n_hits += 1
        upper = direction[wall_axis] > 0.0
        weight *= keep[2 * wall_axis + (1 if upper else 0)]
        for axis in range(3):
            position[axis] += run_m * direction[axis]
        position[wall_axis] = dims[wall_axis] if upper else 0.0
        if _uniform(state) < scattering:
            _lambert(state, wall_axis, upper, direction)
        else:
            direction[wall_axis] = -direction[wall_axis]


@numba.njit(cache=True, inline="always")
def _lambert(state, wall_axis, upper, direction):
    """Draw a direction from Lambert's law: the cosine to the inward normal is the root of a uniform number."""
    sin2, azimuth = _uniform(state), 2.0 * np.pi * _uniform(state)
    direction[wall_axis] = -np.sqrt(1.0 - sin2) if upper else np.sqrt(1.0 - sin2)
    direction[(wall_axis + 1) % 3] = np.sqrt(sin2) * np.cos(azimuth)
    direction[(wall_axis + 2) % 3] = np.sqrt(sin2) * np.sin(azimuth)


@numba.njit(cache=True, inline="always")
def _count(mic, radius_m, position, direction, run_m, travelled_m, weight, step_m, dwell):
    """Add weight times path length inside the sphere, spread over the steps it falls into."""
    along, square = 0.0, 0.0
    for axis in range(3):
        offset = mic[axis] - position[axis]
        along += offset * direction[axis]
        square += offset * offset
    half2 = radius_m * radius_m - square + along * along
    if half2 <= 0.0:
        return
    enter = max(0.0, along - np.sqrt(half2)) + travelled_m
    leave = min(run_m, along + np.sqrt(half2)) + travelled_m
    while enter < leave:
        step = int(enter / step_m)
        if step >= dwell.size:
            return
        border = min(leave, (step + 1) * step_m)
        if border <= enter:  # the border itself, rounded down
            border = min(leave, (step + 2) * step_m)
        dwell[step] += weight * (border - enter)
        enter = border
