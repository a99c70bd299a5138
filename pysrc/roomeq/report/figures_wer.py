"""Figure panels of the section on word error rates."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from roomeq.core.arrays import FloatArray
from roomeq.report.figures import Draw, legend

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class Rates:
    """Word error rates of one evaluation set.

    Parameters
    ----------
    label, colour, marker : str
        Legend entry, name of the colour and matplotlib's marker.
    values : list of float
        Rates in the order of the rows [%].
    intervals : list
        Lower and upper limits of each rate [%], or None.
    """

    label: str
    colour: str
    marker: str
    values: list[float]
    intervals: list[tuple[float, float] | None]


def rates(rows: list[str], sets: list[Rates]) -> Draw:
    """Draw word error rates with their intervals."""
    def draw(axes: "Axes", colours: dict[str, str]) -> None:
        for n, group in enumerate(sets):
            y = np.arange(len(rows)) + 0.22 * (n - (len(sets) - 1) / 2)
            for position, interval in zip(y, group.intervals, strict=True):
                if interval is not None:
                    axes.hlines(position, *interval, color=colours[group.colour], lw=1.6, alpha=0.75)
            axes.plot(group.values, y, group.marker, color=colours[group.colour], ms=5.5, label=group.label)
        axes.set_yticks(range(len(rows)), rows)
        axes.set_ylim(len(rows) - 0.5, -0.5)
        axes.grid(False, axis="y")
        axes.set_xlabel("Word error rate (%)")
        legend(axes)
    return draw


def rooms(title: str, points: FloatArray, mean: float, interval: tuple[float, float] | None, limit: float) -> Draw:
    """Draw a dot for each room, in ascending order, with the difference over all rooms and its interval.

    Parameters
    ----------
    points : ndarray, shape (n_rooms,)
        Differences of word error rates [percentage points].
    mean : float
        Difference over all rooms.
    limit : float
        The vertical axis extends from ``-limit`` to `limit`, the same in panels to be compared.
    """
    def draw(axes: "Axes", colours: dict[str, str]) -> None:
        if interval is not None:
            axes.axhspan(*interval, color=colours["compensated"], alpha=0.18, lw=0)
        axes.axhline(mean, color=colours["compensated"], lw=1.3, label="all rooms, 95 %")
        axes.axhline(0.0, color=colours["soft"], lw=0.9)
        axes.plot(np.arange(1, len(points) + 1), np.sort(points), "o", color=colours["ink"], ms=3.5, label="one room")
        axes.set_ylim(-limit, limit)
        axes.set_xlim(0, len(points) + 1)
        axes.grid(False, axis="x")
        axes.set_xlabel("Rooms in ascending order")
        axes.set_ylabel("Difference of WER (points)")
        axes.set_title(title)
        legend(axes)
    return draw
