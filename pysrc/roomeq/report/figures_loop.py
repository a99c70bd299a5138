"""Figure panels of the section on the closed loop."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from roomeq.core.arrays import FloatArray
from roomeq.report.figures import TICK_LABELS, Draw, legend, log_frequency
from roomeq.report.formats import with_minus

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# the text stands on the colours of the map, which do not follow the page's colour scheme
_ON_DARK, _ON_BRIGHT = "#fefefe", "#101010"
_MIN_SCALE_JND = 5.0
_LINEAR_UP_TO = 10.0
_LEGEND_ENTRIES = 6


@dataclass(frozen=True)
class Candidate:
    """An effect's gain in held-out rooms.

    Parameters
    ----------
    name : str
        Name of the effect.
    mean, low, high : float
        Mean gain of a room and its 95 % interval, in units of the log density.
    """

    name: str
    mean: float
    low: float
    high: float


@dataclass(frozen=True)
class ResponseBand:
    """A frequency response with its interval.

    Parameters
    ----------
    name : str
        The source, microphone or room.
    best, low, high : ndarray, shape (n_frequencies,)
        Gains [dB].
    """

    name: str
    best: FloatArray
    low: FloatArray
    high: FloatArray


@dataclass(frozen=True)
class Curves:
    """Curves of a measured RIR and of its simulations.

    Parameters
    ----------
    title, label : str
        Title of the panel and label of the vertical axis.
    x : ndarray
        Frequency [Hz] or time [s].
    lines : list of (label, colour name, values)
        The measured curve comes first.
    limits : tuple of 2 floats
        Limits of the vertical axis.
    is_spectrum : bool
        Whether `x` is frequency.
    """

    title: str
    x: FloatArray
    lines: list[tuple[str, str, FloatArray]]
    label: str
    limits: tuple[float, float]
    is_spectrum: bool


def residual_map(title: str, size_jnd: FloatArray, regions: Sequence[str], largest_jnd: float) -> Draw:
    """Draw the mean absolute residual over octave bands and time regions.

    Parameters
    ----------
    size_jnd : ndarray, shape (n_regions, 9)
        The ninth column holds broadband features; NaN where not measured.
    largest_jnd : float
        End of the colour scale, the same in panels to be compared.
    """
    def draw(axes: "Axes", colours: dict[str, str]) -> None:
        top = max(largest_jnd, _MIN_SCALE_JND)
        axes.imshow(np.ma.masked_invalid(size_jnd), vmin=0, vmax=top, cmap="magma", aspect="auto")
        for (y, x), value in np.ndenumerate(size_jnd):
            if np.isfinite(value):
                axes.text(x, y, f"{value:.1f}", ha="center", va="center", fontsize=7.5,
                          color=_ON_DARK if value < 0.6 * top else _ON_BRIGHT)
        axes.set_xticks(range(9), [*TICK_LABELS, "all"])
        axes.set_yticks(range(len(regions)), regions)
        axes.tick_params(length=0)
        axes.grid(False)
        axes.spines[:].set_visible(False)
        axes.set_xlabel("Octave band (Hz)")
        axes.set_title(title)
    return draw


def ranking(title: str, candidates: list[Candidate], chosen: str | None) -> Draw:
    """Draw the gain of each candidate in held-out rooms, with its interval.

    Parameters
    ----------
    candidates : list of Candidate
        In descending order of gain.
    chosen : str, optional
        Name of the effect that was added.
    """
    def draw(axes: "Axes", colours: dict[str, str]) -> None:
        y = np.arange(len(candidates))
        low, high = (np.array([getattr(candidate, end) for candidate in candidates]) for end in ("low", "high"))
        shades = [colours["compensated" if candidate.name == chosen else "extra"] for candidate in candidates]
        axes.barh(y, [candidate.mean for candidate in candidates], color=shades, height=0.62, alpha=0.75)
        axes.hlines(y, low, high, color=colours["ink"], lw=1.1)
        axes.axvline(0.0, color=colours["soft"], lw=0.8)
        axes.set_xscale("symlog", linthresh=_LINEAR_UP_TO)
        left, right = min(-15.0, 1.3 * low.min()), max(15.0, 1.3 * high.max())
        axes.set_xlim(left, right)
        ticks = [tick for tick in (-1000, -100, -10, 0, 10, 100, 1000) if left <= tick <= right]
        axes.set_xticks(ticks, [with_minus(f"{tick:g}") for tick in ticks])
        axes.set_yticks(y, [candidate.name for candidate in candidates])
        axes.invert_yaxis()
        axes.grid(False, axis="y")
        axes.set_xlabel("Gain in a held-out room (log density)")
        axes.set_title(title)
    return draw


def before_and_after(names: list[str], before: list[float], after: list[float], ceiling: list[float]) -> Draw:
    """Draw errors before and after and their ceiling by name [JND]; NaN omits an error."""
    def draw(axes: "Axes", colours: dict[str, str]) -> None:
        y = np.arange(len(names))
        axes.hlines(y, before, after, color=colours["line"], lw=3)
        axes.plot(before, y, "s", color=colours["simulated"], ms=5, label="before")
        axes.plot(after, y, "^", color=colours["compensated"], ms=5.5, label="after")
        axes.plot(ceiling, y, "|", color=colours["ink"], ms=9, mew=1.5, label="noise ceiling")
        axes.set_yticks(y, names)
        axes.set_ylim(len(names) - 0.5, -0.5)
        axes.set_xlim(left=0)
        axes.set_xlabel("Mean error (JND)")
        legend(axes)
    return draw


def response_curves(title: str, frequencies_hz: Sequence[float], responses: list[ResponseBand]) -> Draw:
    """Draw frequency responses with their intervals."""
    def draw(axes: "Axes", colours: dict[str, str]) -> None:
        names = ("measured", "simulated", "compensated", "drawn", "extra")
        for n, response in enumerate(responses):
            colour = colours[names[n % len(names)]]
            style = ("-", "--", ":")[n // len(names) % 3]
            axes.fill_between(frequencies_hz, response.low, response.high, color=colour, alpha=0.15, lw=0)
            axes.plot(frequencies_hz, response.best, style, color=colour, label=response.name)
        axes.axhline(0.0, color=colours["soft"], lw=0.8)
        log_frequency(axes, 0.9 * min(frequencies_hz))
        axes.set_ylabel("Gain (dB)")
        axes.set_title(title)
        if len(responses) <= _LEGEND_ENTRIES:
            legend(axes)
    return draw


def draw_curves(curves: Curves) -> Draw:
    """Draw curves of a measured RIR and of its simulations."""
    def draw(axes: "Axes", colours: dict[str, str]) -> None:
        for (name, colour, values), style, width in zip(curves.lines, ("-", "--", "-"), (2.4, 1.2, 1.2), strict=True):
            axes.plot(curves.x, values, style, color=colours[colour], lw=width, label=name,
                      alpha=0.55 if colour == "measured" else 1.0)
        if curves.is_spectrum:
            log_frequency(axes, 0.9 * float(curves.x[0]))
        else:
            axes.set_xlabel("Time after the direct sound (s)")
            levels = np.array([values for *_, values in curves.lines])
            visible = np.flatnonzero(np.any(levels > curves.limits[0], axis=0))
            axes.set_xlim(0, curves.x[visible[-1]] if len(visible) > 1 else curves.x[-1])
        axes.set_ylim(curves.limits)
        axes.set_ylabel(curves.label)
        axes.set_title(curves.title)
        legend(axes)
    return draw
