"""The wave field of a room below its Schroeder frequency, in place of rays (`roomeq.effects.wavefield`)."""

from dataclasses import dataclass

from roomeq.constants import FS_HZ
from roomeq.effects.base import Effect
from roomeq.effects.wavefield import MARGIN, cross_over, crossover_hz, damping_per_s, modal_response, modes


@dataclass(frozen=True)
class RoomModes(Effect):
    """Modes of the room's own geometry, damped as its surfaces and air absorb: nothing is left to fit."""

    REFLECTIONS = False
    NAME = "room_modes"
    SCOPE = "room"
    STARTS = ((),)
    SPREAD = ()
    RENDERED = True
    TELLS = "a source that reaches lower, or more positions"

    @classmethod
    def from_vector(cls, vector):
        return cls()

    def vector(self):
        return []

    def act(self, state, data, rows):
        state.shift[rows] += data.shift_of(RoomModes)[rows]

    def on_rir(self, rir, rendering):
        room, speed_m_s = rendering.scene.room, rendering.scene.air.speed_m_s
        frequency_hz = crossover_hz(room, rendering.t60_s, speed_m_s)
        found = modes(room, MARGIN * frequency_hz, speed_m_s)
        low = modal_response(found, rendering.source_pos_m, rendering.mic_pos_m,
                             damping_per_s(found.frequencies_hz, rendering.t60_s), len(rir), FS_HZ)
        return cross_over(low, rir, FS_HZ, frequency_hz)
