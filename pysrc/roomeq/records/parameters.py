"""Valid values among the acoustic parameters of a row (`roomeq.records.schema.AcousticParameters`)."""

from collections.abc import Mapping
from typing import Any

from roomeq.core.constants import BAND_1KHZ


def value_of(parameters: Mapping[str, Any], metric: str, band: int = BAND_1KHZ) -> float | None:
    """Return the valid value of a metric ("edt", "t20", "t30", "c50" or "eq") in a band, or None."""
    values = parameters.get(f"{metric}_{'db' if metric in ('c50', 'eq') else 's'}")
    valid = parameters.get(f"{metric}_valid")
    return values[band] if values and valid and band < len(values) and valid[band] else None


def reverberation_time_s(parameters: Mapping[str, Any], band: int = BAND_1KHZ) -> float | None:
    """Return T30 of a band, or T20 where T30 is invalid."""
    t30_s = value_of(parameters, "t30", band)
    return value_of(parameters, "t20", band) if t30_s is None else t30_s
