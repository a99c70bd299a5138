"""Magnitude response of each loudspeaker: resonances and roll-offs on everything that it plays."""

from dataclasses import dataclass

from roomeq.effects.response import Response


@dataclass(frozen=True)
class SourceResponse(Response):
    """Of one `source_id`; on its axis, where it has a directivity."""

    NAME = "source_response"
    SCOPE = "source"
    DISCRIMINATING_MEASUREMENT = "the same room recorded with another loudspeaker"
