"""Data of the loop: places of sources, and devices that are the same."""

from itertools import permutations
from types import SimpleNamespace

import numpy as np

from roomeq.loop.data import SAME_PLACE_M, Data, _merge_sources, _Recording
from roomeq.sim.geometry import Place
from roomeq.sim.scene import Shoebox


def test_merged_places_of_a_source_depend_on_no_order():
    room = Shoebox((6.0, 5.0, 3.0))
    at_m = {0.0: 2.0, 0.1: 2.1, 0.2: 2.2, 1.0: 3.0}
    found = set()
    for order in permutations(at_m):
        recordings = [_Recording(None, dict(room_id="r", source_id="s"),
                                 Place(room, (at_m[n], 1.0, 1.0), (5.0, 4.0, 1.0), ())) for n in order]
        merged = {n: recording.place.source_pos_m[0] for n, recording in zip(order, _merge_sources(recordings),
                                                                             strict=True)}
        assert all(abs(merged[n] - at_m[n]) <= SAME_PLACE_M / 2.0 for n in at_m)
        found.add(tuple(np.round([merged[n] for n in at_m], 9)))
    assert len(found) == 1


def test_devices_without_a_name_are_one_within_a_corpus():
    rows = [dict(source_id=source, corpus=corpus) for source, corpus in (
        ("unknown", "a"), ("unknown", "a"), ("unknown", "b"), ("genelec", "a"), ("genelec", "b"))]
    names, number = Data.units(SimpleNamespace(rows=rows), "source")
    assert names == ["genelec", "unknown of a", "unknown of b"]
    assert number.tolist() == [1, 1, 2, 0, 0]
