"""Magnitude response of each microphone, for example its presence peak, proximity effect or roll-off.

Microphones deviate less from a flat response than loudspeakers do.
"""

from dataclasses import dataclass

from roomeq.effects.response import RESPONSE_HZ, Response


@dataclass(frozen=True)
class MicResponse(Response):
    """Magnitude response of the microphone with one `mic_id`."""

    NAME = "mic_response"
    SCOPE = "mic"
    SPREAD = (4.0,) * len(RESPONSE_HZ)
    DISCRIMINATING_MEASUREMENT = "a recording of the same room with another microphone"
