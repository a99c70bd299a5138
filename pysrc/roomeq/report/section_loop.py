"""The section about the closed loop: the effects added, the error before and after, and the unexplained residual."""

import sys
from typing import Any

import numpy as np

from roomeq.acoustics.octaves import SPECTRUM_HZ
from roomeq.core.arrays import FloatArray
from roomeq.core.constants import BANDS_HZ
from roomeq.effects.catalogue import CATALOGUE
from roomeq.effects.response import RESPONSE_HZ, Response
from roomeq.loop.acceptance import NO_CLEAR_FALL, OTHER_DEVICES, RISES
from roomeq.loop.descriptions import (
    describe_effect,
    describe_facing,
    describe_residual,
    describe_scored,
    effect_label,
    effect_names,
)
from roomeq.loop.examples import DECAY_BANDS, EXAMPLES_FILE, KINDS, STEP_S, Examples, read_examples
from roomeq.loop.facing_estimate import FacingEstimate
from roomeq.loop.features import BAND_OF_FEATURE, METRIC, REGION
from roomeq.loop.heldout_errors import SPLITS
from roomeq.loop.ledger import LEDGER_FILE, RESIDUALS_FILE, added_effects, read_ledger, read_residuals
from roomeq.loop.unexplained import Unexplained
from roomeq.report import figures, figures_loop
from roomeq.report.formats import hertz, number, percent, with_interval, with_minus
from roomeq.report.load import Context, Run

REGIONS = ("ahead", "direct", "early", "late", "whole", "floor")
"""Time regions in temporal order; the whole response stands before the noise."""

METRIC_LABELS = {"direct": "level, direct sound", "early": "level, 2.5 to 50 ms", "late": "level, 50 to 200 ms",
                 "spectrum": "level, whole response", "edt": "EDT", "t20": "T20", "t30": "T30",
                 "curvature": "T30 / T20", "c50": "C50", "drr": "DRR", "arrival": "arrival time",
                 "ahead": "level, before direct sound", "floor": "level, noise floor"}
REJECTIONS = {RISES: "held-out error rises", NO_CLEAR_FALL: "no clear fall of the held-out error",
              OTHER_DEVICES: "no fall in rooms with other devices"}
SPLIT_LABELS = {split: split.replace("_", "-") for split in SPLITS}
COLOURS = dict(zip(KINDS, ("measured", "simulated", "compensated"), strict=True))
LABELS = dict(zip(KINDS, ("measured", "simulated, before", "simulated, after"), strict=True))


def closed_loop(run: Run) -> Context:
    """Return the values of the section."""
    ledger = ledger_of(run)
    examples = run.path("loop") / EXAMPLES_FILE
    return {"ledger": ledger, "left_out": left_out(ledger), "scored": scored(ledger),
            "geometry_rows": geometry_rows(ledger), "facings": facings(ledger),
            "has_wer": run.has("wer"), "error_rows": error_rows(ledger),
            "effects": effects(ledger),
            "effect_rows": [effect_row(entry) for entry in added_effects(ledger)],
            "explained_rows": explained_rows(ledger), "at_ceiling": at_ceiling(ledger),
            "power_rows": power_rows(ledger), "maps": residual_maps(run, ledger),
            "rankings": rankings(ledger), "splits": splits(ledger),
            "responses": responses(ledger),
            "examples": example_figures(read_examples(examples)) if examples.is_file() else [],
            "unexplained": unexplained(ledger)}


def ledger_of(run: Run) -> dict[str, Any]:
    """Return the ledger of the run."""
    return run.cached("ledger", lambda: read_ledger(run.need("loop", LEDGER_FILE)))


def left_out(ledger: dict[str, Any]) -> str:
    """Return in a sentence each how many measured RIRs and test RIRs took no part, and why; empty where all did."""
    sets = [("RIRs", ledger["left_out"]), ("RIRs of the test set", ledger.get("test", {}).get("left_out", []))]
    return " ".join(f"{sum(entry['rirs'] for entry in entries)} {name} took no part ("
                    + "; ".join(f"{entry['rirs']}: {entry['reason']}" for entry in entries) + ")."
                    for name, entries in sets if entries)


def facings(ledger: dict[str, Any]) -> list[str]:
    """Return in words where the loudspeakers of the RIRs and of the test set face, if their rows do not state it."""
    sets = [("", ledger["facings"]), ("in the test set, ", ledger.get("test", {}).get("facings", []))]
    return [prefix + describe_facing(FacingEstimate(**facing)) for prefix, entries in sets for facing in entries]


