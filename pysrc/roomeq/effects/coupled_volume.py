"""A second volume behind an opening: its slower decay shows once the room's own has died away.

Cremer and Mueller, Principles and Applications of Room Acoustics, vol. 1, sec. II.3: the energy of two coupled rooms
decays as a sum of two exponentials.
"""

from dataclasses import dataclass

import numpy as np

from roomeq.acoustics.iso3382 import octave_bands
from roomeq.core.constants import FS_HZ
from roomeq.effects.base import Effect
from roomeq.sim.echogram import FRAME_S
from roomeq.sim.render import MAX_LENGTH_S, render, tail_noise

_LEVELS_DB = (-60.0, 0.0)
_TIMES_S = (0.2, 6.0)
_OVER_DB = 75.0  # below the response; see `roomeq.loop.features.QUIET_DB`
_DECAY = 6.0 * np.log(10.0)  # of energy over the decay time


@dataclass(frozen=True)
class CoupledVolume(Effect):
    """The second slope in a room.

    Attributes
    ----------
    level_db : float
        Energy of the second decay relative to that of all reflections.
    time_s : float
        Its decay time at low frequencies; air shortens it at high ones.
    """

    level_db: float
    time_s: float

    NAME = "coupled_volume"
    SCOPE = "room"
    STARTS = ((-2.0, np.log(1.0)), (-1.2, np.log(1.5)), (-2.0, np.log(2.5)))  # tens of dB, logarithm of seconds
    SPREAD = (0.8, 0.5)
    DISCRIMINATING_MEASUREMENT = "a recording with the opening closed"

    def vector(self):
        return np.array([self.level_db / 10.0, np.log(self.time_s)])

    @classmethod
    def from_vector(cls, vector):
        return cls(float(np.clip(10.0 * vector[0], *_LEVELS_DB)),
                   float(np.exp(np.clip(vector[1], *np.log(_TIMES_S)))))

    def rate_per_s(self, air):
        """Rate at which its energy decays, shape (8,)."""
        return _DECAY / self.time_s + air.speed_m_s * np.asarray(air.attenuation_per_m)

    def apply_to_prediction(self, state, data, rows):
        state.decays.append((rows, 10.0 ** (self.level_db / 10.0), _DECAY / self.time_s))

    def on_rir(self, rir, rendering):
        air = rendering.scene.air
        start_s = rendering.distance_m / air.speed_m_s
        total = np.sum(octave_bands(rir, FS_HZ) ** 2, axis=1) - rendering.direct_gain ** 2 * _band_shares()
        rir = np.pad(rir, (0, max(0, self._n_samples(start_s) - len(rir))))
        time_s = (np.arange(int(np.ceil(len(rir) / FS_HZ / FRAME_S))) + 0.5) * FRAME_S - start_s
        rate = self.rate_per_s(air)
        shape = np.where(time_s[:, None] > 0.0, np.exp(-np.maximum(time_s, 0.0)[:, None] * rate), 0.0)
        # an echogram speaks of pulses of the whole band, octaves hold a share of those
        energy = 10.0 ** (self.level_db / 10.0) * np.maximum(total, 0.0) / _band_shares() * rate * FRAME_S * shape
        noise = tail_noise(len(rir), rendering.scene.room.volume_m3, air.speed_m_s, rendering.rng)
        return rir + render(np.zeros(0), np.zeros((0, 8)), energy, noise, speed_m_s=air.speed_m_s, n_samples=len(rir))

    def _n_samples(self, start_s):
        """Length that holds it until it is over: cut off earlier, its end would be taken for noise."""
        return round(min(start_s + (_OVER_DB + self.level_db) / 60.0 * self.time_s, MAX_LENGTH_S) * FS_HZ)


def _band_shares():
    """Share of a pulse's energy that each octave filter lets through, shape (8,)."""
    pulse = np.zeros(4096)
    pulse[2048] = 1.0
    return np.sum(octave_bands(pulse, FS_HZ) ** 2, axis=1)
