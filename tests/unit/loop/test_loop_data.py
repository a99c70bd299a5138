"""Data of the loop: places of sources, and devices that are the same."""

from itertools import permutations
from types import SimpleNamespace

import numpy as np
from plans import L_PLAN, prism_obj
from rirmaker import coloured_rir, write_rir_dir

from roomeq.loop.data import SAME_PLACE_M, Data, _merge_sources, _Recording, load_data
from roomeq.loop.features import METRIC
from roomeq.loop.usable import usable_rirs
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


def test_direct_sound_of_a_hidden_source_is_not_scored(tmp_path):
    """Tables of rays have no direct sound there: its level would be that of nothing."""
    (tmp_path / "l.obj").write_text(prism_obj(L_PLAN, 3.0))
    rows = [dict(id=name, wav=f"{name}.wav", room_id="l", source_id="s", mic_id="m", mesh="../l.obj",
                 source_pos_m=[5.0, 1.0, 1.5], mic_pos_m=mic_m) for name, mic_m in
            (("free", [1.5, 1.2, 1.3]), ("hidden", [1.0, 5.0, 1.3]))]
    where = write_rir_dir(tmp_path / "rirs", [(row, coloured_rir(n)) for n, row in enumerate(rows)])
    data = load_data(usable_rirs([where]), scattering=0.3, seed=0)
    shows_direct = np.isin(METRIC, ("direct", "drr"))
    assert [row["id"] for row in data.rows] == ["free", "hidden"]
    assert data.valid[0, shows_direct].any() and not data.valid[1, shows_direct].any()
    assert data.valid[1, METRIC == "c50"].any()
