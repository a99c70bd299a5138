"""Speed of sound that differs from the scene's: warmer or colder air, in which all sound arrives earlier or later."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from roomeq.acoustics.air import speed_of_sound_m_s
from roomeq.core.arrays import FloatArray
from roomeq.effects.base import Effect, ModelAir
from roomeq.effects.prediction import PredictedRirs
from roomeq.records.schema import is_timed
from roomeq.sim.scene import Air


@dataclass(frozen=True)
class SoundSpeed(Effect):
    """Speed of sound; the absorption of the air remains that of the scene.

    Attributes
    ----------
    temperature_c : float
        Temperature of air with this speed of sound [deg C].
    """

    temperature_c: float

    NAME = "sound_speed"
    SCOPE = "all"
    STARTS = ((2.5,),)  # temperature / 10 deg C
    SPREAD = (1.0,)
    DISCRIMINATING_MEASUREMENT = "recordings whose time of flight is known, at several distances"

    @classmethod
    def applies(cls, data: PredictedRirs) -> bool:
        return any(is_timed(row) for row in data.rows)

    def vector(self) -> FloatArray:
        return np.array([self.temperature_c / 10.0])

    @classmethod
    def from_vector(cls, vector: ArrayLike) -> Self:
        return cls(float(np.clip(10.0 * np.asarray(vector)[0], -20.0, 60.0)))

    def changed_air(self, air: Air | ModelAir) -> ModelAir:
        return ModelAir(speed_of_sound_m_s(self.temperature_c), np.asarray(air.attenuation_per_m))
