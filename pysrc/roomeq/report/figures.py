"""Figure panels as SVG that follows the reader's choice of a light or a dark page.

A panel is legible on a phone without zooming; a wide screen shows the panels of a figure side by side. A function
``draw(axes, colours)`` draws a panel, and `panel` renders it.
"""

import io
import itertools
import re
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from roomeq.core.arrays import FloatArray
from roomeq.core.constants import BANDS_HZ, FS_HZ
from roomeq.report.formats import data_uri
from roomeq.report.rir_sets import column_percentiles
from roomeq.report.style import COLOUR_VARIABLES, LIGHT

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SIZE_IN, SMALL_IN = (4.4, 3.1), (3.5, 2.8)
CSS_PIXELS_PER_INCH = 96
TICK_LABELS = ("62.5", "125", "250", "500", "1k", "2k", "4k", "8k")
TICKS = dict(zip((*BANDS_HZ, 16000.0), (*TICK_LABELS, "16k"), strict=True))
"""Labels of the octave bands by frequency [Hz], for any sample rate."""
MAX_CURVES = 150
"""Largest number of curves in a panel: of more, every n-th is drawn."""

MARKERS = dict(measured="o", simulated="s", compensated="^", drawn="D")
"""Markers that distinguish kinds of RIRs without colour."""

SPECTROGRAM_HOP_S = 4e-3
"""Time between frames; a frame is eight times as long, 512 samples at 16 kHz as in the paper."""

LEGEND_SIZE_PT = 8.0
LEGEND_KEY_IN = 0.56
"""Width of an entry without its text: key, and the distances between them."""

LEGEND_MARGIN_IN = 0.15
POINTS_PER_INCH = 72.0

Draw = Callable[["Axes", dict[str, str]], None]


@dataclass(frozen=True)
class Panel:
    """An image of the page.

    Parameters
    ----------
    ident : str
        Id of the element.
    src : str
        The SVG as a ``data:`` URI.
    alt : str
        Content of the image for readers who cannot see it.
    width, height : int
        Size [CSS pixels], so that the page does not shift while it loads.
    """

    ident: str
    src: str
    alt: str
    width: int
    height: int


def panel(ident: str, draw: Draw, alt: str, size_in: tuple[float, float] = SIZE_IN) -> Panel:
    """Render one panel."""
    width, height = (round(CSS_PIXELS_PER_INCH * length_in) for length_in in size_in)
    return Panel(ident, data_uri("image/svg+xml", render_svg(draw, size_in)), alt, width, height)


def render_svg(draw: Draw, size_in: tuple[float, float] = SIZE_IN) -> bytes:
    """Render an SVG document that follows the colour scheme of the reader; equal drawings give equal bytes."""
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    light: Any = settings()  # matplotlib types each key of its settings
    with matplotlib.rc_context(light):
        figure = Figure(figsize=size_in, layout="constrained")
        FigureCanvasSVG(figure)
        draw(figure.add_subplot(), LIGHT)
        stream = io.BytesIO()
        figure.savefig(stream, format="svg", metadata=dict(Date=None, Creator=None), dpi=144)
    svg = re.sub(r"\n\s*", "\n", stream.getvalue().decode())  # empty lines and indents are a tenth of the file
    for name, colour in LIGHT.items():
        svg = svg.replace(f": {colour}", f": var(--{name})")
    return svg.replace("<defs>", f"<style>{COLOUR_VARIABLES}</style>\n<defs>", 1).encode()