def geometry_rows(ledger: dict[str, Any]) -> list[list[str]]:
    """Return the estimates of geometry that the simulation used, and those of which the recordings say something."""
    def value(mean_and_sd: list[float], unit: str) -> str:
        return with_minus(f"{mean_and_sd[0]:.2f} ± {mean_and_sd[1]:.2f} {unit}")

    entries = [*ledger["geometry"], *ledger.get("test", {}).get("geometry", [])]
    return [[entry["room"], entry["quantity"],
             "unknown" if entry["documented"] is None else with_minus(f"{entry['documented']:.2f} {entry['unit']}"),
             value(entry["prior"], entry["unit"]), value(entry["posterior"], entry["unit"]),
             with_minus(f"{entry['evidence']:.1f}"), "yes" if entry["used"] else "no"]
            for entry in entries if entry["used"] or entry["evidence"] >= 1.0]


def facts(run: Run) -> Context:
    """Return the result for the cards at the top of the page."""
    if not run.has("loop"):
        return {}
    ledger = ledger_of(run)
    before, after = (ledger[when]["leave_positions_out"]["error"] for when in ("baseline", "final"))
    return {"loop_before_jnd": before, "loop_after_jnd": after, "n_effects": len(added_effects(ledger)),
            "loop_explained": ledger["explained"]["leave_positions_out"]["share"]}


def effects(ledger: dict[str, Any]) -> list[Context]:
    """Describe the effects that the loop added."""
    return [added_effect(entry) for entry in added_effects(ledger)]


def unexplained(ledger: dict[str, Any]) -> list[str]:
    """Describe the residuals that no effect explains."""
    return [sentence(describe_residual(Unexplained(**residual))) for residual in ledger["unexplained_all"]]


def added_effect(entry: dict[str, Any]) -> Context:
    """Describe an effect that the loop added: its physics, its parameters and the held-out error."""
    docstring = sys.modules[CATALOGUE[entry["effect"]].__module__].__doc__ or ""
    low, high = entry["heldout_error_ci"]
    labels = [effect_label(name) for name in entry.get("cannot_tell", [entry["effect"]])]
    return {"name": effect_names(entry), "label": sentence(" or ".join(labels)).rstrip("."),
            "physics": docstring.splitlines()[0].rstrip(".:").split(" (`")[0],
            "parameters": sentence(describe_effect(entry["effect"], entry["parameters"], entry.get("sum_with"))),
            "before": entry["heldout_error_before"], "after": entry["heldout_error_after"], "low": low, "high": high,
            "discriminated_by": entry.get("would_tell", [])}


def sentence(text: str) -> str:
    """Return text as a sentence, with typographic minus signs."""
    return with_minus(f"{text[:1].upper()}{text[1:]}.")


def error_rows(ledger: dict[str, Any]) -> list[list[Any]]:
    """Return the held-out errors before and after, their ceiling and the explained share; also of the test set."""
    def row(name: str, split: str, entry: dict[str, Any], before: str, after: str) -> list[Any]:
        errors = (with_interval(entry[when][split]["error"], entry[when][split]["ci"]) for when in (before, after))
        counts = (scored_of(entry, key) for key in ("rirs", "rooms"))
        return [name, *counts, *errors, number(entry["ceiling"][split]["error"], 2),
                share_of(entry["explained"][split])]

    rows = [row(SPLIT_LABELS[split].capitalize(), split, ledger, "baseline", "final") for split in SPLITS]
    if test := ledger.get("test"):
        rows += [row(f"Test set, {SPLIT_LABELS[split]}", split, test, "before", "after") for split in SPLITS]
    return rows


def scored_of(entry: dict[str, Any], key: str) -> str | int:
    """Return how many RIRs or rooms the errors are of, and of how many, where they are not of all."""
    scored, every = entry[f"scored_{key}"], entry[key]
    return every if scored == every else f"{scored} of {every}"


def scored(ledger: dict[str, Any]) -> str:
    """Return in a sentence each on what the errors of the loop and of the test set are scored, if not on all RIRs."""
    sets = [("errors", ledger), ("errors of the test set", ledger.get("test"))]
    return " ".join(f"The {name} are of {text}." for name, entry in sets if entry and (text := describe_scored(entry)))


def share_of(explained: dict[str, Any]) -> str:
    """Format the explained share of a split with its interval."""
    if explained["share"] is None:
        return "nothing left to explain"
    limits = "" if explained["ci"] is None else f" ({' to '.join(percent(bound) for bound in explained['ci'])})"
    return percent(explained["share"]) + limits


