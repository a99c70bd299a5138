"""The first section: what the simulation lacks, how far it is from measurements before and after, and what that is
worth in word errors."""

from typing import Any

import numpy as np

from roomeq.acoustics.jnd import LEVEL_JND_DB
from roomeq.core.constants import BAND_1KHZ, BANDS_HZ
from roomeq.report import figures, figures_rirs, section_eq, section_loop, section_wer
from roomeq.report.formats import DASH, hertz, number, percent, with_interval, with_minus
from roomeq.report.kinds import COMPENSATED, EXTENDED, MEASURED, SIMULATED
from roomeq.report.load import OTHER_WER, Context, Missing, Run
from roomeq.report.rir_sets import column_percentiles, eq_vectors
from roomeq.wer.workspace import BASE, ORACLE, compared

SIGNIFICANT_P = 0.05


def summary(run: Run) -> Context:
    """Return what a reader decides from.

    Raises
    ------
    Missing
        The run has neither simulated RIRs nor a closed loop nor word error rates.
    """
    lacks_eq = eq_lacks(run) if run.has(MEASURED.train) and run.has(SIMULATED.train) else None
    ledger = section_loop.ledger_of(run) if run.has("loop") else None
    rows = [*eq_rows(run), *(loop_rows(ledger) if ledger else []), *wer_rows(run)]
    if lacks_eq is None and not rows:
        run.need(SIMULATED.train)
    return {"lacks_eq": lacks_eq, "unknown_hz": eq_unknown(run) if lacks_eq is not None else [],
            "panels": [eq_panel(run)] if lacks_eq is not None else [], "has_loop": ledger is not None,
            "effects": section_loop.effects(ledger) if ledger else [],
            "unexplained": section_loop.unexplained(ledger)[:1] if ledger else [], "rows": rows,
            "worth": worth(run), "has_wer": run.has("wer"),
            "other_wer": run.other_wer and OTHER_WER.format(run.label("wer"))}


def eq_lacks(run: Run) -> list[str]:
    """Return the points at which the median EQ of simulated RIRs differs noticeably from that of measured ones."""
    difference_db = median_difference_db(run, SIMULATED.train)
    return [f"{abs(db):.1f} dB too {'loud' if db > 0 else 'quiet'} at {hertz(band_hz)}"
            for band_hz, db in zip(BANDS_HZ, difference_db, strict=True) if abs(db) >= LEVEL_JND_DB]


def eq_unknown(run: Run) -> list[str]:
    """Return the points at which no simulated or no measured RIR has a valid EQ."""
    difference_db = median_difference_db(run, SIMULATED.train)
    return [hertz(band_hz) for band_hz, db in zip(BANDS_HZ, difference_db, strict=True) if np.isnan(db)]


def median_difference_db(run: Run, name: str) -> np.ndarray:
    """Return the median EQ of a directory minus that of the measured training RIRs, shape (8,) [dB]."""
    medians = [column_percentiles(eq_vectors(run, directory), (50,))[0] for directory in (name, MEASURED.train)]
    return np.asarray(medians[0] - medians[1])


def eq_panel(run: Run) -> figures.Panel:
    """Draw the differences of median EQs from the measured one."""
    kinds = [kind for kind in (SIMULATED, COMPENSATED, EXTENDED) if run.has(kind.train)]
    groups = [(kind.label, kind.colour, median_difference_db(run, kind.train)) for kind in kinds]
    for *_, difference_db in groups:
        difference_db[BAND_1KHZ] = np.nan
    alt = "; ".join(f"{label} minus measured: " + ", ".join(
        f"{number(db)} dB at {hertz(band_hz)}" for band_hz, db in zip(BANDS_HZ, difference_db, strict=True)
        if np.isfinite(db)) for label, _, difference_db in groups)
    return figures.panel("figure-summary-eq", figures_rirs.eq_differences(groups), alt)


def eq_rows(run: Run) -> list[list[str]]:
    """Return the row of the distance between EQs, if the run has it, and that of the loop's RIRs."""
    try:
        gap = section_eq.eq_gap(run)
    except Missing:
        return []

    def distance(result: dict[str, Any]) -> str:
        return with_interval(result["wasserstein_db"], result["interval_db"], 1)

    rows = [["EQ distance to held-out measured RIRs (dB), with compensation", distance(gap["sim"]),
             distance(gap["comp"]), f"{number(gap['floor']['wasserstein_db'])}, measured training set"]]
    if run.has(EXTENDED.train):
        rows.append(["The same, with the effects of the closed loop", distance(gap["sim"]),
                     distance(section_eq.extended_distance(run)), f"{number(gap['floor']['wasserstein_db'])}, measured "
                     "training set"])
    return rows


def loop_rows(ledger: dict[str, Any]) -> list[list[str]]:
    """Return the rows of the held-out errors of the closed loop."""
    rows = []
    for split, name in (("leave_positions_out", "other positions of known rooms"), ("leave_room_out", "unseen rooms")):
        before, after = (with_interval(ledger[when][split]["error"], ledger[when][split]["ci"], 1)
                         for when in ("baseline", "final"))
        rows.append([f"Held-out error (JND), {name}", before, after,
                     f"{number(ledger['ceiling'][split]['error'])}, noise ceiling"])
    return rows


def wer_rows(run: Run) -> list[list[str]]:
    """Return the rows of the word error rates of all training sets that may close the gap."""
    if not run.has("wer"):
        return []
    wer = section_wer.wer_of(run)
    if BASE not in wer["rows"]:
        return []
    column = wer["columns"][0]
    rates = {row: wer["results"][row][column]["test"] for row in wer["rows"]}
    best = f"{number(rates[ORACLE]['wer'])}, {ORACLE}" if ORACLE in rates else DASH
    return [[f"Word error rate (%, {column}), {row}", *(with_interval(rates[of]["wer"], rates[of]["interval"], 1)
                                                        for of in (BASE, row)), best]
            for row in compared(wer["rows"])]


def worth(run: Run) -> list[str]:
    """Return a sentence for each training set about its change of the word error rate."""
    if not run.has("wer"):
        return []
    wer = section_wer.wer_of(run)
    column = wer["columns"][0]
    sentences = []
    for row in compared(wer["rows"]):
        result = wer["results"][row][column]
        if "change" not in result:
            continue
        change = result["change"]
        points = with_interval(change["points"], change["interval"], 1)
        text = (f"{row} instead of {BASE} changes the word error rate by {points} points, "
                f"{number(change['relative'], 0)} %")
        if change["p"] is None or change["p"] >= SIGNIFICANT_P:
            text += ", which may be chance"
        elif "closed" in result and result["closed"]["share"] is not None:
            text += f", and closes {percent(result['closed']['share'])} of the gap to training with measured RIRs"
        sentences.append(with_minus(text) + ".")
    return sentences
