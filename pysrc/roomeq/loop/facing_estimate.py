"""The estimated facing of a loudspeaker, as log and ledger state it (`roomeq.loop.facing` estimates it)."""

from dataclasses import asdict, dataclass
from typing import Literal, get_args

Hypothesis = Literal["towards the microphone", "fixed", "free"]
HYPOTHESES: tuple[str, ...] = get_args(Hypothesis)


@dataclass(frozen=True)
class FacingEstimate:
    """The facing of a loudspeaker.

    Attributes
    ----------
    source : str
        `source_id`.
    rirs, positions : int
        Number of RIRs with an unknown facing, and of positions of the loudspeaker in them.
    hypothesis : str
        ``"towards the microphone"``; ``"fixed"``, one direction at each position; or ``"free"``, one in each
        recording, or in those that share a direct sound.
    evidence : dict
        Natural logarithm of the Bayes factor of each other hypothesis against ``"towards the microphone"``, which
        includes loudspeakers that radiate alike in all directions.
    angle_deg : float
        Mean angle between the facing and the direction of the microphone.
    """

    source: str
    rirs: int
    positions: int
    hypothesis: Hypothesis
    evidence: dict[str, float]
    angle_deg: float

    def as_dict(self) -> dict:
        return asdict(self)
