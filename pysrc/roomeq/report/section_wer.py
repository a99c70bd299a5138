"""The section about word error rates: the paper's Table 2, the differences between its rows and their intervals."""

from typing import Any

import numpy as np

from roomeq.report import figures, figures_wer
from roomeq.report.formats import DASH, number, with_interval
from roomeq.report.load import Context, Run
from roomeq.wer.check import WER_FILE, read_wer
from roomeq.wer.table import EQ_NOTE, ROOM_ACOUSTICS, caption, gains_caption, label, p_text, room_cells, stratum_label
from roomeq.wer.workspace import BASE, CLEAN, ORACLE, compared


def word_error_rates(run: Run) -> Context:
    """Return the values of the section."""
    wer = wer_of(run)
    column = wer["columns"][0]
    has_changes = any("change" in result for row in wer["results"].values() for result in row.values())
    kinds = [(kind, column) for kind in ("dev", "test") for column in wer["columns"]]
    rows = [[label(row), *(number(wer["results"][row][column][kind]["wer"], 2) for kind, column in kinds)]
            for row in wer["rows"]]
    shown = [row for row in wer["rows"] if row != CLEAN] or wer["rows"]
    return {"caption": caption(wer), "kinds": kinds, "rows": rows, "column": column, "base": BASE, "oracle": ORACLE,
            "rates": [rates_panel(wer, column, shown)], "n_seeds": len(wer["seeds"]),
            "omitted": CLEAN if len(shown) < len(wer["rows"]) else None,
            "changes": change_rows(wer) if has_changes else [],
            "rooms": room_panels(wer, column) if has_changes else [],
            "eq_note": EQ_NOTE,
            "room_headings": [heading for heading, _ in ROOM_ACOUSTICS.values()],
            "room_rows": [[room["room"], str(room["words"]), *room_cells(room),
                           *(number(room["wer"][column][row]) for row in wer["rows"])] for room in wer["rooms"]],
            "gains": [[gain["row"], gain["what"], str(gain["rooms"]), number(gain["rho"], 2), p_text(gain["p"])]
                      for gain in wer["gains"]],
            "gains_caption": gains_caption(wer),
            "detectable": detectable(wer, column) if has_changes else [],
            "strata_labels": [label(row) for row in wer["rows"]],
            "strata": [[stratum_label(stratum), str(stratum["words"]),
                        *(number(stratum["wer"][column][row]) for row in wer["rows"])] for stratum in wer["strata"]]}


def wer_of(run: Run) -> dict[str, Any]:
    """Return the word error rates of the run."""
    return run.cached("wer", lambda: read_wer(run.need("wer", WER_FILE)))


def facts(run: Run) -> Context:
    """Return the result for the cards at the top of the page."""
    if not run.has("wer"):
        return {}
    wer = wer_of(run)
    rows = compared(wer["rows"])
    if BASE not in wer["rows"] or not rows:
        return {}
    column = wer["columns"][0]
    before, after = (wer["results"][row][column]["test"]["wer"] for row in (BASE, rows[-1]))
    return {"wer_before": before, "wer_after": after, "wer_column": column, "wer_base": BASE, "wer_best": rows[-1]}


def rates_panel(wer: dict[str, Any], column: str, rows: list[str]) -> figures.Panel:
    """Draw word error rates with their intervals."""
    results = {kind: [wer["results"][row][column][kind] for row in rows] for kind in ("dev", "test")}
    sets = [figures_wer.Rates(kind, colour, marker, [result["wer"] for result in results[kind]],
                              [result["interval"] for result in results[kind]])
            for kind, colour, marker in (("dev", "extra", "s"), ("test", "measured", "o"))]
    alt = "; ".join(f"{row}: dev {number(dev['wer'])}, test {number(test['wer'])}"
                    for row, dev, test in zip(rows, results["dev"], results["test"], strict=True))
    return figures.panel("figure-wer-rates-panel", figures_wer.rates(rows, sets), f"Word error rates in percent: {alt}")


def change_rows(wer: dict[str, Any]) -> list[list[str]]:
    """Return the difference of each row to the base, for each language model."""
    rows = []
    for row in wer["rows"]:
        for column in wer["columns"]:
            result = wer["results"][row][column]
            change, gap = result.get("change"), result["dev_test_gap"]
            changed = [with_interval(change["points"], change["interval"]),
                       with_interval(change["relative"], change["relative_interval"], 1),
                       DASH if change["p"] is None else p_text(change["p"]),
                       with_interval(change["geometric_mean"]["relative"], change["geometric_mean"]["interval"], 1)
                       ] if change else [DASH] * 4
            rows.append([row, column, *changed, closed_text(result), with_interval(gap["points"], gap["interval"])])
    return rows


def closed_text(result: dict[str, Any]) -> str:
    """Format the share of the gap that a row closes."""
    if "closed" not in result:
        return DASH
    if result["closed"]["share"] is None:
        return "gap not significant"
    return with_interval(100 * result["closed"]["share"], [100 * end for end in result["closed"]["interval"]], 0, " %")


def room_panels(wer: dict[str, Any], column: str) -> list[figures.Panel]:
    """Draw the differences of word error rates in each room."""
    differences = {row: np.array([room["wer"][column][row] - room["wer"][column][BASE] for room in wer["rooms"]])
                   for row in compared(wer["rows"])}
    limit = max([1.0, *(1.05 * float(np.abs(points).max()) for points in differences.values())])
    panels = []
    for row, points in differences.items():
        change = wer["results"][row][column]["change"]
        title = f"{row} − {BASE}"
        draw = figures_wer.rooms(title, points, change["points"], change["interval"], limit)
        alt = (f"{title}: lower in {int((points < 0).sum())} of {len(points)} rooms, "
               f"from {number(points.min())} to {number(points.max())} points")
        panels.append(figures.panel(f"figure-wer-rooms-{row}", draw, alt))
    return panels


def detectable(wer: dict[str, Any], column: str) -> list[Context]:
    """Return the smallest difference that the experiment detects, and what it takes to halve it."""
    entries = []
    for row in compared(wer["rows"]):
        if result := wer["results"][row][column]["change"]["detectable"]:
            half = result["for_half"]
            remedies = [f"{half[kind]} {kind}" for kind in ("seeds", "rooms") if half[kind] is not None]
            remedies += [f"{number(half['factor'])} times as many of both"] if len(wer["seeds"]) > 1 else []
            entries.append({"row": row, "points": result["difference"], "remedies": " or ".join(remedies)})
    return entries
