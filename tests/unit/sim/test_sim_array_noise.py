"""Noise at the microphones of an array: the coherence of a diffuse field, power and first channel kept."""

import numpy as np
import pytest
from scipy.signal import csd, welch

from roomeq.sim.array_noise import make_coherent

FS_HZ, SPEED_M_S = 16000, 343.2
MICS_M = [[0.0, 0.0, 0.0], [0.05, 0.0, 0.0], [0.05, 0.12, 0.0]]


def test_coherence_is_that_of_a_diffuse_field():
    rng = np.random.default_rng(0)
    independent = [rng.standard_normal(60 * FS_HZ) for _ in MICS_M]
    noises = make_coherent(independent, MICS_M, SPEED_M_S, FS_HZ)
    assert np.allclose(noises[0], independent[0], atol=1e-4)
    assert [np.mean(noise ** 2) for noise in noises] == pytest.approx([1.0] * 3, abs=0.02)
    for one, other in ((0, 1), (0, 2), (1, 2)):
        frequency_hz, cross = csd(noises[one], noises[other], FS_HZ, nperseg=1024)
        power = np.sqrt(np.prod([welch(noises[mic], FS_HZ, nperseg=1024)[1] for mic in (one, other)], axis=0))
        distance_m = np.linalg.norm(np.subtract(MICS_M[one], MICS_M[other]))
        expected = np.sinc(2.0 * frequency_hz * distance_m / SPEED_M_S)
        assert np.abs(cross / power - expected)[2:-2].max() < 0.12


def test_microphones_in_one_place_have_one_noise():
    rng = np.random.default_rng(1)
    first, second = make_coherent([rng.standard_normal(8000) for _ in range(2)], [[1.0, 2.0, 1.0]] * 2, SPEED_M_S,
                                  FS_HZ)
    assert np.corrcoef(first, second)[0, 1] > 0.999
