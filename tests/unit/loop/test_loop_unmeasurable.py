"""Recordings of which nothing can be measured: they are refused or left out before the loop, and no error is NaN."""

from types import SimpleNamespace

import numpy as np
import pytest
from loop_run import make_loop

from roomeq.core.files import read_json, write_json
from roomeq.loop.close import _require_errors, _with_errors
from roomeq.loop.features import N_FEATURES, SCORED
from roomeq.loop.heldout_errors import SPLITS, HeldOutErrors, measurable_rooms
from roomeq.loop.ledger import LEDGER_FILE, error_entry, read_ledger
from roomeq.report.section_loop import error_rows


def rooms(*measured, features=SCORED, is_scored=None):
    """Two RIRs in each of some rooms, of which all features are valid in the measured ones."""
    room = np.repeat(np.arange(len(measured)), 2)
    valid = np.array(measured)[room][:, None] & features
    is_scored = np.full(len(measured), True) if is_scored is None else np.array(is_scored)
    return SimpleNamespace(rows=[{}] * len(room), room=room, valid=valid, is_scored=is_scored)


def test_rooms_are_measurable_if_they_are_scored_and_a_scored_feature_is_valid():
    assert measurable_rooms(rooms(True, False, True)).tolist() == [0, 2]
    assert not len(measurable_rooms(rooms(True, True, features=~SCORED)))
    assert measurable_rooms(rooms(True, True, is_scored=[True, False])).tolist() == [0]


def test_test_set_without_a_valid_feature_is_not_scored(caplog):
    assert _with_errors(rooms(False, False), "test") is None
    assert "test: no feature that is scored is valid in any of 4 RIRs" in caplog.text
    partly = rooms(False, True)
    assert _with_errors(partly, "test") is partly


def test_loop_is_refused_if_fewer_than_two_rooms_have_an_error():
    _require_errors(rooms(True, True, False), "rirs")
    with pytest.raises(ValueError, match="rirs: a feature that is scored is valid in 1 of 3 rooms, and must be in 2"):
        _require_errors(rooms(True, False, False), "rirs")


@pytest.mark.filterwarnings("error")
def test_ceiling_without_a_valid_feature_has_no_number(tmp_path):
    """In simulated recordings, the few valid features of the measured ones may not be valid."""
    nothing = HeldOutErrors({split: np.full((4, N_FEATURES), np.nan) for split in SPLITS}, np.array([0, 0, 1, 1]),
                            np.array([0, 1, 0, 1]))
    entry = error_entry(nothing)
    assert all(entry[split]["error"] is None and entry[split]["ci"] is None for split in SPLITS)
    directory = make_loop(tmp_path / "loop")
    ledger = read_json(directory / LEDGER_FILE)
    ledger["test"]["ceiling"] = entry
    write_json(directory / LEDGER_FILE, ledger)
    assert len(error_rows(read_ledger(directory / LEDGER_FILE))) == 2 * len(SPLITS)
    ledger["test"]["before"] = entry
    write_json(directory / LEDGER_FILE, ledger)
    with pytest.raises(ValueError, match="test.before.leave_positions_out.error=None must be a number"):
        read_ledger(directory / LEDGER_FILE)
