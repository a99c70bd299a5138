"""Forked workers: results do not depend on their number, and no worker outlives its parent."""

import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from roomeq.core.build import Build
from roomeq.core.workers import forked, may_fork, n_processes, share_out

pytestmark = pytest.mark.usefixtures("default_hangup")


@pytest.mark.parametrize("first_here", [True, False])
@pytest.mark.parametrize("nj", [1, 2, 5])
@pytest.mark.parametrize("count", [0, 1, 2, 7])
def test_results_keep_the_order_of_the_items(nj, count, first_here):
    lock = threading.Lock()  # items need not be picklable
    items = ((n, lock) for n in range(count))
    squares = share_out(lambda item: item[0] ** 2, items, nj, first_here=first_here, label="")
    assert squares == [n ** 2 for n in range(count)]


@pytest.mark.parametrize("first_here", [True, False])
def test_work_is_done_by_as_many_processes_as_asked(first_here):
    def busy(_):
        time.sleep(0.2)
        return os.getpid()

    ids = share_out(busy, range(5), 2, first_here=first_here, label="")
    assert (ids[0] == os.getpid()) == first_here
    assert len(set(ids) - {os.getpid()}) == 2


def test_errors_of_workers_keep_their_type_and_text():
    def fail(item):
        raise ValueError(f"room {item}: no RIRs")

    with pytest.raises(ValueError, match="room 3: no RIRs"):
        share_out(fail, [3, 4], 2, first_here=False, label='')


@pytest.mark.parametrize("setting, n_cores, n_items, expected", [
    (None, 2, 4, {"1"}), (None, 8, 4, {"4"}), (None, 8, 1, {"8"}), ("3", 2, 4, {"3"})])
def test_workers_share_the_cores(setting, n_cores, n_items, expected, monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(n_cores)))
    monkeypatch.delenv("NUMBA_NUM_THREADS", raising=False)
    if setting:
        monkeypatch.setenv("NUMBA_NUM_THREADS", setting)
    found = share_out(lambda _: os.environ["NUMBA_NUM_THREADS"], range(n_items), 2, first_here=False, label="")
    assert set(found) == expected


def test_results_are_yielded_as_they_are_done():
    def sleep(seconds):
        time.sleep(seconds)
        return seconds

    assert [result for _, result in forked(sleep, [0.8, 0.0, 0.1, 0.2], 2)] == [0.0, 0.1, 0.2, 0.8]


def test_processes_are_not_forked_beside_other_threads(monkeypatch):
    done = threading.Event()
    thread = threading.Thread(target=done.wait)
    thread.start()
    assert not may_fork()
    done.set()
    thread.join()
    monkeypatch.setattr(threading, "active_count", lambda: 1)  # those of other tests may run
    assert may_fork()


@pytest.mark.parametrize("forks", [True, False])
def test_builds_do_not_depend_on_how_their_processes_start(forks, tmp_path, monkeypatch):
    monkeypatch.setattr("roomeq.core.build.may_fork", lambda: forks)
    build, made = Build(tmp_path / "out", step="count", options={}, inputs=[]), []
    build.run({f"n{n}": n for n in range(5)}, _square, nj=2)
    build.finish(lambda directory, records: made.extend(records))
    assert [square for square, _ in made] == [0, 1, 4, 9, 16]
    assert os.getpid() not in {pid for _, pid in made}


def _square(name, item):
    return item ** 2, os.getpid()


@pytest.mark.parametrize("nj, n_items, n_cores, expected", [
    (1, 9, 2, 1), (2, 9, 2, 2), (9, 3, 2, 3), (1000, 1000, 2, 8), (1000, 1000, 16, 64), (2, 0, 2, 1)])
def test_number_of_processes_is_limited_by_items_and_cores(nj, n_items, n_cores, expected, monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(n_cores)))
    assert n_processes(nj, n_items) == expected


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_workers_end_with_their_parent(how, tmp_path):
    """A terminal interrupts all processes; SIGKILL reaches only the parent."""
    # tests that run in the background inherit that interrupts are ignored
    script = ("import os, signal, sys, time\nfrom roomeq.core.workers import share_out\n"
              "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
              "def work(n):\n    open(os.path.join(sys.argv[1], str(os.getpid())), 'w').close()\n    time.sleep(600)\n"
              "share_out(work, range(4), 3, first_here=False, label='')\n")
    parent = subprocess.Popen([sys.executable, "-c", script, str(tmp_path)], start_new_session=True,
                              stderr=subprocess.PIPE, text=True)
    workers = _until(lambda: [int(name) for name in os.listdir(tmp_path)], lambda running: len(running) == 3)
    os.kill(-parent.pid if how == signal.SIGINT else parent.pid, how)
    _, error = parent.communicate(timeout=30)
    assert parent.returncode == -how and error.count("Traceback") == (how == signal.SIGINT)
    assert _until(lambda: [pid for pid in workers if _is_running(pid)], lambda running: not running) == []


BUILD = """
import os, sys, time
from pathlib import Path
from roomeq.core.build import Build

def make(name, item):
    (Path(sys.argv[1]) / str(os.getpid())).touch()
    time.sleep(600)

build = Build(Path(sys.argv[1]) / "out", step="sleep", options={}, inputs=[])
build.run({f"n{n}": n for n in range(4)}, make, nj=2)
"""


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_workers_of_a_build_end_with_their_parent(how, tmp_path):
    parent = subprocess.Popen([sys.executable, "-c", BUILD, str(tmp_path)], start_new_session=True)
    workers = _until(lambda: [int(name) for name in os.listdir(tmp_path) if name.isdigit()],
                     lambda running: len(running) == 2)
    assert len(workers) == 2
    os.kill(parent.pid, how)
    assert parent.wait(30) == -how
    assert _until(lambda: [pid for pid in workers if _is_running(pid)], lambda running: not running) == []


IN_PLACE = """
import sys
from pathlib import Path

import joblib
from roomeq.core.build import Build

def make(name, item):
    return item

build = Build(Path(sys.argv[1]) / "out", step="count", options={}, inputs=[])
with joblib.parallel_config(backend="threading"):
    build.run({f"n{n}": n for n in range(4)}, make, nj=2)
build.finish(lambda directory, records: print(records))
"""


@pytest.mark.parametrize("processes", ["0", "1"])
def test_build_works_where_no_processes_can_be_started(processes, tmp_path):
    run = subprocess.run([sys.executable, "-c", IN_PLACE, str(tmp_path)], text=True, capture_output=True, timeout=60,
                         env=os.environ | {"JOBLIB_MULTIPROCESSING": processes})
    assert (run.returncode, run.stdout) == (0, "[0, 1, 2, 3]\n"), run.stderr


def _is_running(pid):
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except OSError:  # it has ended, possibly while the file was read
        return False


def _until(ask, is_done):
    for _ in range(300):
        if is_done(answer := ask()):
            break
        time.sleep(0.1)
    return answer
