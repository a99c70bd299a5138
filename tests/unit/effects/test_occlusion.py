"""An obstacle: attenuation and delay of the direct sound, and the reflections that it shades."""

from types import SimpleNamespace

import numpy as np
import pytest

from roomeq.acoustics.octaves import SPECTRUM_HZ
from roomeq.core.constants import EXACT_BANDS_HZ, FS_HZ
from roomeq.effects.base import Rendering
from roomeq.effects.near_reflector import NearReflector
from roomeq.effects.occlusion import Occlusion
from roomeq.effects.prediction import PredictionState
from roomeq.effects.response import RESPONSE_HZ
from roomeq.sim.scene import Air, Material, Scene, Shoebox

C = Air().speed_m_s
DISTANCE_M = 2.5
DIFFUSE_M = 17.0


@pytest.fixture
def rendering():
    scene = Scene(Shoebox((6.0, 5.0, 3.0)), [Material("all", 0.2, 0.3)] * 6)
    return Rendering(scene, (1.5, 2.0, 1.5), (4.0, 2.0, 1.5), np.full(8, 1.0 / (4.0 * np.pi * DISTANCE_M)), np.ones(8),
                     np.random.default_rng(0), np.zeros(1), np.zeros(8))


@pytest.mark.parametrize("detour_m, excess_m", [(0.05, 0.3), (0.05, 2.0), (0.3, 1.0), (0.3, 8.0), (0.5, 0.9)])
def test_shaded_share_is_that_of_scatterers_in_the_cones_at_source_and_microphone(detour_m, excess_m):
    rng = np.random.default_rng(1)
    xi, eta = 1.0 + excess_m / DISTANCE_M, rng.uniform(-1.0, 1.0, 200_000)
    along = 0.5 * DISTANCE_M * xi * eta  # of points of the spheroid about source and microphone
    across = 0.5 * DISTANCE_M * np.sqrt((xi ** 2 - 1.0) * (1.0 - eta ** 2))
    angles = np.arctan2(across, 0.5 * DISTANCE_M + along), np.arctan2(across, 0.5 * DISTANCE_M - along)
    cone = np.arccos(DISTANCE_M / (DISTANCE_M + 2.0 * detour_m))
    expected = np.mean(np.minimum(*angles) < cone) * np.exp(-excess_m / DIFFUSE_M)
    assert Occlusion(detour_m).shaded_share(excess_m, DISTANCE_M) == pytest.approx(expected, abs=0.005)


def test_attenuation_of_the_direct_sound_rises_by_3_db_per_octave_in_the_shadow():
    gain_db = 10.0 * np.log10(Occlusion(1.0).energy_gain(EXACT_BANDS_HZ, C))
    assert np.diff(gain_db)[3:] == pytest.approx(np.full(4, -3.0), abs=0.3) and gain_db[-1] < -26.0


def test_obstacle_that_is_not_there_changes_levels_by_a_tenth_of_a_decibel_at_most():
    free = Occlusion.from_vector([-100.0])
    assert 10.0 * np.log10(free.energy_gain(8000.0, C)) > -0.11
    assert np.all(10.0 * np.log10(free.reflected_gain(np.linspace(0.0, 20.0, 50), DISTANCE_M, C)) > -0.11)


def test_rendered_reflections_have_the_predicted_gain_and_nothing_precedes_them(rendering):
    effect, n = Occlusion(0.4), FS_HZ
    onset = int(np.ceil(DISTANCE_M / C * FS_HZ))
    noise = np.random.default_rng(2).standard_normal((40, n))
    noise[:, :onset] = 0.0
    shaded = [effect.on_rir(rir + rendering.direct(n), rendering) for rir in noise]
    shaded = np.array(shaded) - effect.on_rir(rendering.direct(n), rendering)
    window = slice(onset + int(0.010 * FS_HZ), onset + int(0.012 * FS_HZ))
    change_db = 10.0 * np.log10(np.sum(shaded[:, window] ** 2) / np.sum(noise[:, window] ** 2))
    expected = effect.reflected_gain(np.array([0.011 * C]), DISTANCE_M, C)[0, -1]  # half of white noise is at 4-8 kHz
    assert change_db == pytest.approx(10.0 * np.log10(expected), abs=0.4)
    assert np.all(shaded[:, :onset] == pytest.approx(0.0, abs=1e-12))
    assert np.allclose(shaded[:, -1000:], noise[:, -1000:])


def test_direct_sound_that_the_room_hides_is_left_alone(rendering):
    hidden = SimpleNamespace(direct_gain=np.zeros(8))
    rir = np.random.default_rng(3).standard_normal(4000)
    assert np.array_equal(Occlusion(0.3).on_rir(rir, hidden), rir)


@pytest.mark.parametrize("speed_m_s", [330.0, 360.0])
def test_predictions_use_the_speed_of_sound_that_another_effect_set(speed_m_s):
    place = SimpleNamespace(source_pos_m=(1.5, 2.0, 1.5), mic_pos_m=(4.0, 2.0, 1.5))
    data = SimpleNamespace(tables=[SimpleNamespace(visible=True)], distance_m=np.array([DISTANCE_M]), places=[place],
                           speed_m_s=np.array([C]), frame_mid_s=np.array([0.005, 0.02]))

    def predicted(effect, speed):
        state = PredictionState(
            absorption=np.zeros((1, 2, 8)), air_per_m=np.zeros((1, 8)), speed_m_s=np.array([speed]), ray_gain=None,
            reflected_gain=None, direct_gain=np.ones((1, 8)), direct_thirds=np.ones((1, len(SPECTRUM_HZ))), decays=[],
            response_db=np.zeros((1, len(RESPONSE_HZ))), floor=np.zeros((1, 8)), delay_s=np.zeros(1),
            direct_angle=np.zeros(1), rendered_change=np.zeros((1, 1)))
        effect.apply_to_prediction(state, data, np.array([0]))
        return state

    obstructed = predicted(Occlusion(0.2), speed_m_s)
    assert obstructed.delay_s == pytest.approx(0.2 / speed_m_s)
    assert obstructed.direct_gain[0] == pytest.approx(1.0 / (1.0 + 4.0 * np.array(EXACT_BANDS_HZ) / speed_m_s))
    declared, changed = (predicted(NearReflector(0.4, 0.6), speed).direct_thirds for speed in (C, speed_m_s))
    assert not np.allclose(declared, changed)
