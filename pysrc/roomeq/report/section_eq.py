"""Sections about the EQ: the paper's figure 2, distances between distributions, accuracy of the compensation."""

from collections import Counter

import numpy as np

from roomeq.core.constants import BAND_1KHZ, BANDS_HZ
from roomeq.core.files import read_json, read_jsonl
from roomeq.core.rng import rng_for
from roomeq.eq.compensation import MAX_MEDIAN_DB, MAX_P95_DB, SUMMARY_FILE
from roomeq.eq.distance import EqSet, eq_distance, gap_closed
from roomeq.eq.fit import MEASURED_FILE, RESAMPLED_FILE
from roomeq.eq.gmm import FREE, with_reference
from roomeq.report import figures
from roomeq.report.kinds import (
    COLOURS,
    DIRECTORIES,
    HELD_OUT,
    KINDS,
    described,
    eq_vectors,
    key,
    simulated_rows,
    unscreened,
)
from roomeq.report.load import Run
from roomeq.report.page import Html, Missing, figure, hertz, join, number, paragraph, percent, tag
from roomeq.report.page import table as make_table

N_BOOTSTRAP = 200


def eq_distributions(run: Run) -> Html:
    """Return figure 2 of the paper: target and re-sampled EQ distributions, and simulated before and after."""
    fitted = run.need("eq", MEASURED_FILE)
    target = np.array([row["fitted_db"] for row in read_jsonl(fitted) if not row["screen"]], dtype=np.float64)
    sets = [("measured", "Target: measured", "measured", target)]
    if (run.path("eq") / RESAMPLED_FILE).is_file():
        resampled = np.array([row["eq_db"] for row in read_jsonl(run.path("eq") / RESAMPLED_FILE)])
        sets.append(("resampled", "Re-sampled", "drawn", resampled))
    for kind, title in (("simulated", "Simulated, before"), ("compensated", "Simulated, after EQ")):
        if run.has(DIRECTORIES[kind]):
            sets.append((kind, title, kind, eq_vectors(run, DIRECTORIES[kind])))
    limits = figures.common_limits(*(eq_db for *_, eq_db in sets))
    panels = []
    for ident, title, colour, eq_db in sets:
        middle = figures.quantiles(eq_db, (50,))[0]
        alt = described(f"{title}, median", middle)
        panels.append(figures.panel(f"figure-2-{ident}", figures.eq_curves(title, eq_db, colour, limits), alt))
    return join([
        paragraph("Each thin line is one RIR: its level at the eight points relative to 1 kHz. A Gaussian mixture "
                  "is fitted to the measured set; one new line per simulated RIR is drawn from it and becomes "
                  "that RIR's target. After compensation the simulated set should look like the measured one."),
        figure("figure-2", panels, "Paper's figure 2, all panels on the same scale. Only training RIRs that "
               f"passed the screening. At most {figures.MAX_CURVES} lines a panel are drawn; medians and "
               "percentiles are those of all. Where an anti-alias filter cuts at 8 kHz, the level just below it "
               "stands for that point.")])


def accuracy(run: Run) -> Html:
    """Return how near the measured EQ of compensated RIRs comes to their targets."""
    errors, missed = [], {}
    for name in ("rirs.sim.EQ.train", "rirs.sim.EQ.dev"):
        if run.has(name):
            errors += [row["eq_error_db"] for row in run.rirs(name) if row.get("eq_error_db")]
            path = run.path(name) / SUMMARY_FILE
            missed.update(read_json(path)["missed"] if path.is_file() else {})
    if not errors:
        run.need(DIRECTORIES["compensated"])
        raise Missing("eq_error_db in data/rirs.sim.EQ.train", "stage 4 (roomeq compensate)")
    error = np.abs(np.array(errors, dtype=np.float64))
    middle, high = np.percentile(error, (50, 95), axis=0)
    rows = [accuracy_row(hertz(BANDS_HZ[n]), error[:, n]) for n in FREE]
    rows.append(accuracy_row("all seven", error[:, list(FREE)].ravel()))
    middle[BAND_1KHZ] = high[BAND_1KHZ] = np.nan
    goals = {"goal for the median": MAX_MEDIAN_DB, "goal for the 95th percentile": MAX_P95_DB}
    draw = figures.per_point([("median, up to 95th percentile", "compensated", middle, high)],
                             "|achieved − target| (dB)", goals)
    return join([
        paragraph("The filter is corrected until the EQ of the filtered response, measured again, is what was "
                  f"drawn. Goals: {MAX_MEDIAN_DB} dB in the median and {MAX_P95_DB} dB for 95 % of all RIRs."),
        make_table("table-accuracy", "Difference between achieved and drawn EQ, in dB",
                   ["EQ point", "median", "95th percentile", "largest", "goal met"], rows),
        figure("figure-accuracy", [figures.panel("figure-accuracy-points", draw, "Error of the achieved EQ at "
                                                 "each point; the table has the numbers")],
               f"{len(error)} compensated RIRs of the training and development sets; 1 kHz is the reference and "
               "has no error."),
        misses(missed, len(error))])


def accuracy_row(name: str, error: np.ndarray) -> list:
    """Return a row of the table of accuracy."""
    middle, high = np.percentile(error, (50, 95))
    met = "yes" if middle <= MAX_MEDIAN_DB and high <= MAX_P95_DB else "no"
    return [name, f"{middle:.2f}", f"{high:.2f}", f"{error.max():.2f}", met]


