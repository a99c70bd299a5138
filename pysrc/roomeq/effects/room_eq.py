"""What all recordings have in common and no physical effect explains: an equaliser.

The paper's compensation (Tang, Meng, Manocha, section 3) draws it from a distribution over RIRs; here it is that
distribution's mean, and competes with effects that know where it comes from.
"""

from dataclasses import dataclass

from roomeq.effects.response import Response


@dataclass(frozen=True)
class RoomEq(Response):
    """Of all recordings alike."""

    NAME = "room_eq"
    SCOPE = "all"
    DISCRIMINATING_MEASUREMENT = "a second loudspeaker and a second microphone in the same rooms"
