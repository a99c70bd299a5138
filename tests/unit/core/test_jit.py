"""Cached machine code is that of the present sources, and a damaged cache does no harm."""

import os
import shutil
import subprocess
import sys
import threading
from pathlib import Path

import pytest

import roomeq
from roomeq.core.jit import on_threads

HELPER = """from roomeq.core.jit import compiled
FACTOR = {factor}
@compiled
def scale(value):
    return FACTOR * value
"""
KERNEL = """from roomeq.core.jit import compiled
from roomeq.core.probe_helper import scale
@compiled
def kernel(value):
    return scale(value) + 1.0
"""


@pytest.fixture
def package(tmp_path):
    """A copy of the modules that kernels need, with a kernel that calls a helper of another module."""
    core = tmp_path / "roomeq" / "core"
    shutil.copytree(Path(roomeq.__file__).parent / "core", core, ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "roomeq" / "__init__.py").write_text("")
    (core / "probe_helper.py").write_text(HELPER.format(factor=2.0))
    (core / "probe.py").write_text(KERNEL)
    return tmp_path


def run_kernel(package, **environment):
    """Return what the kernel makes of 10 in a process of its own."""
    program = "from roomeq.core.probe import kernel; print(kernel(10.0))"
    done = subprocess.run([sys.executable, "-c", program], cwd=package, text=True, check=True, capture_output=True,
                          env=os.environ | {"PYTHONPATH": str(package)} | environment)
    return float(done.stdout)


def cached_files(package):
    return [path for path in package.rglob("*.nb[ic]") if "probe" in path.name]


def test_a_changed_helper_is_compiled_into_kernels_of_other_modules(package):
    assert run_kernel(package) == 21.0
    assert cached_files(package)
    # of another length, so that Python does not take bytecode of the same second for that of this file
    (package / "roomeq/core/probe_helper.py").write_text(HELPER.format(factor=12.0))
    assert run_kernel(package) == 121.0


@pytest.mark.parametrize("share", [0.0, 0.5], ids=["empty", "truncated"])
def test_damaged_machine_code_is_compiled_again(package, share):
    run_kernel(package)
    for path in cached_files(package):
        path.write_bytes(path.read_bytes()[:int(share * path.stat().st_size)])
    assert run_kernel(package) == 21.0
    assert all(path.stat().st_size > 0 for path in cached_files(package))


def test_a_cache_that_cannot_be_written_is_done_without(package):
    assert run_kernel(package, NUMBA_CACHE_DIR="/proc/nothing") == 21.0
    assert not cached_files(package)


def test_a_terminal_is_told_once_that_kernels_are_compiled(package):
    program = ("import logging; logging.basicConfig(level='INFO', format='%(message)s')\n"
               "from roomeq.core.probe import kernel; kernel(10.0)")
    shown = []
    for _ in range(2):
        reader, writer = os.openpty()
        subprocess.run([sys.executable, "-c", program], cwd=package, check=True, stderr=writer,
                       env=os.environ | {"PYTHONPATH": str(package)})
        os.close(writer)
        try:
            shown.append(os.read(reader, 4096))
        except OSError:  # nothing was written
            shown.append(b"")
        os.close(reader)
    assert b"kernels are compiled at the first use" in shown[0] and shown[1] == b""


def test_jobs_are_shared_out_to_threads_once(monkeypatch):
    """Results come in the order of the jobs; what a thread hands on is computed in it."""
    monkeypatch.setenv("NUMBA_NUM_THREADS", "2")
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    together = threading.Barrier(2, timeout=10.0)

    def within(n):
        return n, threading.get_ident()

    def work(n):
        together.wait()
        inner = on_threads(within, [(10 * n + k,) for k in range(3)])
        return threading.get_ident(), [value for value, _ in inner], {thread for _, thread in inner}

    for _ in range(2):
        done = on_threads(work, [(1,), (2,)])
        assert [values for _, values, _ in done] == [[10, 11, 12], [20, 21, 22]]
        assert all(threads == {thread} for thread, _, threads in done)
        assert done[0][0] != done[1][0]


def test_an_error_in_a_thread_is_raised(monkeypatch):
    monkeypatch.setenv("NUMBA_NUM_THREADS", "2")
    with pytest.raises(ZeroDivisionError):
        on_threads(lambda n: 1 // n, [(n,) for n in range(8)])
    assert on_threads(lambda n: 1 // n, [(1,), (2,)]) == [1, 0]
