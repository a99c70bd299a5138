"""Sections about the EQ: the paper's figure 2, distances between distributions, accuracy of the compensation."""

import logging
from collections import Counter
from typing import Any

import numpy as np

from roomeq.core.arrays import FloatArray
from roomeq.core.constants import BAND_1KHZ, BANDS_HZ
from roomeq.core.files import read_json, read_jsonl
from roomeq.core.rng import rng_for
from roomeq.eq.compensation import MAX_MEDIAN_DB, MAX_P95_DB, SUMMARY_FILE
from roomeq.eq.distance import FEWEST_ROOMS, EqSet, eq_distance, gap_closed
from roomeq.eq.fit import MEASURED_FILE, RESAMPLED_FILE
from roomeq.eq.gmm import FREE, with_reference
from roomeq.report import figures
from roomeq.report.formats import hertz, number, with_interval, with_minus
from roomeq.report.kinds import COMPENSATED, EXTENDED, MEASURED, SIMULATED
from roomeq.report.load import Context, Missing, Run
from roomeq.report.rir_sets import (
    column_percentiles,
    describe_eq,
    eq_errors,
    eq_vectors,
    unscreened,
)

logger = logging.getLogger(__name__)

N_BOOTSTRAP = 200
HELD_OUT = "rirs.real.test"
"""Measured RIRs that no model is fitted to."""


def eq_distributions(run: Run) -> Context:
    """Return figure 2 of the paper: target and resampled EQ distributions, and simulated before and after."""
    fitted = run.need("eq", MEASURED_FILE)
    target = np.array([row["fitted_db"] for row in read_jsonl(fitted) if not row["screen"]], dtype=np.float64)
    sets = [("measured", "Target: measured", "measured", target)]
    if (run.path("eq") / RESAMPLED_FILE).is_file():
        resampled = np.array([row["eq_db"] for row in read_jsonl(run.path("eq") / RESAMPLED_FILE)])
        sets.append(("resampled", "Resampled", "drawn", resampled))
    for kind, title in ((SIMULATED, "Simulated, before EQ"), (COMPENSATED, "Simulated, after EQ")):
        if run.has(kind.train):
            sets.append((kind.colour, title, kind.colour, eq_vectors(run, kind.train)))
    limits = figures.common_limits(*(eq_db for *_, eq_db in sets))
    panels = [figures.panel(f"figure-2-{ident}", figures.eq_curves(title, eq_db, colour, limits),
                            describe_eq(f"{title}, median", column_percentiles(eq_db, (50,))[0]))
              for ident, title, colour, eq_db in sets]
    return {"panels": panels, "max_curves": figures.MAX_CURVES}


def accuracy(run: Run) -> Context:
    """Return the differences between the EQ of compensated RIRs and their targets."""
    names = ("rirs.sim.EQ.train", "rirs.sim.EQ.dev")
    error = eq_errors(run, names)
    if not len(error):
        run.need(COMPENSATED.train)
        raise Missing("eq_error_db in data/rirs.sim.EQ.train", "stage 4 (roomeq compensate)")
    misses: dict[str, dict[str, Any]] = {}
    for name in names:
        if (path := run.path(name) / SUMMARY_FILE).is_file():
            misses |= read_json(path)["missed"]
    rows = [accuracy_row(hertz(BANDS_HZ[n]), error[:, n]) for n in FREE]
    beyond = [row[0] for row in rows if row[-1] == "no"]
    rows.append([*accuracy_row("all seven", error[:, list(FREE)].ravel())[:-1],
                 "not at " + ", ".join(beyond) if beyond else "yes"])
    middle, high = np.percentile(error, (50, 95), axis=0)
    middle[BAND_1KHZ] = high[BAND_1KHZ] = np.nan
    draw = figures.per_point([figures.PointSeries("median, up to 95th percentile", "compensated", middle, high)],
                             "|achieved − target| (dB)",
                             {"limit of the median": MAX_MEDIAN_DB, "limit of the 95th percentile": MAX_P95_DB})
    alt = "Error of the achieved EQ at each point; the table lists the values"
    return {"rows": rows, "panels": [figures.panel("figure-accuracy-points", draw, alt)], "n_rirs": len(error),
            "max_median_db": MAX_MEDIAN_DB, "max_p95_db": MAX_P95_DB,
            "n_missed": len(misses), **(missed_targets(misses) if misses else {})}


