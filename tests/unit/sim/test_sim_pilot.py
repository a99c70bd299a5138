"""A few rays tell about how absorbing a room has to be for a reverberation time."""

import numpy as np
import pytest

from roomeq.core.constants import BAND_1KHZ
from roomeq.sim.pilot import PilotRays
from roomeq.sim.response import eyring_exponent, simulate_responses
from roomeq.sim.scene import Material, Scene, Shoebox

SOURCE_M, MIC_M = (1.3, 1.1, 1.4), (5.0, 3.1, 1.2)


def scene_with(walls, ceiling, scattering):
    return Scene(Shoebox((7.0, 5.0, 3.0)), [Material(f"s{n}", walls, scattering) for n in range(5)]
                 + [Material("ceiling", ceiling, scattering)])


def pilot_exponent(scene, target_s, seed=0, guess=None):
    pilot = PilotRays(scene, SOURCE_M, target_s, np.random.default_rng(seed))
    return pilot.exponent(scene.absorption, target_s, eyring_exponent(scene, target_s) if guess is None else guess)


@pytest.mark.parametrize("target_s", [0.3, 0.6, 1.2])
def test_exponent_of_a_diffuse_field_is_about_that_of_eyring(target_s):
    """Paths of unequal length let sound decay more slowly (Kuttruff, Room Acoustics, eq. 5.23): by 8 % at 0.3 s."""
    scene = scene_with(0.2, 0.2, 0.9)
    by_eyring = eyring_exponent(scene, target_s)
    assert pilot_exponent(scene, target_s, guess=3.0 * by_eyring) == pytest.approx(by_eyring, rel=0.1)


@pytest.mark.parametrize("walls, ceiling, scattering", [(0.08, 0.5, 0.1), (0.05, 0.6, 0.2)])
def test_exponent_is_nearer_to_the_one_that_meets_the_target_than_that_of_eyring(walls, ceiling, scattering):
    scene, target_s = scene_with(walls, ceiling, scattering), 0.7
    (response,) = simulate_responses(scene, SOURCE_M, MIC_M, target_t60_s=target_s, num_rays=10000)
    met = (np.log(1.0 - response.absorption[0, BAND_1KHZ]) / np.log(1.0 - scene.absorption[0, BAND_1KHZ]))
    by_pilot, by_eyring = (abs(np.log(exponent / met)) for exponent in (
        pilot_exponent(scene, target_s), eyring_exponent(scene, target_s)))
    assert by_pilot < by_eyring


def test_exponent_does_not_depend_on_how_far_the_rays_were_traced():
    scene = scene_with(0.1, 0.4, 0.2)
    near, far = (PilotRays(scene, SOURCE_M, length_s, np.random.default_rng(0)) for length_s in (0.5, 2.0))
    assert near.exponent(scene.absorption, 0.5, 1.0) == far.exponent(scene.absorption, 0.5, 1.0)


def test_rays_that_leave_the_room_keep_no_energy():
    scene = scene_with(0.2, 0.2, 0.9)
    pilot = PilotRays(scene, SOURCE_M, 0.6, np.random.default_rng(0))
    before = pilot.exponent(scene.absorption, 0.6, 1.0)
    pilot._paths.counts[:2] = 8
    assert pilot.exponent(scene.absorption, 0.6, 1.0) == pytest.approx(before, rel=0.02)


def test_guess_is_kept_where_nothing_decays():
    scene = Scene(Shoebox((7.0, 5.0, 3.0)), [Material("hard", 0.0, 0.2)] * 6)
    assert pilot_exponent(scene, 0.5, guess=7.0) == 7.0
