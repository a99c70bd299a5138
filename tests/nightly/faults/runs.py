"""The bench behind tests/nightly/faults/run.sh: see there."""

import argparse
import atexit
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

from recipe_run import hashes
from stages import STAGES, Run, freeze, is_refusal, leftovers

from roomeq.core.files import read_json, write_json, write_text

PROJECT = Path(__file__).resolve().parents[3]
COLUMNS = ("case", "what", "stage hit", "then", "restarted", "ok")


class Bench:
    """Cases with a result file each, so that a stopped bench goes on."""

    def __init__(self, out, seed, nj, corpora, stop_stage):
        self.out, self.seed, self.nj, self.corpora = out, seed, nj, corpora
        self.stages = [stage for stage in STAGES if stage <= stop_stage]
        subprocess.run(["local/install.sh"], cwd=PROJECT, check=True)  # the copy shares what is installed
        self.tree = freeze(PROJECT, out / "tree")
        self.durations_s, self.size = {}, 0

    def run(self, where, *more):
        """Start a run."""
        return Run(self.tree, where, self.corpora or where / "corpora", self.nj, "--stop-stage",
                   str(self.stages[-1]), *more)

    def case(self, name, make):
        """Do a case unless it is done; its directory goes, unless it failed."""
        path = self.out / "results" / f"{name}.json"
        if path.is_file():
            return
        where = self.out / "work" / name
        shutil.rmtree(where, ignore_errors=True)
        where.mkdir(parents=True)
        row = make(where, random.Random(f"{self.seed} {name}"))
        write_json(path, dict(row, case=name))
        print(f"{time.strftime('%H:%M:%S')} {name}: {row['what']}: {row['then']}: "
              f"{'ok' if row['ok'] else 'NOT OK'}", flush=True)
        if row["ok"]:
            shutil.rmtree(where)

    def undisturbed(self):
        """Make (once) the run that all others are compared with."""
        path = self.out / "undisturbed.json"
        if not path.is_file():
            where = self.out / "work" / "undisturbed"  # as deep as the others: paths are relative
            if self.corpora:
                self.run(where, "--stop-stage", "0").wait()
            shutil.rmtree(where, ignore_errors=True)
            run = self.run(where)
            if run.wait():
                sys.exit("the undisturbed run failed:\n" + "\n".join(run.lines[-20:]))
            write_json(path, dict(durations_s=run.durations_s(), hashes=hashes(where),
                                  size=int(subprocess.check_output(["du", "-sk", where]).split()[0])))
        made = read_json(path)
        self.durations_s = {int(stage): value for stage, value in made["durations_s"].items()}
        self.hashes, self.size_kib = made["hashes"], made["size"]

    def moment(self, rng, stage):
        """Return a moment after the beginning of a stage [s], as far as it lasted undisturbed."""
        return rng.uniform(0, 1) * self.durations_s[stage]

    def restarted(self, where):
        """Run to the end; return how that went, and whether the bytes are right."""
        run = self.run(where)
        status = run.wait()
        if status:
            write_text(where / "output", "\n".join(run.lines))
            return f"failed: {run.lines[-1]}", False
        return self.compared(where)

    def compared(self, where):
        """Compare a directory with the undisturbed one."""
        found = hashes(where)
        different = sorted(name for name in found.keys() | self.hashes.keys()
                           if found.get(name) != self.hashes.get(name))
        if different:
            return f"{len(different)} files differ, first {different[0]}", False
        return "same bytes", True

    def kills(self, numbers, stages):
        """Kill one run again and again, once in each of the stages; then let it end."""
        def make(where, rng):
            hit, said, alive = [], [], []
            for stage in stages:
                run = self.run(where)
                after_s = self.moment(rng, stage)
                if run.wait_for(stage, after_s):
                    run.kill()
                    hit.append(f"{run.stage} +{after_s:.1f} s")
                    said.append(f"{len(leftovers(where))} unfinished")
                    alive += run.survivors()
                else:
                    hit.append(f"none (ended in {run.stage} first)")
            then, ok = self.restarted(where)
            return dict(what=f"SIGKILL x {len(stages)}", stages=list(stages), hit=hit, then=", ".join(said),
                        restarted=then, ok=ok and not alive)
        self.case(f"kill-{numbers[0]:02d}-{numbers[-1]:02d}", make)

    def pair(self, number, with_kill):
        """Start two copies in one directory: the second must refuse; kill the first, or let it end."""
        def make(where, rng):
            first = self.run(where)
            first.wait_for(self.stages[0], rng.uniform(0, 2))
            second = self.run(where)
            statuses = [None, second.wait()]
            refused = statuses[1] != 0 and "another run works there" in second.lines[-1] and is_refusal(second.lines)
            hit = "-"
            if with_kill:
                stage = rng.choice(self.stages)
                if first.wait_for(stage, self.moment(rng, stage)):
                    hit = f"{first.stage} +{time.monotonic() - first.began_s[first.stage]:.1f} s"
                first.kill()
            statuses[0] = first.wait()
            good = refused and (with_kill or statuses[0] == 0)
            if not good:
                for name, run in (("first", first), ("second", second)):
                    write_text(where / f"output.{name}", "\n".join(run.lines))
            then, ok = self.restarted(where)
            return dict(what="two at once" + ", the first killed" * with_kill, hit=[hit],
                        then=f"exit {statuses[0]} and {statuses[1]}: {second.lines[-1]}"[:300], restarted=then,
                        ok=good and ok)
        self.case(f"pair-{number:02d}", make)

    def full_disk(self, number, share):
        """Run on a disk that holds a share of what the run needs, then make room."""
        def make(where, rng):
            mount(where, f"size={int(share * self.size_kib)}k")
            try:
                run = self.run(where)
                status = run.wait()
                said = run.lines[-1] if run.lines else "nothing"
                mount(where, "remount,size=4g")
                then, ok = self.restarted(where)
                return dict(what=f"disk full at {share:.0%} of what it takes", hit=[str(run.stage)],
                            then=f"exit {status}: {said}"[:300], restarted=then,
                            ok=ok and status != 0 and is_refusal(run.lines))
            finally:
                subprocess.run(["umount", where], check=True)
        self.case(f"full-{number:02d}", make)

    def read_only(self, number):
        """Stop after a stage, forbid writing, start again; then allow writing."""
        def make(where, rng):
            stop = rng.choice(self.stages[:-1])
            mount(where, "size=4g")
            try:
                self.run(where, "--stop-stage", str(stop)).wait()
                mount(where, "remount,ro")
                run = self.run(where)
                status = run.wait()
                said = run.lines[-1]
                mount(where, "remount,rw")
                then, ok = self.restarted(where)
                return dict(what=f"read-only after stage {stop}", hit=[str(run.stage)],
                            then=f"exit {status}: {said}"[:300], restarted=then,
                            ok=ok and status != 0 and is_refusal(run.lines))
            finally:
                subprocess.run(["umount", where], check=True)
        self.case(f"readonly-{number:02d}", make)


