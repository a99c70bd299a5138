"""Stationary noise of a room: its spectrum in third octaves."""

from types import SimpleNamespace

import numpy as np
import pytest

from roomeq.acoustics.octaves import OCTAVE_OF_THIRD, THIRDS_HZ
from roomeq.core.arrays import FloatArray
from roomeq.core.constants import FS_HZ
from roomeq.effects.base import octave_energies
from roomeq.effects.noise_floor import NOISE_S, SHARE_OF_THIRD, NoiseFloor
from roomeq.loop.features import feature_slice, measure_features, with_noise_in_octaves

HUM = int(np.argmin(np.abs(np.array(THIRDS_HZ) - 125.0)))  # a third octave in the middle of its octave
NO_WHITE = np.zeros(8)


def response() -> FloatArray:
    """A decaying response of 1 s with T60 = 0.4 s."""
    rir = np.random.default_rng(0).standard_normal(FS_HZ) * 10.0 ** (-3.0 * np.arange(FS_HZ) / FS_HZ / 0.4)
    rir[:100] = 0.0
    rir[100] = 20.0
    return rir


def noise_of(effect: NoiseFloor, rir: FloatArray, seed: int = 1) -> FloatArray:
    return effect.on_rir(rir, SimpleNamespace(white=NO_WHITE, rng=np.random.default_rng(seed))) - rir


def with_hum(level_db: float) -> NoiseFloor:
    return NoiseFloor(tuple(level_db if n == HUM else -80.0 for n in range(len(THIRDS_HZ))))


def octave_levels_db(noise: FloatArray, rir: FloatArray) -> FloatArray:
    return 10.0 * np.log10(octave_energies(noise) / octave_energies(rir) / (len(rir) / FS_HZ / NOISE_S))


def test_hum_reaches_less_far_into_the_neighbouring_octaves_than_noise_of_its_octave():
    rir, octave = response(), OCTAVE_OF_THIRD[HUM]
    hum_db = octave_levels_db(noise_of(with_hum(-20.0), rir), rir)
    in_octave = np.where(OCTAVE_OF_THIRD == octave, -20.0 + 10.0 * np.log10(SHARE_OF_THIRD), -80.0)
    broad_db = octave_levels_db(noise_of(NoiseFloor(tuple(in_octave.tolist())), rir), rir)
    assert hum_db[octave] == pytest.approx(-20.0, abs=2.5) and broad_db[octave] == pytest.approx(-20.0, abs=2.5)
    for neighbour in (octave - 1, octave + 1):
        assert hum_db[neighbour] < broad_db[neighbour] - 3.0


def test_white_noise_has_its_energy_in_every_octave():
    rir = response()
    white = NoiseFloor(tuple((-20.0 + 10.0 * np.log10(SHARE_OF_THIRD)).tolist()))
    np.testing.assert_allclose(octave_levels_db(noise_of(white, rir), rir), -20.0, atol=1.5)


def test_vector_of_an_effect_gives_the_effect():
    levels_db = tuple(np.linspace(-50.0, -10.0, len(THIRDS_HZ)).tolist())
    np.testing.assert_allclose(NoiseFloor.from_vector(NoiseFloor(levels_db).vector()).levels_db, levels_db, atol=1e-6)
    np.linalg.cholesky(NoiseFloor.prior_covariance())


def test_rendered_hum_is_measured_in_its_third_octave_and_scored_in_its_octave():
    rir, at = response(), feature_slice("floor")
    effect = with_hum(-25.0)
    measured = measure_features(rir + noise_of(effect, rir), white=np.full(8, 1e-6)).values
    expected_db = 10.0 * np.log10(1.0 + 10.0 ** -2.5 / (10.0 ** -5.5 + 1e-6) / SHARE_OF_THIRD[HUM])
    assert measured[at][HUM] == pytest.approx(expected_db, abs=4.0) and np.argmax(measured[at]) == HUM
    assert measured[at][HUM + 5:].max() < 3.0
    scored = with_noise_in_octaves(measured)
    of_octave = scored[at][OCTAVE_OF_THIRD == OCTAVE_OF_THIRD[HUM]]
    assert np.ptp(of_octave) < 1e-9 and of_octave[0] < measured[at][HUM]
    np.testing.assert_array_equal(np.delete(scored, np.r_[at]), np.delete(measured, np.r_[at]))
