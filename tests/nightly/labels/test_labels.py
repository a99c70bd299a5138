"""No labelling error makes the loop name another effect; tests/nightly/labels/label_errors.py has the table."""

from label_errors import main


def test_no_labelling_error_changes_the_effects(tmp_path, capfd):
    status = main(["--out", str(tmp_path), "--seeds", "1"])
    assert status == 0, capfd.readouterr().out
