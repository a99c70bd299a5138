"""Compile the kernels before they are needed: ``python -m roomeq.compile_kernels``.

The machine code is kept on disk for this version of the sources (`roomeq.core.jit`). Without it, the first response of
each installation waits for the compiler, and so does the first loop.
"""

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import cast

import numpy as np

from roomeq.acoustics.parameters import measure
from roomeq.core.arrays import Array, FloatArray
from roomeq.core.constants import FS_HZ
from roomeq.effects.spherical_cap import cap_gain
from roomeq.effects.wavefield import high_passed
from roomeq.loop.arrivals import log_likelihood
from roomeq.loop.features import measure_features
from roomeq.loop.likelihood import Sparse, add_block, append_nonzero, whitened_product
from roomeq.loop.predict import decay_times, levels_until
from roomeq.loop.ray_energy import add_gain, add_up
from roomeq.loop.tables import ANGLES, collect, turned
from roomeq.loop.unknown_geometry import N_SHARED, log_likelihoods
from roomeq.sim.mesh import MeshRoom
from roomeq.sim.response import simulate_responses, trace_every_ray, trace_source
from roomeq.sim.scene import Material, Scene, Shoebox

_SCENE = Scene(Shoebox((3.0, 3.0, 3.0)), [Material("all", (0.3,) * 8, (0.2,) * 8)] * 6)
_SOURCE_M, _MICS_M = (1.0, 1.0, 1.0), np.array([[2.0, 2.0, 2.0], [2.0, 2.0, 1.0]])
_NUM_RAYS = 1000
"""With fewer, the energy of single rays is not limited (`roomeq.sim.ray_limits`)."""


def main() -> None:
    """Compile the kernels, two parts at once: the compiler takes one core.

    Where no processes can be started, or one was killed, which also happens for lack of memory, this one compiles all.
    """
    parts = analyse, simulate, predict, simulate_mesh
    try:
        with ProcessPoolExecutor(2, multiprocessing.get_context("fork")) as processes:
            for compiled in [processes.submit(part) for part in parts]:
                compiled.result()
    except (OSError, NotImplementedError, BrokenProcessPool):
        for part in parts:
            part()


def simulate() -> None:
    """Simulate responses in a shoebox, with and without a target, of one and of two microphones."""
    for mics_m in (_MICS_M[:1], _MICS_M):
        for target_t60_s in (None, 0.3):
            simulate_responses(_SCENE, _SOURCE_M, mics_m, num_rays=_NUM_RAYS, target_t60_s=target_t60_s)
    # paths of many reflections
    small = Scene(Shoebox((1.0, 1.0, 1.0)), [Material("hard", (0.03,) * 8, (0.2,) * 8)] * 6)
    for mics_m in (0.4 * _MICS_M[:1], 0.4 * _MICS_M):
        simulate_responses(small, (0.2, 0.2, 0.2), mics_m, num_rays=_NUM_RAYS, target_t60_s=0.9)
    # a source with many microphones is traced once, and plays roulette for each absorption
    every_ray = trace_every_ray(_SCENE, _SOURCE_M, num_rays=_NUM_RAYS, max_length_s=0.1, rng=np.random.default_rng(0))
    every_ray.play_roulette(_SCENE.absorption, 0.1)


def simulate_mesh() -> None:
    """Simulate a response in a mesh."""
    room = MeshRoom(3.0 * _cube(), ("all",), np.zeros(12, int), 27.0, False)
    simulate_responses(Scene(room, _SCENE.materials[:1]), _SOURCE_M, _MICS_M, num_rays=_NUM_RAYS)


def analyse() -> None:
    """Measure a decay into noise as that of an RIR, and as the loop does."""
    time_s = np.arange(FS_HZ // 2) / FS_HZ
    response = np.hypot(10.0 ** (-3.0 * time_s / 0.3), 1e-3) * np.random.default_rng(0).standard_normal(len(time_s))
    measure(response)
    measure_features(response, 0.0)


def predict() -> None:
    """Run the kernels of the loop's prediction on arrays of the types that they get there."""
    traced = trace_source(_SCENE, _SOURCE_M, num_rays=_NUM_RAYS, max_length_s=0.1, rng=np.random.default_rng(0))
    table = turned(*collect(traced, _MICS_M[:1])[0], *np.eye(3)[:2])
    n_frames, n_angles, n_shares = table.entries[:, 0].max() + 1, len(ANGLES), table.counts.shape[1]
    energy, by_angle = np.zeros((1, n_frames, 8)), np.zeros((1, n_frames, n_angles, 8), np.float32)
    add_up(table.entries, table.counts, cast(Array, table.angular), np.ones((n_angles, 8), np.float32),
           np.ones((n_shares, 8), np.float32), energy[0], np.zeros((2, n_frames, 8)), by_angle[0])
    add_gain(by_angle, np.ones((1, n_angles, 8)), energy)
    decay_times(np.ones((1, 8)), energy, np.arange(energy.shape[1] + 1.0), np.ones(8), np.ones(8, bool),
                np.empty((1, 3, 8)))
    levels_until(np.ones((3, 1)), energy)
    sparse = Sparse.empty((1, 1), 1)
    append_nonzero(np.ones((1, 1, 1)), np.zeros(1, int), np.zeros((1, 1), int), np.ones((1, 1), bool), np.ones((1, 1)),
                   *sparse)
    add_block(np.ones((1, 1)), np.zeros(1, int), whitened_product(*sparse, np.ones(1), 1), 1.0)
    points = np.ones((1, 3))
    log_likelihood(np.ones(10), points, np.ones(1), points, points, np.zeros((1, 3), int), np.ones((1, 1)))
    one = np.zeros(1, int)
    log_likelihoods(np.ones((1, N_SHARED)), one, np.ones((1, 10)), points, points, one, one, np.ones(1),
                    np.zeros((1, 3), int), np.ones((1, 1)), np.ones(1))
    cap_gain(1.0, 0.1, 0.5)
    high_passed(np.zeros(8), 0.1)


def _cube() -> FloatArray:
    """Return the triangles of a unit cube, shape (12, 3, 3), whose normals point out of it."""
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    sides = []
    for axis in range(3):
        for end in (0.0, 1.0):
            corners = np.insert(square if end else square[::-1], 0, end, axis=1)
            sides += [np.roll(corners, axis, axis=1)[list(three)] for three in ((0, 1, 2), (0, 2, 3))]
    return np.array(sides)


if __name__ == "__main__":
    main()
