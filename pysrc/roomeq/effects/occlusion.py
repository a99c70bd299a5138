"""An obstacle between source and microphone: the direct sound arrives around its edges, early reflections are shaded.

Direct sound
    Maekawa, Appl. Acoust. 1 (1968) 157, and Kurze and Anderson, Appl. Acoust. 4 (1971) 35: an edge attenuates by
    ``10 log10(1 + 20 N)`` dB at the Fresnel number ``N = 2 delta f / c``, where delta is the detour. Sound comes around
    at least two sides of a finite obstacle, such as a pillar or a head: ``10 log10(1 + 10 N)``. The limit of 20 to 24
    dB that is known from barriers outdoors is due to scattered sound, which in a room is that of the reflections.
Reflections
    Of the reflections whose paths are longer than the direct one by e, those are shaded that arrive or depart within
    the obstacle's cone. Scatterers that fill the space uniformly contribute ``d eta / (xi^2 - eta^2)`` in prolate
    spheroidal coordinates about source and microphone, ``xi = 1 + e / r``, and nearly uniformly in eta. The cone of a
    round obstacle half-way, around whose edge sound takes a detour of ``w``, has the cosine ``r / (r + w)``, and the
    share outside of both cones is ``(e - w) / (e + w + e w / r)``. The cone is larger than that of the detour, because
    a path that does not meet the obstacle in its middle has the shortest detour around the nearest edge: a round
    obstacle shades as if w were one (met in the middle) to three times (met anywhere, in the mean) the detour.
    Reflections off the obstacle itself replace what it shades within the time in which the field becomes diffuse.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import irfft, next_fast_len, rfft

from roomeq.acoustics.filterbank import SPREAD_S, octave_filterbank
from roomeq.core.arrays import FloatArray, IntArray
from roomeq.core.constants import EXACT_BANDS_HZ, FS_HZ
from roomeq.effects.base import Effect, Rendering
from roomeq.effects.prediction import PredictedRirs, PredictionState

_DETOURS_M = (5e-5, 3.0)
_SIDES = 2.0  # around which sound comes
_WIDTH = 2.0  # detour of the round obstacle that shades as many reflections, relative to the shortest detour
_DIFFUSE_M = 17.0  # path in which the field behind the obstacle becomes diffuse: 50 ms
_SHADED_S = 0.25  # after the direct sound; later less than 1 % of the reflections are shaded


@dataclass(frozen=True)
class Occlusion(Effect):
    """Obstructed direct sound and early reflections of one RIR.

    Attributes
    ----------
    detour_m : float
        Length of the path around the nearest edge less that of the straight line; 0.1 mm or less means a free view.
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
        return 1.0 / (1.0 + 20.0 / _SIDES * fresnel)

    def shaded_share(self, excess_m: ArrayLike, distance_m: float | FloatArray) -> FloatArray:
        """Return the share of reflections that are shaded, of the shape to which the arguments broadcast.

        Parameters
        ----------
        excess_m : array_like
            Lengths of their paths less that of the direct sound.
        distance_m : array_like
            Length of the direct path.
        """
        excess, width = np.asarray(excess_m) / distance_m, _WIDTH * self.detour_m / distance_m
        outside = np.maximum(excess - width, 0.0) / (excess + width + excess * width)
        return (1.0 - outside) * np.exp(-np.asarray(excess_m) / _DIFFUSE_M)

    def reflected_gain(self, excess_m: FloatArray, distance_m: float | FloatArray,
                       speed_m_s: float | FloatArray) -> FloatArray:
        """Return the energy gain of reflections per octave, shape (..., 8) for an excess of shape (...)."""
        share = self.shaded_share(excess_m, distance_m)[..., None]
        return 1.0 - share * (1.0 - self.energy_gain(EXACT_BANDS_HZ, speed_m_s))

    def apply_to_prediction(self, state: PredictionState, data: PredictedRirs, rows: IntArray) -> None:
        rows = rows[[data.tables[n].visible for n in rows]]
        speed_m_s = state.speed_m_s[rows][:, None]
        state.direct_gain[rows] *= self.energy_gain(EXACT_BANDS_HZ, speed_m_s)
        state.delay_s[rows] += self.detour_m / state.speed_m_s[rows]
        excess_m = data.frame_mid_s * data.speed_m_s[rows][:, None]
        state.shade_reflections(rows, self.reflected_gain(excess_m, data.distance_m[rows][:, None],
                                                          speed_m_s[:, :, None]))

    def on_rir(self, rir: FloatArray, rendering: Rendering) -> FloatArray:
        if not np.any(rendering.direct_gain):
            return rir
        pressure_gain = np.sqrt(self.energy_gain(EXACT_BANDS_HZ, rendering.scene.air.speed_m_s))
        diffracted = rendering.pulse(rendering.distance_m + self.detour_m, pressure_gain * rendering.direct_gain,
                                     len(rir))
        return self._shaded(rir - rendering.direct(len(rir)), rendering) + diffracted

    def _shaded(self, reflections: FloatArray, rendering: Rendering) -> FloatArray:
        """Return the reflections with the gain of their time in each octave."""
        speed_m_s, distance_m = rendering.scene.air.speed_m_s, rendering.distance_m
        start, guard = int(np.ceil(distance_m / speed_m_s * FS_HZ)), int(SPREAD_S * FS_HZ)
        stop = min(len(reflections), start + int(_SHADED_S * FS_HZ))
        n_fft = next_fast_len(stop + 2 * guard, real=True)
        octaves = irfft(rfft(reflections[:stop + guard], n_fft) * octave_filterbank(n_fft, FS_HZ), n_fft)
        excess_m = np.arange(start, stop) / FS_HZ * speed_m_s - distance_m
        pressure_gain = np.sqrt(self.reflected_gain(excess_m, distance_m, speed_m_s))
        shaded = reflections.copy()
        # the difference is added, so that nothing rings ahead of the direct sound
        shaded[start:stop] -= np.einsum("tb,bt->t", 1.0 - pressure_gain, octaves[:, start:stop])
        return shaded
