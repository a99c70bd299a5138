"""The sections of a page on an RIR directory."""

import numpy as np

from roomeq.report.figures import Panel, panel
from roomeq.report.formats import number
from roomeq.report.load import Context
from roomeq.show import figures_sets, tables
from roomeq.show.figures_sets import QUANTITIES
from roomeq.show.inputs import RirSet

MAX_LISTED = 300
"""Largest number of RIRs in the list of a page."""


def set_context(of_set: RirSet) -> Context:
    """Return what the template of a set shows."""
    room_columns = [(heading, "text" if n < 2 else "number") for n, heading in enumerate(tables.ROOM_COLUMNS)]
    return {"label": of_set.label, "n_rirs": len(of_set.rows), "left_out": of_set.left_out,
            "distributions": distribution_panels([of_set]), "by_room": room_panels(of_set),
            "frequency_panels": frequency_panels([of_set]), "rooms": tables.room_rows(of_set),
            "room_columns": room_columns, "n_rooms_drawn": min(len(of_set.rooms), figures_sets.MAX_ROOMS),
            "n_rooms": len(of_set.rooms), "rirs": tables.rir_rows(of_set, MAX_LISTED)}


def set_facts(of_set: RirSet) -> list[tuple[str, str]]:
    """Return value and label of the cards at the top of the page."""
    cards = [(f"{len(of_set.rows):,}", f"RIRs of {len(of_set.rooms):,} rooms")]
    for ident, label, value in QUANTITIES:
        values = figures_sets.known(map(value, of_set.parameters))
        if len(values):
            middle, low, high = (number(float(value), 2 if ident == "t60" else 1)
                                 for value in (np.median(values), values.min(), values.max()))
            name, _, unit = label.rstrip(")").rpartition(" (")
            cards.append((f"{middle} {unit}", f"median {name} ({low} to {high} {unit})"))
    return cards


def distribution_panels(sets: list[RirSet]) -> list[Panel]:
    """Draw the histogram of each quantity."""
    panels = []
    for quantity in QUANTITIES:
        ident, label, value = quantity
        medians = [f"{name} {number(tables.middle(map(value, of_set.parameters)), 2)}"
                   for name, of_set in zip(figures_sets.labels_of(sets), sets, strict=True)]
        panels.append(panel(f"figure-distribution-{ident}", figures_sets.distribution(sets, quantity),
                            f"Histogram of {label}; medians: {', '.join(medians)}"))
    return panels


def room_panels(of_set: RirSet) -> list[Panel]:
    """Draw each quantity by room."""
    size_in = 4.4, figures_sets.by_room_height_in(of_set)
    return [panel(f"figure-rooms-{ident}", figures_sets.by_room(of_set, (ident, label, value)),
                  f"{label} of each RIR by room", size_in) for ident, label, value in QUANTITIES]


def frequency_panels(sets: list[RirSet]) -> list[Panel]:
    """Draw reverberation time and EQ over frequency."""
    names = " and ".join(figures_sets.labels_of(sets))
    metrics = [("t60", "Reverberation time (s)"), ("eq", "EQ (dB, 1 kHz = 0)")]
    return [panel(f"figure-over-frequency-{metric}", figures_sets.over_frequency(sets, metric, label),
                  f"{label} of {names} over frequency")
            for metric, label in metrics if all("eq_db" in of_set.parameters[0] for of_set in sets) or metric != "eq"]
