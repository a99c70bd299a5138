"""Stationary coloured noise in the recordings of a room: hum, ventilation, hiss of the recording chain.

Its spectrum is given by third octaves: noise of octaves would spread the hum of a fan over the whole octave, and a loud
octave would cover the decay in its quiet neighbours.

The signal-to-noise ratio differs between recordings of the same room, for example with the playback level. White noise
is estimated for each recording. The coloured noise of the room is assumed to have a constant ratio to it, except in
recordings whose white noise is weaker than `QUIET_DB`.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from roomeq.acoustics.octaves import OCTAVE_OF_THIRD, OCTAVE_WIDTH_HZ, THIRD_WIDTH_HZ, THIRDS_HZ
from roomeq.core.arrays import FloatArray, IntArray
from roomeq.core.constants import FS_HZ
from roomeq.effects.base import Effect, Rendering, correlation_of_bands, octave_energies
from roomeq.effects.prediction import PredictedRirs, PredictionState

NOISE_S = 0.1
"""Duration [s] of the section of noise whose energy is given relative to that of the response."""
QUIET_DB = -55.0
"""Noise below this level does not affect the measured decay: energy of `NOISE_S` of noise relative to the response, per
octave band [dB]."""
SHARE_OF_THIRD = THIRD_WIDTH_HZ / OCTAVE_WIDTH_HZ[OCTAVE_OF_THIRD]
"""Share of an octave's white noise that lies in each third octave, shape (22,)."""
_QUIET_THIRDS_DB = QUIET_DB + 10.0 * np.log10(SHARE_OF_THIRD)
_SMOOTH_SHARE, _CORRELATION_THIRDS = 0.8, 4.0  # of the variance of the spectrum; the rest are tones
_PASSES = 4  # to find the values of a spectrum
_SMOOTH = 0.2  # rounding of the vector's lower end, which adds 1 dB of noise at 0


@dataclass(frozen=True)
class NoiseFloor(Effect):
    """Stationary noise in recordings of a room.

    Attributes
    ----------
    levels_db : tuple of 22 floats
        Energy of 100 ms of noise in each third octave (`roomeq.acoustics.octaves.THIRDS_HZ`) relative to the response
        in its octave, in a recording without white noise. In a recording with white noise it is larger by the factor
        1 + w / q, where w is the energy of the white noise in the octave and q the energy that corresponds to
        `QUIET_DB`.
    """

    levels_db: tuple[float, ...]

    REFLECTIONS = False
    MEASURED = True
    IN_RESPONSE = False
    NAME = "noise_floor"
    SCOPE = "room"
    STARTS = ((0.5,) * len(THIRDS_HZ),)  # tens of dB that the noise adds to white noise of `QUIET_DB`
    SPREAD = (1.0,) * len(THIRDS_HZ)
    BANDS = tuple(OCTAVE_OF_THIRD.tolist())
    DISCRIMINATING_MEASUREMENT = "a recording of the background noise before the sweep"

    @classmethod
    def prior_covariance(cls) -> FloatArray:
        n = len(cls.SPREAD)
        return _SMOOTH_SHARE * correlation_of_bands(n, _CORRELATION_THIRDS) + (1.0 - _SMOOTH_SHARE) * np.eye(n)

    def vector(self) -> FloatArray:
        added = 2.0 * np.log10(1.0 + 10.0 ** ((np.array(self.levels_db) - _QUIET_THIRDS_DB) / 10.0))
        return (added ** 2 - _SMOOTH ** 2) / (2.0 * added)

    @classmethod
    def from_vector(cls, vector: ArrayLike) -> Self:
        vector = np.clip(vector, -3.0, 5.0)
        added = 0.5 * (vector + np.hypot(vector, _SMOOTH))
        return cls(tuple((_QUIET_THIRDS_DB + 10.0 * np.log10(10.0 ** added - 1.0)).tolist()))

    @classmethod
    def measured_vectors(cls, data: PredictedRirs) -> FloatArray:
        """Return the vector of each room whose noise is that at the end of its recordings; 0 where that is unknown."""
        vectors = np.zeros((int(data.room.max()) + 1, len(cls.SPREAD)))
        for r, vector in enumerate(vectors):
            of_room = data.noise_db[data.room == r]
            known = np.isfinite(of_room).any(axis=0)
            vector[known] = np.maximum(np.nanmedian(of_room[:, known], axis=0), 0.0) / 10.0
        return vectors

    def energy_ratio(self, white: FloatArray) -> FloatArray:
        """Return the energy of 100 ms of noise in third octaves relative to the response in their octave, (..., 22).

        Parameters
        ----------
        white : ndarray, shape (..., 8)
            Energy of 100 ms of the recording's white noise relative to the response.
        """
        of_octave = 1.0 + white[..., OCTAVE_OF_THIRD] / 10.0 ** (QUIET_DB / 10.0)
        return 10.0 ** (np.array(self.levels_db) / 10.0) * of_octave

    def apply_to_prediction(self, state: PredictionState, data: PredictedRirs, rows: IntArray) -> None:
        state.floor[rows] += self.energy_ratio(data.white[rows])

    def on_rir(self, rir: FloatArray, rendering: Rendering) -> FloatArray:
        per_sample = self.energy_ratio(rendering.white) * octave_energies(rir)[OCTAVE_OF_THIRD] / (NOISE_S * FS_HZ)
        n = next_fast_len(len(rir), real=True)
        noise = irfft(rfft(rendering.rng.standard_normal(n)) * np.sqrt(_power_gain(per_sample, n)), n)
        return rir + noise[:len(rir)]


def _power_gain(per_sample: FloatArray, n_fft: int) -> FloatArray:
    """Return the power gain of a filter for white noise of unit variance, shape (n_fft // 2 + 1,).

    The density is interpolated in dB over log frequency, since noise with steps at the edges of third octaves would
    reach far into the next ones. Its values at the middle of third octaves are such that each has its energy
    `per_sample`, as far as the slopes of a louder neighbour allow.
    """
    frequency_hz = np.maximum(rfftfreq(n_fft, 1.0 / FS_HZ), 1.0)
    place = 10.0 * np.log10(frequency_hz / THIRDS_HZ[0])
    third = np.clip(np.rint(place), 0, len(THIRDS_HZ) - 1).astype(int)
    inside = np.abs(place - third) < 0.5  # the outermost go on beyond
    wanted = np.maximum(per_sample, 1e-30)
    of_thirds = np.log(wanted / THIRD_WIDTH_HZ)
    for _ in range(_PASSES):
        density = np.exp(np.interp(np.log(frequency_hz), np.log(THIRDS_HZ), of_thirds))
        energy = np.bincount(third[inside], density[inside], minlength=len(THIRDS_HZ)) * FS_HZ / n_fft
        of_thirds += np.log(np.where(energy > 0.0, wanted / np.maximum(energy, 1e-30), 1.0))
    return 0.5 * FS_HZ * density
