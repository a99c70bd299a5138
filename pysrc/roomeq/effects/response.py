"""Magnitude responses that a recording chain applies to everything it records, and what they share."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import irfft, next_fast_len, rfft

from roomeq.acoustics.minimum_phase import minimum_phase
from roomeq.acoustics.octaves import SPECTRUM_HZ, nearest_octave
from roomeq.core.arrays import FloatArray, IntArray
from roomeq.effects.base import Effect, Rendering, correlation_of_bands
from roomeq.effects.prediction import PredictedRirs, PredictionState

RESPONSE_HZ = (*SPECTRUM_HZ, 1000.0 * 10.0 ** (0.1 * 9))
"""Third octaves from 25 Hz to 8 kHz."""
_SPREAD_DB = 6.0
_MAX_DB = 60.0
_ROUGHNESS_DB = 1.5  # independent part of the spread
_CORRELATION_THIRDS = 2.0  # third octaves over which a response stays similar


@dataclass(frozen=True)
class Response(Effect):
    """A magnitude response of minimum phase.

    Attributes
    ----------
    gains_db : tuple of 26 floats
        At `RESPONSE_HZ`, within 60 dB.
    """

    gains_db: tuple[float, ...]

    REFLECTIONS = False
    STARTS = ((0.0,) * len(RESPONSE_HZ),)
    SPREAD = (_SPREAD_DB,) * len(RESPONSE_HZ)
    BANDS = tuple(nearest_octave(RESPONSE_HZ).tolist())

    @classmethod
    def prior_covariance(cls) -> FloatArray:
        n = len(RESPONSE_HZ)
        return cls.SPREAD[0] ** 2 * correlation_of_bands(n, _CORRELATION_THIRDS) + _ROUGHNESS_DB ** 2 * np.eye(n)

    def vector(self) -> FloatArray:
        return np.array(self.gains_db)

    @classmethod
    def from_vector(cls, vector: ArrayLike) -> Self:
        return cls(tuple(float(value) for value in np.clip(vector, -_MAX_DB, _MAX_DB)))

    def apply_to_prediction(self, state: PredictionState, data: PredictedRirs, rows: IntArray) -> None:
        state.response_db[rows] += np.array(self.gains_db)

    def on_rir(self, rir: FloatArray, rendering: Rendering) -> FloatArray:
        taps = minimum_phase(RESPONSE_HZ, self.gains_db)
        n_fft = next_fast_len(len(rir) + len(taps) - 1, real=True)
        return irfft(rfft(rir, n_fft) * rfft(taps, n_fft), n_fft)[:len(rir)]