def explained_rows(ledger: dict[str, Any]) -> list[list[str]]:
    """Return the explained share of each metric, then of each octave band, on both splits."""
    of_splits = [ledger["explained"][split] for split in SPLITS]
    metrics = [metric for metric in METRIC_LABELS if any(metric in entry["by_metric"] for entry in of_splits)]
    rows = [[METRIC_LABELS[metric], *(share_of(entry["by_metric"][metric]) if metric in entry["by_metric"] else ""
                                      for entry in of_splits)] for metric in metrics]
    return rows + [[hertz(band_hz), *(share_of(entry["by_band"][band]) for entry in of_splits)]
                   for band, band_hz in enumerate(BANDS_HZ)]


def at_ceiling(ledger: dict[str, Any]) -> list[str]:
    """Return the labels of the metrics whose error on held-out positions cannot fall further."""
    return [METRIC_LABELS[metric] for metric in ledger["explained"][SPLITS[0]]["at_ceiling"]]


def power_rows(ledger: dict[str, Any]) -> list[list[Any]]:
    """Return the effects that were not added: if tried, why, the size that would be found, what would show less."""
    return [[entry["effect"], REJECTIONS[entry["rejected"]["reason"]] if "rejected" in entry else "not tried",
             number(entry["detectable_jnd"]), entry["would_show"]] for entry in ledger["ranking"]]


def effect_row(entry: dict[str, Any]) -> list[str]:
    """Return a row of the table of added effects."""
    return [effect_names(entry), entry["scope"], summarise_parameters(entry["parameters"]), number(entry["size_jnd"]),
            f"{entry['heldout_error_before']:.2f} → {entry['heldout_error_after']:.2f}",
            SPLIT_LABELS[entry["scored_on"]], f"{entry['p']:.1g}"]


def summarise_parameters(parameters: dict[str, Any]) -> str:
    """Return an effect's parameters in one line: each unit's value if there are one or two units, else the range."""
    best = {unit: estimate["best"] for unit, estimate in parameters.items()}
    parts = []
    for name in next(iter(best.values()), {}):
        values = {unit: np.atleast_1d(fields[name]) for unit, fields in best.items()}
        every = np.concatenate(list(values.values()))
        if len(every) > len(values):
            parts.append(f"{name} {number(every.min())} to {number(every.max())}")
        elif len(values) <= 2:
            parts.append(f"{name} " + ", ".join(f"{value[0]:.3g}" + (f" ({unit})" if unit != "all" else "")
                                                for unit, value in values.items()))
        else:
            parts.append(f"{name} {np.median(every):.3g} ({every.min():.3g} to {every.max():.3g})")
    return with_minus("; ".join(parts)) or "none"


def residual_sizes(residual: FloatArray) -> FloatArray:
    """Return the mean absolute residual of each time region and band.

    Parameters
    ----------
    residual : ndarray, shape (n_rirs, n_features)
        Measured minus simulated [JND]; NaN where not measured.

    Returns
    -------
    ndarray, shape (6, 9)
        Rows as in `REGIONS`; the ninth column is for broadband features [JND].
    """
    region = np.array([REGION[metric] for metric in METRIC])
    result = np.full((len(REGIONS), len(BANDS_HZ) + 1), np.nan)
    for row, name in enumerate(REGIONS):
        for column, band in enumerate([*range(len(BANDS_HZ)), -1]):
            features = residual[:, (region == name) & (BAND_OF_FEATURE == band)]
            if np.isfinite(features).any():
                result[row, column] = np.nanmean(np.abs(features))
    return result


def residual_maps(run: Run, ledger: dict[str, Any]) -> list[figures.Panel]:
    """Draw the residuals before and after by time region and band."""
    residuals = read_residuals(run.need("loop", RESIDUALS_FILE), ledger["rirs"])
    maps = {when: residual_sizes(residuals[when]) for when in ("before", "after")}
    largest = float(np.nanmax(list(maps.values())))
    panels = []
    for when, sizes in maps.items():
        means = [f"{name} {number(float(np.nanmean(row)))} JND" for name, row in zip(REGIONS, sizes, strict=True)
                 if np.isfinite(row).any()]
        draw = figures_loop.residual_map(when.capitalize(), sizes, REGIONS, largest)
        panels.append(figures.panel(f"figure-loop-map-{when}", draw,
                                    f"Mean absolute residual {when} the loop: {'; '.join(means)}"))
    return panels


def rankings(ledger: dict[str, Any]) -> list[figures.Panel]:
    """Draw the candidates of each iteration."""
    iterations = [(f"Iteration {n}", entry["ranking"], entry["effect"])
                  for n, entry in enumerate(ledger["iterations"], start=1)]
    iterations.append(("Last iteration: no effect added", ledger["ranking"], None))
    panels = []
    for n, (title, candidates, chosen) in enumerate(iterations, start=1):
        if candidates:
            gains = [figures_loop.Candidate(candidate["effect"], candidate["gain"] / ledger["scored_rooms"],
                                            *candidate["ci"]) for candidate in candidates]
            alt = f"{title}: " + ", ".join(f"{gain.name} {number(gain.mean)}" for gain in gains)
            panels.append(figures.panel(f"figure-loop-ranking-{n}", figures_loop.ranking(title, gains, chosen), alt))
    return panels


