"""Air absorption that differs from the scene's, because temperature or humidity differed (ISO 9613-1)."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from roomeq.acoustics.air import band_attenuation_per_m
from roomeq.core.arrays import FloatArray
from roomeq.effects.base import Effect, ModelAir
from roomeq.sim.scene import Air

_TEMPERATURE_RANGE_C = (-15.0, 45.0)
_HUMIDITY_RANGE_PCT = (3.0, 99.0)


@dataclass(frozen=True)
class AirAbsorption(Effect):
    """Absorption of the air; the speed of sound remains that of the scene.

    Attributes
    ----------
    temperature_c, humidity_pct : float
        Temperature [deg C] and relative humidity [%] of air with the same absorption. They need not be those of the
        room: many pairs of temperature and humidity give nearly the same absorption.
    """

    temperature_c: float
    humidity_pct: float

    NAME = "air_absorption"
    SCOPE = "all"
    STARTS = ((2.0, np.log(40.0)),)  # temperature / 10 deg C, natural logarithm of humidity / %
    SPREAD = (0.8, 0.6)
    DISCRIMINATING_MEASUREMENT = (
        "recordings at very different distances or in rooms of very different size, or a thermometer and a hygrometer")

    def vector(self) -> FloatArray:
        return np.array([self.temperature_c / 10.0, np.log(self.humidity_pct)])

    @classmethod
    def from_vector(cls, vector: ArrayLike) -> Self:
        vector = np.asarray(vector)
        return cls(float(np.clip(10.0 * vector[0], *_TEMPERATURE_RANGE_C)),
                   float(np.exp(np.clip(vector[1], *np.log(_HUMIDITY_RANGE_PCT)))))

    def changed_air(self, air: Air | ModelAir) -> ModelAir:
        return ModelAir(air.speed_m_s, np.array(band_attenuation_per_m(self.temperature_c, self.humidity_pct)))
