"""The whole recipe at its smallest size: the same bytes over jobs and interruptions."""

import random
import signal
import time

import pytest

from recipe_run import finish, hashes, kill, start


@pytest.fixture(scope="module")
def corpora(tmp_path_factory):
    return tmp_path_factory.mktemp("recipe")


@pytest.fixture(scope="module")
def undisturbed(corpora, project_dir):
    """A run with one job; what it printed, and what it made."""
    where = corpora / "run-a"
    return finish(start(project_dir, where, corpora / "corpora", 1)), hashes(where)


def test_ends_with_data_directories_and_a_report(undisturbed, corpora):
    output, files = undisturbed
    assert "report: " in output.splitlines()[-1] and "data directory: " in output.splitlines()[-2]
    for name in ("train.real", "train.sim", "train.sim.EQ", "dev.real", "dev.sim", "dev.sim.EQ", "test.real"):
        assert f"data/{name}.rvb/wav.scp" in files and f"data/{name}.rvb/segments" in files
    assert "exp/report/index.html" in files


def test_two_jobs_and_a_second_run_give_the_same_bytes(undisturbed, corpora, project_dir):
    where = corpora / "run-b"
    finish(start(project_dir, where, corpora / "corpora", 2))
    assert hashes(where) == undisturbed[1]
    again = finish(start(project_dir, where, corpora / "corpora", 2))
    assert "up to date" in again
    assert hashes(where) == undisturbed[1]


def test_killed_and_started_again_gives_the_same_bytes(undisturbed, corpora, project_dir):
    where = corpora / "run-c"
    moments, killed = random.Random(0), []
    for _ in range(4):
        process = start(project_dir, where, corpora / "corpora", 2)
        time.sleep(moments.uniform(2, 15))
        kill(process)
        killed.append(process.returncode == -signal.SIGKILL)
    assert any(killed), "each ended before it was killed"
    finish(start(project_dir, where, corpora / "corpora", 2))
    assert hashes(where) == undisturbed[1]


def test_stages_without_what_they_need_say_which_to_run(corpora, project_dir):
    process = start(project_dir, corpora / "run-d", corpora / "corpora", 1, "--stage", "4")
    output, _ = process.communicate(timeout=120)
    assert process.returncode != 0
    assert "rirs.sim.train/rirs.jsonl is missing: run steps/simulate_rirs.sh first" in output.splitlines()[-1]
