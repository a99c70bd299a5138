"""Noise of a room and its recording chain behind the response: hum, ventilation, hiss that is not white.

How loud noise is beside the response is a matter of the recording's level, and white noise tells that level: what has
a spectrum of its own goes up and down with it.
"""

from dataclasses import dataclass

import numpy as np

from roomeq.acoustics.iso3382 import octave_bands
from roomeq.core.constants import EXACT_BANDS_HZ, FS_HZ
from roomeq.effects.base import Effect
from roomeq.sim.echogram import FRAME_S
from roomeq.sim.render import render

_QUIET_DB = -55.0  # below it, noise disturbs nothing: roomeq.loop.features


@dataclass(frozen=True)
class NoiseFloor(Effect):
    """Stationary noise in recordings of a room.

    Attributes
    ----------
    levels_db : tuple of 8 floats
        Energy of 100 ms of noise relative to the response, per octave, in a recording without white noise. Below -55
        it disturbs nothing; where white noise is louder than that, it is as much louder.
    """

    levels_db: tuple

    REFLECTIONS = False
    NAME = "noise_floor"
    SCOPE = "room"
    STARTS = ((1.0,) * 8,)  # tens of dB above -55
    SPREAD = (1.0,) * 8
    DISCRIMINATING_MEASUREMENT = "a recording of the silence before the sweep"

    def vector(self):
        return (np.array(self.levels_db) - _QUIET_DB) / 10.0

    @classmethod
    def from_vector(cls, vector):
        return cls(tuple(float(value) for value in _QUIET_DB + 10.0 * np.clip(vector, -3.0, 5.0)))

    def apply_to_prediction(self, state, data, rows):
        state.floor[rows] += self._energies(data.white[rows])

    def on_rir(self, rir, rendering):
        total = np.sum(octave_bands(rir, FS_HZ) ** 2, axis=1)
        density = self._energies(rendering.white) * total / (0.1 * FS_HZ)
        width = np.minimum(np.array(EXACT_BANDS_HZ) * np.sqrt(2.0), 0.5 * FS_HZ) - np.array(EXACT_BANDS_HZ) / np.sqrt(2)
        per_frame = density / (width / (0.5 * FS_HZ)) * FRAME_S * FS_HZ
        n_frames = int(np.ceil(len(rir) / FS_HZ / FRAME_S)) + 1
        noise = rendering.rng.standard_normal(len(rir))
        return rir + render(np.zeros(0), np.zeros((0, 8)), np.tile(per_frame, (n_frames, 1)), noise,
                            speed_m_s=rendering.scene.air.speed_m_s, n_samples=len(rir))

    def _energies(self, white):
        """Energy of 100 ms of noise relative to the response in recordings with white noise, shape (..., 8)."""
        return 10.0 ** (np.array(self.levels_db) / 10.0) * (1.0 + white / 10.0 ** (_QUIET_DB / 10.0))
