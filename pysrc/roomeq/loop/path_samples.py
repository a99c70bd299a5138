"""Samples of the paths from each source to each microphone, from which RIRs are rendered with any absorption.

A random sample serves any absorption and directivity, and is least noisy about those for which it was drawn
(`roomeq.sim.path_sample`): surfaces that absorb about as much as the decay times of the recordings tell, and a source
that radiates alike in all directions. Drawn for a loudspeaker of usual size instead, held-out errors were no lower.
"""

from collections.abc import Sequence

import numpy as np

from roomeq.core.arrays import FloatArray
from roomeq.sim.defaults import ISM_ORDER
from roomeq.sim.echogram import FRAME_S
from roomeq.sim.path_sample import PathSample, sample_paths
from roomeq.sim.response import TracedSource
from roomeq.sim.scene import uniform_absorption

UNKNOWN_DECAYS_S = (0.4, 1.5)
"""Shortest and longest decay time for which paths are drawn where none is valid."""
_DECAY_FACTORS = (0.5, 2.0)
"""Range of decay times for which paths are drawn, relative to the shortest and the longest that were measured."""


def draw_path_samples(traced: TracedSource, mics_m: FloatArray, decays_s: tuple[float, float],
                      rngs: Sequence[np.random.Generator]) -> list[PathSample]:
    """Draw the samples of a traced source.

    Parameters
    ----------
    traced : TracedSource
        With a single trace.
    mics_m : ndarray, shape (n_mics, 3)
    decays_s : tuple of two floats
        Shortest and longest of the recordings [s].
    rngs : sequence of numpy.random.Generator
        One per microphone.
    """
    scene = traced.scene
    references = [uniform_absorption(scene.room, factor * decay_s, scene.air.speed_m_s)
                  for factor, decay_s in zip(_DECAY_FACTORS, decays_s, strict=True)]
    return sample_paths(traced, mics_m, np.resize(references, scene.absorption.shape), rngs, ism_order=ISM_ORDER,
                        n_frames=int(np.ceil(traced.max_length_s / FRAME_S)))
