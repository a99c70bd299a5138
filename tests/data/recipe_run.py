"""Run the recipe at its smallest size from tests, and compare what two runs made."""

import hashlib
import os
import signal
import subprocess

OPTIONS = ["--config", "conf/smallest.conf", "--num-rays", "500"]


def start(project_dir, where, corpora, nj, *more):
    """Start a run that writes below `where`, in a process group of its own."""
    return subprocess.Popen(
        ["./run.sh", *OPTIONS, "--nj", str(nj), "--data", f"{where}/data", "--exp", f"{where}/exp",
         "--corpora", str(corpora), *more],
        cwd=project_dir, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True)


def finish(process):
    """Wait for a run and return what it printed; it must have succeeded."""
    output, _ = process.communicate(timeout=1200)
    assert process.returncode == 0, output
    return output


def kill(process, *, read=True):
    """Kill a run with everything that it started, at once; `read` what it printed, unless somebody else does."""
    os.killpg(process.pid, signal.SIGKILL)
    if read:
        process.communicate()
    process.wait()


def hashes(where):
    """Return the hash of every file that a run made, with the run's own place taken out of the text."""
    found = {}
    for path in sorted(where.rglob("*")):
        name = str(path.relative_to(where))
        if path.is_file() and "/log/" not in name and path.name != ".done" and not name.endswith(".lock"):
            found[name] = hashlib.sha256(path.read_bytes().replace(str(where).encode(), b"HERE")).hexdigest()
    return found
