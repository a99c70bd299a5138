"""No labelling error makes the loop name another effect; tests/nightly/labels/label_errors.py has the table."""

from label_errors import ERRORS, FIRST_SEED, main

REFUSED = [error for error in ERRORS if error.endswith("in cm, all rooms") or error.endswith("in feet, all rooms")]
"""Errors after which no room is left, so that a second seed costs little."""


def test_no_labelling_error_changes_the_effects(tmp_path, capfd):
    status = main(["--out", str(tmp_path), "--seeds", "1"])
    assert status == 0, capfd.readouterr().out


def test_errors_that_leave_no_room_are_refused_with_another_seed_too(tmp_path, capfd):
    status = main(["--out", str(tmp_path), "--first-seed", str(FIRST_SEED + 1), "--seeds", "1",
                   "--errors", ";".join(REFUSED)])
    said = capfd.readouterr().out
    assert status == 0 and said.count(": refused: ") == 2 * len(REFUSED), said
