"""Frequency responses that a recording chain puts on everything it records, and their shared parts."""

from dataclasses import dataclass

import numpy as np
import scipy  # its submodules are slow to import and load themselves when first used

from roomeq.effects.base import Effect, minimum_phase

RESPONSE_HZ = tuple(1000.0 * 10.0 ** (0.1 * k) for k in range(-13, 10))
"""Third octaves from 50 Hz to 8 kHz."""
_SPREAD_DB = 6.0
_MOST_DB = 60.0
_ROUGH_DB = 1.5
_WIDTH = 2.0  # third octaves over which a response stays alike


@dataclass(frozen=True)
class Response(Effect):
    """A magnitude response, minimum phase.

    Attributes
    ----------
    gains_db : tuple of 23 floats
        At `RESPONSE_HZ`, within 60 dB.
    """

    gains_db: tuple

    REFLECTIONS = False
    STARTS = ((0.0,) * len(RESPONSE_HZ),)
    SPREAD = (_SPREAD_DB,) * len(RESPONSE_HZ)

    @classmethod
    def prior_covariance(cls):
        lag = np.subtract.outer(np.arange(len(RESPONSE_HZ)), np.arange(len(RESPONSE_HZ)))
        return _SPREAD_DB ** 2 * np.exp(-0.5 * (lag / _WIDTH) ** 2) + _ROUGH_DB ** 2 * np.eye(len(RESPONSE_HZ))

    def vector(self):
        return np.array(self.gains_db)

    @classmethod
    def from_vector(cls, vector):
        return cls(tuple(float(value) for value in np.clip(vector, -_MOST_DB, _MOST_DB)))

    def apply_to_prediction(self, state, data, rows):
        state.response_db[rows] += np.array(self.gains_db)

    def on_rir(self, rir, rendering):
        return scipy.signal.oaconvolve(rir, minimum_phase(RESPONSE_HZ, self.gains_db))[:len(rir)]
