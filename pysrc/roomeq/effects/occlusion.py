"""An obstacle between source and microphone: the direct sound arrives around its edge.

Kurze and Anderson, Appl. Acoust. 4 (1971) 35, and Maekawa, Appl. Acoust. 1 (1968) 157, for a screen: attenuation
``10 log10(1 + 20 N)`` dB at the Fresnel number ``N = 2 delta f / c``, where delta is the detour.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from roomeq.core.arrays import FloatArray, IntArray
from roomeq.core.constants import EXACT_BANDS_HZ
from roomeq.effects.base import Effect, Rendering
from roomeq.effects.prediction import PredictedRirs, PredictionState

_DETOURS_M = (5e-5, 0.6)
_MAX_ATTENUATION_DB = 24.0  # sound that is scattered around a screen sets a limit


@dataclass(frozen=True)
class Occlusion(Effect):
    """Obstructed direct sound of one RIR.

    Attributes
    ----------
    detour_m : float
        Length of the path around the edge less that of the straight line; 0.1 mm or less means a free view.
    """

    detour_m: float

    REFLECTIONS = False
    NAME = "occlusion"
    SCOPE = "rir"
    STARTS = ((-5.0,),)  # logarithm of metres; the spread reaches from a free view to a pillar
    SPREAD = (2.5,)
    DISCRIMINATING_MEASUREMENT = "a recording with the obstacle taken away"

    def vector(self) -> FloatArray:
        return np.log([self.detour_m])

    @classmethod
    def from_vector(cls, vector: ArrayLike) -> Self:
        return cls(float(np.exp(np.clip(np.asarray(vector)[0], *np.log(_DETOURS_M)))))

    def energy_gain(self, frequencies_hz: ArrayLike, speed_m_s: float | FloatArray) -> FloatArray:
        """Return the energy gain of the direct sound, of the shape to which the arguments broadcast."""
        fresnel = 2.0 * self.detour_m * np.asarray(frequencies_hz) / speed_m_s
        return np.maximum(1.0 / (1.0 + 20.0 * fresnel), 10.0 ** (-_MAX_ATTENUATION_DB / 10.0))

    def apply_to_prediction(self, state: PredictionState, data: PredictedRirs, rows: IntArray) -> None:
        state.direct_gain[rows] *= self.energy_gain(EXACT_BANDS_HZ, data.speed_m_s[rows][:, None])
        state.delay_s[rows] += self.detour_m / data.speed_m_s[rows]

    def on_rir(self, rir: FloatArray, rendering: Rendering) -> FloatArray:
        pressure_gain = np.sqrt(self.energy_gain(EXACT_BANDS_HZ, rendering.scene.air.speed_m_s))
        if not np.any(rendering.direct_gain):
            return rir
        diffracted = rendering.pulse(rendering.distance_m + self.detour_m, pressure_gain * rendering.direct_gain,
                                     len(rir))
        return rir - rendering.direct(len(rir)) + diffracted
