"""A `Build` killed before any of its dealings with the file system goes on to the same bytes."""

import multiprocessing
import os
import signal
import sys

import pytest

from roomeq.core.build import Build
from roomeq.core.files import write_json, write_text

WATCHED = ("open", "os.rename", "os.mkdir", "os.remove", "os.rmdir", "fcntl.flock")


def make(out, version):
    build = Build(out, step="crash", options=dict(version=version), inputs=[])

    def one(name, number):
        write_text(build.work / "deep" / f"{name}.txt", f"{version} {number}\n" * 100)
        return [number, version]

    if not build.done and build.run({f"n{n}": n for n in range(4)}, one):
        build.finish(lambda directory, records: write_json(directory / "all.json", records))


def contents(directory):
    return {str(path.relative_to(directory)): path.read_bytes()
            for path in sorted(directory.rglob("*")) if path.is_file()}


def killed_before(moment, out, version):
    """Make a directory in a process that kills itself before its dealing `moment` of `WATCHED` kinds below `out`."""
    seen = 0

    def watch(event, args):
        nonlocal seen
        if event not in WATCHED or (event == "open" and not args[2] & (os.O_WRONLY | os.O_RDWR)):
            return
        if event != "fcntl.flock" and str(out.parent) not in str(args[0]) and not str(args[-1]).isdigit():
            return
        seen += 1
        if seen == moment:
            os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(watch)
    make(out, version)


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    whole = tmp_path_factory.mktemp("whole")
    for version in (1, 2):
        make(whole / str(version), version)
    return {version: contents(whole / str(version)) for version in (1, 2)}


@pytest.mark.parametrize("replaced", [False, True], ids=["fresh", "over-an-older-one"])
def test_every_moment(replaced, expected, tmp_path):
    processes, moment, absent = multiprocessing.get_context("fork"), 0, 0
    while True:
        moment += 1
        out = tmp_path / str(moment) / "out"
        if replaced:
            make(out, 1)
        process = processes.Process(target=killed_before, args=(moment, out, 2))
        process.start()
        process.join()
        if out.exists():
            assert contents(out) in ([expected[2], expected[1]] if replaced else [expected[2]])
        else:
            absent += replaced
        make(out, 2)
        assert contents(out) == expected[2]
        assert [path.name for path in out.parent.iterdir() if path.name not in ("out", ".out.lock")] == [], moment
        if process.exitcode == 0:
            break
        assert process.exitcode == -signal.SIGKILL
    assert moment > 30
    assert absent <= 1  # between the two renames
