"""Figure panels of one or two sets of RIRs: distributions, values by room, and parameters over frequency."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from roomeq.core.arrays import FloatArray
from roomeq.records.parameters import reverberation_time_s, value_of
from roomeq.report import figures
from roomeq.report.figures import Draw, legend, log_frequency
from roomeq.report.rir_sets import column_percentiles, without_rare
from roomeq.show.inputs import RirSet
from roomeq.show.sheet import plot_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = ("measured", "simulated")
MAX_ROOMS = 24
"""Largest number of rooms in a panel: those with the most RIRs are drawn."""
_N_BINS = 16
_LABEL_CHARACTERS = 22

Quantity = tuple[str, str, Callable[[dict[str, Any]], float | None]]
QUANTITIES: tuple[Quantity, ...] = (
    ("t60", "Reverberation time at 1 kHz (s)", reverberation_time_s),
    ("drr", "DRR (dB)", lambda parameters: parameters.get("drr_db")),
    ("c50", "C50 at 1 kHz (dB)", lambda parameters: value_of(parameters, "c50")))
"""Id, label and function of each quantity of a distribution."""


def distribution(sets: Sequence[RirSet], quantity: Quantity) -> Draw:
    """Draw the histogram of a quantity over the RIRs of each set."""
    _, label, value = quantity
    groups = [(plot_text(name), colour, known(map(value, of_set.parameters)))
              for name, of_set, colour in zip(labels_of(sets), sets, COLOURS, strict=False)]
    every = np.concatenate([values for *_, values in groups])
    low, high = (float(every.min()), float(every.max())) if len(every) else (0.0, 1.0)
    edges = np.linspace(low, high if high > low else low + 1.0, _N_BINS + 1)
    return figures.histogram("", groups, edges, label)


def by_room(of_set: RirSet, quantity: Quantity) -> Draw:
    """Draw a quantity of each RIR by room, and the median of each room; the rooms with the most RIRs."""
    _, label, value = quantity
    largest = sorted(of_set.rooms.items(), key=lambda item: (-len(item[1]), item[0]))[:MAX_ROOMS]
    values = {room: known(value(of_set.parameters[n]) for n in numbers) for room, numbers in largest}
    ordered = sorted((room for room in values if len(values[room])), key=lambda room: float(np.median(values[room])))

    def draw(axes: "Axes", colours: dict[str, str]) -> None:
        for y, room in enumerate(ordered):
            axes.plot(values[room], np.full(len(values[room]), y), "o", color=colours["measured"], ms=3.5, mew=0,
                      alpha=0.45, label="RIR" if y == 0 else None)
            axes.plot(np.median(values[room]), y, "|", color=colours["ink"], ms=10, mew=1.6,
                      label="median of the room" if y == 0 else None)
        axes.set_yticks(range(len(ordered)), [_shortened(room) for room in ordered], fontsize=7)
        axes.set_ylim(-0.7, len(ordered) - 0.3)
        axes.grid(False, axis="y")
        axes.set_xlabel(label)
        legend(axes)
    return draw


def by_room_height_in(of_set: RirSet) -> float:
    """Return the height of a panel of `by_room` [inches]."""
    return 1.3 + 0.2 * min(len(of_set.rooms), MAX_ROOMS)


def over_frequency(sets: Sequence[RirSet], metric: str, label: str) -> Draw:
    """Draw median and range of the middle 90 % of a parameter per octave band; T60 is T30, or T20 where it is invalid.

    A band in which less than half of the RIRs have a valid value is left out: those that have one are no fair sample.

    Parameters
    ----------
    metric : str
        ``"t60"``, ``"c50"`` or ``"eq"``.
    label : str
        Label of the vertical axis, with its unit.
    """
    def draw(axes: "Axes", colours: dict[str, str]) -> None:
        every = [band_values(of_set, metric) for of_set in sets]
        for name, values, colour in zip(labels_of(sets), every, COLOURS, strict=False):
            bands_hz = list(figures.TICKS)[:values.shape[1]]
            low, middle, high = column_percentiles(without_rare(values), (5, 50, 95))
            axes.fill_between(bands_hz, low, high, color=colours[colour], alpha=0.2, lw=0)
            axes.plot(bands_hz, middle, f"{figures.MARKERS[colour]}-", color=colours[colour], ms=4.5,
                      label=plot_text(name))
        n_bands = max(values.shape[1] for values in every)
        log_frequency(axes, 45.0, 18000.0 if n_bands > 8 else 8600.0)
        axes.set_ylabel(label)
        if metric == "t60":
            axes.set_ylim(bottom=0.0)
        if len(sets) > 1:
            legend(axes)
    return draw


def band_values(of_set: RirSet, metric: str) -> FloatArray:
    """Return the values of a parameter per octave band; NaN where invalid, shape (n_rirs, n_bands)."""
    n_bands = max(len(parameters["t20_s"]) for parameters in of_set.parameters)

    def value(parameters: dict[str, Any], band: int) -> float:
        found = (reverberation_time_s(parameters, band) if metric == "t60" else value_of(parameters, metric, band))
        return np.nan if found is None else found

    return np.array([[value(parameters, band) for band in range(n_bands)] for parameters in of_set.parameters])


def labels_of(sets: Sequence[RirSet]) -> list[str]:
    """Return the labels of sets; those of two directories of one name begin with A and B."""
    labels = [of_set.label for of_set in sets]
    if len(set(labels)) < len(labels):
        labels = [f"{letter}: {label}" for letter, label in zip("AB", labels, strict=True)]
    return labels


def known(values: Any) -> FloatArray:
    """Return the values that are not None."""
    return np.array([value for value in values if value is not None], dtype=np.float64)


def _shortened(room: str) -> str:
    return room if len(room) <= _LABEL_CHARACTERS else f"{room[:9]}…{room[-(_LABEL_CHARACTERS - 10):]}"
