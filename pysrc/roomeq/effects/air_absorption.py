"""Air that absorbs more or less than declared, because its temperature or humidity differed (ISO 9613-1)."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from roomeq.acoustics.air import band_attenuation_per_m
from roomeq.core.arrays import FloatArray
from roomeq.effects.base import Effect, ModelAir
from roomeq.sim.scene import Air

_TEMPERATURES_C = (-15.0, 45.0)
_HUMIDITIES_PCT = (3.0, 99.0)


@dataclass(frozen=True)
class AirAbsorption(Effect):
    """Absorption of the air; the speed of sound stays as declared.

    Attributes
    ----------
    temperature_c, humidity_pct : float
        Air that absorbs like this; absorption alone hardly distinguishes the two.
    """

    temperature_c: float
    humidity_pct: float

    NAME = "air_absorption"
    SCOPE = "all"
    STARTS = ((2.0, np.log(40.0)),)  # temperature in tens of degrees, logarithm of the humidity
    SPREAD = (0.8, 0.6)
    DISCRIMINATING_MEASUREMENT = "distances and rooms of very different size, or a hygrometer"

    def vector(self) -> FloatArray:
        return np.array([self.temperature_c / 10.0, np.log(self.humidity_pct)])

    @classmethod
    def from_vector(cls, vector: ArrayLike) -> Self:
        vector = np.asarray(vector)
        return cls(float(np.clip(10.0 * vector[0], *_TEMPERATURES_C)),
                   float(np.exp(np.clip(vector[1], *np.log(_HUMIDITIES_PCT)))))

    def changed_air(self, air: Air | ModelAir) -> ModelAir:
        return ModelAir(air.speed_m_s, np.array(band_attenuation_per_m(self.temperature_c, self.humidity_pct)))
