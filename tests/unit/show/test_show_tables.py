"""Differences in JND, pairs of sets, and tables of text."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from rirmaker import coloured_rir, row

from roomeq.acoustics.parameters import measure
from roomeq.show import tables
from roomeq.show.figures_rir import label_lines
from roomeq.show.figures_sets import COLOURS, over_frequency
from roomeq.show.inputs import RirSet
from roomeq.show.page_compare import change_text, median_rows, pair_rirs, paired_rows, typical_pair

PARAMETERS = measure(coloured_rir(0))


def set_of(*rows, parameters=PARAMETERS):
    return RirSet(Path("set"), list(rows), [parameters] * len(rows), [])


@pytest.mark.parametrize("metric, first, second, jnd", [
    ("t30", 1.0, 1.05, 1.0), ("edt", 1.05, 1.0, -1.0), ("c50", 3.0, 5.2, 2.0), ("drr", 0.0, -4.0, -2.0),
    ("eq", -1.0, 2.0, 3.0)])
def test_difference_is_in_units_of_the_jnd(metric, first, second, jnd):
    assert tables.difference_jnd(metric, first, second) == pytest.approx(jnd)
    assert np.isnan(tables.difference_jnd(metric, None, second))


def test_equal_parameters_differ_by_nothing():
    for values in tables.differences_jnd(PARAMETERS, PARAMETERS, 8).values():
        assert set(values[np.isfinite(values)]) <= {0.0}


@pytest.mark.parametrize("value, text", [(0.04, "0.0"), (-0.04, "0.0"), (1.26, "+1.3"), (-1.26, "−1.3"), (None, "–"),
                                         (float("nan"), "–")])
def test_signed_numbers(value, text):
    assert tables.signed(value) == text


def test_change_shows_both_values_and_the_difference():
    assert change_text(0.50, 0.525, "t30") == "0.50 → 0.53 (+1.0)"
    assert change_text(None, 0.5, "t30") == "– → 0.50" and change_text(None, None, "t30") == "–"


def test_columns_of_text_are_aligned():
    text = tables.as_text(["a", "bb"], [["long", "1"], ["x", "10"]])
    assert text.splitlines() == ["a     bb", "long   1", "x     10"]


@pytest.mark.parametrize("first, second, pairs", [
    ([row("a"), row("b")], [row("b"), row("c")], [(1, 0)]),
    ([row("a"), row("b")], [row("a-sim", measured_id="a"), row("b-sim", measured_id="b")], [(0, 0), (1, 1)]),
    ([row("a-sim", measured_id="a")], [row("a")], [(0, 0)]),
    ([row("a-sim", measured_id="a")], [row("a-loop", measured_id="a")], [(0, 0)]),
    ([row("a")], [row("z")], [])])
def test_rirs_are_paired_by_id_or_measured_id(first, second, pairs):
    assert pair_rirs(set_of(*first), set_of(*second)).numbers == pairs


def test_pairs_of_equal_rirs_have_no_differences():
    pairs = pair_rirs(set_of(row("a"), row("b")), set_of(row("a"), row("b")))
    assert {cell for cells in paired_rows(pairs) for cell in cells[1:]} <= {"0.0 (0.0)", "–"}
    assert typical_pair(pairs) == 0


def test_medians_of_few_valid_values_are_left_out():
    invalid = PARAMETERS | dict(t30_valid=[False] * 8)
    mixed = RirSet(Path("set"), [row(name) for name in "abc"], [PARAMETERS, invalid, invalid], [])
    (cells, *_), (full, *_) = (list(zip(*median_rows(of_set, of_set), strict=True))[3:] for of_set in (
        mixed, set_of(row("a"))))
    assert set(cells) == {"–"} and set(full) != {"–"}


def test_figure_over_frequency_shows_all_bands_of_both_sets():
    wide = {key: [*value, value[-1]] if isinstance(value, list) else value for key, value in PARAMETERS.items()}
    sets = [set_of(row("a"), parameters=wide), set_of(row("a"))]
    for ordered in (sets, sets[::-1]):
        axes = Figure().subplots()
        over_frequency(ordered, "c50", "C50 (dB)")(axes, dict.fromkeys(COLOURS, "k"))
        assert axes.get_xlim()[1] > 16000.0


def test_figure_over_frequency_omits_bands_of_which_few_are_valid():
    """At low frequencies, a decay time is valid if it is long."""
    invalid = PARAMETERS | dict(t20_valid=[False, *PARAMETERS["t20_valid"][1:]], t30_valid=[False] * 8)
    few = RirSet(Path("set"), [row(name) for name in "abc"], [PARAMETERS, invalid, invalid], [])
    axes = Figure().subplots()
    over_frequency([few], "t60", "Reverberation time (s)")(axes, dict.fromkeys(COLOURS, "k"))
    drawn = np.isfinite(axes.lines[0].get_ydata())
    assert not drawn[0] and drawn[3:].all()


def test_labels_of_reflections_do_not_overlap():
    assert label_lines([3.0, 4.0, 5.0, 20.0, 20.5, 40.0]) == [0, 1, 2, 0, 1, 0]
