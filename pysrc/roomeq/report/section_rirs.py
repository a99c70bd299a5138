"""Sections about impulse responses: the paper's figures 1 and 3, and reverberation times."""

import numpy as np

from roomeq.acoustics.decibels import TINY_POWER, power_db
from roomeq.acoustics.octaves import octave_bands
from roomeq.acoustics.subband_eq import N_LEAD, POINT_BINS, energy_spectrum, eq_part
from roomeq.core.arrays import FloatArray
from roomeq.core.constants import BAND_1KHZ, BANDS_HZ, EXACT_BANDS_HZ, FS_HZ
from roomeq.records.schema import RirRow
from roomeq.report import figures, figures_rirs
from roomeq.report.kinds import COMPENSATED, EXTENDED, MEASURED, SIMULATED, Kind
from roomeq.report.load import Context, Missing, Run
from roomeq.report.rir_sets import (
    LIKE_T60,
    acoustic_parameters,
    are_paired,
    column_percentiles,
    decay_shapes,
    describe_eq,
    direct_sample,
    measured_example,
    reverberation_times,
    simulated_decays,
    t60_at_1khz,
    t60_mismatch,
    unscreened,
    without_rare,
)

SPECTROGRAM_S = 0.6
ECHOGRAMS = (("first 80 ms", None, 5e-4, 0.08), ("octave at 125 Hz", EXACT_BANDS_HZ[1], 1e-2, SPECTROGRAM_S),
             ("octave at 1 kHz", EXACT_BANDS_HZ[BAND_1KHZ], 1e-2, SPECTROGRAM_S))
"""Title, octave [Hz] or None, duration of a frame [s] and of the panel [s] of each echogram."""

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
    points_db = [level_db[list(POINT_BINS)] for level_db in levels.values()]
    limits = figures.common_limits(*levels.values(), marked=points_db)
    alt = "; ".join(describe_eq(kind.label, level_db[list(POINT_BINS)]) for kind, level_db in levels.items())
    panels = []
    for side, kind in (("left", SIMULATED), ("right", COMPENSATED)):
        if kind in levels:
            curves = [(shown.label, shown.colour, levels[shown]) for shown in (MEASURED, kind)]
            panels.append(figures.panel(f"figure-1-{side}", figures.frequency_responses(curves, limits), alt))
    return {"panels": panels, "measured": chosen[MEASURED], "paired": are_paired(chosen)}


def spectrograms(run: Run) -> Context:
    """Return figure 3 of the paper, and echograms of the same RIRs."""
    chosen = example_rirs(run)
    parts = {kind: from_direct(run, kind, row) for kind, row in chosen.items()}
    panels = []
    for kind in (SIMULATED, COMPENSATED, MEASURED):
        if kind in chosen:
            time_s = t60_at_1khz(chosen[kind])
            title = f"{kind.label[0].upper()}{kind.label[1:]}" + (f", T60 {time_s:.2f} s" if time_s else "")
            alt = f"Spectrogram of the {kind.label} RIR {chosen[kind]['id']}, {SPECTROGRAM_S} s from the direct sound"
            panels.append(figures.panel(f"figure-3-{kind.colour}",
                                        figures.spectrogram(title, parts[kind], SPECTROGRAM_S), alt, figures.SMALL_IN))
    mismatch = t60_mismatch(chosen[MEASURED], chosen[SIMULATED]) if SIMULATED in chosen else np.inf
    return {"panels": panels, "echograms": echograms(parts), "paired": are_paired(chosen),
            "mismatch": mismatch if np.isfinite(mismatch) else None, "like": mismatch <= LIKE_T60}


def from_direct(run: Run, kind: Kind, row: RirRow) -> FloatArray:
    """Return an RIR from half a frame of the spectrogram before its direct sound on."""
    rir = run.rir(kind.train, row)
    start = round(direct_sample(run, kind.train, row)) - N_LEAD
    return np.concatenate([np.zeros(max(0, -start)), rir[max(0, start):]])


def echograms(parts: dict[Kind, FloatArray]) -> list[figures.Panel]:
    """Draw the levels of RIRs over time: the first reflections, and the decay in two octaves."""
    panels: list[figures.Panel] = []
    for title, band_hz, step_s, duration_s in ECHOGRAMS:
        curves = []
        for kind, part in parts.items():
            response = part if band_hz is None else octave_bands(part, FS_HZ, [band_hz])[0]
            curves.append((kind.label, kind.colour, level_over_time(response[N_LEAD:], step_s, duration_s)))
        panels.append(figures.panel(f"figure-echogram-{len(panels) + 1}", figures_rirs.echogram(title, curves, step_s),
                                    f"Level over time after the direct sound, {title}: "
                                    + ", ".join(kind.label for kind in parts), figures.SMALL_IN))
    return panels


def level_over_time(response: FloatArray, step_s: float, duration_s: float) -> FloatArray:
    """Return the energy of frames of `step_s` in dB relative to the largest, shape (n_frames,)."""
    n_frame, n_frames = round(step_s * FS_HZ), round(duration_s / step_s)
    energy = np.zeros(n_frame * n_frames)
    energy[:len(response)] = np.square(response[:len(energy)])
    frames = energy.reshape(n_frames, n_frame).sum(axis=1)
    return power_db(frames / max(frames.max(), TINY_POWER), 1e-9)


def reverberation(run: Run) -> Context:
    """Return achieved reverberation times against targets, histograms with measured ones, and T30 over frequency."""
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
    if series := decay_series(run):
        alt = "; ".join(f"{group.label}: " + ", ".join(f"{middle:.2f} at {band_hz:g} Hz" for band_hz, middle
                                                      in zip(BANDS_HZ, group.middle, strict=True)
                                                      if np.isfinite(middle)) for group in series)
        panels.append(figures.panel("figure-t60-frequency", figures_rirs.decay_over_frequency(series),
                                    f"Median T30 relative to that at 1 kHz: {alt}"))
    leaked = [decay.leaked_share for decay in decays if decay.leaked_share is not None]
    return {"panels": panels, "median_error": float(np.median([decay.error for decay in decays])), "worst": worst,
            "leaked_share": max(leaked, default=None),
            "drawn_rooms": run.has(SIMULATED.train) and any(row.get("room_type") for row in run.rirs(SIMULATED.train))}


def decay_series(run: Run) -> list[figures_rirs.BandSeries]:
    """Return the T30 over frequency, relative to 1 kHz, of the measured, simulated and extended training RIRs."""
    series = []
    for kind in (MEASURED, SIMULATED, EXTENDED):
        shapes = (without_rare(decay_shapes(unscreened(run, kind.train))) if run.has(kind.train)
                  else np.empty((0, len(BANDS_HZ))))
        if np.isfinite(shapes).any():
            low, middle, high = column_percentiles(shapes, (5, 50, 95))
            series.append(figures_rirs.BandSeries(kind.label, kind.colour, middle, low, high))
    return series