def mount(where, options):
    """Mount a small file system in memory, or change one."""
    subprocess.run(["mount", "-t", "tmpfs", "-o", options, "roomeq-faults", where], check=True)


def table(out):
    """Return all results as a table."""
    rows = [json.loads(path.read_text()) for path in sorted((out / "results").glob("*.json"))]
    kills = [stage.split()[0] for row in rows if row["case"].startswith("kill") for stage in row["hit"]]
    lines = ["| " + " | ".join(COLUMNS) + " |", "|---" * len(COLUMNS) + "|"]
    for row in rows:
        cells = (row["case"], row["what"], "; ".join(row["hit"]), row["then"], row["restarted"],
                 "yes" if row["ok"] else "NO")
        lines.append("| " + " | ".join(cell.replace("|", "\\|").replace(str(out), "DIR") for cell in cells) + " |")
    counts = ", ".join(f"stage {stage}: {kills.count(stage)}" for stage in sorted(set(kills)))
    lines.append(f"\n{len([k for k in kills if k != 'none'])} kills ({counts}); "
                 f"{sum(row['ok'] for row in rows)} of {len(rows)} cases as they must be.")
    return "\n".join(lines) + "\n"


def main(argv=None):
    """Do all cases; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=30)
    parser.add_argument("--kills-per-run", type=int, default=5)
    parser.add_argument("--pairs", type=int, default=6, help="two at once; in every second case one is killed")
    parser.add_argument("--disks", type=int, default=6, help="full disks; half as many read-only ones")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--nj", type=int, default=2)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--corpora", type=Path, help="where stand-ins are, or go; else every case makes its own")
    parser.add_argument("--stop-stage", type=int, default=STAGES[-1])
    args = parser.parse_args(argv)
    bench = Bench(args.out.resolve(), args.seed, args.nj, args.corpora, args.stop_stage)
    atexit.register(Run.kill_all)
    bench.undisturbed()
    for first in range(0, args.kills, args.kills_per_run):
        numbers = range(first, min(first + args.kills_per_run, args.kills))
        # every stage in turn; within a run in order, since what is done is not done again
        stages = sorted(bench.stages[number % len(bench.stages)] for number in numbers)
        bench.kills([n + 1 for n in numbers], stages)
    for number in range(1, args.pairs + 1):
        bench.pair(number, with_kill=number % 2 == 0)
    disks = args.disks if os.geteuid() == 0 else print("full and read-only disks need root: left out") or 0
    for number in range(disks):
        bench.full_disk(number + 1, (number + 0.5) / disks)
    for number in range(disks // 2):
        bench.read_only(number + 1)
    result = table(bench.out)
    write_text(bench.out / "table.md", result)
    print(result)
    return 0 if "| NO |" not in result else 1


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    sys.exit(main())
