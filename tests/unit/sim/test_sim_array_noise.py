"""Noise at the microphones of an array: the coherence of a diffuse field, power and first channel kept."""

from functools import partial

import numpy as np
import pytest
from scipy.signal import csd, welch

from roomeq.sim.array_noise import make_coherent
from roomeq.sim.directivity import FirstOrder

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


@pytest.mark.parametrize("one, other, expected", [
    (FirstOrder("figure_eight", (1, 0, 0)), FirstOrder("figure_eight", (0, 1, 0)), 0.0),
    (None, FirstOrder("figure_eight", (1, 0, 0)), 0.0),
    (FirstOrder("cardioid", (1, 0, 0)), FirstOrder("cardioid", (-1, 0, 0)), 0.5),
    (FirstOrder("cardioid", (1, 0, 0)), FirstOrder("cardioid", (0, 1, 0)), 0.75)])
def test_directive_microphones_in_one_place_have_the_coherence_of_their_directivities(one, other, expected):
    """The mean of the product of both directivities over all directions, by hand."""
    rng = np.random.default_rng(2)
    pressures = [directivity and partial(directivity.pressure, fs_hz=FS_HZ) for directivity in (one, other)]
    first, second = make_coherent([rng.standard_normal(20 * FS_HZ) for _ in range(2)], np.zeros((2, 3)), SPEED_M_S,
                                  FS_HZ, pressures)
    assert np.corrcoef(first, second)[0, 1] == pytest.approx(expected, abs=0.01)
    assert [np.mean(noise ** 2) for noise in (first, second)] == pytest.approx([1.0, 1.0], abs=0.02)


def test_sound_is_earlier_at_the_microphone_that_faces_where_it_comes_from():
    """Beams towards x at 0.02 m along x: most sound comes from there, first to the microphone further along x."""
    rng = np.random.default_rng(3)
    towards_x = partial(FirstOrder("cardioid", (1, 0, 0)).pressure, fs_hz=FS_HZ)
    first, second = make_coherent([rng.standard_normal(20 * FS_HZ) for _ in range(2)], [[0, 0, 0], [0.02, 0, 0]],
                                  SPEED_M_S, FS_HZ, [towards_x] * 2)
    frequency_hz, cross = csd(first, second, FS_HZ, nperseg=1024)  # conj(first) second: positive if the second leads
    assert np.angle(cross[np.searchsorted(frequency_hz, 2000.0)]) > 0.1


def test_microphones_in_one_place_have_one_noise():
    rng = np.random.default_rng(1)
    first, second = make_coherent([rng.standard_normal(8000) for _ in range(2)], [[1.0, 2.0, 1.0]] * 2, SPEED_M_S,
                                  FS_HZ)
    assert np.corrcoef(first, second)[0, 1] > 0.999
