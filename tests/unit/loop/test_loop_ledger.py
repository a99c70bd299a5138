"""Reading a ledger: a whole one is accepted, an invalid one is refused with the place of its first error."""

from types import SimpleNamespace

import pytest
from loop_run import make_loop

from roomeq.core.files import read_json, write_json
from roomeq.effects.catalogue import CATALOGUE
from roomeq.effects.source_response import SourceResponse
from roomeq.loop import ledger as ledger_module
from roomeq.loop.ledger import LEDGER_FILE, read_ledger, update_parameters, validate_loop
from roomeq.loop.selection import SPLITS


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
    (without("format"), "format=None must be 7"),  # of an older version
    (replace(1, "format"), "format=1 must be 7"),
    (without("given"), "ledger must hold 'given'"),
    (without("left_out"), "ledger must hold 'left_out'"),
    (replace("", "left_out", 0, "reason"), r"left_out\[0\].reason='' must be a text"),
    (replace(0, "left_out", 0, "rirs"), r"left_out\[0\].rirs=0 must be a positive whole number"),
    (replace(9, "left_out", 0, "rooms"), r"left_out\[0\].rooms=9 must not exceed the number of RIRs"),
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