def misses(missed: dict[str, dict], n_rirs: int) -> Html:
    """Say where bins of 31 Hz do not allow the target."""
    if not missed:
        return paragraph(f"No point of any RIR is off by more than {MAX_P95_DB} dB.")
    where = Counter(why["hz"] for why in missed.values())
    ident, worst = max(missed.items(), key=lambda item: (abs(item[1]["error_db"]), item[0]))
    return paragraph(
        f"RIRs with a point that is off by more than {MAX_P95_DB} dB: {len(missed)} of {n_rirs}, most often at ",
        ", ".join(f"{hz:g} Hz ({n})" for hz, n in where.most_common(3)), ". Bins of 31 Hz do not allow those "
        "targets: one bin can stand out only so far from its neighbours, and their filters step by up to "
        f"{max(why['steepest_db'] for why in missed.values()):.0f} dB an octave. The worst is ", tag("code", ident),
        f": {worst['error_db']:+.1f} dB at {worst['hz']:g} Hz.")


def distances(run: Run) -> Html:
    """Return the distances between EQ distributions, and how much of the gap compensation closes."""
    found = gap(run)
    results = {"simulated": found["sim"], "compensated": found["comp"], **looped(run), "measured": found["floor"]}
    labels = {"measured": join([key("measured"), ", training set (the floor)"])}
    rows = [[labels.get(kind, key(kind)), with_interval(one["wasserstein_db"], one["interval_db"]),
             with_interval(one["energy_db"], one["energy_interval_db"]), *(number(band) for band in one["bands_db"])]
            for kind, one in results.items()]
    groups = [(KINDS[kind], COLOURS[kind], *(2 * [with_reference(one["bands_db"])])) for kind, one in results.items()]
    for *_, value, _ in groups:
        value[BAND_1KHZ] = np.nan
    draw = figures.per_point(groups, "1-Wasserstein distance (dB)", {})
    return join([
        paragraph("How far the EQs of a set are from those of measured RIRs that nothing was fitted to (",
                  tag("code", f"data/{HELD_OUT}"), f", {len(eq_vectors(run, HELD_OUT))} RIRs). Rooms count "
                  "equally. The measured training set is the floor: what more "
                  "measurements of the same kind would give."),
        verdict(found),
        make_table("table-distance", "Distance to held-out measured RIRs, with 95 % bootstrap intervals over "
                   "rooms. Wasserstein: how many dB the values of one set have to be moved on average to become "
                   "the other; energy: the like for all seven points together",
                   ["EQs of", "Wasserstein (dB)", "Energy", *(hertz(BANDS_HZ[n]) for n in FREE)], rows),
        figure("figure-distance", [figures.panel("figure-distance-points", draw,
                                                 "Distance to held-out measured EQs at each point, as in the "
                                                 "table")],
               "The distances of the table by frequency.")])


def gap(run: Run) -> dict:
    """Return the distances of simulated, compensated and training RIRs to held-out ones; computed once."""
    def compute():
        names = [DIRECTORIES["simulated"], DIRECTORIES["compensated"], DIRECTORIES["measured"], HELD_OUT]
        return gap_closed(*(eq_set(run, name) for name in names), rng_for(0, "report", "EQ distance"),
                          n_bootstrap=N_BOOTSTRAP)

    return run.once("gap", compute)


def looped(run: Run) -> dict:
    """Return the distance of the RIRs of the closed loop, by their kind; nothing where there are none."""
    if not run.has(DIRECTORIES["looped"]):
        return {}
    return {"looped": eq_distance(eq_set(run, DIRECTORIES["looped"]), eq_set(run, HELD_OUT),
                                  rng_for(0, "report", "EQ distance of the loop"), n_bootstrap=N_BOOTSTRAP)}


def eq_set(run: Run, name: str) -> EqSet:
    """Return the EQs of a directory at the free points, with the rooms of its RIRs."""
    return EqSet(eq_vectors(run, name)[:, list(FREE)], [row["room_id"] for row in unscreened(run, name)])


def main_numbers(run: Run) -> list[tuple[str, str]]:
    """Return the results that the top of the page shows."""
    cards = []
    rows = simulated_rows(run)
    if rows:
        error = max(abs(row["t30_s"] / row["target_t60_s"] - 1) for row in rows)
        cards.append(("worst error of a simulated RIR's T60", percent(error, 1)))
    name = DIRECTORIES["compensated"]
    errors = [row["eq_error_db"] for row in run.rirs(name) if row.get("eq_error_db")] if run.has(name) else []
    if errors:
        high = float(np.percentile(np.abs(np.array(errors)[:, list(FREE)]), 95))
        cards.append((f"or less: error of {percent(0.95)} of the compensated EQ points", f"{high:.2f} dB"))
    found = gap(run)
    if found["closed"] is not None:
        low, high = found["closed_interval"] or (float("nan"),) * 2
        cards.append((f"of the EQ gap between simulated and measured closed ({percent(low)} to {percent(high)})",
                      percent(found["closed"])))
    return cards


def verdict(found: dict) -> Html:
    """Return the sentence that says how much of the gap is closed."""
    if found["closed"] is None:
        return paragraph("The simulated set is no farther from the held-out RIRs than the floor: ",
                         "there is no gap to close.")
    text = f"Compensation closes {100 * found['closed']:.0f} % of the gap between simulated and floor"
    interval = found["closed_interval"]
    between = f" (95 % interval {100 * interval[0]:.0f} to {100 * interval[1]:.0f} %)" if interval else ""
    energy = found["closed_energy"]
    beyond = (" More than 100 % is no better than 100 %: the held-out RIRs are few, and rooms that lie only in the "
              "training set make the floor higher than a perfect model's.") if found["closed"] > 1 else ""
    return paragraph(tag("strong", text), between,
                     f"; by the energy distance {percent(energy)}" if energy is not None else "", ".", beyond)


def with_interval(value: float, interval: list[float]) -> Html:
    """Return a number with its interval."""
    return tag("span", f"{value:.2f} ({interval[0]:.2f}–{interval[1]:.2f})", class_="nw")
