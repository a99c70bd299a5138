"""Sections about impulse responses: the paper's figures 1 and 3, and reverberation times."""

import numpy as np

from roomeq.acoustics.subband_eq import N_LEAD, POINT_BINS, energy_spectrum, eq_part
from roomeq.core.constants import BAND_1KHZ
from roomeq.report import figures
from roomeq.report.kinds import (
    DIRECTORIES,
    KINDS,
    described,
    direct_sample,
    eq_vectors,
    reverberation_times,
    simulated_rows,
    unscreened,
)
from roomeq.report.load import Run
from roomeq.report.page import Html, Missing, figure, join, paragraph, tag

SPECTROGRAM_S = 0.6


def response_db(rir: np.ndarray, direct: float) -> np.ndarray:
    """Return the energy spectrum of an RIR as EQ is measured, shape (257,) [dB relative to 1 kHz]."""
    start, stop = eq_part(rir, direct)
    power = energy_spectrum(rir[start:stop])
    level_db = 10 * np.log10(np.maximum(power, 1e-30))
    return level_db - level_db[POINT_BINS[BAND_1KHZ]]


def example(run: Run) -> dict[str, dict]:
    """Choose one RIR of each kind: the measured one nearest to the median EQ, and what was simulated after it."""
    rows = unscreened(run, DIRECTORIES["measured"])
    eq_db = eq_vectors(run, DIRECTORIES["measured"])
    middle = figures.quantiles(eq_db, (50,))[0]
    distance = np.nansum((eq_db - middle) ** 2, axis=1)
    others = {kind: run.rirs(DIRECTORIES[kind]) for kind in ("simulated", "compensated") if run.has(DIRECTORIES[kind])}
    twins = {kind: {row.get("measured_id"): row for row in members} for kind, members in others.items()}
    nearest = [rows[n] for n in np.argsort(distance, kind="stable")]
    paired = [row for row in nearest if all(row["id"] in twins[kind] for kind in twins)]
    row = (paired or nearest)[0]
    return {"measured": row} | {kind: twins[kind].get(row["id"], members[0]) for kind, members in others.items()}


def frequency_responses(run: Run) -> Html:
    """Return figure 1 of the paper: a recorded and a simulated frequency response."""
    chosen = example(run)
    if "simulated" not in chosen:
        run.need(DIRECTORIES["simulated"])
    curves = [(KINDS[kind], kind, response_db(run.rir(DIRECTORIES[kind], row),
                                              direct_sample(run, DIRECTORIES[kind], row)))
              for kind, row in chosen.items()]
    alt = "; ".join(described(label, level_db[list(POINT_BINS)]) for label, _, level_db in curves)
    limits = figures.common_limits(*(level_db for *_, level_db in curves))
    first = [curve for curve in curves if curve[1] != "compensated"]
    panels = [figures.panel("figure-1-left", figures.frequency_responses(first, limits), alt)]
    if len(curves) > len(first):
        with_eq = [curve for curve in curves if curve[1] != "simulated"]
        panels.append(figures.panel("figure-1-right", figures.frequency_responses(with_eq, limits), alt))
    row = chosen["measured"]
    return join([
        paragraph("How strongly each frequency comes through from the loudspeaker to the microphone. "
                  "Ray-based simulation knows no room modes and no loudspeaker, so its curve is nearly flat; that "
                  "of a recording is not, above all below 500 Hz. The marks are the eight EQ sample points at "
                  "which the toolkit compares and corrects."),
        figure("figure-1", panels, join([
            "Paper's figure 1. First: recorded and simulated. Second: the same recording and the simulated response "
            "after compensation. Recorded: ", tag("code", row["id"]), " of room ", tag("code", row["room_id"]),
            ", the one nearest to the median EQ; the simulated one was made after it. They need not be "
            "equal: the toolkit matches distributions, not pairs."]))])


