"""The chapter about word error rates: the paper's Table 2, what separates its rows, and what it cannot show."""

import numpy as np

from roomeq.report import figures, figures_wer
from roomeq.report.load import Run
from roomeq.report.page import Html, figure, join, number, paragraph, tag
from roomeq.report.page import table as make_table
from roomeq.wer.check import WER_FILE, read_wer
from roomeq.wer.table import caption, label, stratum_label
from roomeq.wer.workspace import BASE, CLEAN, ORACLE, compared


def wer_of(run: Run) -> dict:
    """Return the run's word error rates, read once."""
    return run.once("wer", lambda: read_wer(run.need("wer", WER_FILE)))


def word_error_rates(run: Run) -> Html:
    """Return the chapter."""
    found = wer_of(run)
    parts = [paragraph("Recognisers (Kaldi, TDNN, LF-MMI) that differ in nothing but their training data were tested "
                       "on the same far-field speech. ", " ".join(caption(found))),
             rates_table(found), rates_figure(found)]
    if any("change" in one for row in found["results"].values() for one in row.values()):
        parts += [changes_table(found), rooms_figure(found), can_detect(found)]
    if found["strata"]:
        parts.append(strata_table(found))
    return join(parts)


def main_numbers(run: Run) -> list[tuple[str, str]]:
    """Return the result that the top of the page shows."""
    if not run.has("wer"):
        return []
    found = wer_of(run)
    others = compared(found["rows"])
    if BASE not in found["rows"] or not others:
        return []
    column = main_column(found)
    before, after = (found["results"][row][column]["test"]["wer"] for row in (BASE, others[-1]))
    return [(f"% of test words wrong ({column}), {BASE} and {others[-1]}", f"{before:.1f} \u2192 {after:.1f}")]


def main_column(found: dict) -> str:
    """Return the column that figures are about."""
    return found["columns"][0]


def rates_table(found: dict) -> Html:
    """Return the paper's Table 2."""
    kinds = [(kind, column) for kind in ("dev", "test") for column in found["columns"]]
    rows = [[label(row), *(number(found["results"][row][column][kind]["wer"], 2) for kind, column in kinds)]
            for row in found["rows"]]
    return make_table("table-wer", "Word error rates in per cent, as in the paper's Table 2",
                      ["Training data", *(f"{kind} {column}" for kind, column in kinds)], rows)


def rates_figure(found: dict) -> Html:
    """Return the rates with their intervals; clean training data, far above the others as a rule, is left out."""
    column, rows = main_column(found), [row for row in found["rows"] if row != CLEAN] or found["rows"]
    of = {kind: [found["results"][row][column][kind] for row in rows] for kind in ("dev", "test")}
    sets = [(kind, colour, marker, [one["wer"] for one in of[kind]], [one["interval"] for one in of[kind]])
            for kind, colour, marker in (("dev", "extra", "s"), ("test", "measured", "o"))]
    alt = "; ".join(f"{row}: dev {number(dev['wer'])}, test {number(test['wer'])}"
                    for row, dev, test in zip(rows, of["dev"], of["test"], strict=True))
    panel = figures.panel("figure-wer-rates-panel", figures_wer.rates(rows, sets),
                          f"Word error rates in per cent: {alt}")
    return figure("figure-wer-rates", [panel], f"Word error rates ({column}) with 95 % intervals for other rooms"
                  + (" and seeds" if found["seeds"] > 1 else "") + ". Rows share rooms, speech and noise, so their "
                  "differences are surer than these intervals look: see the table below."
                  + (f" {CLEAN} is in the table only." if len(rows) < len(found["rows"]) else ""))