def settings() -> dict[str, Any]:
    """Return all of matplotlib's settings, with the colours of a light page; those of the user have no effect."""
    import matplotlib

    defaults = {str(name): value for name, value in matplotlib.rcParamsDefault.items()
                if not name.startswith("backend")}
    ink, soft, line, paper = (LIGHT[key] for key in ("ink", "soft", "line", "paper"))
    return defaults | {
        "svg.hashsalt": "roomeq", "svg.fonttype": "path", "font.family": "DejaVu Sans", "font.size": 8.5,
        "figure.facecolor": paper, "axes.facecolor": paper, "savefig.facecolor": paper, "text.color": ink,
        "axes.edgecolor": soft, "axes.labelcolor": ink, "xtick.color": soft, "ytick.color": soft,
        "xtick.labelcolor": ink, "ytick.labelcolor": ink, "axes.spines.top": False, "axes.spines.right": False,
        "axes.linewidth": 0.7, "xtick.major.width": 0.7, "ytick.major.width": 0.7, "axes.grid": True,
        "grid.color": line, "grid.linewidth": 0.6, "axes.axisbelow": True, "axes.titlesize": 9.5,
        "axes.titleweight": "bold", "axes.titlelocation": "left", "legend.frameon": False,
        "legend.fontsize": LEGEND_SIZE_PT, "lines.linewidth": 1.4, "axes.unicode_minus": True, "path.simplify": True,
    }


def legend(axes: "Axes") -> None:
    """Put the legend above the axes, in as many columns as fit; a label that is too long is wrapped."""
    handles, labels = axes.get_legend_handles_labels()
    if not labels:
        return
    figure = axes.get_figure()  # of several panels, the part with this one
    assert figure is not None  # panels have one
    available_in = figure.bbox.width / figure.dpi - LEGEND_MARGIN_IN
    columns = next((n for n in (3, 2) if n <= len(labels) and _legend_width_in(labels, n) <= available_in), 1)
    if columns == 1:
        labels = [_wrapped(label, available_in - LEGEND_KEY_IN) for label in labels]
    figure.legend(handles, labels, loc="outside upper left", ncols=columns)


