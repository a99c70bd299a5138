"""Reading a ledger: a whole one is accepted, an invalid one is refused with the place of its first error."""

from types import SimpleNamespace

import numpy as np
import pytest
from loop_run import make_loop

from roomeq.core.files import read_json, write_json
from roomeq.effects.catalogue import CATALOGUE
from roomeq.effects.source_response import SourceResponse
from roomeq.loop import ledger as ledger_module
from roomeq.loop.heldout_errors import SPLITS
from roomeq.loop.ledger import LEDGER_FILE, count_entries, read_ledger, update_parameters, validate_loop
from roomeq.report import section_loop
from roomeq.show.page_loop import show_loop


@pytest.fixture(scope="module")
def loop(tmp_path_factory):
    """Make a valid loop directory."""
    return make_loop(tmp_path_factory.mktemp("loop") / "loop")


def test_valid_loop_directory_is_accepted(loop):
    assert validate_loop(loop) == len(read_ledger(loop / LEDGER_FILE)["iterations"]) == 2


def without(key):
    """Remove a key."""
    return lambda ledger: ledger.pop(key)


def replace(value, *keys):
    """Replace the value at a path of keys."""
    def change(ledger):
        for key in keys[:-1]:
            ledger = ledger[key]
        ledger[keys[-1]] = value
    return change


@pytest.mark.parametrize("change, message", [
    (without("format"), "format=None must be 9"),  # of an older version
    (replace(1, "format"), "format=1 must be 9"),
    (without("given"), "ledger must hold 'given'"),
    (without("left_out"), "ledger must hold 'left_out'"),
    (replace("", "left_out", 0, "reason"), r"left_out\[0\].reason='' must be a text"),
    (replace(0, "left_out", 0, "rirs"), r"left_out\[0\].rirs=0 must be a positive whole number"),
    (replace(9, "left_out", 0, "rooms"), r"left_out\[0\].rooms=9 must not exceed the number of RIRs"),
    (without("scored_rirs"), "ledger must hold 'scored_rirs'"),
    (replace(4, "scored_rooms"), "scored_rooms=4 must not exceed rooms, 3"),
    (replace(5, "scored_rirs"), "scored_rirs=5 must be two or more for each of scored_rooms, 3"),
    (replace(9, "test", "scored_rirs"), "test.scored_rirs=9 must not exceed test.rirs, 8"),
    (without("geometry"), "ledger must hold 'geometry'"),
    (replace([2.73], "geometry", 0, "posterior"), r"geometry\[0\].posterior=\[2.73\] must be mean and spread"),
    (replace("yes", "geometry", 1, "used"), r"geometry\[1\].used='yes' must be true or false"),
    (replace([3], "test", "left_out"), r"test.left_out\[0\] must be an object"),
    (replace({}, "final"), f"final must hold '{SPLITS[0]}'"),
    (replace("positions", "iterations", 0, "scored_on"),
     r"iterations\[0\].scored_on='positions' must be leave_positions_out or leave_room_out"),
    (replace(2.0, "iterations", 0, "p"), r"iterations\[0\].p=2.0 must be a number in \[0, 1\]"),
    (replace("luck", "ranking", 0, "rejected", "reason"),
     r"ranking\[0\].rejected.reason='luck' must be one of error rises, not in rooms with other devices, no clear fall"),
    (replace(1.5, "ranking", 0, "rejected", "p_other_devices"),
     r"ranking\[0\].rejected.p_other_devices=1.5 must be a number in \[0, 1\]"),
    (replace("no", "ranking", 0, "rejected", "rendered"),
     r"ranking\[0\].rejected.rendered='no' must be true or false"),
    (replace({}, "ranking", 0, "rejected"), r"ranking\[0\].rejected must hold 'p'"),
    (without("ceiling"), "ledger must hold 'ceiling'"),
    (replace([0.8, 0.9], "explained", SPLITS[0], "ci"),
     r"explained.leave_positions_out.ci=\[0.8, 0.9\] must lie around 0.79"),
    (replace(-1.0, "ranking", 1, "detectable_jnd"), r"ranking\[1\].detectable_jnd=-1.0 must be a number in \[0, inf\]"),
    (replace(0.8, "explained", SPLITS[0], "by_metric", "t20"),
     "explained.leave_positions_out.by_metric.t20 must be an object"),
    (replace(["bass"], "explained", SPLITS[0], "at_ceiling"),
     "explained.leave_positions_out.at_ceiling must name metrics of by_metric"),
    (replace(3.3, "baseline", SPLITS[0], "error"),
     "baseline.leave_positions_out.error=3.3 must be the heldout_error_before of its iteration, 3.4")])
