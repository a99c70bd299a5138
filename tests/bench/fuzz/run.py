#!/usr/bin/env python
"""Coverage-guided fuzzing of the text parsers: nothing but ValueError, no hang, no file anywhere else, no command.

Each parser runs in processes of its own, on inputs that atheris makes from small right ones. Prints a table and
writes fuzz.json; inputs that broke a parser are kept beside it. Exit status 1 if there were any.

e.g.: python tests/bench/fuzz/run.py --minutes 10 --out exp/bench
      python tests/bench/fuzz/run.py --minutes 1 --only csv,rows
      python tests/bench/fuzz/run.py --only csv --replay exp/bench/fuzz/csv-crash-0a1b
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

HERE = Path(__file__).resolve().parent
for folder in (HERE.parents[2] / "pysrc", HERE):
    sys.path.insert(0, str(folder))

HANG_S = 10
MEMORY_MB = 2048


def main() -> int:
    """Fuzz the chosen parsers for their shares of the time; one line each."""
    from targets import TARGETS

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0, help="for all parsers together (default: 10)")
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)), help="processes (default: cores)")
    parser.add_argument("--only", default=",".join(TARGETS), help=f"some of {', '.join(TARGETS)}")
    parser.add_argument("--seed", type=int, default=1, help="of atheris (default: 1); its runs depend on time as well")
    parser.add_argument("--out", type=Path, default=Path("exp/bench"), help="default: exp/bench")
    parser.add_argument("--replay", type=Path, help="run one kept input instead, with its traceback")
    given = parser.parse_args()
    names = given.only.split(",")
    if unknown := set(names) - set(TARGETS):
        parser.error(f"--only {','.join(sorted(unknown))}: choose from {', '.join(TARGETS)}")
    try:
        import atheris  # noqa: F401
    except ImportError:
        parser.error("atheris is not installed: pip install -r tests/bench/requirements.txt")
    if given.replay:
        return subprocess.run(child(names[0], Path(tempfile.mkdtemp()), [str(given.replay.resolve())])).returncode
    seconds = max(1, round(given.minutes * 60 * given.jobs / len(names)))
    print(f"{'parser':14s}{'inputs':>12s}{'coverage':>10s}{'seconds':>9s}  result", flush=True)
    with ThreadPoolExecutor(given.jobs) as pool:
        rows = list(pool.map(lambda name: fuzz(name, seconds, given), names))
    given.out.mkdir(parents=True, exist_ok=True)
    (given.out / "fuzz.json").write_text(json.dumps(rows, indent=1) + "\n")
    bad = [row["parser"] for row in rows if row["result"] != "well"]
    print(f"{len(rows) - len(bad)} of {len(rows)} parsers well; {given.out / 'fuzz.json'}")
    return 1 if bad else 0


def child(name: str, work: Path, more: list[str]) -> list[str]:
    return [sys.executable, str(HERE / "targets.py"), name, str(work), *more]


def fuzz(name: str, seconds: int, given) -> dict:
    """Run one parser in a process of its own; return a row of the table."""
    began = time.monotonic()
    with tempfile.TemporaryDirectory(dir="/dev/shm" if os.path.isdir("/dev/shm") else None) as folder:
        work, kept = Path(folder), (given.out / "fuzz").resolve()
        kept.mkdir(parents=True, exist_ok=True)
        try:
            done = subprocess.run(child(name, work, [
                f"-dict={work / 'words'}", f"-max_total_time={seconds}", f"-timeout={HANG_S}",
                f"-rss_limit_mb={MEMORY_MB}", f"-seed={given.seed}",
                "-print_final_stats=1", f"-artifact_prefix={kept}/{name}-", str(work / "corpus")]),
                capture_output=True, text=True, errors="replace", timeout=2 * seconds + 120, stdin=subprocess.DEVNULL)
            status, said = done.returncode, done.stdout + done.stderr
        except subprocess.TimeoutExpired as expired:
            status, said = -1, (expired.stderr or b"").decode(errors="replace") + "\nno end"
    found = re.findall(r"number_of_executed_units: (\d+)|^#(\d+)", said, re.MULTILINE)
    counts = [int(a or b) for a, b in found]
    coverage = re.findall(r"cov: (\d+)", said)
    row = dict(parser=name, inputs=max(counts, default=0), coverage=int(coverage[-1]) if coverage else 0,
               seconds=round(time.monotonic() - began), result="well" if status == 0 else reason(said))
    print(f"{name:14s}{row['inputs']:12d}{row['coverage']:10d}{row['seconds']:9d}  {row['result']}", flush=True)
    return row


def reason(said: str) -> str:
    """Return the lines of a failing run that say most: the exception, or libFuzzer's own summary."""
    told = re.findall(r"^(?:\w+\.)*(\w*(?:Error|Exception|Warning|Exit)\b.*)$|(ERROR: libFuzzer: .*)", said,
                      re.MULTILINE)
    kept = re.findall(r"Test unit written to (\S+)", said)
    last = [a or b for a, b in told][:1] or said.strip().splitlines()[-1:] or ["no word"]
    return "; ".join([*last, *kept])


if __name__ == "__main__":
    sys.exit(main())
