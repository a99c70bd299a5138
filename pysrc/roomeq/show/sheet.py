"""Figures of several panels: for PNG files, and for notebooks."""

import functools
import io
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from roomeq.core.extras import require_packages
from roomeq.report import figures
from roomeq.report.figures import Draw
from roomeq.report.style import LIGHT

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike

_PANEL_IN = (4.4, 3.2)
_DPI = 110
_COLUMNS = 3


def plot_text(text: str) -> str:
    """Return a text that matplotlib draws as it is: neither as mathematics nor, where it begins with _, not at all."""
    return (" " if text.startswith("_") else "") + text.replace("$", r"\$")


@functools.cache
def _sheet_class() -> "type[Figure]":
    """Return the class of figures that notebooks show, whether or not pyplot is in use."""
    require_packages("matplotlib")
    from matplotlib.figure import Figure

    class Sheet(Figure):
        def _repr_png_(self) -> bytes:
            return _as_png(self)
    return Sheet


def _as_png(figure: "Figure") -> bytes:
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=_DPI, metadata=dict(Software=None))
    return stream.getvalue()


def sheet(draws: Sequence[Draw], title: str) -> "Figure":
    """Return a figure with panels in rows, from functions that draw one panel each (`roomeq.report.figures`)."""
    figure_class = _sheet_class()
    import matplotlib

    settings: Any = figures.settings()
    columns = min(_COLUMNS, len(draws))
    rows = -(-len(draws) // columns)
    with matplotlib.rc_context(settings):
        figure = figure_class(figsize=(columns * _PANEL_IN[0], rows * _PANEL_IN[1] + 0.4), layout="constrained")
        figure.suptitle(plot_text(title), fontweight="bold", fontsize=11, x=0.01, ha="left")
        parts = figure.subfigures(rows, columns, squeeze=False).ravel()
        for part, draw in zip(parts, draws, strict=False):
            draw(part.add_subplot(), LIGHT)
    return figure


def png(draws: Sequence[Draw], title: str) -> bytes:
    """Return a figure as PNG; equal drawings give equal bytes."""
    figure = sheet(draws, title)
    import matplotlib

    settings: Any = figures.settings()
    with matplotlib.rc_context(settings):
        return _as_png(figure)


def plot_rir(rir: "ArrayLike", fs: int, name: str = "RIR") -> "Figure":
    """Draw an RIR: waveform, early reflections, echogram, spectrogram, response and decay times, decays per octave.

    In a notebook, a cell that ends in ``roomeq.plot_rir(rir, fs)`` shows the figure.

    Parameters
    ----------
    rir : array_like, shape (n_samples,)
        An RIR of any scale.
    fs : int
        Sample rate, 8 to 48 kHz; the octave bands are those below half of it.
    name : str
        Title.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        `rir` is not mono, not finite, silent, or has no direct sound; or `fs` is out of range.
    """
    import numpy as np

    from roomeq.acoustics.direct import require_samples
    from roomeq.show.analysis import analyse
    from roomeq.show.page_rir import rir_draws

    require_samples(rir, "impulse response")
    return sheet(rir_draws(analyse(np.asarray(rir, dtype=np.float64), fs, name)), name)
