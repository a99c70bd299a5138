"""The explained share of the explainable error: its value, its interval, and where nothing is left to explain."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from roomeq.loop import close
from roomeq.loop.ceiling import MIN_EXPLAINABLE_JND, _moved, describe_explained, explained
from roomeq.loop.features import METRIC, N_FEATURES
from roomeq.loop.heldout_errors import SPLITS, HeldOutErrors
from roomeq.sim.geometry import Place
from roomeq.sim.scene import Shoebox


def errors(of_rooms, scored=None):
    """Return errors of rooms of two RIRs, the same of all features."""
    room = np.repeat(np.arange(len(of_rooms)), 2)
    values = np.repeat(of_rooms, 2)[:, None] * np.ones(N_FEATURES)
    values = values if scored is None else np.where(scored, values, np.nan)
    return HeldOutErrors(dict.fromkeys(SPLITS, values), room, np.tile([0, 1], len(of_rooms)))


def test_share_is_the_fall_relative_to_what_can_fall():
    entry = explained(errors([4.0, 4.2, 3.8]), errors([2.0, 2.1, 1.9]), errors([1.0, 1.1, 0.9]))[SPLITS[0]]
    assert entry["share"] == pytest.approx(2.0 / 3.0)
    low, high = entry["ci"]
    assert 0.55 < low < 2.0 / 3.0 < high < 0.8
    alike = dict(share=pytest.approx(2.0 / 3.0), ci=pytest.approx([low, high]))
    assert entry["by_metric"] == dict.fromkeys(METRIC, alike) and entry["by_band"] == [alike] * 8
    assert entry["at_ceiling"] == []
    assert describe_explained(entry).startswith("67 % [")


def test_metrics_whose_error_rises_are_logged(caplog):
    before, after = errors([4.0, 4.2, 3.8]), errors([2.0, 2.1, 1.9])
    for values in after.by_split.values():
        values[:, METRIC == "t20"] = 4.5
    with caplog.at_level("INFO", "roomeq"):
        close._log_rises("final model", before, after)
    assert [record.getMessage() for record in caplog.records] == [
        f"final model: the held-out error of some metrics rises: t20 4.00 -> 4.50 JND ({split.replace('_', '-')})"
        for split in SPLITS]


def test_interval_covers_the_share_of_the_population():
    rng, hits = np.random.default_rng(0), 0
    for _ in range(300):
        left = 2.0 + 0.4 * rng.standard_normal(8)  # explainable error of each room
        fallen = 0.7 * left + 0.3 * rng.standard_normal(8)
        low, high = explained(errors(1.0 + left), errors(1.0 + left - fallen), errors(np.ones(8)))[SPLITS[0]]["ci"]
        hits += low < 0.7 < high
    assert hits / 300 == pytest.approx(0.95, abs=0.04)


def test_nothing_is_left_to_explain_near_the_ceiling():
    entry = explained(errors([1.2, 1.3, 1.1]), errors([1.2, 1.3, 1.1]), errors([1.0, 1.1, 0.9]))[SPLITS[0]]
    assert entry["share"] is None and entry["ci"] is None
    nothing = dict(share=None, ci=None)
    assert entry["by_metric"] == dict.fromkeys(METRIC, nothing) and entry["by_band"] == [nothing] * 8
    assert entry["at_ceiling"] == list(dict.fromkeys(METRIC)) and MIN_EXPLAINABLE_JND > 0.2
    assert describe_explained(entry) == "nothing left to explain"


def test_shares_and_intervals_of_a_metric_are_those_of_the_rooms_that_have_it():
    before, after, ceiling = (errors(of_rooms) for of_rooms in ([4.0, 4.2, 3.8, 4.4], [2.0, 2.1, 1.9, 2.4], [1.0] * 4))
    after.by_split[SPLITS[0]][:, METRIC == "t20"] += np.repeat([0.5, 0.0, 1.0, 0.0], 2)[:, None]
    before.by_split[SPLITS[0]][:4, METRIC == "c50"] = np.nan
    entry = explained(before, after, ceiling)[SPLITS[0]]["by_metric"]
    assert entry["t20"]["share"] == pytest.approx((2.0 + 2.1 + 1.9 + 2.0 - 1.5) / (3.0 + 3.2 + 2.8 + 3.4))
    assert np.ptp(entry["t20"]["ci"]) > np.ptp(entry["t30"]["ci"])
    assert entry["c50"] == dict(share=pytest.approx((1.9 + 2.0) / (2.8 + 3.4)), ci=None)  # two rooms


def test_two_rooms_have_a_share_without_interval():
    entry = explained(errors([4.0, 4.0]), errors([2.0, 3.0]), errors([1.0, 1.0]))[SPLITS[0]]
    assert entry["share"] == pytest.approx(0.5) and entry["ci"] is None
    assert describe_explained(entry) == "50 % of the explainable error"


def test_features_without_a_ceiling_take_no_part():
    scored = METRIC != "ahead"
    after = errors([2.0, 2.0, 2.0])
    for of_split in after.by_split.values():
        of_split[:, ~scored] = 20.0
    entry = explained(errors([4.0, 4.0, 4.0]), after, errors([1.0, 1.0, 1.0], scored))[SPLITS[0]]
    assert entry["share"] == pytest.approx(2.0 / 3.0) and "ahead" not in entry["by_metric"]


def test_twin_of_a_near_microphone_is_no_nearer_than_the_simulator_allows():
    place = Place(Shoebox((6.0, 5.0, 3.0)), (2.0, 2.0, 1.5), (2.05, 2.0, 1.5), ())
    data = SimpleNamespace(places=[place], rows=[dict(id="r")])
    moved = {_moved(data, 0, seed) for seed in range(50)}
    assert len(moved) == 50 and min(math.dist(position, place.source_pos_m) for position in moved) >= 0.05
