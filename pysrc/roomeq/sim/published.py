"""The published table of materials in pyroomacoustics, read where that package is installed.

Most of its coefficients are from Vorlaender, Auralization (2008). None of it is copied into this package.
"""

import json
from collections.abc import Iterable
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

from roomeq.core.constants import BANDS_HZ

PACKAGE = "pyroomacoustics"
_FIRST_BAND = {9: 0, 8: 0, 7: 1, 6: 1, 5: 1}  # tables of fewer bands begin at 125 Hz


def extend_bands(values: Iterable[float]) -> tuple[float, ...]:
    """Extend coefficients in octave bands from 125 Hz on to all eight: outer bands take their neighbour's value.

    Parameters
    ----------
    values
        Nine (62.5 Hz to 16 kHz), eight (to 8 kHz), seven (125 Hz to 8 kHz), six (to 4 kHz) or five (to 2 kHz).

    Returns
    -------
    tuple of 8 floats, or 9 where they are given

    Raises
    ------
    ValueError
        The number of coefficients is another.
    """
    values = tuple(values)
    if len(values) not in _FIRST_BAND:
        raise ValueError(f"{len(values)} coefficients must be 9 (62.5 Hz to 16 kHz), 8 (to 8 kHz), "
                         "7 (125 Hz to 8 kHz), 6 (125 Hz to 4 kHz) or 5 (125 Hz to 2 kHz): give one per band")
    first = _FIRST_BAND[len(values)]
    missing = max(0, len(BANDS_HZ) - first - len(values))
    return (values[0],) * first + values + (values[-1],) * missing


def published_file() -> Path | None:
    """Return the path of the published table, or None where pyroomacoustics is not installed."""
    spec = find_spec(PACKAGE)
    path = Path(spec.origin).parent / "data" / "materials.json" if spec and spec.origin else None
    return path if path and path.is_file() else None


@lru_cache(maxsize=1)
def read_published() -> dict[str, dict[str, tuple[float, ...]]]:
    """Read the published table.

    Returns
    -------
    dict of str to dict
        ``"absorption"`` and ``"scattering"``: name to tuple of 8 floats; empty where the table is not installed.

    Raises
    ------
    ValueError
        The table is installed and cannot be read.
    """
    path = published_file()
    if path is None:
        return {"absorption": {}, "scattering": {}}
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
        return {what: {name: extend_bands(min(max(float(value), 0.0), 1.0) for value in entry["coeffs"])
                       for group in table[what].values() for name, entry in group.items()}
                for what in ("absorption", "scattering")}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{path}: cannot be read as pyroomacoustics' table of materials ({error}): install version "
                         "0.10.1 of it, or name materials of your own table") from None
