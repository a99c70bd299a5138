"""Malformed configuration files beyond those of `test_shell.py`, and failures without a wrong input."""

from concurrent.futures.process import BrokenProcessPool

import pytest
from running import call
from scripts import call as run

from roomeq import validate


@pytest.mark.parametrize("content, message", [
    (None, "--config size.conf: no such file"), (b"nj=\0 3\n", "size.conf:1: --nj"),
    (b"some_name\n", "size.conf:1: 'some_name' must be name=value"), (b"=3\n", "size.conf:1: unknown option ''"),
    (b"IFS=x\n", "size.conf:1: unknown option 'IFS'"),
    (b"nj=3\nsome name=4\n", "size.conf:2: unknown option 'some name'"),
    (b"$(touch evil)=4\n", "size.conf:1: unknown option '$(touch evil)'"),
    (b"nj[$(touch evil)]=4\n", "size.conf:1: unknown option"),
    (b"fast=maybe\n", "--fast 'maybe' must be true or false")])
def test_malformed_config_is_named_with_its_line(recipe, content, message):  # noqa: F811
    if content is None:
        (recipe / "size.conf").mkdir()
    else:
        (recipe / "size.conf").write_bytes(content)
    done = run(recipe, "./say.sh", "--config", "size.conf", "say.sh")
    assert done.returncode == 1 and done.stdout == ""
    assert message in done.stderr and done.stderr.count("\n") == 1 and not (recipe / "evil").exists()


@pytest.mark.parametrize("error, message", [
    (MemoryError(), "not enough memory, or a worker was killed (MemoryError): use a smaller --nj"),
    (BrokenProcessPool("x"), "a worker was killed (BrokenProcessPool): use a smaller --nj and start it again to go on"),
    (KeyboardInterrupt(), "interrupted; start it again to go on"),
    (RuntimeError("odd\nlines"), "internal error, please report it: RuntimeError: odd lines (fail, test_conf.py:")])
def test_internal_failures_are_one_line(error, message, monkeypatch):
    def fail(directories):
        raise error

    monkeypatch.setattr(validate, "validate", fail)
    status, said = call(["validate", "x"])
    assert status == (130 if isinstance(error, KeyboardInterrupt) else 1)
    assert said.startswith("roomeq: ") and message in said and said.count("\n") == 1
