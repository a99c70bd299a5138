"""An obstacle between source and microphone: the direct sound comes around its edge.

Kurze and Anderson, Appl. Acoust. 4 (1971) 35, and Maekawa, Appl. Acoust. 1 (1968) 157, for a screen: attenuation
``10 log10(1 + 20 N)`` dB at the Fresnel number ``N = 2 delta f / c``, delta being the detour.
"""

from dataclasses import dataclass

import numpy as np

from roomeq.core.constants import EXACT_BANDS_HZ
from roomeq.effects.base import Effect

_DETOURS_M = (5e-5, 0.6)
_MOST_DB = 24.0  # what scatters around a screen leaves


@dataclass(frozen=True)
class Occlusion(Effect):
    """Obstructed direct sound of one RIR.

    Attributes
    ----------
    detour_m : float
        How much longer the way around the edge is; a tenth of a millimetre or less for a free view.
    """

    detour_m: float

    REFLECTIONS = False
    NAME = "occlusion"
    SCOPE = "rir"
    STARTS = ((-5.0,),)  # logarithm of metres: from as good as nothing to a pillar
    SPREAD = (2.5,)
    DISCRIMINATING_MEASUREMENT = "a recording with the obstacle taken away"

    def vector(self):
        return np.log([self.detour_m])

    @classmethod
    def from_vector(cls, vector):
        return cls(float(np.exp(np.clip(vector[0], *np.log(_DETOURS_M)))))

    def energy_gain(self, frequencies_hz, speed_m_s):
        """Energy of the direct sound that is left."""
        fresnel = 2.0 * self.detour_m * np.asarray(frequencies_hz) / speed_m_s
        return np.maximum(1.0 / (1.0 + 20.0 * fresnel), 10.0 ** (-_MOST_DB / 10.0))

    def apply_to_prediction(self, state, data, rows):
        state.direct_gain[rows] *= self.energy_gain(EXACT_BANDS_HZ, data.speed_m_s[rows][:, None])
        state.delay_s[rows] += self.detour_m / data.speed_m_s[rows]

    def on_rir(self, rir, rendering):
        left = np.sqrt(self.energy_gain(EXACT_BANDS_HZ, rendering.scene.air.speed_m_s))
        if not np.any(rendering.direct_gain):
            return rir
        around = rendering.pulse(rendering.distance_m + self.detour_m, left * rendering.direct_gain, len(rir))
        return rir - rendering.direct(len(rir)) + around
