"""Magnitude response of each microphone, for example its presence peak, proximity effect or roll-off."""

from dataclasses import dataclass

from roomeq.effects.response import Response


@dataclass(frozen=True)
class MicResponse(Response):
    """Magnitude response of the microphone with one `mic_id`."""

    NAME = "mic_response"
    SCOPE = "mic"
    DISCRIMINATING_MEASUREMENT = "a recording of the same room with another microphone"
