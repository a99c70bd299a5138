"""Upper bounds on what is read into memory, so that a broken or hostile header cannot make roomeq fill it.

They are options of `roomeq` (``roomeq --max-audio-hours 24 VERB ...``) and reach worker processes and recipes as
environment variables. What exceeds a bound is refused, so that results do not depend on them; only where a step leaves
out what cannot be read (``--skip-bad``), the bound is one of its options.
"""

import os
from dataclasses import dataclass

from roomeq.core.constants import FS_HZ


@dataclass(frozen=True)
class Limit:
    """An upper bound: the option that sets it, its default, and what it limits."""

    option: str
    default: float
    description: str

    @property
    def variable(self) -> str:
        """The environment variable that sets the bound."""
        return "ROOMEQ_" + self.option.upper().replace("-", "_")

    def value(self) -> float:
        """Return the bound as the environment sets it, or the default.

        Raises
        ------
        ValueError
            The environment variable is not a positive number.
        """
        text = os.environ.get(self.variable, "")
        try:
            value = float(text or self.default)
            if not 0 < value < float("inf"):
                raise ValueError
        except ValueError:
            raise ValueError(f"{self.variable}={text!r} (option --{self.option}) must be a positive number") from None
        return value


AUDIO_HOURS = Limit("max-audio-hours", 6.0, f"longest recording that is read [h of mono at {FS_HZ} Hz]")
MESH_MB = Limit("max-mesh-mb", 64.0, "largest mesh file that is read [MB]")
LIMITS = (AUDIO_HOURS, MESH_MB)


def max_audio_samples() -> int:
    """Return the largest number of samples of a recording, all channels together."""
    return round(AUDIO_HOURS.value() * 3600 * FS_HZ)
