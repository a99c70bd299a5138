"""The sections of a page that compares two RIRs or two sets of RIRs."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from roomeq.core.arrays import FloatArray
from roomeq.core.constants import MAX_FS_HZ, bands_hz
from roomeq.records.parameters import value_of
from roomeq.report.figures import panel
from roomeq.report.formats import DASH, hertz, number
from roomeq.report.load import Context
from roomeq.show import figures_rir, tables
from roomeq.show.clips import clips
from roomeq.show.figures_sets import labels_of
from roomeq.show.inputs import RirSet, ShownRir
from roomeq.show.page_rir import decay_panels, frequency_panels
from roomeq.show.page_set import distribution_panels
from roomeq.show.page_set import frequency_panels as set_frequency_panels
from roomeq.show.tables import METRICS

LETTERS = ("A", "B")


@dataclass(frozen=True)
class Pairs:
    """The pairs of two sets.

    Attributes
    ----------
    numbers : list of (int, int)
        Numbers of the RIRs of each pair in the two sets.
    differences : dict
        B minus A in JND for each parameter, shape (n_pairs, n_bands); see `roomeq.show.tables.differences_jnd`.
    """

    numbers: list[tuple[int, int]]
    differences: dict[str, FloatArray]


def pair_rirs(first: RirSet, second: RirSet) -> Pairs:
    """Pair the RIRs of two sets by id, or a simulated one with the measured one that it was made for."""
    by_id = {row["id"]: number for number, row in enumerate(first.rows)}
    by_measured_id = {row["measured_id"]: number for number, row in enumerate(first.rows) if row.get("measured_id")}
    numbers, taken = [], set()
    for number_b, row in enumerate(second.rows):
        number_a = next((at for at in (by_id.get(row["id"]), by_id.get(row.get("measured_id") or ""),
                                       by_measured_id.get(row["id"]),
                                       by_measured_id.get(row.get("measured_id") or "")) if at is not None), None)
        if number_a is not None and number_a not in taken:
            taken.add(number_a)
            numbers.append((number_a, number_b))
    n_bands = min(_n_bands(first), _n_bands(second))
    each = [tables.differences_jnd(first.parameters[a], second.parameters[b], n_bands) for a, b in numbers]
    return Pairs(numbers, {metric: np.array([entry[metric] for entry in each]) for metric in (each[0] if each else ())})


def compared_rirs(first: ShownRir, second: ShownRir, speech: Path | None) -> Context:
    """Return what the template of two RIRs shows."""
    rirs = [replace(shown.rir, name=letter) for letter, shown in zip(LETTERS, (first, second), strict=True)]
    players = [(letter, colour, rir.samples, rir.fs_hz)
               for letter, colour, rir in zip(LETTERS, figures_rir.COLOURS, rirs, strict=True)]
    return {"names": [shown.rir.name for shown in (first, second)],
            "problems": [shown.problem for shown in (first, second)], "clips": clips(players, speech),
            "bands": compared_bands(first, second),
            "band_columns": [("Octave", "text"), *((tables.HEADINGS[metric], "interval") for metric in METRICS)],
            "summary": compared_summary(first, second),
            "time_panels": [panel("figure-waveform", figures_rir.waveform(rirs), "Waveforms of both RIRs"),
                            panel("figure-early", figures_rir.early_reflections(rirs),
                                  "Level of the first 60 ms of both RIRs")],
            "frequency_panels": frequency_panels(rirs, "pair"), "decay_panels": decay_panels(rirs, "pair"),
            "picture_panels": [panel(f"figure-echogram-{letter}", figures_rir.echogram(rir, letter),
                                     f"Energy of {rir.name} over time and octave bands")
                               for letter, rir in zip(LETTERS, rirs, strict=True)]}


def compared_bands(first: ShownRir, second: ShownRir) -> list[list[str]]:
    """Return for each octave band the parameters of both RIRs and the difference in JND."""
    a, b = first.rir.parameters, second.rir.parameters
    rows = []
    for band, band_hz in enumerate(bands_hz(min(first.rir.fs_hz, second.rir.fs_hz))):
        cells = [change_text(value_of(a, metric, band), value_of(b, metric, band), metric) for metric in METRICS]
        rows.append([hertz(band_hz), *cells])
    return rows


def compared_summary(first: ShownRir, second: ShownRir) -> list[list[str]]:
    """Return the parameters of the whole responses: name, A, B and the difference in JND."""
    a, b = dict(tables.summary_rows(first)), dict(tables.summary_rows(second))
    difference = tables.differences_jnd(first.rir.parameters, second.rir.parameters, 5)
    jnd = {"Direct-to-reverberant ratio (DRR)": float(difference["drr"][0]),
           "Reverberation time, 1 kHz": float(difference["t30"][4])}
    return [[name, a.get(name, DASH), b.get(name, DASH), tables.signed(jnd.get(name))] for name in {**a, **b}]


def change_text(first: float | None, second: float | None, metric: str) -> str:
    """Return two values and their difference in JND, e.g. ``0.52 → 0.60 (+2.9)``."""
    decimals = tables.DECIMALS[metric]
    if first is None and second is None:
        return DASH
    text = f"{number(first, decimals)} → {number(second, decimals)}"
    if first is None or second is None:
        return text
    return f"{text} ({tables.signed(tables.difference_jnd(metric, first, second))})"


def compared_sets(first: RirSet, second: RirSet, pairs: Pairs) -> Context:
    """Return what the template of two sets shows."""
    sets = [first, second]
    return {"labels": labels_of(sets), "counts": [len(of_set.rows) for of_set in sets],
            "left_out": sum(len(of_set.left_out) for of_set in sets), "distributions": distribution_panels(sets),
            "frequency_panels": set_frequency_panels(sets),
            "columns": [("Octave", "text"), *((tables.HEADINGS[metric], "interval") for metric in METRICS)],
            "drr": paired_text(pairs.differences["drr"][:, 0]) if pairs.numbers else None,
            **compared_values(first, second, pairs)}


def compared_values(first: RirSet, second: RirSet, pairs: Pairs) -> Context:
    """Return the numbers of two sets, without figures."""
    return {"n_pairs": len(pairs.numbers), "medians": median_rows(first, second),
            "median_drr": median_drr(first, second), "paired": paired_rows(pairs)}


def median_rows(first: RirSet, second: RirSet) -> list[list[str]]:
    """Return for each octave band the medians of both sets and their difference in JND."""
    rows = []
    for band in range(min(_n_bands(first), _n_bands(second))):
        cells = [change_text(*_medians(first, second, metric, band), metric) for metric in METRICS]
        rows.append([hertz(_band_hz(band)), *cells])
    return rows


def median_drr(first: RirSet, second: RirSet) -> str:
    """Return the medians of the DRR of both sets and their difference in JND."""
    a, b = (tables.middle(parameters.get("drr_db") for parameters in of_set.parameters) for of_set in (first, second))
    return f"{number(a)} → {number(b)} dB ({tables.signed(tables.difference_jnd('drr', a, b))} JND)"


def _medians(first: RirSet, second: RirSet, metric: str, band: int) -> tuple[float | None, float | None]:
    a, b = (_median([value_of(parameters, metric, band) for parameters in of_set.parameters])
            for of_set in (first, second))
    return a, b


def _median(values: list[float | None]) -> float | None:
    """Return the median, or None if less than half of the values are valid: those that are would be no fair sample."""
    n_valid = len(values) - values.count(None)
    return tables.middle(values) if 2 * n_valid >= len(values) else None


def paired_rows(pairs: Pairs) -> list[list[str]]:
    """Return for each octave band the mean absolute and the mean difference of the pairs in JND."""
    if not pairs.numbers:
        return []
    n_bands = pairs.differences["t30"].shape[1]
    return [[hertz(_band_hz(band)), *(paired_text(pairs.differences[metric][:, band]) for metric in METRICS)]
            for band in range(n_bands)]


def paired_text(differences: FloatArray) -> str:
    """Return the mean absolute difference and the mean difference, e.g. ``2.3 (+1.1)``."""
    differences = differences[np.isfinite(differences)]
    if not len(differences):
        return DASH
    return f"{number(float(np.abs(differences).mean()))} ({tables.signed(float(differences.mean()))})"


def typical_pair(pairs: Pairs) -> int:
    """Return the number of the pair whose mean absolute difference is the median of the pairs'."""
    every = np.concatenate(list(pairs.differences.values()), axis=1)
    means = [float(np.abs(row[np.isfinite(row)]).mean()) if np.isfinite(row).any() else np.inf for row in every]
    return int(np.argsort(means, kind="stable")[(len(means) - 1) // 2])


def _n_bands(of_set: RirSet) -> int:
    return min(len(parameters["t20_s"]) for parameters in of_set.parameters)


def _band_hz(band: int) -> float:
    return bands_hz(MAX_FS_HZ)[band]