def spectrograms(run: Run) -> Html:
    """Return figure 3 of the paper."""
    chosen = example(run)
    panels = []
    for kind in ("simulated", "compensated", "measured"):
        if kind in chosen:
            rir = run.rir(DIRECTORIES[kind], chosen[kind])
            direct = direct_sample(run, DIRECTORIES[kind], chosen[kind])
            start = round(direct) - N_LEAD
            part = np.concatenate([np.zeros(max(0, -start)), rir[max(0, start):]])
            title = KINDS[kind][0].upper() + KINDS[kind][1:]
            panels.append(figures.panel(
                f"figure-3-{kind}", figures.spectrogram(title, part, SPECTROGRAM_S),
                f"Spectrogram of the {KINDS[kind]} RIR {chosen[kind]['id']}, {SPECTROGRAM_S} s from the direct "
                "sound", figures.SMALL_IN))
    if len(panels) == 1:
        run.need(DIRECTORIES["simulated"])
    return join([
        paragraph("Where the energy of a response lies in time and frequency. Bright from bottom to top at the "
                  "left edge is the direct sound; what fades to the right is reverberation."),
        figure("figure-3", panels, "Paper's figure 3: the RIRs of figure 1, each relative to its own maximum. "
               "Compensation moves energy between low and high frequencies; the decay stays that of the "
               "simulation.")])


def reverberation(run: Run) -> Html:
    """Return T60 targets against what was met, and the histogram beside the measured rooms'."""
    rows = simulated_rows(run)
    if not rows:
        run.need(DIRECTORIES["simulated"])
        raise Missing("target_t60_s and t30_s in data/rirs.sim.train", "stage 2 (roomeq simulate)")
    target, met = (np.array([row[name] for row in rows], dtype=np.float64) for name in ("target_t60_s", "t30_s"))
    measured = measured_times(run)
    groups = [("measured", "measured", measured)] if len(measured) else []
    groups += [("target", "drawn", target), ("simulated", "simulated", met)]
    edges = np.arange(0.0, max(2.0, *(values.max() for *_, values in groups)) + 0.2, 0.2)
    error = np.abs(met / target - 1.0)
    worst = rows[int(error.argmax())]
    panels = [
        figures.panel("figure-t60-histogram", figures.histogram("", groups, edges, "Reverberation time (s)"),
                      "Histogram of T60 targets, of the simulated and of the measured RIRs"),
        figures.panel("figure-t60-met", figures.target_and_met(target, met),
                      f"T30 met against T60 drawn; the worst error is {100 * error.max():.1f} %")]
    return join([
        paragraph("The time in which sound decays by 60 dB, measured at 1 kHz. Materials are drawn at random and "
                  "scaled until the rendered response meets a target that is uniform over the range asked for. "
                  f"Worst error: {100 * error.max():.1f} % (", tag("code", worst["id"]), f", {worst['t30_s']:.3f} "
                  f"s for {worst['target_t60_s']:.3f} s); median {100 * np.median(error):.1f} %. "
                  "5 % is the just noticeable difference."),
        figure("figure-t60", panels, "First: the paper aims at a uniform distribution, which measured rooms do not "
               "have. Second: each simulated RIR of the training and development sets."),
        leaks(rows)])


def measured_times(run: Run) -> np.ndarray:
    """Return the reverberation times of the measured training RIRs [s]."""
    rows = unscreened(run, DIRECTORIES["measured"]) if run.has(DIRECTORIES["measured"]) else []
    return np.array(reverberation_times([row["acoustic_parameters"] for row in rows if row.get("acoustic_parameters")]))


def leaks(rows: list[dict]) -> Html:
    """Return the energy audit, where the rows have one."""
    shares = [row["leaked_share"] for row in rows if row.get("leaked_share") is not None]
    if not shares:
        return Html("")
    if not max(shares):
        return paragraph("Energy audit: no ray left a room through a gap.")
    return paragraph(f"Energy audit: at most {100 * max(shares):.3g} % of the rays left a room through a gap.")
