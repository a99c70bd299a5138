"""The panels of the report's chapter on word error rates."""

import numpy as np

from roomeq.report.figures import Draw, legend


def rates(rows: list[str], sets: list[tuple[str, str, str, list[float], list]]) -> Draw:
    """Draw word error rates with their intervals.

    Parameters
    ----------
    sets : list of (label, colour name, marker, rates, intervals)
        Rates [%] in the order of the rows; an interval is None where there is none.
    """
    def draw(axes, colours):
        for n, (name, colour, marker, values, intervals) in enumerate(sets):
            y = np.arange(len(rows)) + 0.22 * (n - (len(sets) - 1) / 2)
            for place, interval in zip(y, intervals, strict=True):
                if interval is not None:
                    axes.hlines(place, *interval, color=colours[colour], lw=1.6, alpha=0.75)
            axes.plot(values, y, marker, color=colours[colour], ms=5.5, label=name)
        axes.set_yticks(range(len(rows)), rows)
        axes.set_ylim(len(rows) - 0.5, -0.5)
        axes.grid(False, axis="y")
        axes.set_xlabel("Word error rate (%)")
        legend(axes)
    return draw


def rooms(title: str, points: np.ndarray, mean: float, interval: list[float] | None, limit: float) -> Draw:
    """Draw a dot for each room, sorted, with the difference over all of them and its interval.

    Parameters
    ----------
    points : ndarray, shape (n_rooms,)
        Difference of word error rates [points].
    limit : float
        End of the vertical axis on either side, the same in panels to be compared.
    """
    def draw(axes, colours):
        if interval is not None:
            axes.axhspan(*interval, color=colours["compensated"], alpha=0.18, lw=0)
        axes.axhline(mean, color=colours["compensated"], lw=1.3, label="all rooms, 95 %")
        axes.axhline(0.0, color=colours["soft"], lw=0.9)
        axes.plot(np.arange(1, len(points) + 1), np.sort(points), "o", color=colours["ink"], ms=3.5, label="a room")
        axes.set_ylim(-limit, limit)
        axes.set_xlim(0, len(points) + 1)
        axes.grid(False, axis="x")
        axes.set_xlabel("Rooms, sorted")
        axes.set_ylabel("Difference of WER (points)")
        axes.set_title(title)
        legend(axes)
    return draw
