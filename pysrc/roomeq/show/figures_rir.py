"""Figure panels of one or two RIRs: waveform, echogram, decays, spectrogram and frequency response.

A panel takes a list of RIRs, of which the first is drawn in the colour of measurements; a page that compares two RIRs
draws both in the same panels.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from roomeq.acoustics.decibels import FLOOR_POWER, power_db
from roomeq.core.arrays import FloatArray
from roomeq.report import figures
from roomeq.report.figures import TICKS, Draw, legend, log_frequency
from roomeq.report.formats import hertz, with_minus
from roomeq.report.room_map import Reflection
from roomeq.show.analysis import FRAME_S, LOWEST_DB, AnalysedRir

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = ("measured", "simulated")
"""Colours of the first and of the second RIR."""
EARLY_S = (-0.005, 0.06)
"""Time axis of the early reflections, from the direct sound."""
_N_COLUMNS = 1200  # of a waveform: more samples are drawn as the range of their values
_EARLY_DB = (-50.0, 5.0)
_LABEL_DB, _LABEL_MS = 4.0, 11.0  # size of the label of a reflection
_SMOOTHING_S = 2e-4
_HALF_FRAME_S = 0.016  # of the spectrogram


def waveform(rirs: Sequence[AnalysedRir]) -> Draw:
    """Draw the samples relative to their maximum; long responses as the range of values in each column."""
    def draw(axes: "Axes", colours: dict[str, str]) -> None:
        for rir, colour in zip(rirs, COLOURS, strict=False):
            samples = rir.samples / np.abs(rir.samples).max()
            n_each = -(-len(samples) // _N_COLUMNS)
            padded = np.pad(samples, (0, -len(samples) % n_each), mode="edge").reshape(-1, n_each)
            time_s = (np.arange(len(padded)) + 0.5) * n_each / rir.fs_hz - rir.direct_s
            axes.fill_between(time_s, padded.min(axis=1), padded.max(axis=1), color=colours[colour], lw=0.6,
                              alpha=1.0 if len(rirs) == 1 else 0.6, label=rir.name)
        axes.axvline(0.0, color=colours["soft"], lw=0.8, ls=":")
        axes.set_ylim(-1.05, 1.05)
        axes.set_xlabel("Time after the direct sound (s)")
        axes.set_ylabel("Amplitude (maximum = 1)")
        axes.set_title("Waveform")
        if len(rirs) > 1:
            legend(axes)
    return draw


def early_reflections(rirs: Sequence[AnalysedRir], reflections: Sequence[Reflection] = ()) -> Draw:
    """Draw the level of the first 60 ms, with the arrivals that the geometry predicts for the first reflections."""
    def draw(axes: "Axes", colours: dict[str, str]) -> None:
        for rir, colour in zip(rirs, COLOURS, strict=False):
            level_db = _smoothed_level_db(rir)
            time_ms = 1e3 * ((np.arange(len(level_db))) / rir.fs_hz - rir.direct_s)
            part = (time_ms >= 1e3 * EARLY_S[0]) & (time_ms <= 1e3 * EARLY_S[1])
            axes.plot(time_ms[part], level_db[part], color=colours[colour], lw=0.9, label=rir.name)
        within = [reflection for reflection in reflections if reflection.delay_s < EARLY_S[1]]
        lines = label_lines([1e3 * reflection.delay_s for reflection in within])
        for reflection, line in zip(within, lines, strict=True):
            at_ms, top_db = 1e3 * reflection.delay_s, _EARLY_DB[1] + _LABEL_DB * line
            axes.plot([at_ms, at_ms], [_EARLY_DB[0], top_db], color=colours["soft"], lw=0.8, ls="--")
            axes.text(at_ms, top_db, f" {reflection.surface}", fontsize=7, va="center", color=colours["ink"])
        axes.set_xlim(1e3 * EARLY_S[0], 1e3 * EARLY_S[1])
        axes.set_ylim(_EARLY_DB[0], _EARLY_DB[1] + _LABEL_DB * (max(lines, default=-1) + 1))
        axes.set_xlabel("Time after the direct sound (ms)")
        axes.set_ylabel("Level (dB re maximum)")
        axes.set_title("Early reflections")
        if len(rirs) > 1:
            legend(axes)
    return draw


def label_lines(times_ms: Sequence[float]) -> list[int]:
    """Return the line of text above the curve in which each label, in the order of time, meets no other label."""
    ends: list[float] = []  # of the last label in each line
    lines = []
    for at_ms in times_ms:
        line = next((n for n, end_ms in enumerate(ends) if at_ms >= end_ms), len(ends))
        ends[line:line + 1] = [at_ms + _LABEL_MS]
        lines.append(line)
    return lines


def echogram(rir: AnalysedRir, title: str = "Echogram by octave band") -> Draw:
    """Draw the energy of each octave band in frames of 5 ms."""
    def draw(axes: "Axes", colours: dict[str, str]) -> None:
        levels_db = rir.band_levels_db[:, :max(2, round(rir.shown_s() / FRAME_S))]
        end_s = levels_db.shape[1] * FRAME_S
        mesh = axes.pcolormesh(np.linspace(0.0, end_s, levels_db.shape[1] + 1), np.arange(len(levels_db) + 1) - 0.5,
                               levels_db, vmin=-60, vmax=0, cmap="magma", rasterized=True)
        axes.set_yticks(range(len(levels_db)), [TICKS[band_hz] for band_hz in rir.bands_hz])
        axes.grid(False)
        axes.set_xlabel("Time after the direct sound (s)")
        axes.set_ylabel("Octave band (Hz)")
        axes.set_title(title)
        bar = axes.figure.colorbar(mesh, ax=axes, pad=0.02, fraction=0.05)
        bar.set_label("dB re maximum")
        bar.outline.set_visible(False)
    return draw


def spectrogram(rir: AnalysedRir, title: str = "Spectrogram") -> Draw:
    """Draw the spectrogram from the direct sound to the end of the decay."""
    start = round(rir.direct.sample - _HALF_FRAME_S * rir.fs_hz)
    part = np.concatenate([np.zeros(max(0, -start)), rir.samples[max(0, start):]])
    return figures.spectrogram(title, part, max(0.05, rir.shown_s()), rir.fs_hz)


def decay(rirs: Sequence[AnalysedRir], number: int) -> Draw:
    """Draw the decay curve of one octave band with the fitted slope and the noise intersection."""
    def draw(axes: "Axes", colours: dict[str, str]) -> None:
        for rir, colour in zip(rirs, COLOURS, strict=False):
            band = rir.decays[number]
            if len(rirs) == 1:
                axes.plot(band.time_s, band.level_db - band.level_db.max(), color=colours["extra"], lw=0.7, alpha=0.7,
                          label="level, 5 ms")
            axes.plot(band.curve_s, band.curve_db, color=colours[colour], lw=1.8,
                      label="decay curve" if len(rirs) == 1 else rir.name)
            if band.fit is not None:
                name, time_s, offset_db, valid = band.fit
                end_s = min((offset_db - LOWEST_DB) * time_s / 60.0, band.intersection_s)
                axes.plot([0.0, end_s], [offset_db, offset_db - 60.0 * end_s / time_s], "--",
                          color=colours["simulated" if len(rirs) == 1 else colour], lw=1.2,
                          label=f"{name} {time_s:.2f} s" + ("" if valid else ", not valid"))
            if band.has_noise:
                axes.axvline(band.intersection_s, color=colours["compensated" if len(rirs) == 1 else colour], lw=1.1,
                             ls=":", label="meets noise" if len(rirs) == 1 else None)
        axes.set_xlim(0.0, max(rir.shown_s() for rir in rirs))
        axes.set_ylim(LOWEST_DB, 3.0)
        axes.set_xlabel("Time after the direct sound (s)")
        axes.set_ylabel("Level (dB)")
        axes.set_title(hertz(rirs[0].bands_hz[number]))
        legend(axes)
    return draw


def response(rirs: Sequence[AnalysedRir]) -> Draw:
    """Draw the frequency response with the octave bands of the EQ marked."""
    def draw(axes: "Axes", colours: dict[str, str]) -> None:
        marked = [np.interp(rir.bands_hz, *rir.response) for rir in rirs]
        limits = figures.common_limits(*(_audible(rir) for rir in rirs), marked=marked)
        for rir, points_db, colour in zip(rirs, marked, COLOURS, strict=False):
            frequencies_hz, level_db = rir.response
            axes.plot(frequencies_hz[1:], level_db[1:], color=colours[colour], lw=1.1, label=rir.name)
            axes.plot(rir.bands_hz, points_db, figures.MARKERS[colour], color=colours[colour], ms=5.0,
                      mec=colours["paper"], mew=0.8)
        log_frequency(axes, 31.0, max(8600.0, 0.5 * max(rir.fs_hz for rir in rirs)))
        axes.set_ylim(limits)
        axes.set_ylabel("Level (dB, 1 kHz = 0)")
        axes.set_title("Frequency response")
        if len(rirs) > 1:
            legend(axes)
    return draw


def decay_times(rirs: Sequence[AnalysedRir]) -> Draw:
    """Draw EDT, T20 and T30 over frequency; hollow markers are values that are not valid."""
    def draw(axes: "Axes", colours: dict[str, str]) -> None:
        styles = {"t30": ("o", "-"), "t20": ("s", "--"), "edt": ("^", ":")}
        for rir, colour in zip(rirs, COLOURS, strict=False):
            for metric, (marker, line) in styles.items() if len(rirs) == 1 else [("t30", ("o", "-"))]:
                times_s, valid = (rir.parameters[f"{metric}_{key}"] for key in ("s", "valid"))
                values = np.array(times_s, dtype=float)
                label = metric.upper() if len(rirs) == 1 else f"T30, {rir.name}"
                axes.plot(rir.bands_hz, np.where(valid, values, np.nan), marker + line, color=colours[colour], ms=4.5,
                          lw=1.1, label=label)
                axes.plot(rir.bands_hz, np.where(valid, np.nan, values), marker, color=colours[colour], ms=4.5,
                          mfc=colours["paper"])
        log_frequency(axes, 45.0, max(8600.0, 0.5 * max(rir.fs_hz for rir in rirs)))
        axes.set_ylim(bottom=0.0)
        axes.set_ylabel("Decay time (s)")
        axes.set_title("Decay times")
        legend(axes)
    return draw


def describe_decays(rir: AnalysedRir) -> str:
    """Return the decay times as text for readers who cannot see the figures."""
    parts = [f"{TICKS[band.band_hz]} Hz: {band.fit[0]} {band.fit[1]:.2f} s" for band in rir.decays if band.fit]
    return with_minus(f"{rir.name}: {', '.join(parts) or 'no decay time'}")


def _smoothed_level_db(rir: AnalysedRir) -> FloatArray:
    """Return the level of each sample, averaged over 0.2 ms, relative to its maximum."""
    n_window = max(1, round(_SMOOTHING_S * rir.fs_hz))
    power = np.convolve(np.square(rir.samples), np.ones(n_window) / n_window, mode="same")
    return power_db(power, FLOOR_POWER) - float(power_db(power.max(), FLOOR_POWER))


def _audible(rir: AnalysedRir) -> FloatArray:
    """Return the level from 50 Hz to the edge of the highest octave."""
    frequencies_hz, level_db = rir.response
    return level_db[(frequencies_hz >= 50.0) & (frequencies_hz <= min(1.2 * rir.bands_hz[-1], 0.45 * rir.fs_hz))]
