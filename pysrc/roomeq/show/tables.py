"""Acoustic parameters as rows of text, for pages and for the terminal."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from roomeq.acoustics.jnd import C50_JND_DB, DECAY_JND, DRR_JND_DB, LEVEL_JND_DB
from roomeq.core.arrays import FloatArray
from roomeq.records.geometry import distance_between
from roomeq.records.parameters import reverberation_time_s, value_of
from roomeq.report.formats import DASH, hertz, number
from roomeq.show.analysis import AnalysedRir
from roomeq.show.inputs import RirSet, ShownRir

METRICS = ("edt", "t20", "t30", "c50", "eq")
"""Parameters per octave band."""
HEADINGS = {"edt": "EDT (s)", "t20": "T20 (s)", "t30": "T30 (s)", "c50": "C50 (dB)", "eq": "EQ (dB)"}
UNITS_JND = {"edt": DECAY_JND, "t20": DECAY_JND, "t30": DECAY_JND, "c50": C50_JND_DB, "eq": LEVEL_JND_DB,
             "drr": DRR_JND_DB}
"""Size of a JND: decay times as logarithms, levels in dB."""
DECIMALS = {"edt": 2, "t20": 2, "t30": 2, "c50": 1, "eq": 1}
BAND_COLUMNS = ["Octave", *(HEADINGS[metric] for metric in METRICS), "Decay range (dB)", "Meets noise (s)"]
ROOM_COLUMNS = ["Room", "Size (m)", "RIRs", "T60, 1 kHz (s)", "C50, 1 kHz (dB)", "DRR (dB)", "Distance (m)"]


def band_rows(rir: AnalysedRir) -> list[list[str]]:
    """Return the parameters of each octave band; a dash stands for values that are not valid."""
    rows = []
    for number_of_band, band in enumerate(rir.decays):
        values = [number(value_of(rir.parameters, metric, number_of_band), DECIMALS[metric]) for metric in METRICS]
        range_db = rir.parameters["decay_range_db"][number_of_band]
        meets = f"{band.intersection_s:.2f}" if band.has_noise else DASH
        rows.append([hertz(band.band_hz), *values, "∞" if range_db >= 199.0 else number(range_db, 0), meets])
    return rows


def summary_rows(shown: ShownRir) -> list[list[str]]:
    """Return the parameters of the whole response: name and value."""
    rir = shown.rir
    row: dict[str, Any] = dict(shown.row or {})
    parameters = rir.parameters
    rows = [["Sample rate", f"{rir.fs_hz:,} Hz"],
            ["Length", f"{len(rir.samples) / rir.fs_hz:.3f} s ({len(rir.samples):,} samples)"],
            ["Largest sample", number(float(np.abs(rir.samples).max()), 4)],
            ["Direct sound", f"{1e3 * rir.direct_s:.2f} ms after the start"
             + (", inverted" if rir.direct.polarity < 0 else "")],
            ["Reverberation time, 1 kHz", with_unit(reverberation_time_s(parameters), 2, "s")],
            ["Direct-to-reverberant ratio (DRR)", with_unit(parameters.get("drr_db"), 1, "dB")],
            ["Noise floor re strongest 5 ms", with_unit(parameters.get("noise_floor_db"), 0, "dB")]]
    distance_m = distance_of(row)
    if distance_m is not None:
        rows.append(["Distance of source and microphone", with_unit(distance_m, 2, "m")])
    for key, label in (("room_id", "Room"), ("source_id", "Source"), ("mic_id", "Microphone")):
        if row.get(key):
            rows.append([label, str(row[key])])
    if row.get("room_dims_m"):
        rows.append(["Dimensions of the room", f"{size_text(row)} m"])
    return rows


def room_rows(of_set: RirSet) -> list[list[str]]:
    """Return a row for each room of a set: medians over its RIRs."""
    rows = []
    for room, numbers in sorted(of_set.rooms.items()):
        values = [of_set.parameters[n] for n in numbers]
        row = of_set.rows[numbers[0]]
        rows.append([room, size_text(row), str(len(numbers)), number(middle(map(reverberation_time_s, values)), 2),
                     number(middle(value_of(parameters, "c50") for parameters in values)),
                     number(middle(parameters.get("drr_db") for parameters in values)),
                     number(middle(distance_of(of_set.rows[n]) for n in numbers), 2)])
    return rows


def rir_rows(of_set: RirSet, limit: int) -> list[list[str]]:
    """Return a row for each of the first RIRs of a set: id, room, distance, T60, C50 and DRR."""
    return [[row["id"], row["room_id"], number(distance_of(row), 2), number(reverberation_time_s(parameters), 2),
             number(value_of(parameters, "c50")), number(parameters.get("drr_db"))]
            for row, parameters in list(zip(of_set.rows, of_set.parameters, strict=True))[:limit]]


def distance_of(row: Any) -> float | None:
    """Return the distance of source and microphone from their positions, or as it is stated [m]."""
    between_m = distance_between(row.get("source_pos_m"), row.get("mic_pos_m"))
    return row.get("distance_m") if between_m is None else between_m


def size_text(row: Any) -> str:
    """Return the dimensions of a room as text."""
    if row.get("mesh"):
        return "mesh"
    dims_m = row.get("room_dims_m")
    return " × ".join(number(size_m) for size_m in dims_m) if dims_m else DASH


def middle(values: Any) -> float | None:
    """Return the median of the values that are not None."""
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else None


def with_unit(value: float | None, decimals: int, unit: str) -> str:
    """Return a value with its unit, or a dash."""
    return DASH if value is None else f"{number(value, decimals)} {unit}"


def differences_jnd(first: dict[str, Any], second: dict[str, Any], n_bands: int) -> dict[str, FloatArray]:
    """Return second minus first in JND for each parameter per octave band, shape (n_bands,), and "drr", shape (1,).

    NaN where a value is not valid in both.
    """
    result = {}
    for metric in METRICS:
        pairs = [(value_of(first, metric, band), value_of(second, metric, band)) for band in range(n_bands)]
        result[metric] = np.array([difference_jnd(metric, a, b) for a, b in pairs])
    result["drr"] = np.array([difference_jnd("drr", first.get("drr_db"), second.get("drr_db"))])
    return result


def difference_jnd(metric: str, first: float | None, second: float | None) -> float:
    """Return second minus first in JND; NaN where one is None."""
    if first is None or second is None:
        return float("nan")
    if metric in ("edt", "t20", "t30"):
        return float(np.log(second / first) / UNITS_JND[metric])
    return float((second - first) / UNITS_JND[metric])


def signed(value: float | None) -> str:
    """Return a number with its sign and one decimal, or a dash."""
    if value is None or not np.isfinite(value):
        return DASH
    return f"{'+' if round(value, 1) > 0.0 else ''}{number(value)}"


def as_text(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table of text in columns, the first flush left and the others flush right."""
    table = [list(columns), *[[cell.replace("\N{NO-BREAK SPACE}", " ") for cell in row] for row in rows]]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    return "\n".join("  ".join(cell.ljust(width) if n == 0 else cell.rjust(width)
                               for n, (cell, width) in enumerate(zip(row, widths, strict=True))).rstrip()
                     for row in table)
