"""A script ends with everything that it has started; one run at a time works in a directory; jobs are limited."""

import fcntl
import os
import signal
import subprocess
import time
from pathlib import Path

import pytest
from scripts import call

pytestmark = pytest.mark.usefixtures("default_hangup")
SIGNALS = [signal.SIGHUP, signal.SIGINT, signal.SIGTERM]
SLEEPER = """#!/usr/bin/env bash
# Sleep in jobs, one of which has left its parent.
# Usage: sleeper.sh [options]
set -euo pipefail
data=data  # directory
. utils/parse_options.sh
. utils/one_run.sh
one_run "$data"
(sleep 600 & echo $! >pid.left)
echo 'echo $$ >pid.$1; sleep 600; true' >job.sh
bash -c 'echo $$ >pid.middle; utils/local.sh JOB=1:2 log/x.JOB.log bash job.sh JOB; true'
"""


@pytest.fixture
def sleeper(recipe):
    """A running script with four processes below it, and their ids."""
    (recipe / "sleeper.sh").write_text(SLEEPER)
    (recipe / "sleeper.sh").chmod(0o755)
    process = subprocess.Popen(["./sleeper.sh"], cwd=recipe, stderr=subprocess.PIPE, text=True,
                               preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
                               env={"PATH": os.environ["PATH"]}, start_new_session=True)
    names = [recipe / f"pid.{name}" for name in ("left", "middle", "1", "2")]
    _until(lambda: all(name.is_file() and name.read_text().strip() for name in names))
    yield process, {name.suffix[1:]: int(name.read_text()) for name in names}
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        pass


def _until(is_true, tries=300):
    for _ in range(tries):
        if is_true():
            return
        time.sleep(0.1)
    pytest.fail("waited in vain")


def _is_running(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.parametrize("how", SIGNALS)
def test_signal_to_a_script_ends_all_that_it_started(how, sleeper):
    process, ids = sleeper
    process.send_signal(how)
    assert process.wait(30) == 128 + how
    assert process.stderr.readline() == f"sleeper.sh: ended by {how.name}\n"
    assert [name for name, pid in ids.items() if _is_running(pid)] == []


def test_killed_script_leaves_nothing_behind(sleeper):
    process, ids = sleeper
    process.kill()
    process.wait()
    _until(lambda: not any(_is_running(pid) for pid in ids.values()))


@pytest.mark.parametrize("how", [*SIGNALS, signal.SIGKILL])
def test_signal_to_a_part_ends_the_rest(how, sleeper):
    process, ids = sleeper
    if how == signal.SIGINT:
        how = signal.SIGABRT  # jobs in the background ignore interrupts
    os.kill(ids["middle"], how)
    assert process.wait(30) == 128 + how
    assert [name for name, pid in ids.items() if _is_running(pid)] == []


def test_second_run_in_a_directory_is_refused_and_told_who_works_there(sleeper, recipe):
    process, _ = sleeper
    done = call(recipe, "./sleeper.sh", "--data", "./data")
    assert done.returncode == 1
    assert done.stderr.startswith(f"sleeper.sh: ./data: another run works there: process {process.pid} on ")
    assert done.stderr.count("\n") == 1 and ": ./sleeper.sh" in done.stderr


def test_lock_ends_with_its_holder(sleeper, recipe):
    process, ids = sleeper
    process.kill()
    process.wait()
    _until(lambda: not any(_is_running(pid) for pid in ids.values()))
    with open(recipe / "data/.run.lock") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)


def test_killed_run_can_be_restarted_at_once(sleeper, recipe):
    process, _ = sleeper
    os.kill(process.pid, signal.SIGSTOP)  # its jobs live until its end is noticed
    (recipe / "short.sh").write_text(SLEEPER.partition("(sleep")[0])
    restarted = subprocess.Popen(["bash", "short.sh"], cwd=recipe, stderr=subprocess.PIPE, text=True)
    time.sleep(1)
    assert restarted.poll() is None
    process.kill()
    assert (restarted.communicate()[1], restarted.returncode) == ("", 0)


@pytest.mark.parametrize("place", ["data", "exp"])
def test_recipe_refuses_a_directory_in_which_another_run_works(place, project_dir, tmp_path):
    (tmp_path / place).mkdir()
    with open(tmp_path / place / ".run.lock", "w") as lock:
        lock.write("process 12 on host since yesterday: ./run.sh --nj 3\n")
        lock.flush()
        fcntl.flock(lock, fcntl.LOCK_EX)
        done = call(project_dir, "./run.sh", "--data", tmp_path / "data", "--exp", tmp_path / "exp")
    assert done.returncode == 1 and done.stdout == ""
    assert done.stderr == (f"run.sh: {tmp_path}/{place}: another run works there: process 12 on host since yesterday: "
                           "./run.sh --nj 3 \n")


COUNT = """
mkdir running.JOB
ls -d running.* | wc -l >>counts
sleep 0.05
rmdir running.JOB
[ JOB != 7 ]
"""


def test_jobs_at_once_are_limited_and_each_failure_is_named(recipe):
    done = call(recipe, "utils/local.sh", "--max-jobs-run", "3", "JOB=1:40", "log/x.JOB.log", "bash", "-c", COUNT)
    assert done.returncode == 1 and "job 7 failed" in done.stderr and done.stderr.count("\n") == 1
    counts = [int(line) for line in (recipe / "counts").read_text().split()]
    assert len(counts) == 40 and 1 < max(counts) <= 3


def test_jobs_at_once_are_as_many_as_cores(recipe):
    done = call(recipe, "utils/local.sh", "JOB=1:40", "log/x.JOB.log", "bash", "-c", COUNT.replace("!= 7", "!= 0"))
    assert done.returncode == 0, done.stderr
    assert max(int(line) for line in (recipe / "counts").read_text().split()) <= len(os.sched_getaffinity(0))
