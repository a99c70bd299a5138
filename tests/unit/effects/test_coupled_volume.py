"""A coupled volume: what it takes for the energy of reflections, and that a wave field leaves it."""

import numpy as np

from roomeq.core.constants import FS_HZ
from roomeq.effects.base import Rendering, octave_energies
from roomeq.effects.catalogue import CATALOGUE
from roomeq.effects.coupled_volume import CoupledVolume
from roomeq.effects.model import apply_to_rir
from roomeq.effects.room_modes import RoomModes
from roomeq.sim.scene import Material, Scene, Shoebox

SCENE = Scene(Shoebox((6.0, 4.5, 2.9)), [Material("all", 0.3, 0.3)] * 6)
SOURCE_M = (1.5, 2.0, 1.5)
VOLUME = CoupledVolume(-12.0, 2.0, 0.1)


def rendering_of(mic_m, reflections, direct_gain):
    empty = Rendering(SCENE, SOURCE_M, mic_m, direct_gain, np.full(8, 0.5), np.random.default_rng(1), reflections,
                      np.zeros(8))
    return Rendering(SCENE, SOURCE_M, mic_m, direct_gain, np.full(8, 0.5), np.random.default_rng(1),
                     reflections + empty.direct(len(reflections)), np.zeros(8))


def decaying_noise(level, time_s=0.5):
    time = np.arange(FS_HZ) / FS_HZ
    return level * np.random.default_rng(0).standard_normal(FS_HZ) * 10.0 ** (-3.0 * time / time_s)


def test_energy_of_the_second_decay_does_not_depend_on_the_direct_sound():
    mic_m, reflections = (1.8, 2.0, 1.5), decaying_noise(2e-4)
    gain = 1.0 / (4.0 * np.pi * 0.3) * 10.0 ** np.array([0.0, -0.2, -0.1, -0.4, -0.1, -0.6, -0.2, -0.9])  # directive
    added = []
    for direct_gain in (np.zeros(8), gain):
        rendering = rendering_of(mic_m, reflections, direct_gain)
        of_volume = VOLUME.on_rir(rendering.rendered, rendering)
        of_volume[:len(rendering.rendered)] -= rendering.rendered
        added.append(octave_energies(of_volume))
    np.testing.assert_allclose(added[1], added[0], rtol=1e-6)


def test_wave_field_leaves_the_second_decay_at_low_frequencies():
    mic_m = (4.0, 2.5, 1.2)
    effects = sorted([VOLUME, RoomModes(150.0)], key=lambda effect: list(CATALOGUE).index(effect.NAME))
    direct_gain = np.full(8, 1.0 / (4.0 * np.pi * np.linalg.norm(np.subtract(mic_m, SOURCE_M))))
    rendering = rendering_of(mic_m, decaying_noise(5e-4), direct_gain)
    late_db = []
    for model in (effects, effects[:1], [VOLUME]):
        rir = apply_to_rir(model, rendering.rendered, SCENE, SOURCE_M, mic_m, direct_gain, np.random.default_rng(2))
        late_db.append(10.0 * np.log10(octave_energies(rir[int(0.8 * FS_HZ):])[:2]))
    of_both, of_modes, of_volume = late_db
    assert np.all(of_modes < of_volume - 10.0)
    np.testing.assert_allclose(of_both, of_volume, atol=1.0)
