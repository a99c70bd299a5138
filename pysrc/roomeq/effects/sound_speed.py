"""Another speed of sound than declared: the air was warmer or colder, and everything arrives earlier or later."""

from dataclasses import dataclass, replace

import numpy as np

from roomeq.acoustics.air import speed_of_sound_m_s
from roomeq.effects.base import Effect, ModelAir


@dataclass(frozen=True)
class SoundSpeed(Effect):
    """Speed of sound, absorption of the air left as declared.

    Attributes
    ----------
    temperature_c : float
        Of air in which sound is as fast.
    """

    temperature_c: float

    NAME = "sound_speed"
    SCOPE = "all"
    STARTS = ((2.5,),)  # tens of degrees
    SPREAD = (1.0,)
    DISCRIMINATING_MEASUREMENT = "recordings whose time of flight is known, at several distances"

    @classmethod
    def applies(cls, data):
        return any(row.get("tof_removed") is False for row in data.rows)

    def vector(self):
        return np.array([self.temperature_c / 10.0])

    @classmethod
    def from_vector(cls, vector):
        return cls(float(np.clip(10.0 * vector[0], -20.0, 60.0)))

    def apply_to_prediction(self, state, data, rows):
        state.speed_m_s[rows] = speed_of_sound_m_s(self.temperature_c)

    def on_scene(self, scene):
        return replace(scene, air=ModelAir(speed_of_sound_m_s(self.temperature_c),
                                           np.asarray(scene.air.attenuation_per_m)))
