"""Stationary coloured noise in the recordings of a room: hum, ventilation, hiss of the recording chain.

The signal-to-noise ratio differs between recordings of the same room, for example with the playback level. White noise
is estimated for each recording. The coloured noise of the room is assumed to have a constant ratio to it, except in
recordings whose white noise is weaker than `QUIET_DB`.
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
"""Duration [s] of the section of noise whose energy is given relative to that of the response."""
QUIET_DB = -55.0
"""Noise below this level does not affect the measured decay: energy of `NOISE_S` of noise relative to the response, per
octave band [dB]."""
_SMOOTH = 0.2  # rounding of the vector's lower end, which adds 1 dB of noise at 0


@dataclass(frozen=True)
class NoiseFloor(Effect):
    """Stationary noise in recordings of a room.

    Attributes
    ----------
    levels_db : tuple of 8 floats
        Energy of 100 ms of noise relative to the response, per octave, in a recording without white noise. In a
        recording with white noise it is larger by the factor 1 + w / q, where w is the energy of the white noise and q
        the energy that corresponds to `QUIET_DB`.
    """

    levels_db: tuple[float, ...]

    REFLECTIONS = False
    MEASURED = True
    NAME = "noise_floor"
    SCOPE = "room"
    STARTS = ((0.5,) * 8,)  # tens of dB that the noise adds to that of `QUIET_DB`
    SPREAD = (1.0,) * 8
    BANDS = tuple(range(8))
    DISCRIMINATING_MEASUREMENT = "a recording of the background noise before the sweep"

    def vector(self) -> FloatArray:
        added = 2.0 * np.log10(1.0 + 10.0 ** ((np.array(self.levels_db) - QUIET_DB) / 10.0))
        return (added ** 2 - _SMOOTH ** 2) / (2.0 * added)

    @classmethod
    def from_vector(cls, vector: ArrayLike) -> Self:
        vector = np.clip(vector, -3.0, 5.0)
        added = 0.5 * (vector + np.hypot(vector, _SMOOTH))
        return cls(tuple(float(value) for value in QUIET_DB + 10.0 * np.log10(10.0 ** added - 1.0)))

    @classmethod
    def measured_vectors(cls, data: PredictedRirs) -> FloatArray:
        """Return the vector of each room whose noise is that at the end of its recordings; 0 where that is unknown."""
        vectors = np.zeros((int(data.room.max()) + 1, len(cls.SPREAD)))
        for r, vector in enumerate(vectors):
            of_room = data.noise_db[data.room == r]
            known = np.isfinite(of_room).any(axis=0)
            vector[known] = np.maximum(np.nanmedian(of_room[:, known], axis=0), 0.0) / 10.0
        return vectors

    def energy_ratio(self, white: FloatArray) -> FloatArray:
        """Return the energy of 100 ms of noise relative to the response, shape (..., 8).

        Parameters
        ----------
        white : ndarray, shape (..., 8)
            Energy of 100 ms of the recording's white noise relative to the response.
        """
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