def accuracy_row(name: str, error_db: FloatArray) -> list[str]:
    """Return a row of the table of accuracy."""
    middle, high = np.percentile(error_db, (50, 95))
    met = "yes" if middle <= MAX_MEDIAN_DB and high <= MAX_P95_DB else "no"
    return [name, f"{middle:.2f}", f"{high:.2f}", f"{error_db.max():.2f}", met]


def missed_targets(misses: dict[str, dict[str, Any]]) -> Context:
    """Summarise the RIRs whose EQ is off the target at a point."""
    frequencies = Counter(miss["hz"] for miss in misses.values())
    ident, worst = max(misses.items(), key=lambda item: (abs(item[1]["error_db"]), item[0]))
    return {"frequencies": ", ".join(f"{hertz(hz)} ({n})" for hz, n in frequencies.most_common(3)),
            "worst_id": ident, "worst_error": with_minus(f"{worst['error_db']:+.1f} dB at {hertz(worst['hz'])}"),
            "steepest_db": max(miss["steepest_db"] for miss in misses.values())}


def distances(run: Run) -> Context:
    """Return the distances between EQ distributions, and the share of the gap that compensation closes."""
    gap = eq_gap(run)
    results = [(SIMULATED, SIMULATED.label, gap["sim"]), (COMPENSATED, COMPENSATED.label, gap["comp"])]
    if run.has(EXTENDED.train):
        results.append((EXTENDED, EXTENDED.label, extended_distance(run)))
    results.append((MEASURED, "measured, training set (reference)", gap["floor"]))
    rows = [[(kind.colour, label), with_interval(result["wasserstein_db"], result["interval_db"]),
             with_interval(result["energy_db"], result["energy_interval_db"]),
             *(number(band_db) for band_db in result["bands_db"])] for kind, label, result in results]
    groups = []
    for kind, _, result in results:
        points_db = with_reference(result["bands_db"])
        points_db[BAND_1KHZ] = np.nan
        groups.append(figures.PointSeries(kind.label, kind.colour, points_db, points_db))
    draw = figures.per_point(groups, "1-Wasserstein distance (dB)", {})
    alt = "Distance to held-out measured EQs at each point, as in the table"
    if few := few_rooms(run):
        logger.warning("EQ distance: %s", few)
    return {"rows": rows, "frequencies_hz": [BANDS_HZ[n] for n in FREE], "gap": gap, "held_out": HELD_OUT,
            "n_held_out": len(eq_vectors(run, HELD_OUT)), "few_rooms": few,
            "panels": [figures.panel("figure-distance-points", draw, alt)]}


def eq_gap(run: Run) -> dict[str, Any]:
    """Return the distances of simulated, compensated and training RIRs to held-out ones."""
    def compute() -> dict[str, Any]:
        return gap_closed(eq_set(run, SIMULATED.train), eq_set(run, COMPENSATED.train), eq_set(run, MEASURED.train),
                          eq_set(run, HELD_OUT), rng_for(0, "report", "EQ distance"), n_bootstrap=N_BOOTSTRAP)

    return run.cached("gap", compute)


def extended_distance(run: Run) -> dict[str, Any]:
    """Return the distance of the RIRs of the closed loop to held-out ones."""
    return run.cached("extended distance", lambda: eq_distance(
        eq_set(run, EXTENDED.train), eq_set(run, HELD_OUT), rng_for(0, "report", "EQ distance of the loop"),
        n_bootstrap=N_BOOTSTRAP))


def few_rooms(run: Run) -> str:
    """Return the sentence that names the sets of too few rooms for an interval; nothing where all have enough."""
    names = {kind.label: kind.train for kind in (SIMULATED, COMPENSATED, EXTENDED, MEASURED) if run.has(kind.train)}
    rooms = {label: len(eq_set(run, name).members) for label, name in (names | {"held-out": HELD_OUT}).items()}
    few = [f"{label} ({count})" for label, count in rooms.items() if count < FEWEST_ROOMS]
    return (f"Distances from or to a set of fewer than {FEWEST_ROOMS} rooms have no interval: {', '.join(few)}."
            if few else "")


def eq_set(run: Run, name: str) -> EqSet:
    """Return the EQs of a directory at the free points, with the rooms of its RIRs."""
    return EqSet(eq_vectors(run, name)[:, list(FREE)], [row["room_id"] for row in unscreened(run, name)])


def facts(run: Run) -> Context:
    """Return the result for the cards at the top of the page."""
    try:
        return {"gap": eq_gap(run)}
    except Missing:
        return {}
