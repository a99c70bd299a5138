"""Magnitude response of each microphone: presence peak, proximity effect, roll-offs."""

from dataclasses import dataclass

from roomeq.effects.response import Response


@dataclass(frozen=True)
class MicResponse(Response):
    """Response of one `mic_id`."""

    NAME = "mic_response"
    SCOPE = "mic"
    DISCRIMINATING_MEASUREMENT = "the same room recorded with another microphone"
