#!/usr/bin/env python
"""What it costs to run the recipe again when everything is up to date, beside the first run, by stage.

e.g.: python tests/bench/up_to_date.py --out exp/bench
      python tests/bench/up_to_date.py --in RUN        # RUN/data and so on are there already

Each stage is a call of run.sh with the smallest configuration. CPU time is that of all its processes.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[2]
STAGES = range(8)


def cpu_s(folder, stage):
    """Run one stage of the recipe in a folder; return the CPU time of its processes [s]."""
    paths = [f"--{name}={folder / name}" for name in ("data", "exp", "corpora")]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(["./run.sh", "--config", "conf/smallest.conf", f"--stage={stage}", f"--stop-stage={stage}", *paths],
                   cwd=PROJECT, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main():
    """Run all stages twice and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="folder for up_to_date.json")
    parser.add_argument("--in", dest="folder", type=Path, help="folder of the run; default: a temporary one")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = (chosen.folder or Path(temporary)).resolve()
        runs = {run: [cpu_s(folder, stage) for stage in STAGES] for run in ("first", "again")}
    print(f"{'stage':>9} {'first [s]':>10} {'again [s]':>10}")
    for stage, first, again in zip(STAGES, runs["first"], runs["again"], strict=True):
        print(f"{stage:9d} {first:10.1f} {again:10.2f}")
    print(f"{'all':>9} {sum(runs['first']):10.1f} {sum(runs['again']):10.2f}")
    if chosen.out:
        chosen.out.mkdir(parents=True, exist_ok=True)
        (chosen.out / "up_to_date.json").write_text(json.dumps(dict(stages=list(STAGES), cpu_s=runs), indent=1) + "\n")


if __name__ == "__main__":
    sys.exit(main())
