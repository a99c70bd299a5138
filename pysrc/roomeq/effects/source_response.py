"""Magnitude response of each loudspeaker: resonances and roll-offs in everything that it plays."""

from dataclasses import dataclass

from roomeq.effects.response import Response


@dataclass(frozen=True)
class SourceResponse(Response):
    """Response of one `source_id`; that on its axis, where it has a directivity."""

    NAME = "source_response"
    SCOPE = "source"
    DISCRIMINATING_MEASUREMENT = "the same room recorded with another loudspeaker"
