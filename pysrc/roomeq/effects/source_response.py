"""Magnitude response of each loudspeaker: resonances and roll-offs in everything that it plays."""

from dataclasses import dataclass

from roomeq.effects.response import Response


@dataclass(frozen=True)
class SourceResponse(Response):
    """Magnitude response of the source with one `source_id`; the on-axis response if the source has a directivity."""

    NAME = "source_response"
    SCOPE = "source"
    DISCRIMINATING_MEASUREMENT = "a recording of the same room with another loudspeaker"
