"""Figure panels of a room: plan and section with source, microphones and first reflections."""

from typing import TYPE_CHECKING

import numpy as np

from roomeq.core.arrays import FloatArray
from roomeq.report.figures import Draw, legend
from roomeq.report.room_map import RoomMap

if TYPE_CHECKING:
    from matplotlib.axes import Axes

VIEWS = {"plan": (0, 1), "section": (0, 2)}
"""Axes of each view: the plan from above, and the section seen from the south."""
_AXIS_LABELS = ("x, length (m)", "y, width (m)", "z, height (m)")
_MARGIN = 0.06
_ARROW = 0.1  # length of the arrow of a direction, as a share of the room's


def room_view(room: RoomMap, view: str, title: str | None = None) -> Draw:
    """Draw the plan or the section of a room, with the name of the view or another title."""
    across, up = VIEWS[view]

    def draw(axes: "Axes", colours: dict[str, str]) -> None:
        from matplotlib.collections import LineCollection

        axes.add_collection(LineCollection(list(room.edges_m[:, :, (across, up)]), colors=colours["ink"],
                                           linewidths=1.4 if len(room.edges_m) < 40 else 0.6))
        for number, reflection in enumerate(room.reflections):
            axes.plot(*reflection.points_m[:, (across, up)].T, color=colours["extra"], lw=0.9,
                      label="first reflections" if number == 0 else None)
        others = {"source": room.sources_m, "mic": room.mics_m}
        for kind, marker in (("source", "s"), ("mic", "o")):
            points = np.array([position_m[[across, up]] for position_m in others[kind]]).reshape(-1, 2)
            if len(points) > 1:
                axes.plot(*points.T, marker, color=colours["soft"], ms=4, mfc="none", mew=0.8, lw=0,
                          label=f"other {'sources' if kind == 'source' else 'microphones'}")
        _mark(axes, room.source_m[[across, up]], "s", colours["simulated"], "source")
        _mark(axes, room.mic_m[[across, up]], "o", colours["measured"], "microphone")
        ends = np.array([room.source_m, room.mic_m])[:, (across, up)]
        if np.isfinite(ends).all():
            axes.plot(*ends.T, color=colours["measured"], lw=1.2, label="direct sound", zorder=1.5)
        _set_limits(axes, room.edges_m[:, :, (across, up)].reshape(-1, 2))
        if room.source_dir is not None and np.isfinite(ends[0]).all():
            arrow = _ARROW * np.ptp(room.edges_m.reshape(-1, 3), axis=0).max() * room.source_dir[[across, up]]
            axes.annotate("", ends[0] + arrow, ends[0],
                          arrowprops=dict(arrowstyle="->", color=colours["simulated"], lw=1.5))
        axes.set_aspect("equal")
        axes.set_xlabel(_AXIS_LABELS[across])
        axes.set_ylabel(_AXIS_LABELS[up])
        axes.set_title(title or view.capitalize())
        legend(axes)
    return draw


def _mark(axes: "Axes", position_m: FloatArray, marker: str, colour: str, label: str) -> None:
    """Mark a position whose coordinates are known."""
    if np.isfinite(position_m).all():
        axes.plot(*position_m, marker, color=colour, ms=7, label=label, lw=0)


def _set_limits(axes: "Axes", points: FloatArray) -> None:
    low, high = points.min(axis=0), points.max(axis=0)
    margin = _MARGIN * float((high - low).max())
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(low[1] - margin, high[1] + margin)
