"""A second volume behind an opening: its slower decay becomes audible after the room's own has died away.

Cremer and Mueller, Principles and Applications of Room Acoustics, vol. 1, sec. II.3: the energy of two coupled rooms
decays as a sum of two exponentials. The second one arrives as ``E r exp(-r t) dt``, where r is `rate_per_s` and E is
the energy of all reflections times `energy_ratio`. Of the power that enters the second volume, an energy proportional
to 1 / r is stored there: where its air absorbs more, less comes back. What comes back is reflected in the room until it
is absorbed there, which takes a time proportional to the room's own decay time.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from roomeq.core.arrays import FloatArray, IntArray
from roomeq.core.constants import BANDS_HZ, FS_HZ
from roomeq.effects.base import Effect, Rendering, octave_energies
from roomeq.effects.prediction import PredictedRirs, PredictionState
from roomeq.sim.echogram import FRAME_S
from roomeq.sim.render import render

_LEVELS_DB = (-60.0, 0.0)
_TIMES_S = (0.2, 6.0)
_SLOPES = (-0.5, 1.0)
_OVER_1KHZ = np.maximum(np.array(BANDS_HZ) / 1000.0, 1.0)
_TYPICAL_S = 0.5
"""Decay time of a room in which the ratio of energies is `CoupledVolume.level_db` [s]."""
_RANGE_DB = 75.0  # level below the response at which rendering ends; see `roomeq.effects.noise_floor.QUIET_DB`
_DECAY = 6.0 * np.log(10.0)  # of energy over the decay time


@dataclass(frozen=True)
class CoupledVolume(Effect):
    """The second slope of the decay in a room.

    Attributes
    ----------
    level_db : float
        Energy of the second decay relative to that of all reflections, at low frequencies where the room itself decays
        in `_TYPICAL_S`.
    time_s : float
        Its decay time at low frequencies; air absorption shortens it at high ones.
    slope : float
        Exponent of frequency, from 1 kHz on, with which its surfaces absorb more.
    """

    level_db: float
    time_s: float
    slope: float

    NAME = "coupled_volume"
    SCOPE = "room"
    STARTS = ((-2.0, np.log(1.0), 0.0), (-1.2, np.log(1.5), 0.0), (-2.0, np.log(2.5), 0.0))
    """Tens of dB, logarithm of seconds, and the slope."""
    SPREAD = (0.8, 0.5, 0.2)
    DISCRIMINATING_MEASUREMENT = "a recording with the opening closed"

    def vector(self) -> FloatArray:
        return np.array([self.level_db / 10.0, np.log(self.time_s), self.slope])

    @classmethod
    def from_vector(cls, vector: ArrayLike) -> Self:
        vector = np.asarray(vector)
        return cls(float(np.clip(10.0 * vector[0], *_LEVELS_DB)),
                   float(np.exp(np.clip(vector[1], *np.log(_TIMES_S)))), float(np.clip(vector[2], *_SLOPES)))

    def energy_ratio(self, t60_s: FloatArray, speed_m_s: float | FloatArray, attenuation_per_m: ArrayLike
                     ) -> FloatArray:
        """Return the energy of the second decay relative to that of all reflections, in each octave.

        Parameters
        ----------
        t60_s : ndarray, shape (..., 8)
            Decay time of the room itself.
        speed_m_s, attenuation_per_m : array_like
        """
        of_low = _DECAY / self.time_s / self.rate_per_s(speed_m_s, attenuation_per_m)  # relative to low octaves
        return 10.0 ** (self.level_db / 10.0) * t60_s / _TYPICAL_S * of_low

    def rate_per_s(self, speed_m_s: float | FloatArray, attenuation_per_m: ArrayLike) -> FloatArray:
        """Return the rate at which its energy decays, shape (..., 8) [1/s]."""
        return _DECAY / self.time_s * _OVER_1KHZ ** self.slope + np.asarray(speed_m_s) * np.asarray(attenuation_per_m)

    def apply_to_prediction(self, state: PredictionState, data: PredictedRirs, rows: IntArray) -> None:
        state.decays.append((self, rows))

    def on_rir(self, rir: FloatArray, rendering: Rendering) -> FloatArray:
        air = rendering.scene.air
        start_s = rendering.distance_m / air.speed_m_s
        reflected = octave_energies(rendering.rendered - rendering.direct(len(rendering.rendered)))
        rir = np.pad(rir, (0, max(0, self._n_samples(start_s) - len(rir))))
        time_s = (np.arange(int(np.ceil(len(rir) / FS_HZ / FRAME_S))) + 0.5) * FRAME_S - start_s
        rate = self.rate_per_s(air.speed_m_s, air.attenuation_per_m)
        shape = np.where(time_s[:, None] > 0.0, np.exp(-np.maximum(time_s, 0.0)[:, None] * rate), 0.0)
        # an echogram holds energies of pulses of the whole band, of which each octave filter passes a part
        ratio = self.energy_ratio(rendering.t60_s, air.speed_m_s, air.attenuation_per_m)
        energy = ratio * reflected / _pulse_energies() * rate * FRAME_S * shape
        noise = rendering.tail_noise(len(rir))
        return rir + render(np.zeros(0), np.zeros((0, 8)), energy, noise, speed_m_s=air.speed_m_s, n_samples=len(rir))

    def _n_samples(self, start_s: float) -> int:
        """Length at which the decay is complete; if it were cut off earlier, its end would be taken for noise."""
        return round((start_s + (_RANGE_DB + self.level_db) / 60.0 * self.time_s) * FS_HZ)


def _pulse_energies() -> FloatArray:
    """Energy of a unit pulse that each octave filter passes, shape (8,)."""
    pulse = np.zeros(4096)
    pulse[2048] = 1.0
    return octave_energies(pulse)
