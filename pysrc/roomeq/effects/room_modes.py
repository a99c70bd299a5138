"""The wave field of a room at low frequencies, in place of rays (`roomeq.effects.wavefield`)."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from roomeq.core.arrays import FloatArray, IntArray
from roomeq.core.constants import FS_HZ
from roomeq.effects.base import Effect, Rendering
from roomeq.effects.prediction import PredictedRirs, PredictionState
from roomeq.effects.wavefield import (
    MARGIN,
    MAX_CROSSOVER_HZ,
    cross_over,
    crossover_hz,
    damping_per_s,
    modal_response,
    modes,
)

_REFERENCE_HZ = 100.0
_RANGE_HZ = (40.0, MAX_CROSSOVER_HZ)


@dataclass(frozen=True)
class RoomModes(Effect):
    """Modes of the room's own geometry, damped by the absorption of its surfaces and air.

    How modes interfere at a position follows from no table of energies. The prediction interpolates between changes of
    the features that are measured on renderings (`INTERPOLATION_GRID`).

    Attributes
    ----------
    up_to_hz : float
        Crossover to rays; a room's Schroeder frequency takes its place where that is lower.
    """

    up_to_hz: float

    NAME = "room_modes"
    SCOPE = "all"
    REFLECTIONS = False
    STARTS = tuple((np.log2(hz / _REFERENCE_HZ),) for hz in (60.0, 90.0, 200.0))
    SPREAD = (1.0,)
    INTERPOLATION_GRID = tuple((np.log2(hz / _REFERENCE_HZ),)
                               for hz in (*_RANGE_HZ[:1], 60.0, 90.0, 130.0, *_RANGE_HZ[1:]))
    DISCRIMINATING_MEASUREMENT = "a source that reaches lower, or more positions"

    def vector(self) -> FloatArray:
        return np.log2([self.up_to_hz / _REFERENCE_HZ])

    @classmethod
    def from_vector(cls, vector: ArrayLike) -> Self:
        return cls(float(np.clip(_REFERENCE_HZ * 2.0 ** np.asarray(vector)[0], *_RANGE_HZ)))

    def apply_to_prediction(self, state: PredictionState, data: PredictedRirs, rows: IntArray) -> None:
        grid = [point[0] for point in self.INTERPOLATION_GRID]
        weights = [np.interp(self.vector()[0], grid, unit) for unit in np.eye(len(grid))]
        state.rendered_change[rows] += np.tensordot(weights, data.rendered_change_of(RoomModes)[:, rows], axes=1)

    def on_rir(self, rir: FloatArray, rendering: Rendering) -> FloatArray:
        room, speed_m_s = rendering.scene.room, rendering.scene.air.speed_m_s
        frequency_hz = min(self.up_to_hz, crossover_hz(room, rendering.t60_s, speed_m_s))
        room_modes = modes(room, MARGIN * frequency_hz, speed_m_s)
        low = modal_response(room_modes, rendering.source_pos_m, rendering.mic_pos_m,
                             damping_per_s(room_modes.frequencies_hz, rendering.t60_s), len(rir), FS_HZ)
        return cross_over(low, rir, FS_HZ, frequency_hz, rendering.distance_m / speed_m_s)
