"""The wave field of a room at low frequencies, in place of rays (`roomeq.effects.wavefield`)."""

from dataclasses import dataclass

import numpy as np

from roomeq.core.constants import FS_HZ
from roomeq.effects.base import Effect
from roomeq.effects.wavefield import MARGIN, cross_over, crossover_hz, damping_per_s, modal_response, modes

_REFERENCE_HZ = 100.0
_RANGE_HZ = (40.0, 300.0)


@dataclass(frozen=True)
class RoomModes(Effect):
    """Modes of the room's own geometry, damped as its surfaces and air absorb.

    Attributes
    ----------
    up_to_hz : float
        Rays take over from here, or from a room's Schroeder frequency where that is lower.
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

    def vector(self):
        return np.log2([self.up_to_hz / _REFERENCE_HZ])

    @classmethod
    def from_vector(cls, vector):
        return cls(float(np.clip(_REFERENCE_HZ * 2.0 ** vector[0], *_RANGE_HZ)))

    def apply_to_prediction(self, state, data, rows):
        nodes = [node[0] for node in self.INTERPOLATION_GRID]
        weights = [np.interp(self.vector()[0], nodes, unit) for unit in np.eye(len(nodes))]
        state.rendered_change[rows] += np.tensordot(weights, data.rendered_change_of(RoomModes)[:, rows], axes=1)

    def on_rir(self, rir, rendering):
        room, speed_m_s = rendering.scene.room, rendering.scene.air.speed_m_s
        frequency_hz = min(self.up_to_hz, crossover_hz(room, rendering.t60_s, speed_m_s))
        found = modes(room, MARGIN * frequency_hz, speed_m_s)
        low = modal_response(found, rendering.source_pos_m, rendering.mic_pos_m,
                             damping_per_s(found.frequencies_hz, rendering.t60_s), len(rir), FS_HZ)
        return cross_over(low, rir, FS_HZ, frequency_hz, rendering.distance_m / speed_m_s)
