"""Figure panels of RIRs and of sets of RIRs: differences from measured ones, decay times and echograms."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from roomeq.acoustics.jnd import LEVEL_JND_DB
from roomeq.core.arrays import FloatArray
from roomeq.core.constants import BANDS_HZ
from roomeq.report.figures import MARKERS, Draw, legend, log_frequency

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LOWEST_DB = -60.0


@dataclass(frozen=True)
class BandSeries:
    """Values in the octave bands.

    Parameters
    ----------
    label, colour : str
        Legend entry and name of the colour.
    middle, low, high : ndarray, shape (8,)
        Median and ends of the range; NaN omits a band.
    """

    label: str
    colour: str
    middle: FloatArray
    low: FloatArray
    high: FloatArray


def eq_differences(groups: list[tuple[str, str, FloatArray]]) -> Draw:
    """Draw the differences of median EQs from the measured one, with the just noticeable difference.

    Parameters
    ----------
    groups : list of (label, colour name, difference_db)
        `difference_db` has shape (8,); NaN omits a point.
    """
    def draw(axes: "Axes", colours: dict[str, str]) -> None:
        axes.axhspan(-LEVEL_JND_DB, LEVEL_JND_DB, color=colours["extra"], alpha=0.2, lw=0, label="just noticeable")
        axes.axhline(0.0, color=colours["measured"], lw=1.4, label="measured")
        for label, colour, difference_db in groups:
            axes.plot(BANDS_HZ, difference_db, MARKERS[colour] + "-", color=colours[colour], ms=5.5, lw=1.2,
                      label=label)
        log_frequency(axes)
        axes.set_ylabel("Median EQ, re measured (dB)")
        legend(axes)
    return draw


def decay_over_frequency(groups: list[BandSeries]) -> Draw:
    """Draw reverberation times over frequency relative to that at 1 kHz, with the range of the middle 90 %."""
    def draw(axes: "Axes", colours: dict[str, str]) -> None:
        for n, group in enumerate(groups):
            x = np.array(BANDS_HZ) * 2 ** (0.1 * (n - (len(groups) - 1) / 2))
            axes.vlines(x, group.low, group.high, color=colours[group.colour], lw=1.3, alpha=0.6)
            axes.plot(x, group.middle, MARKERS[group.colour] + "-", color=colours[group.colour], ms=5, lw=1.2,
                      label=group.label)
        log_frequency(axes)
        axes.set_ylim(bottom=0.0)
        axes.set_ylabel("T30, re that at 1 kHz")
        legend(axes)
    return draw


def echogram(title: str, curves: list[tuple[str, str, FloatArray]], step_s: float) -> Draw:
    """Draw the level of RIRs over time.

    Parameters
    ----------
    curves : list of (label, colour name, level_db)
        `level_db` has shape (n_frames,), from the direct sound on.
    step_s : float
        Duration of a frame [s].
    """
    def draw(axes: "Axes", colours: dict[str, str]) -> None:
        for label, colour, level_db in curves:
            axes.plot(1000.0 * step_s * (np.arange(len(level_db)) + 0.5), level_db, color=colours[colour], lw=1.1,
                      alpha=0.85, label=label)
        axes.set_xlim(0.0, 1000.0 * step_s * max(len(level_db) for *_, level_db in curves))
        axes.set_ylim(LOWEST_DB, 3.0)
        axes.set_xlabel("Time after the direct sound (ms)")
        axes.set_ylabel("Level (dB)")
        axes.set_title(title)
        legend(axes)
    return draw