def changes_table(found: dict) -> Html:
    """Return what separates the rows, each column for itself."""
    rows = []
    for row in found["rows"]:
        for column in found["columns"]:
            one = found["results"][row][column]
            change, gap = one.get("change"), one["dev_test_gap"]
            changed = [between(change["points"], change["interval"], 2),
                       between(change["relative"], change["relative_interval"], 1),
                       chance(change["p"])] if change else ["\u2013"] * 3
            rows.append([row, column, *changed, closed(one), between(gap["points"], gap["interval"], 2)])
    return make_table(
        "table-wer-changes", f"Change against {BASE} in points and relative to it, paired over rooms, seeds and "
        f"speech; share of the gap between {BASE} and {ORACLE} that is closed (paper: 36 % by the EQ); test less dev "
        "(paper: 4.37 for sim, \u22120.51 for sim.EQ). All with 95 % intervals; p: that a change as large comes by "
        "chance",
        ["Training data", "LM", "Change (points)", "Relative (%)", "p", "Gap closed", "Test less dev"], rows, (0, 1))


def between(value: float | None, interval: list[float] | None, decimals: int) -> Html:
    """Return a value with its interval; a dash for none."""
    ends = "" if interval is None else f" ({number(interval[0], decimals)} to {number(interval[1], decimals)})"
    return tag("span", f"{number(value, decimals)}{ends}", class_="nw")


def chance(p: float | None) -> str:
    """Return a probability as text."""
    return "\u2013" if p is None else "<\N{NO-BREAK SPACE}0.001" if p < 0.001 else f"{p:.2g}"


def closed(one: dict) -> Html:
    """Return the share of the gap that a row closes."""
    if "closed" not in one:
        return Html("\u2013")
    if one["closed"]["share"] is None:
        return tag("span", "gap not certain", class_="nw")
    low, high = (100 * end for end in one["closed"]["interval"])
    return tag("span", f"{number(100 * one['closed']['share'], 0)} % ({number(low, 0)} to {number(high, 0)})",
               class_="nw")


def rooms_figure(found: dict) -> Html:
    """Return the differences of rows in each room."""
    column = main_column(found)
    points = {row: np.array([one["wer"][column][row] - one["wer"][column][BASE] for one in found["rooms"]])
              for row in compared(found["rows"])}
    if not points:
        return Html("")
    limit = max(1.0, 1.05 * max(float(np.abs(one).max()) for one in points.values()))
    panels = []
    for row, of_rooms in points.items():
        change = found["results"][row][column]["change"]
        draw = figures_wer.rooms(f"{row} less {BASE}", of_rooms, change["points"], change["interval"], limit)
        panels.append(figures.panel(
            f"figure-wer-rooms-{row}", draw, f"{row} less {BASE}: lower in {int((of_rooms < 0).sum())} of "
            f"{len(of_rooms)} rooms, from {number(of_rooms.min())} to {number(of_rooms.max())} points"))
    return figure("figure-wer-rooms", panels, f"Difference of word error rates ({column}) in each test room, over all "
                  "seeds; below zero is better. Rooms weigh as many words as they have; with few, most of the spread "
                  "of dots is chance.")


def strata_table(found: dict) -> Html:
    """Return the rates of parts of the test set."""
    column = main_column(found)
    rows = [[stratum_label(one), str(one["words"]), *(number(one["wer"][column][row]) for row in found["rows"])]
            for one in found["strata"]]
    return make_table("table-wer-strata", f"Word error rates in per cent ({column}) of parts of the test set, whose "
                      "edges are the same for every set. Parts are small: differences within them are chance for the "
                      "most part", ["Part", "Words", *map(label, found["rows"])], rows)


def can_detect(found: dict) -> Html:
    """Return which difference this experiment can see."""
    column, points = main_column(found), []
    for row in compared(found["rows"]):
        if one := found["results"][row][column]["change"]["detectable"]:
            half = one["for_half"]
            ways = [f"{half[kind]} {kind}" for kind in ("seeds", "rooms") if half[kind] is not None]
            ways += [f"{number(half['factor'])} times as many of both"] if found["seeds"] > 1 else []
            points.append(f"{row} less {BASE}: {number(one['difference'], 2)} points ({column}). Half of that would "
                          f"take {' or '.join(ways)}.")
    if not points:
        return Html("")
    return join([paragraph(tag("strong", "What it can detect"), " in four of five such experiments, at 5 %, by the "
                           "spread over rooms and seeds that it found. A smaller difference is neither shown nor "
                           "excluded."), tag("ul", *(tag("li", one) for one in points))])
