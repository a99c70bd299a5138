"""Rates of the loop's bench: which sets count as found, not told apart, misnamed."""

import os

import pytest

from bench.loop.run import RoomSet, in_own_process, key, planned_sets, run_set, run_sets
from bench.loop.table import by_base, rates, show


def result(kind="occlusion", seed=1, added=("occlusion",), rivals=(), **more):
    """Return the result of one set of rooms at 2 JND."""
    clean = kind == "clean"
    return dict(base="testbed", kind=kind, strength=0 if clean else 2, seed=seed,
                achieved_jnd={} if clean else {kind: 2.0}, rings_hz=[], added=list(added),
                cannot_tell=[list(rivals)] + [[]] * (len(added) - 1) if added else [], before=1.0 if clean else 2.0,
                after=1.0, test_after=1.0, unexplained=[], seconds=10.0) | more


def found(results):
    return {rate.name: (rate.hits, rate.count) for rate in rates(results)}


FIRST = "true effect added first, achieved 1.8 JND or more"
AMONG = "first find cannot be told from others, true effect among them"
MISNAMED = "another effect added first"
SECOND = "second effect added that is not there"


@pytest.mark.parametrize(("added", "rivals", "expected"), [
    (("occlusion",), (), dict(first=1, among=0, misnamed=0, second=0)),
    (("occlusion", "room_eq"), (), dict(first=1, among=0, misnamed=0, second=1)),
    (("occlusion",), ("occlusion", "mic_response"), dict(first=1, among=1, misnamed=0, second=0)),
    (("mic_response",), ("mic_response", "occlusion"), dict(first=0, among=1, misnamed=0, second=0)),
    (("mic_response", "occlusion"), (), dict(first=0, among=0, misnamed=1, second=0)),
    ((), (), dict(first=0, among=0, misnamed=0, second=0)),
])
def test_a_find_is_right_or_not_told_apart_or_misnamed(added, rivals, expected):
    counts = found([result(added=added, rivals=rivals)])
    assert {name: counts[key][0] for name, key in
            dict(first=FIRST, among=AMONG, misnamed=MISNAMED, second=SECOND).items()} == expected
    assert counts[FIRST][1] == counts[MISNAMED][1] == 1
    assert counts[SECOND][1] == expected["first"]


@pytest.mark.parametrize(("added", "detectable_jnd", "stated"), [
    (("occlusion",), {}, True), ((), dict(occlusion=1.2), True), ((), dict(occlusion=None), True),
    ((), dict(occlusion=0.8), False), ((), {}, False)])
def test_what_is_stated_to_be_too_small_is_no_miss(added, detectable_jnd, stated):
    weak = result(added=added, achieved_jnd=dict(occlusion=1.0), detectable_jnd=detectable_jnd)
    name = "the same, or too small to be found by the ledger's statement"
    assert found([weak])[name] == (stated, 1)
    pair = result("occlusion+air_absorption", added=[*added, "air_absorption"], detectable_jnd=detectable_jnd,
                  achieved_jnd=dict(occlusion=1.0, air_absorption=1.0))
    assert found([pair])["both added, or too small to be found by the ledger's statement"] == (stated, 1)


def test_half_of_the_added_error_is_judged_by_the_clean_set_of_the_seed():
    clean = [result("clean", seed=seed, added=()) for seed in (1, 2)]
    counts = found([*clean, result(seed=1, after=1.4), result(seed=2, after=1.6), result(seed=3)])
    assert counts["half of the effect's error removed"] == (1, 2)
    assert counts["effect added to clean rooms"] == (0, 2)


def test_bases_are_shown_apart_with_their_own_goals(capsys):
    old = result()
    del old["base"]  # of before there was a second one
    results = [result(base="pyroomacoustics", added=()), old]
    assert {base: len(these) for base, these in by_base(results).items()} == {"testbed": 1, "pyroomacoustics": 1}
    show(results)
    first, second = capsys.readouterr().out.split("Rooms simulated by: pyroomacoustics")
    assert f"{FIRST}: 1 of 1, 100 % [20.65, 100] (goal >= 95 %)" in first
    assert f"{FIRST}: 0 of 1, 0 % [0, 79.35] (goal >= 85 %)" in second


def test_sets_whose_rows_do_not_state_facings_are_apart():
    unknown = result(base="pyroomacoustics", facings_stated=False)
    assert list(by_base([result(), unknown])) == ["testbed", "pyroomacoustics, facings not stated"]
    (rooms,) = planned_sets("pyroomacoustics", ["occlusion"], [2], seeds=1, clean=0, facings_stated=False)
    assert not rooms.facings_stated and key(unknown) == rooms._replace(seed=1)


def test_sets_run_alone_are_those_that_are_timed():
    name = "within 60 s of wall time, two jobs"
    assert found([result(), result(seed=2, nj=1), result(seed=3, nj=2, seconds=70.0)])[name] == (1, 2)


def test_sets_are_planned_by_base_with_as_many_clean_ones_as_asked():
    sets = list(planned_sets("pyroomacoustics", ["clean", "occlusion"], [1, 2], seeds=1, clean=2))
    assert [(rooms.kind, rooms.strength, rooms.seed) for rooms in sets] == [
        ("clean", 0, 101), ("occlusion", 2, 101), ("occlusion", 1, 101), ("clean", 0, 102)]
    assert {rooms.base for rooms in sets} == {"pyroomacoustics"}


def test_nothing_runs_where_nothing_is_missing(tmp_path):
    assert list(run_sets(iter(()), tmp_path, [], jobs=2)) == []


def test_a_set_sees_earlier_results_of_its_base_kind_and_seed(tmp_path, monkeypatch):
    monkeypatch.setattr("bench.loop.run.in_own_process", lambda function, rooms, cache, earlier, nj: dict(
        function=function, strength=rooms.strength, earlier=len(earlier), nj=nj))
    sets = [RoomSet("testbed", "occlusion", strength, 101) for strength in (2, 1, 4)]
    results = [result(seed=101), result(seed=102), result("clean", seed=101, added=()),
               result(seed=101, base="pyroomacoustics"), result(seed=101, facings_stated=False)]
    told = list(run_sets(iter(sets), tmp_path, results, jobs=2))
    assert sorted(one["strength"] for one in told) == [1, 2, 4]
    assert {(one["function"], one["nj"], one["earlier"]) for one in told} == {(run_set, 1, 1)}
    assert next(run_sets(iter(sets), tmp_path, results, jobs=1))["nj"] == 2


def test_no_two_sets_share_a_process():
    assert len({os.getpid(), in_own_process(os.getpid), in_own_process(os.getpid)}) == 3
