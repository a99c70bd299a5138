"""A small part of tests/nightly/faults/run.sh (the first stages, on synthetic corpora made once), and 1,000 damages."""

import attacks
from runs import main


def test_kills_two_at_once_and_a_full_disk(tmp_path, capfd):
    status = main(["--kills", "3", "--kills-per-run", "3", "--pairs", "1", "--disks", "1", "--stop-stage", "1",
                   "--corpora", str(tmp_path / "corpora"), "--out", str(tmp_path / "out")])
    said = capfd.readouterr().out
    assert status == 0, said
    assert "3 kills (stage" in said


def test_thousand_generated_damages_and_all_losses_of_power(tmp_path, capfd):
    status = attacks.main(["--only", "damage,power", "--out", str(tmp_path)])
    assert status == 0, capfd.readouterr().out
