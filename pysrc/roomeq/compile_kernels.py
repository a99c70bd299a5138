"""Compile the simulator's kernels before they are needed: ``python -m roomeq.compile_kernels``.

The machine code is kept on disk for this version of the sources (`roomeq.core.jit`). Without it, the first response of
each installation waits for the compiler.
"""

import numpy as np

from roomeq.acoustics.parameters import measure
from roomeq.core.arrays import FloatArray
from roomeq.sim.mesh import MeshRoom
from roomeq.sim.response import simulate_responses
from roomeq.sim.scene import Material, Scene, Shoebox


def main() -> None:
    """Simulate and analyse a response, with and without a target of the reverberation time, and one in a mesh."""
    scene = Scene(Shoebox((3.0, 3.0, 3.0)), [Material("all", (0.3,) * 8, (0.2,) * 8)] * 6)
    source_m, mics_m = (1.0, 1.0, 1.0), np.array([[2.0, 2.0, 2.0]])
    for target_t60_s in (None, 0.3):
        (response,) = simulate_responses(scene, source_m, mics_m, num_rays=100, target_t60_s=target_t60_s)
        measure(response.rir)
    concave = MeshRoom(3.0 * _cube(), ("all",), np.zeros(12, int), 27.0, False)
    simulate_responses(Scene(concave, scene.materials[:1]), source_m, mics_m, num_rays=100)


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
