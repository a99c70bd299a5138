"""An equaliser for what all recordings have in common and no physical effect explains.

The paper's compensation (Tang, Meng, Manocha, section 3) draws an equaliser from a distribution over RIRs. This effect
is the mean of that distribution. It competes with effects that have a physical cause.
"""

from dataclasses import dataclass

from roomeq.effects.response import Response


@dataclass(frozen=True)
class RoomEq(Response):
    """Response of all recordings."""

    NAME = "room_eq"
    SCOPE = "all"
    NAMES_CAUSE = False
    DISCRIMINATING_MEASUREMENT = "a second loudspeaker and a second microphone in the same rooms"
