"""A desk below source and microphone: one early reflection that interferes with the direct sound."""

from dataclasses import dataclass

import numpy as np

from roomeq.core.constants import EXACT_BANDS_HZ
from roomeq.effects.base import Effect
from roomeq.effects.response import RESPONSE_HZ

_POINTS = 9  # frequencies over which a third octave is averaged
_EDGE_HZ = 250.0  # below, a desk is small against the wavelength


@dataclass(frozen=True)
class NearReflector(Effect):
    """A horizontal surface in a room, below the lower one of source and microphone.

    Attributes
    ----------
    depth_m : float
        How far below.
    reflection : float
        Pressure reflection coefficient, in [0, 1].
    """

    depth_m: float
    reflection: float

    REFLECTIONS = False
    NAME = "near_reflector"
    SCOPE = "room"
    STARTS = tuple((np.log(depth_m), 0.6) for depth_m in (0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.9, 1.1))
    SPREAD = (0.5, 0.5)
    DISCRIMINATING_MEASUREMENT = "recordings at other heights"

    def vector(self):
        return np.array([np.log(self.depth_m), self.reflection])

    @classmethod
    def from_vector(cls, vector):
        return cls(float(np.exp(np.clip(vector[0], np.log(0.05), np.log(2.0)))), float(np.clip(vector[1], 0.0, 1.0)))

    def lengths_m(self, source_pos_m, mic_pos_m):
        """Lengths of the reflected path, shape (n,)."""
        source, mic = np.atleast_2d(source_pos_m), np.atleast_2d(mic_pos_m)
        plan = np.linalg.norm((mic - source)[:, :2], axis=1)
        below = np.abs(mic[:, 2] - source[:, 2]) + 2.0 * self.depth_m
        return np.hypot(plan, below)

    def apply_to_prediction(self, state, data, rows):
        source = np.array([data.places[n].source_pos_m for n in rows])
        mic = np.array([data.places[n].mic_pos_m for n in rows])
        direct_m = data.distance_m[rows]
        length_m = self.lengths_m(source, mic)
        delay_s = (length_m - direct_m) / data.speed_m_s[rows]
        amplitude = self.reflection * direct_m / length_m
        frequency = np.array(RESPONSE_HZ[:-1])[:, None] * 10.0 ** np.linspace(-0.05, 0.05, _POINTS)
        share = 1.0 / (1.0 + (_EDGE_HZ / frequency) ** 4)
        pressure = 1.0 + (amplitude[:, None, None] * np.sqrt(share)
                          * np.exp(-2j * np.pi * frequency * delay_s[:, None, None]))
        state.direct_thirds[rows] *= np.mean(np.abs(pressure) ** 2, axis=2)

    def on_rir(self, rir, rendering):
        length_m = float(self.lengths_m(rendering.source_pos_m, rendering.mic_pos_m)[0])
        share = np.sqrt(1.0 / (1.0 + (_EDGE_HZ / np.array(EXACT_BANDS_HZ)) ** 4))
        gains = self.reflection * rendering.distance_m / length_m * share * rendering.direct_gain
        return rir + rendering.pulse(length_m, gains, len(rir))
