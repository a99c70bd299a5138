"""The panels of the report's chapter on the closed loop."""

import numpy as np

from roomeq.report.figures import TICK_LABELS, Draw, legend, log_frequency

_ON_DARK, _ON_BRIGHT = "#fefefe", "#101010"  # not the page's colours: they stand on a map that has its own
_LARGEST_JND = 5.0  # of the colour scale, at least


def residual_map(title: str, size_jnd: np.ndarray, regions: list[str], largest_jnd: float) -> Draw:
    """Draw the mean size of residuals over octave bands and regions of time.

    Parameters
    ----------
    size_jnd : ndarray, shape (n_regions, 9)
        The ninth column is of what has no band; NaN where nothing was measured.
    largest_jnd : float
        End of the colour scale, the same in panels to be compared.
    """
    def draw(axes, colours):
        top = max(largest_jnd, _LARGEST_JND)
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


def ranking(title: str, candidates: list[tuple[str, float, float, float]], chosen: str | None) -> Draw:
    """Draw what each candidate is worth on rooms left out, with its interval.

    Parameters
    ----------
    candidates : list of (name, mean, low, high)
        Gain a room, in units of the logarithm of the density; the best first.
    chosen : str, optional
        Name of the one that was added.
    """
    def draw(axes, colours):
        y = np.arange(len(candidates))
        _, mean, low, high = (np.array(column) for column in zip(*candidates, strict=True))
        shades = [colours["compensated" if name == chosen else "extra"] for name, *_ in candidates]
        axes.barh(y, mean, color=shades, height=0.62, alpha=0.75)
        axes.hlines(y, low, high, color=colours["ink"], lw=1.1)
        axes.axvline(0.0, color=colours["soft"], lw=0.8)
        axes.set_xscale("symlog", linthresh=10.0)
        axes.set_xlim(min(-15.0, 1.3 * low.min()), max(15.0, 1.3 * high.max()))
        ticks = [one for one in (-1000, -100, -10, 0, 10, 100, 1000) if axes.get_xlim()[0] <= one <= axes.get_xlim()[1]]
        axes.set_xticks(ticks, [f"{one:g}".replace("-", "\u2212") for one in ticks])
        axes.set_yticks(y, [name for name, *_ in candidates])
        axes.invert_yaxis()
        axes.grid(False, axis="y")
        axes.set_xlabel("Gain on a room left out (log density)")
        axes.set_title(title)
    return draw


def before_and_after(names: list[str], before: list[float], after: list[float]) -> Draw:
    """Draw errors before and after by name, the numbers at the side; NaN leaves one out."""
    def draw(axes, colours):
        y = np.arange(len(names))
        axes.hlines(y, before, after, color=colours["line"], lw=3)
        axes.plot(before, y, "s", color=colours["simulated"], ms=5, label="before")
        axes.plot(after, y, "^", color=colours["compensated"], ms=5.5, label="after")
        axes.set_yticks(y, names)
        axes.invert_yaxis()
        axes.set_xlim(left=0)
        axes.set_xlabel("Mean error (JND)")
        legend(axes)
    return draw


def response_curves(title: str, frequencies_hz, units: list[tuple[str, np.ndarray, np.ndarray, np.ndarray]]) -> Draw:
    """Draw responses with their intervals.

    Parameters
    ----------
    units : list of (name, best, low, high)
        Gains [dB].
    """
    def draw(axes, colours):
        names = ("measured", "simulated", "compensated", "drawn", "extra")
        for n, (name, best, low, high) in enumerate(units):
            colour = colours[names[n % len(names)]]
            style = ("-", "--", ":")[n // len(names) % 3]
            axes.fill_between(frequencies_hz, low, high, color=colour, alpha=0.15, lw=0)
            axes.plot(frequencies_hz, best, style, color=colour, label=name)
        axes.axhline(0.0, color=colours["soft"], lw=0.8)
        log_frequency(axes, 45.0)
        axes.set_ylabel("Gain (dB)")
        axes.set_title(title)
        if len(units) <= 6:
            legend(axes)
    return draw


def curves(title: str, x: np.ndarray, lines: list[tuple[str, str, np.ndarray]], label: str, *,
           frequency: bool = False, limits: tuple[float, float]) -> Draw:
    """Draw curves of a measured RIR and of its simulations.

    Parameters
    ----------
    lines : list of (label, colour name, values)
    label : str
        Of the vertical axis.
    frequency : bool
        Whether `x` is frequency [Hz]; else it is time [s].
    limits : tuple of 2 floats
        Of the vertical axis.
    """
    def draw(axes, colours):
        for (name, colour, values), style, width in zip(lines, ("-", "--", "-"), (2.4, 1.2, 1.2), strict=True):
            axes.plot(x, values, style, color=colours[colour], lw=width, label=name,
                      alpha=0.55 if colour == "measured" else 1.0)
        if frequency:
            log_frequency(axes, 45.0)
        else:
            axes.set_xlabel("Time after the direct sound (s)")
            shown = [values for *_, values in lines]
            seen = np.flatnonzero(np.any(np.array(shown) > limits[0], axis=0))
            axes.set_xlim(0, x[seen[-1]] if len(seen) > 1 else x[-1])
        axes.set_ylim(limits)
        axes.set_ylabel(label)
        axes.set_title(title)
        legend(axes)
    return draw
