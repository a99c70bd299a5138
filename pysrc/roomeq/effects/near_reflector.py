"""A surface close below source and microphone, such as a desk: its reflection interferes with the direct sound."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from roomeq.acoustics.octaves import SPECTRUM_HZ
from roomeq.core.arrays import FloatArray, IntArray
from roomeq.core.constants import EXACT_BANDS_HZ
from roomeq.effects.base import Effect, Rendering
from roomeq.effects.prediction import PredictedRirs, PredictionState

_POINTS = 9  # frequencies over which a third octave is averaged
_EDGE_HZ = 250.0  # below, the surface is small against the wavelength


@dataclass(frozen=True)
class NearReflector(Effect):
    """A horizontal surface in a room, below the lower one of source and microphone.

    Attributes
    ----------
    depth_m : float
        Vertical distance below the lower one.
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

    def vector(self) -> FloatArray:
        return np.array([np.log(self.depth_m), self.reflection])

    @classmethod
    def from_vector(cls, vector: ArrayLike) -> Self:
        vector = np.asarray(vector)
        return cls(float(np.exp(np.clip(vector[0], np.log(0.05), np.log(2.0)))), float(np.clip(vector[1], 0.0, 1.0)))

    def lengths_m(self, source_pos_m: ArrayLike, mic_pos_m: ArrayLike) -> FloatArray:
        """Return the lengths of the reflected paths between positions of shape (n, 3), shape (n,)."""
        source, mic = np.atleast_2d(source_pos_m), np.atleast_2d(mic_pos_m)
        plan = np.linalg.norm((mic - source)[:, :2], axis=1)
        below = np.abs(mic[:, 2] - source[:, 2]) + 2.0 * self.depth_m
        return np.hypot(plan, below)

    def pressure_gain(self, frequencies_hz: ArrayLike, direct_m: float | FloatArray,
                      length_m: float | FloatArray) -> FloatArray:
        """Return the pressure of the reflection relative to the direct sound.

        Parameters
        ----------
        frequencies_hz, direct_m, length_m : array_like
            Frequencies, and lengths of the direct and the reflected path; shapes that broadcast.
        """
        size = 1.0 / (1.0 + (_EDGE_HZ / np.asarray(frequencies_hz)) ** 4)
        return self.reflection * direct_m / length_m * np.sqrt(size)

    def apply_to_prediction(self, state: PredictionState, data: PredictedRirs, rows: IntArray) -> None:
        direct_m = data.distance_m[rows]
        length_m = self.lengths_m(np.array([data.places[n].source_pos_m for n in rows]),
                                  np.array([data.places[n].mic_pos_m for n in rows]))
        delay_s = (length_m - direct_m) / state.speed_m_s[rows]
        frequency = np.array(SPECTRUM_HZ)[:, None] * 10.0 ** np.linspace(-0.05, 0.05, _POINTS)
        pressure = 1.0 + (self.pressure_gain(frequency, direct_m[:, None, None], length_m[:, None, None])
                          * np.exp(-2j * np.pi * frequency * delay_s[:, None, None]))
        state.direct_thirds[rows] *= np.mean(np.abs(pressure) ** 2, axis=2)

    def on_rir(self, rir: FloatArray, rendering: Rendering) -> FloatArray:
        length_m = float(self.lengths_m(rendering.source_pos_m, rendering.mic_pos_m)[0])
        gains = self.pressure_gain(EXACT_BANDS_HZ, rendering.distance_m, length_m) * rendering.direct_gain
        return rir + rendering.pulse(length_m, gains, len(rir))
