"""Stationary noise of a room and its recording chain behind the response: hum, ventilation, coloured hiss.

The level of noise relative to the response depends on the recording's level. White noise reveals that level: coloured
noise rises and falls with it.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from roomeq.acoustics.octaves import OCTAVE_WIDTH_HZ
from roomeq.core.arrays import FloatArray, IntArray
from roomeq.core.constants import FS_HZ
from roomeq.effects.base import Effect, Rendering, octave_energies
from roomeq.effects.prediction import PredictedRirs, PredictionState
from roomeq.sim.echogram import FRAME_S
from roomeq.sim.render import render

NOISE_S = 0.1
"""Duration of the noise whose energy is compared with that of the response."""
QUIET_DB = -55.0
"""Energy of `NOISE_S` of noise relative to the response of its band, below which it disturbs no decay."""


@dataclass(frozen=True)
class NoiseFloor(Effect):
    """Stationary noise in recordings of a room.

    Attributes
    ----------
    levels_db : tuple of 8 floats
        Energy of 100 ms of noise relative to the response, per octave, in a recording without white noise. Below
        `QUIET_DB` it disturbs no decay; in a recording whose white noise is louder than that, it is louder by as much.
    """

    levels_db: tuple[float, ...]

    REFLECTIONS = False
    NAME = "noise_floor"
    SCOPE = "room"
    STARTS = ((1.0,) * 8,)  # tens of dB above `QUIET_DB`
    SPREAD = (1.0,) * 8
    DISCRIMINATING_MEASUREMENT = "a recording of the silence before the sweep"

    def vector(self) -> FloatArray:
        return (np.array(self.levels_db) - QUIET_DB) / 10.0

    @classmethod
    def from_vector(cls, vector: ArrayLike) -> Self:
        return cls(tuple(float(value) for value in QUIET_DB + 10.0 * np.clip(vector, -3.0, 5.0)))

    def energy_ratio(self, white: FloatArray) -> FloatArray:
        """Return the energy of 100 ms of noise relative to the response, for white noise of shape (..., 8)."""
        return 10.0 ** (np.array(self.levels_db) / 10.0) * (1.0 + white / 10.0 ** (QUIET_DB / 10.0))

    def apply_to_prediction(self, state: PredictionState, data: PredictedRirs, rows: IntArray) -> None:
        state.floor[rows] += self.energy_ratio(data.white[rows])

    def on_rir(self, rir: FloatArray, rendering: Rendering) -> FloatArray:
        per_sample = self.energy_ratio(rendering.white) * octave_energies(rir) / (NOISE_S * FS_HZ)
        per_frame = per_sample / (OCTAVE_WIDTH_HZ / (0.5 * FS_HZ)) * FRAME_S * FS_HZ
        n_frames = int(np.ceil(len(rir) / FS_HZ / FRAME_S)) + 1
        noise = rendering.rng.standard_normal(len(rir))
        return rir + render(np.zeros(0), np.zeros((0, 8)), np.tile(per_frame, (n_frames, 1)), noise,
                            speed_m_s=rendering.scene.air.speed_m_s, n_samples=len(rir))
