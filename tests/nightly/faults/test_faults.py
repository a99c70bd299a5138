"""A small part of tests/nightly/faults/run.sh: the recipe's first stages, on stand-ins made once."""

from runs import main


def test_kills_two_at_once_and_a_full_disk(tmp_path, capfd):
    status = main(["--kills", "3", "--kills-per-run", "3", "--pairs", "1", "--disks", "1", "--stop-stage", "1",
                   "--corpora", str(tmp_path / "corpora"), "--out", str(tmp_path / "out")])
    said = capfd.readouterr().out
    assert status == 0, said
    assert "3 kills (stage" in said