def splits(ledger: dict[str, Any]) -> list[figures.Panel]:
    """Draw the held-out errors by metric and by band."""
    def panel(ident: str, names: list[str], errors: list[list[float]]) -> figures.Panel:
        alt = "; ".join(f"{name} {number(b)} to {number(a)} JND, ceiling {number(c)} JND"
                        for name, b, a, c in zip(names, *errors, strict=True))
        return figures.panel(ident, figures_loop.before_and_after(names, *errors), alt)

    metrics, by_metric, by_band = split_errors(ledger)
    return [panel("figure-loop-metrics", metrics, by_metric),
            panel("figure-loop-bands", [hertz(band_hz) for band_hz in BANDS_HZ], by_band)]


def split_errors(ledger: dict[str, Any]) -> tuple[list[str], list[list[float]], list[list[float]]]:
    """Return labels of metrics, and the held-out errors before, after and at the ceiling: by metric, and by band."""
    entries = [ledger[when]["leave_positions_out"] for when in ("baseline", "final", "ceiling")]
    metrics = list(entries[0]["by_metric"])
    return ([METRIC_LABELS[metric] for metric in metrics],
            [[entry["by_metric"].get(metric, np.nan) for metric in metrics] for entry in entries],
            [np.array(entry["by_band"], dtype=float).tolist() for entry in entries])


def responses(ledger: dict[str, Any]) -> list[figures.Panel]:
    """Draw the fitted frequency responses."""
    panels = []
    for entry in ledger["iterations"]:
        if issubclass(CATALOGUE[entry["effect"]], Response):
            bands, alt = response_bands(entry["parameters"], "gains_db")
            draw = figures_loop.response_curves(entry["effect"], RESPONSE_HZ, bands)
            panels.append(figures.panel(f"figure-loop-{entry['effect']}", draw, alt))
    return panels


def response_bands(parameters: dict[str, Any], key: str) -> tuple[list[figures_loop.ResponseBand], str]:
    """Return the gains or levels of each unit with their intervals, and their ranges in words."""
    bands = [figures_loop.ResponseBand(unit, *(np.array(estimate.get(bound, estimate["best"])[key])
                                               for bound in ("best", "low", "high")))
             for unit, estimate in parameters.items()]
    return bands, "; ".join(f"{band.name}: {number(band.best.min())} to {number(band.best.max())} dB"
                            for band in bands)


def example_figures(examples: Examples) -> list[Context]:
    """Draw spectra and decay curves of a few RIRs, measured and simulated."""
    frequency_hz = np.array(SPECTRUM_HZ, dtype=np.float64)
    time_s = np.array(np.arange(examples.decay_db.shape[-1]) * STEP_S, dtype=np.float64)
    drawn = []
    for n, (ident, room) in enumerate(zip(examples.ids, examples.rooms, strict=True)):
        spectra = examples.spectrum_db[n] - np.nanmean(examples.spectrum_db[n][0])
        panels = [example_panel(f"spectrum-{n + 1}", ident, figures_loop.Curves(
            "Spectrum", frequency_hz, lines(spectra), "Level (dB)", figures.common_limits(spectra), True))]
        panels += [example_panel(f"decay-{n + 1}-{BANDS_HZ[band]:g}", ident, figures_loop.Curves(
            f"Decay at {BANDS_HZ[band]:g} Hz", time_s, lines(examples.decay_db[n, :, k]),
            "Remaining energy (dB)", (-50.0, 2.0), False)) for k, band in enumerate(DECAY_BANDS)]
        drawn.append({"figure_id": f"figure-loop-example-{n + 1}", "rir": ident, "room": room, "panels": panels})
    return drawn


def lines(values: FloatArray) -> list[tuple[str, str, FloatArray]]:
    """Return label, colour and values of the curves of one RIR, measured and simulated."""
    return [(LABELS[kind], COLOURS[kind], curve) for kind, curve in zip(KINDS, values, strict=True)]


def example_panel(ident: str, rir: str, curves: figures_loop.Curves) -> figures.Panel:
    """Draw one panel of an example."""
    alt = f"{curves.title} of {rir}: measured, simulated before and after"
    return figures.panel(f"figure-loop-{ident}", figures_loop.draw_curves(curves), alt, figures.SMALL_IN)
