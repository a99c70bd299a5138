"""Noise at the microphones of an array: the coherence of a diffuse field, power and first channel kept."""

from functools import partial

import numpy as np
import pytest
from scipy.fft import irfft, next_fast_len, rfft
from scipy.signal import csd, welch
from threadpoolctl import threadpool_info, threadpool_limits

from roomeq.sim import array_noise
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


def test_compact_array_is_mixed_in_groups_of_one_width():
    """By hand: each group spans a change of k d by 0.1 rad at the largest distance."""
    rng = np.random.default_rng(4)
    noises = [rng.standard_normal(4000).astype(np.float32) for _ in MICS_M]
    n_fft = next_fast_len(4000 + 320, real=True)
    spectra = rfft(np.array(noises), n_fft)
    width = int(0.1 * SPEED_M_S / (2.0 * np.pi * 0.13) * n_fft / FS_HZ)
    distance_m = np.linalg.norm(np.subtract(np.array(MICS_M)[:, None], MICS_M), axis=2)
    for first in range(0, spectra.shape[1], width):
        frequency_hz = (first + 0.5 * width) * FS_HZ / n_fft
        coherence = np.sinc(2.0 * frequency_hz * distance_m / SPEED_M_S)
        factor = np.linalg.cholesky((1.0 - 1e-6) * coherence + 1e-6 * np.eye(3))
        spectra[:, first:first + width] = factor @ spectra[:, first:first + width]
    found = np.array(make_coherent(noises, MICS_M, SPEED_M_S, FS_HZ))
    assert np.abs(found - irfft(spectra, n_fft)[:, :4000]).max() < 1e-5


@pytest.mark.parametrize("fs_hz", [8000, 16000, 48000])
@pytest.mark.parametrize("largest_m", [0.0, 0.1, 0.5, 0.51, 2.0, 5.0])
def test_coherence_differs_little_within_a_group(fs_hz, largest_m):
    """Between microphones at any distance in the array, whatever the frequency."""
    duration_s = 2.0
    n_bins = int(0.5 * duration_s * fs_hz) + 1
    edges = array_noise._group_edges(int(duration_s * fs_hz), fs_hz, largest_m, SPEED_M_S)
    assert edges[0] == 0 and edges[-1] >= n_bins > edges[-2] and np.diff(edges).min() > 0
    assert largest_m > 0.5 or np.ptp(np.diff(edges)) == 0
    middle_hz = 0.5 * (edges[:-1] + edges[1:]) / duration_s
    for distance_m in np.linspace(0.01, 1.0, 40) * largest_m:
        at_middle = np.sinc(2.0 * middle_hz * distance_m / SPEED_M_S)
        for bins in (edges[:-1], edges[1:]):
            assert np.abs(np.sinc(2.0 * bins / duration_s * distance_m / SPEED_M_S) - at_middle).max() < 0.022


@pytest.mark.parametrize("pattern", ["omnidirectional", "cardioid"])
def test_microphones_across_a_room_are_as_coherent_as_with_narrower_groups(pattern, monkeypatch):
    """Where k d < 60: beyond, too few plane waves stand for the field of directive microphones."""
    rng = np.random.default_rng(5)
    mics_m = np.array([[0.0, 0.0, 0.0], [0.06, 0.0, 0.0], [0.5, 0.3, 0.2], [2.0, 1.0, 0.5]])
    noises = [rng.standard_normal(30 * FS_HZ).astype(np.float32) for _ in mics_m]
    directivities = [None if pattern == "omnidirectional" else partial(FirstOrder(pattern, facing).pressure,
                                                                       fs_hz=FS_HZ)
                     for facing in rng.standard_normal((4, 3))]
    wide = make_coherent(noises, mics_m, SPEED_M_S, FS_HZ, directivities)
    monkeypatch.setattr(array_noise, "_STEP_SHARE", 0.002)
    narrow = make_coherent(noises, mics_m, SPEED_M_S, FS_HZ, directivities)
    assert [np.mean(noise ** 2) for noise in wide] == pytest.approx([1.0] * 4, abs=0.02)
    for one, other in zip(*np.triu_indices(4, 1), strict=True):
        frequency_hz, found = csd(wide[one], wide[other], FS_HZ, nperseg=1024)
        expected = csd(narrow[one], narrow[other], FS_HZ, nperseg=1024)[1]
        kd = 2.0 * np.pi * frequency_hz / SPEED_M_S * np.linalg.norm(mics_m[one] - mics_m[other])
        assert np.abs(found - expected)[kd < 60.0].max() * FS_HZ / 2.0 < 0.02


def test_matrices_are_computed_on_one_thread(monkeypatch):
    """Of a pool of several: that takes many times as long on a busy machine."""
    cholesky, counts = np.linalg.cholesky, []

    def counted(matrices):
        counts.extend(pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas")
        return cholesky(matrices)

    monkeypatch.setattr(np.linalg, "cholesky", counted)
    rng = np.random.default_rng(6)
    with threadpool_limits(2):
        make_coherent([rng.standard_normal(4000) for _ in MICS_M], MICS_M, SPEED_M_S, FS_HZ)
    assert counts and set(counts) == {1}


def test_directivity_that_microphones_share_is_asked_once():
    asked = []

    def pressure(directions):
        asked.append(len(directions))
        return FirstOrder("cardioid", (1, 0, 0)).pressure(directions, FS_HZ)

    rng = np.random.default_rng(7)
    make_coherent([rng.standard_normal(4000) for _ in MICS_M], MICS_M, SPEED_M_S, FS_HZ, [pressure, None, pressure])
    assert len(asked) == 1