def _legend_width_in(labels: list[str], columns: int) -> float:
    """Return the width of a legend [inch]; matplotlib fills it column by column."""
    n_rows = -(-len(labels) // columns)
    return sum(LEGEND_KEY_IN + max(map(_text_width_in, labels[start:start + n_rows]))
               for start in range(0, len(labels), n_rows))


def _text_width_in(text: str) -> float:
    """Return the width of a label of the legend [inch]."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import TextPath

    size_pt = FontProperties(size=LEGEND_SIZE_PT)
    return float(TextPath((0, 0), text, prop=size_pt).get_extents().width) / POINTS_PER_INCH if text.strip() else 0.0


def _wrapped(text: str, width_in: float) -> str:
    """Break a label into lines that are not wider than `width_in`."""
    for n_characters in range(len(text), 0, -1):
        lines = textwrap.wrap(text, n_characters)
        if max(map(_text_width_in, lines), default=0.0) <= width_in:
            return "\n".join(lines)
    return text


def log_frequency(axes: "Axes", low_hz: float = 50.0, high_hz: float = 8600.0, along: str = "x") -> None:
    """Make an axis logarithmic in frequency, with the octave bands as ticks."""
    from matplotlib.ticker import FixedLocator, NullFormatter

    axis = axes.xaxis if along == "x" else axes.yaxis
    (axes.set_xscale if along == "x" else axes.set_yscale)("log")
    (axes.set_xlim if along == "x" else axes.set_ylim)(low_hz, high_hz)
    ticks = {band_hz: label for band_hz, label in TICKS.items() if low_hz <= band_hz <= high_hz}
    axis.set_major_locator(FixedLocator(list(ticks)))
    axis.set_minor_locator(FixedLocator([]))
    axis.set_minor_formatter(NullFormatter())
    axis.set_ticklabels(list(ticks.values()))
    axis.set_label_text("Frequency (Hz)")


def frequency_responses(curves: list[tuple[str, str, FloatArray]], limits_db: tuple[float, float]) -> Draw:
    """Draw magnitude responses with the EQ sample points marked (the paper's figure 1).

    Parameters
    ----------
    curves : list of (label, colour name, level_db)
        `level_db` has shape (257,): bins of 31.25 Hz, relative to 1 kHz.
    """
    def draw(axes: "Axes", colours: dict[str, str]) -> None:
        for label, colour, level_db in curves:
            frequency_hz = np.arange(len(level_db)) * FS_HZ / (2 * (len(level_db) - 1))
            points = [round(f * 2 * (len(level_db) - 1) / FS_HZ) for f in BANDS_HZ]
            axes.plot(frequency_hz[1:], level_db[1:], color=colours[colour], lw=1.1, label=label)
            axes.plot(frequency_hz[points], level_db[points], MARKERS[colour], color=colours[colour], ms=5.5,
                      mec=colours["paper"], mew=0.8)
        log_frequency(axes, 31.0)
        axes.set_ylim(limits_db)
        axes.set_ylabel("Level (dB, 1 kHz = 0)")
        legend(axes)
    return draw


def eq_curves(title: str, eq_db: FloatArray, colour: str, limits_db: tuple[float, float]) -> Draw:
    """Draw a set of EQ vectors with its median and the range of the middle 90 % (the paper's figure 2).

    Parameters
    ----------
    eq_db : ndarray, shape (n_rirs, 8)
        Gains relative to 1 kHz [dB]; NaN where invalid.
    limits_db : tuple of 2 floats
        Limits of the vertical axis.
    """
    def draw(axes: "Axes", colours: dict[str, str]) -> None:
        from matplotlib.collections import LineCollection

        every = max(1, -(-len(eq_db) // MAX_CURVES))
        lines = [np.column_stack([BANDS_HZ, row])[np.isfinite(row)] for row in eq_db[::every]]
        axes.add_collection(LineCollection(lines, colors=colours[colour], linewidths=0.5,
                                           alpha=max(0.15, min(0.6, 20 / len(lines)))))
        low, middle, high = column_percentiles(eq_db, (5, 50, 95))
        axes.plot(BANDS_HZ, middle, "o-", color=colours["ink"], ms=4, lw=1.5, label="median")
        axes.plot(BANDS_HZ, low, "--", color=colours["ink"], lw=0.9, label="5 % and 95 %")
        axes.plot(BANDS_HZ, high, "--", color=colours["ink"], lw=0.9)
        log_frequency(axes)
        axes.set_ylim(limits_db)
        axes.set_ylabel("EQ gain (dB, 1 kHz = 0)")
        axes.set_title(f"{title} (n = {len(eq_db)})")
        legend(axes)
    return draw


def common_limits(*sets: FloatArray, marked: Sequence[FloatArray] = ()) -> tuple[float, float]:
    """Return axis limits [dB], multiples of 5 dB, around the 0.5th to the 99.5th percentile of EQs and all `marked`."""
    values = np.concatenate([eq_db[np.isfinite(eq_db)].ravel() for eq_db in sets])
    low, high = np.percentile(values, (0.5, 99.5)) if len(values) else (-10.0, 10.0)
    for points_db in marked:
        low, high = min(low, np.min(points_db)), max(high, np.max(points_db))
    return 5.0 * np.floor(min(low - 1, -5) / 5), 5.0 * np.ceil(max(high + 1, 5) / 5)


def spectrogram(title: str, rir: FloatArray, duration_s: float, fs_hz: int = FS_HZ) -> Draw:
    """Draw the spectrogram of an RIR in dB relative to its maximum (the paper's figure 3).

    Parameters
    ----------
    rir : ndarray, shape (n_samples,)
        Starts half a frame (16 ms) before the direct sound, which is the centre of the first frame.
    duration_s : float
        Extent of the time axis [s].
    fs_hz : int
        Sample rate [Hz].
    """
    hop = round(SPECTROGRAM_HOP_S * fs_hz)
    n_fft = 8 * hop
    n_samples = round(duration_s * fs_hz)
    padded = np.concatenate([rir, np.zeros(max(0, n_samples + n_fft - len(rir)))])
    frames = np.lib.stride_tricks.sliding_window_view(padded, n_fft)[::hop][:n_samples // hop]
    power = np.abs(np.fft.rfft(frames * np.hanning(n_fft), axis=1).T[1:]) ** 2
    level_db = 10 * np.log10(np.maximum(power, 1e-30) / max(power.max(), 1e-30))

    def draw(axes: "Axes", colours: dict[str, str]) -> None:
        edges_hz = (np.arange(len(level_db) + 1) + 0.5) * fs_hz / n_fft
        edges_s = np.arange(level_db.shape[1] + 1) * hop / fs_hz
        mesh = axes.pcolormesh(edges_s, edges_hz, level_db, vmin=-60, vmax=0, cmap="magma", rasterized=True)
        axes.grid(False)
        log_frequency(axes, 46.9, 0.5 * fs_hz, along="y")
        axes.set_xlabel("Time after the direct sound (s)")
        axes.set_title(title)
        bar = axes.figure.colorbar(mesh, ax=axes, pad=0.02, fraction=0.05)
        bar.set_label("dB re maximum")
        bar.outline.set_visible(False)
    return draw


def histogram(title: str, groups: list[tuple[str, str, FloatArray]], edges: FloatArray, label: str,
              unit: str = "RIRs") -> Draw:
    """Draw overlaid histograms of several groups.

    Parameters
    ----------
    groups : list of (label, colour name, values)
    edges : ndarray
        Edges of the bins.
    label : str
        Label of the horizontal axis, with its unit.
    unit : str
        The counted items.
    """
    def draw(axes: "Axes", colours: dict[str, str]) -> None:
        from matplotlib.ticker import MaxNLocator

        styles = itertools.cycle(["-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1))])
        for n, ((name, colour, values), style) in enumerate(zip(groups, styles, strict=False)):
            if n == 0:
                axes.hist(values, list(edges), histtype="stepfilled", color=colours[colour], alpha=0.2)
            axes.hist(values, list(edges), histtype="step", color=colours[colour], lw=1.6, ls=style,
                      label=f"{name} (n = {len(values)})")
        axes.set_xlim(edges[0], edges[-1])
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlabel(label)
        axes.set_ylabel(f"Number of {unit}")
        if title:
            axes.set_title(title)
        legend(axes)
    return draw


def target_and_achieved(target_s: FloatArray, achieved_s: FloatArray) -> Draw:
    """Draw achieved against target reverberation times [s], with the 5 % band."""
    def draw(axes: "Axes", colours: dict[str, str]) -> None:
        top = 1.05 * max(target_s.max(), achieved_s.max())
        line = np.array([0.0, top])
        axes.fill_between(line, 0.95 * line, 1.05 * line, color=colours["extra"], alpha=0.25, lw=0, label="±5 %")
        axes.plot(target_s, achieved_s, "o", color=colours["simulated"], ms=4, alpha=0.7, mew=0, label="simulated RIR",
                  rasterized=len(target_s) > 300)
        axes.set_xlim(0, top)
        axes.set_ylim(0, top)
        axes.set_xlabel("Target T60 (s)")
        axes.set_ylabel("T30 of the rendered RIR at 1 kHz (s)")
        legend(axes)
    return draw


@dataclass(frozen=True)
class PointSeries:
    """Values at the EQ points, drawn as dots with whiskers.

    Parameters
    ----------
    label, colour : str
        Legend entry and name of the colour.
    value, top : ndarray, shape (8,)
        The dot and the upper end of its whisker; NaN omits a point.
    """

    label: str
    colour: str
    value: FloatArray
    top: FloatArray


def per_point(groups: list[PointSeries], label: str, limits: dict[str, float]) -> Draw:
    """Draw a dot with a whisker for each EQ point and group.

    Parameters
    ----------
    label : str
        Label of the vertical axis, with its unit.
    limits : dict
        Horizontal lines by legend entry.
    """
    def draw(axes: "Axes", colours: dict[str, str]) -> None:
        for n, group in enumerate(groups):
            x = np.arange(len(BANDS_HZ)) + 0.16 * (n - (len(groups) - 1) / 2)
            axes.vlines(x, group.value, group.top, color=colours[group.colour], lw=1.4, alpha=0.7)
            axes.plot(x, group.value, MARKERS[group.colour], color=colours[group.colour], ms=5, label=group.label)
        for style, (name, value) in zip(("--", ":"), limits.items(), strict=False):
            axes.axhline(value, color=colours["ink"], lw=0.9, ls=style, label=name)
        axes.set_xticks(range(len(BANDS_HZ)), TICK_LABELS)
        axes.grid(False, axis="x")
        axes.set_xlabel("Frequency (Hz)")
        axes.set_ylabel(label)
        axes.set_ylim(bottom=0)
        legend(axes)
    return draw
