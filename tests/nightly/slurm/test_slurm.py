"""Jobs on a real Slurm cluster of one machine: the convention, what goes wrong, and a recipe step's bytes."""

import json
import os
import re
import signal
import subprocess
import time
from pathlib import Path

import pytest
from cluster import cluster, why_not
from datadirs import speech_dir
from rirmaker import coloured_rir, row, write_rir_dir

HOSTILE = ["uniform 5 25", "$(touch evil)", "`touch evil`", "'; touch evil; '", 'a"b', "a\nb", "-x", "*", "é", "\\n",
           ""]
HOLD = "until [ -e %s/go ]; do sleep 0.1; done"


@pytest.fixture(scope="module")
def slurm(tmp_path_factory):
    """The environment of a running cluster."""
    if reason := why_not():
        pytest.skip(reason)
    with cluster(tmp_path_factory.mktemp("slurm") / "c") as env:
        yield env | {"here": str(tmp_path_factory.mktemp("logs"))}


def said(env, *command):
    return subprocess.run(command, env=env, capture_output=True, text=True, timeout=30, check=False).stdout


class Jobs:
    """A call of a runner, `bash -c SCRIPT ARGUMENT...` as its command."""

    def __init__(self, project_dir, env, runner, options, where, script, *arguments):
        self.where = where
        self.process = subprocess.Popen(
            [str(project_dir / runner), *options, str(where / "job.JOB.log"), "bash", "-c", script, "bash", *arguments],
            cwd=where, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def end(self):
        """Return exit status and what was said."""
        out, error = self.process.communicate(timeout=120)
        assert out == ""
        return self.process.returncode, error

    def log(self, job):
        """Return a job's log without the runner's comments."""
        lines = (self.where / f"job.{job}.log").read_text().split("\n")
        return "\n".join(line for line in lines if not line.startswith("# "))


def on_slurm(project_dir, slurm, where, options, script, *arguments):
    return Jobs(project_dir, slurm, "utils/slurm.sh", ["--mem=100M", *options], where, script, *arguments)


def job_id(slurm, where):
    """Return the id of the jobs that run in a directory, once they do."""
    for _ in range(100):
        for line in said(slurm, "squeue", "--noheader", "--states=RUNNING", "--format=%A %F %Z").splitlines():
            running, array, folder = line.split(maxsplit=2)
            if folder == str(where):
                return array
        time.sleep(0.1)
    raise AssertionError(f"no job came to run in {where}")


@pytest.fixture(scope="module")
def overdue(slurm, project_dir, tmp_path_factory):
    """Two jobs of which the first runs out of time: Slurm looks only twice a minute, so they begin before all tests."""
    where = tmp_path_factory.mktemp("overdue")
    jobs = on_slurm(project_dir, slurm, where, ["--time", "1", "JOB=1:2"],
                    "echo working on JOB; [ JOB = 2 ] || { trap 'echo ended' TERM; sleep 600 & wait; }")
    array = job_id(slurm, where)
    said(slurm, "scontrol", "update", f"JobId={array}_1", "EndTime=now+1")
    return jobs


@pytest.fixture(params=["local", "slurm"])
def runner(request, project_dir):
    """Call a runner in a directory."""
    if request.param == "local":
        return lambda where, options, *rest: Jobs(project_dir, os.environ, "utils/local.sh", options, where, *rest)
    slurm = request.getfixturevalue("slurm")
    request.getfixturevalue("overdue")
    return lambda *rest: on_slurm(project_dir, slurm, *rest)


def test_job_is_replaced_by_its_number(runner, tmp_path):
    jobs = runner(tmp_path, ["JOB=1:3"], 'echo "$1" "$2"', "JOB", "part JOB/3")
    assert jobs.end() == (0, "")
    assert [jobs.log(job) for job in (1, 2, 3)] == [f"{job} part {job}/3\n" for job in (1, 2, 3)]


def test_arguments_arrive_as_they_are(runner, tmp_path):
    folder = tmp_path / "it's a 100% $(touch evil) place"
    folder.mkdir()
    jobs = runner(folder, ["JOB=1:1"], 'printf "[%s]\\n" "$@"', *HOSTILE)
    assert jobs.end() == (0, "")
    assert jobs.log(1) == "".join(f"[{value}]\n" for value in HOSTILE)
    assert list(tmp_path.rglob("evil")) == []


def test_failing_jobs_are_named_with_the_last_line_of_their_logs(runner, tmp_path):
    jobs = runner(tmp_path, ["JOB=1:4"], 'echo start; echo "no RIRs in JOB"; [ $((JOB % 2)) = 0 ] || exit JOB')
    status, error = jobs.end()
    assert status != 0
    lines = error.splitlines()
    assert len(lines) == 2
    for line, job in zip(lines, (1, 3), strict=True):
        assert f"job {job} failed" in line and f"no RIRs in {job} (log: {tmp_path}/job.{job}.log)" in line
    assert jobs.log(2) == "start\nno RIRs in 2\n"


def test_state_and_exit_status_of_slurm_are_told(slurm, project_dir, tmp_path):
    status, error = on_slurm(project_dir, slurm, tmp_path, ["JOB=1:1"], "exit 7").end()
    assert status == 1
    assert "job 1 failed, exit status 7, Slurm says FAILED (NonZeroExitCode)" in error


def test_a_job_that_dies_is_named_and_the_others_are_kept(slurm, project_dir, tmp_path):
    jobs = on_slurm(project_dir, slurm, tmp_path, ["JOB=1:2"],
                    'echo half way; [ JOB = 1 ] || { kill -9 $PPID; sleep 60; }; echo whole >whole.JOB')
    status, error = jobs.end()
    assert status == 1
    assert len(error.splitlines()) == 1
    assert re.search(r"job 2 failed, exit status none, Slurm says FAILED \(\S+\): half way", error), error
    assert (tmp_path / "whole.1").read_text() == "whole\n"


def test_a_cancelled_job_is_named(slurm, project_dir, tmp_path):
    jobs = on_slurm(project_dir, slurm, tmp_path, ["JOB=1:2"], "echo began; " + HOLD % tmp_path)
    said(slurm, "scancel", f"{job_id(slurm, tmp_path)}_2")
    time.sleep(1)
    (tmp_path / "go").touch()
    status, error = jobs.end()
    assert status == 1
    assert len(error.splitlines()) == 1 and "job 2 failed" in error and "CANCELLED" in error


def test_a_requeued_job_goes_on(slurm, project_dir, tmp_path):
    jobs = on_slurm(project_dir, slurm, tmp_path, ["JOB=1:2"],
                    'echo "begun" >>begun.JOB; ' + HOLD % tmp_path + "; echo done JOB")
    array = job_id(slurm, tmp_path)
    while not (tmp_path / "begun.2").exists():
        time.sleep(0.1)
    said(slurm, "scontrol", "requeue", f"{array}_2")
    (tmp_path / "go").touch()
    assert jobs.end() == (0, "")
    assert (tmp_path / "begun.1").read_text() == "begun\n"
    assert (tmp_path / "begun.2").read_text() == "begun\nbegun\n"
    assert jobs.log(2).endswith("done 2\n")
    assert "restarted 1 times" in (tmp_path / "job.2.log").read_text()


def test_a_killed_runner_takes_its_jobs_along(slurm, project_dir, tmp_path):
    jobs = on_slurm(project_dir, slurm, tmp_path, ["JOB=1:2"], "sleep 600")
    job_id(slurm, tmp_path)
    jobs.process.send_signal(signal.SIGTERM)
    assert jobs.end()[0] == 143
    for _ in range(100):
        if str(tmp_path) not in said(slurm, "squeue", "--noheader", "--format=%Z"):
            break
        time.sleep(0.1)
    else:
        raise AssertionError("jobs are still there")
    assert list(tmp_path.glob(".slurm*")) == []


@pytest.mark.parametrize("options, message", [
    (["--partition", "nosuch"], "sbatch refused: .*partition"),
    (["--mem", "100000G"], "sbatch refused: .*[Mm]emory|sbatch refused: .*node configuration"),
    (["--array=1-5"], "--array=1-5 is set by slurm.sh itself"),
    (["JOB=1:x"], "JOB=1:x must be JOB=FIRST:LAST"),
    (["JOB=3:2"], "JOB=3:2: the first must not be above the last"),
])
def test_wrong_options_are_refused_in_one_line(slurm, project_dir, tmp_path, options, message):
    status, error = on_slurm(project_dir, slurm, tmp_path, options, "true").end()
    assert status == 1
    (line,) = error.splitlines()
    assert re.search(message, line), line


STEPS = (
    "characterise_rirs.sh --nj 2 measured {out}/real",
    "simulate_rirs.sh --nj 2 --num-rays 200 --order 20 --t60-range 0.3,0.4 {out}/real {out}/sim",
    "fit_eq.sh --nj 2 --num-components 2 {out}/real {out}/sim {out}/eq",
    "compensate_rirs.sh --nj 2 {out}/sim {out}/eq {out}/sim.EQ",
    "close_loop.sh --nj 2 --max-effects 1 {out}/real {out}/real {out}/loop",
    "simulate_rirs.sh --nj 2 --num-rays 200 --order 20 --t60-range 0.3,0.4 --model {out}/loop/model.json {out}/real "
    "{out}/sim.loop",
    "augment_data.sh --nj 2 --snr none speech {out}/sim.EQ {out}/rvb",
)


def run_steps(project_dir, env, where, name, cmd):
    """Run all steps that have jobs with a runner; return the bytes of what they made, by path."""
    out = where / name
    for step in STEPS:
        step, *words = step.replace("measured", f"{where}/measured").replace(" speech", f" {where}/speech").split()
        done = subprocess.run([f"steps/{step}", *(word.format(out=out) for word in words)], cwd=project_dir,
                              env=dict(env) | {"cmd": cmd}, capture_output=True, text=True, timeout=300, check=False)
        assert done.returncode == 0, f"{step}: {done.stderr}"
    return {str(path.relative_to(out)): path.read_bytes().replace(str(out).encode(), b"")
            for path in sorted(out.rglob("*"))
            if path.is_file() and not {"log", "q"} & set(path.parts)  # q is where stock runners keep theirs
            and path.name != ".done" and path.suffix != ".lock"}


@pytest.fixture(scope="module")
def by_local_processes(project_dir, tmp_path_factory):
    """What the steps make with the runner that is the default, and where their inputs lie."""
    where = tmp_path_factory.mktemp("steps")
    write_rir_dir(where / "measured", [
        (row(f"r{n}", f"hall{n // 2}", source_pos_m=[1.0, 2.0, 1.5], mic_pos_m=[3.0 + n / 4, 2.5, 1.2]),
         coloured_rir(n, eq_db=(0, 0, 0, 0, 0, 0, -20, 0))) for n in range(6)])  # the loop has something to find
    speech_dir(where / "speech")
    return where, run_steps(project_dir, os.environ, where, "local", "utils/local.sh")


def test_steps_on_the_cluster_give_the_same_bytes(slurm, project_dir, by_local_processes):
    where, expected = by_local_processes
    assert {"real/rirs.jsonl", "eq/gmm.json", "sim.EQ/rirs.jsonl", "loop/model.json", "sim.loop/rirs.jsonl",
            "rvb/wav.scp"} <= expected.keys()
    assert json.loads(expected["loop/model.json"])["effects"], "nothing was found: the loop did not simulate again"
    assert run_steps(project_dir, slurm, where, "cluster", "utils/slurm.sh --mem 500M --time 10") == expected
    logs = [*(where / "cluster").rglob("*.2.log"), *(where / "cluster").rglob("close-loop.log")]
    assert len(logs) == len(STEPS)
    for log in logs:
        assert "Slurm job" in log.read_text()


def test_stock_run_pl_gives_the_same_bytes(project_dir, by_local_processes):
    where, expected = by_local_processes
    assert run_steps(project_dir, os.environ, where, "run_pl", str(stock("run.pl"))) == expected


def test_stock_slurm_pl_gives_the_same_bytes(slurm, project_dir, by_local_processes, tmp_path):
    where, expected = by_local_processes
    config = tmp_path / "slurm.conf"
    config.write_text("command sbatch --export=ALL\noption mem=* --mem $0\noption num_threads=* --cpus-per-task $0\n")
    cmd = f"{stock('slurm.pl')} --config {config} --mem 500M"
    assert run_steps(project_dir, slurm, where, "slurm_pl", cmd) == expected


QSUB = """#!/bin/bash
# as much of Grid Engine's qsub as queue.pl asks for: the tasks run at once, one after the other
tasks=1:1
while [ $# -gt 1 ]; do [ "$1" != -t ] || tasks=$2; shift; done
echo "Your job-array 7.$tasks:1 has been submitted"
for n in $(seq "${tasks%:*}" "${tasks#*:}"); do SGE_TASK_ID=$n JOB_ID=7 bash "$1"; done
"""


def test_stock_queue_pl_gives_the_same_bytes(project_dir, by_local_processes, tmp_path):
    where, expected = by_local_processes
    queue = stock("queue.pl")
    (tmp_path / "qsub").write_text(QSUB)
    (tmp_path / "qsub").chmod(0o755)
    env = os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}"}
    assert run_steps(project_dir, env, where, "queue_pl", f"{queue} --mem 2G") == expected


def stock(name):
    """Kaldi's own runner, unless it isn't here."""
    path = Path(os.environ.get("KALDI_ROOT", "/nonexistent")) / "egs/wsj/s5/utils/parallel" / name
    if not path.is_file():
        pytest.skip("needs Kaldi's scripts: set KALDI_ROOT")
    return path


def test_a_job_out_of_time_is_named(overdue):
    status, error = overdue.end()
    assert status == 1
    assert len(error.splitlines()) == 1
    assert "job 1 failed, exit status none, Slurm says TIMEOUT (TimeLimit): " in error
    assert "DUE TO TIME LIMIT" in error
    assert overdue.log(2) == "working on 2\n"
