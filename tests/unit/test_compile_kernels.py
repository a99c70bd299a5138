"""The kernels are compiled also where no second process can do it."""

import os

import pytest

from roomeq import compile_kernels

PARTS = ("analyse", "simulate", "predict", "simulate_mesh")
HERE = os.getpid()
compiled = []


def part():
    if os.getpid() != HERE:
        os._exit(1)  # as if it were killed
    compiled.append(HERE)


@pytest.mark.parametrize("error", [OSError, NotImplementedError, None])
def test_kernels_are_compiled_where_processes_do_not_start_or_are_killed(error, monkeypatch):
    def no_processes(*_):
        raise error

    if error:
        monkeypatch.setattr(compile_kernels, "ProcessPoolExecutor", no_processes)
    for name in PARTS:
        monkeypatch.setattr(compile_kernels, name, part)
    compiled.clear()
    compile_kernels.main()
    assert compiled == [HERE] * len(PARTS)
