"""Numbers and bytes as text for the page."""

import base64
import io
import math
import re
from collections.abc import Sequence

from roomeq.core.arrays import FloatArray

DASH = "–"
"""Stands for a value that was not measured."""


def number(value: float | None, decimals: int = 1) -> str:
    """Format a number with a typographic minus sign, zero without one; None and non-finite values give a dash."""
    if value is None or not math.isfinite(value):
        return DASH
    return with_minus(f"{round(value, decimals) + 0.0:.{decimals}f}")


def with_interval(value: float | None, interval: Sequence[float] | None, decimals: int = 2, unit: str = "") -> str:
    """Format a number with its interval, e.g. ``1.50 (1.20 to 1.80)``; the interval is optional."""
    limits = "" if interval is None else f" ({number(interval[0], decimals)} to {number(interval[1], decimals)})"
    return f"{number(value, decimals)}{unit}{limits}"


def percent(share: float, decimals: int = 0) -> str:
    """Format a share as a percentage; the number does not break from its sign."""
    return f"{number(100 * share, decimals)}\N{NO-BREAK SPACE}%"


def hertz(value: float) -> str:
    """Format a frequency; the number does not break from its unit."""
    return f"{value:g}\N{NO-BREAK SPACE}Hz"


def duration(hours: float) -> str:
    """Format a duration in the largest fitting unit: hours, minutes or seconds."""
    if hours >= 1:
        return f"{hours:,.0f} h" if hours >= 10 else f"{hours:.1f} h"
    return f"{60 * hours:.0f} min" if hours >= 0.1 else f"{3600 * hours:.0f} s"


def with_minus(text: str) -> str:
    """Replace the hyphens of negative numbers by typographic minus signs."""
    return re.sub(r"(?<!\w)-(?=\d)", "\N{MINUS SIGN}", text)


def data_uri(mime: str, data: bytes) -> str:
    """Encode bytes as a ``data:`` URI."""
    return f"data:{mime};base64,{base64.b64encode(data).decode()}"


def flac_uri(samples: FloatArray, fs_hz: int) -> str:
    """Encode audio in [-1, 1] as FLAC in a ``data:`` URI."""
    import soundfile

    stream = io.BytesIO()
    soundfile.write(stream, samples, fs_hz, format="FLAC", subtype="PCM_16")
    return data_uri("audio/flac", stream.getvalue())