def test_invalid_ledger_is_refused_with_the_place_of_its_error(loop, tmp_path, change, message):
    ledger = read_json(loop / LEDGER_FILE)
    change(ledger)
    write_json(tmp_path / LEDGER_FILE, ledger)
    with pytest.raises(ValueError, match=f"{LEDGER_FILE}: {message}: run roomeq close-loop again"):
        read_ledger(tmp_path / LEDGER_FILE)


@pytest.fixture
def partly_scored(loop):
    """Return a ledger of which one room has RIRs of a single place."""
    return read_ledger(loop / LEDGER_FILE) | dict(scored_rirs=20, scored_rooms=2)


def test_errors_stand_beside_the_rirs_and_rooms_that_are_scored(loop, partly_scored):
    whole = read_ledger(loop / LEDGER_FILE)
    assert section_loop.scored(whole) == "" and section_loop.error_rows(whole)[0][1:3] == [24, 3]
    assert section_loop.scored(partly_scored) == ("The errors are of 20 of 24 RIRs in 2 of 3 rooms: the RIRs of each "
                                                  "other room are of a single place.")
    rows = section_loop.error_rows(partly_scored)
    assert rows[0][1:3] == ["20 of 24", "2 of 3"] and rows[2][1:3] == [8, 1]


def test_gains_are_drawn_per_scored_room(partly_scored):
    gain, (low, high) = (partly_scored["ranking"][1][key] for key in ("gain", "ci"))
    panel = section_loop.rankings(partly_scored)[-1]
    assert f"noise_floor {gain / 2:.1f}" in panel.alt and low < gain / 2 < high


def test_show_prints_what_is_scored(loop, partly_scored, tmp_path):
    for ledger, said in ((read_ledger(loop / LEDGER_FILE), False), (partly_scored, True)):
        write_json(tmp_path / LEDGER_FILE, ledger)
        assert ("The errors are of 20 of 24 RIRs" in show_loop(tmp_path, None, None)) is said


def test_counts_of_a_ledger_are_those_of_rooms_with_several_places():
    data = SimpleNamespace(rows=[None] * 7, room=np.array([0, 0, 0, 1, 1, 2, 2]), room_names=["a", "b", "c"],
                           is_scored=np.array([True, False, True]))
    assert count_entries(data) == dict(rirs=7, rooms=3, scored_rirs=5, scored_rooms=2)


def test_parameters_of_effects_in_the_final_model_are_renewed(monkeypatch):
    monkeypatch.setattr(ledger_module, "_parameter_intervals", lambda session, effect: f"final {effect.NAME}")
    iterations = [dict(effect="source_response", parameters="first"), dict(effect="occlusion", parameters="first")]
    update_parameters(iterations, SimpleNamespace(effects=(SourceResponse,)))
    assert [entry["parameters"] for entry in iterations] == ["final source_response", "first"]


def test_responses_of_which_only_the_sum_is_known_name_each_other(monkeypatch):
    monkeypatch.setattr(ledger_module, "_parameter_intervals", lambda session, effect: {})
    names = ("source_response", "mic_response", "occlusion")
    iterations = [dict(effect=name) for name in names]
    update_parameters(iterations, SimpleNamespace(effects=tuple(CATALOGUE[name] for name in names)))
    assert [entry.get("sum_with") for entry in iterations] == ["mic_response", "source_response", None]
