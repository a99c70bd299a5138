"""Sections about impulse responses: the paper's figures 1 and 3, and reverberation times."""

import numpy as np

from roomeq.acoustics.subband_eq import N_LEAD, POINT_BINS, energy_spectrum, eq_part
from roomeq.core.arrays import FloatArray
from roomeq.core.constants import BAND_1KHZ
from roomeq.records.schema import RirRow
from roomeq.report import figures
from roomeq.report.kinds import COMPENSATED, MEASURED, SIMULATED, Kind
from roomeq.report.load import Context, Missing, Run
from roomeq.report.rir_sets import (
    acoustic_parameters,
    describe_eq,
    direct_sample,
    measured_example,
    reverberation_times,
    simulated_decays,
    unscreened,
)

SPECTROGRAM_S = 0.6
EXAMPLE_KINDS = (MEASURED, SIMULATED, COMPENSATED)


def response_db(rir: FloatArray, direct: float) -> FloatArray:
    """Return the energy spectrum of an RIR as the EQ analysis computes it.

    Parameters
    ----------
    direct : float
        Position of the direct sound [samples].

    Returns
    -------
    ndarray, shape (257,)
        Level relative to 1 kHz [dB].
    """
    start, stop = eq_part(rir, direct)
    power = energy_spectrum(rir[start:stop])
    level_db = 10 * np.log10(np.maximum(power, 1e-30))
    return level_db - level_db[POINT_BINS[BAND_1KHZ]]


def example_rirs(run: Run) -> dict[Kind, RirRow]:
    """Return the measured and simulated RIRs of figures 1 and 3."""
    chosen = measured_example(run, EXAMPLE_KINDS)
    if SIMULATED not in chosen:
        run.need(SIMULATED.train)
    return chosen


def frequency_responses(run: Run) -> Context:
    """Return figure 1 of the paper: a measured and a simulated frequency response."""
    chosen = example_rirs(run)
    levels = {kind: response_db(run.rir(kind.train, row), direct_sample(run, kind.train, row))
              for kind, row in chosen.items()}
    limits = figures.common_limits(*levels.values())
    alt = "; ".join(describe_eq(kind.label, level_db[list(POINT_BINS)]) for kind, level_db in levels.items())
    panels = []
    for side, kind in (("left", SIMULATED), ("right", COMPENSATED)):
        if kind in levels:
            curves = [(shown.label, shown.colour, levels[shown]) for shown in (MEASURED, kind)]
            panels.append(figures.panel(f"figure-1-{side}", figures.frequency_responses(curves, limits), alt))
    return {"panels": panels, "measured": chosen[MEASURED]}


def spectrograms(run: Run) -> Context:
    """Return figure 3 of the paper."""
    chosen = example_rirs(run)
    panels = []
    for kind in (SIMULATED, COMPENSATED, MEASURED):
        if kind in chosen:
            rir = run.rir(kind.train, chosen[kind])
            start = round(direct_sample(run, kind.train, chosen[kind])) - N_LEAD
            part = np.concatenate([np.zeros(max(0, -start)), rir[max(0, start):]])
            title = f"{kind.label[0].upper()}{kind.label[1:]}"
            alt = f"Spectrogram of the {kind.label} RIR {chosen[kind]['id']}, {SPECTROGRAM_S} s from the direct sound"
            panels.append(figures.panel(f"figure-3-{kind.colour}", figures.spectrogram(title, part, SPECTROGRAM_S),
                                        alt, figures.SMALL_IN))
    return {"panels": panels}


def reverberation(run: Run) -> Context:
    """Return achieved reverberation times against targets, and their histograms with that of measured RIRs."""
    decays = simulated_decays(run)
    if not decays:
        run.need(SIMULATED.train)
        raise Missing("target_t60_s and t30_s in data/rirs.sim.train", "stage 2 (roomeq simulate)")
    target, achieved = (np.array([getattr(decay, name) for decay in decays]) for name in ("target_s", "t30_s"))
    measured = unscreened(run, MEASURED.train) if run.has(MEASURED.train) else []
    measured_times = reverberation_times(acoustic_parameters(measured))
    groups = [("measured", "measured", measured_times)] if len(measured_times) else []
    groups += [("target", "drawn", target), ("simulated", "simulated", achieved)]
    edges = np.arange(0.0, max(2.0, *(values.max() for *_, values in groups)) + 0.2, 0.2)
    worst = max(decays, key=lambda decay: decay.error)
    panels = [
        figures.panel("figure-t60-histogram", figures.histogram("", groups, edges, "Reverberation time (s)"),
                      "Histogram of T60 targets and of the T30 of simulated and measured RIRs"),
        figures.panel("figure-t60-met", figures.target_and_achieved(target, achieved),
                      f"Achieved T30 against target T60; the largest error is {100 * worst.error:.1f} %")]
    leaked = [decay.leaked_share for decay in decays if decay.leaked_share is not None]
    return {"panels": panels, "median_error": float(np.median([decay.error for decay in decays])), "worst": worst,
            "leaked_share": max(leaked, default=None)}
