#!/usr/bin/env python3
"""Project what the paper's experiment takes, and ten and a hundred times as much, from rates measured here.

Usage: tests/bench/projection.py [--augment augment.json] [--utterances 300] [--positions 3] [--rirs 90] --out DIR
e.g.:  tests/bench/augment.py >augment.json && tests/bench/projection.py --augment augment.json --out exp/projection

Runs every step of the recipe as one job, with the paper's options, on stand-ins (simulation: on the rooms of BUT
ReverbDB), and divides CPU seconds by what was done: starting Python is in them, so a small run tells rates that are too
low rather than too high. With the JSON of augment.py the rate, memory and disk of augmentation are those of its
LibriSpeech recordings. Prints two tables and writes projection.json: redo it when a rate changes. Stages 8-10 are not
in it.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(PROJECT / "pysrc"), str(PROJECT / "tests")]

from bench.speed.dataset import rows  # noqa: E402
from roomeq.core.files import read_json, read_jsonl, write_json, write_jsonl  # noqa: E402

# train-clean-100 and -360, dev-clean, test-clean: hours and utterances as released; four training sets (real, sim,
# sim.EQ, sim.loop), as many development sets, one test set
HOURS, UTTERANCES = 4 * (464.2 + 5.4) + 5.4, 132_553 + 2_703 + 2_620
MEASURED, SIMULATED = 773 + 194 + 242, 773 + 194
# simulated with the loop's model and without
PAPER = dict(utterances=UTTERANCES, measured=MEASURED, rendered=2 * SIMULATED, simulated=SIMULATED, analysed=2 * 773,
             looped=SIMULATED, hours=HOURS, reported=MEASURED + 3 * SIMULATED)
SCALES = (1, 10, 100)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--augment", type=Path, help="what tests/bench/augment.py printed")
    parser.add_argument("--utterances", default="226,37,37", help="of the stand-in speech, for train, dev and test")
    parser.add_argument("--positions", type=int, default=3, help="of the stand-in RIRs, a room")
    parser.add_argument("--rirs", type=int, default=90, help="to simulate, over nine rooms")
    parser.add_argument("--out", type=Path, required=True, help="where everything goes")
    given = parser.parse_args()
    measured = measure(given, given.out.resolve())
    if given.augment:
        use_augment_bench(measured, json.loads(given.augment.read_text()))
    write_json(given.out / "projection.json", measured)
    print(tables(measured))


def measure(given, out):
    """Run the steps; return what each did, in which unit, and CPU seconds, peak memory [MiB] and bytes written."""
    data, exp, corpora = out / "data", out / "exp", out / "corpora"
    where = ["--nj", "1", "--match-rooms", "false", "--data", str(data), "--exp", str(exp), "--corpora", str(corpora),
             "--synthetic-utterances", given.utterances, "--synthetic-positions", str(given.positions)]
    run(["local/make_synthetic_corpus.sh", "--utterances", given.utterances, "--positions", str(given.positions),
         str(corpora)])
    steps = dict(
        prepare_speech=run(["steps/prepare_speech.sh", str(corpora / "speech"), str(data)]),
        read_measured=run(["steps/read_measured.sh", str(corpora / "reverbdb"), str(data / "measured")]))
    run(["./run.sh", *where, "--stop-stage", "0"])  # the same with noises, for the stages after it
    steps["characterise_split"] = stage(1, where)
    (out / "rooms").mkdir(parents=True, exist_ok=True)
    write_jsonl(out / "rooms/rirs.jsonl", rows(given.rirs))
    steps["simulate"] = run(["steps/simulate_rirs.sh", "--nj", "1", str(out / "rooms"), str(out / "rirs.sim")])
    stage(2, where)
    steps |= dict(fit_eq=stage(3, where), compensate=stage(4, where), close_loop=run(
        ["steps/close_loop.sh", "--nj", "1", *(str(data / f"rirs.real.{x}") for x in ("train", "dev")),
         str(exp / "loop")]))
    stage(5, where)
    steps |= dict(augment=stage(6, where), report=stage(7, where))
    counts = {path.name.removeprefix("rirs."): len(read_jsonl(path / "rirs.jsonl")) for path in data.glob("rirs.*")}
    simulated = len([row for row in read_jsonl(out / "rirs.sim/rirs.jsonl") if not row.get("noise_for")])
    hours = sum(read_json(path)["hours"] for path in data.glob("*.rvb/summary.json"))
    done = dict(prepare_speech=("utterances", sum(map(int, given.utterances.split(",")))),
                read_measured=("measured", counts["real"]),
                characterise_split=("measured", counts["real"]), simulate=("rendered", simulated),
                fit_eq=("analysed", counts["real.train"] + counts["sim.train"]),
                compensate=("simulated", counts["sim.EQ.train"] + counts["sim.EQ.dev"]),
                close_loop=("looped", counts["real.train"] + counts["real.dev"]), augment=("hours", hours),
                report=("reported", counts["real"] + sum(counts[f"{kind}.{x}"] for kind in ("sim", "sim.EQ", "sim.loop")
                                                         for x in ("train", "dev"))))
    written = dict(simulate=size(out / "rirs.sim"), compensate=sum(size(path) for path in data.glob("rirs.sim.EQ.*")),
                   augment=sum(size(path) for path in data.glob("*.rvb")))
    return {name: dict(unit=unit, done=count, cpu_s=steps[name][0], peak_mib=steps[name][1],
                       written=written.get(name, 0)) for name, (unit, count) in done.items()}


def use_augment_bench(measured, bench):
    """Take augmentation's rate, memory and disk from tests/bench/augment.py, as if it had done one hour."""
    rate = bench["times_real_time"]["roomeq_and_point_noise_for_half"]["median"]
    measured["augment"] = dict(unit="hours", done=1, cpu_s=3600 / rate, written=bench["flac_mib_per_hour"] * 2**20,
                               peak_mib=max(bench["peak_memory_mib"].values()))


def stage(number, where):
    return run(["./run.sh", *where, "--stage", str(number), "--stop-stage", str(number)])


def run(command):
    """Run a step; return CPU seconds and peak memory [MiB] of it and all that it started."""
    done = subprocess.run([sys.executable, "-c", _CHILD, *command], cwd=PROJECT, stdout=subprocess.PIPE, text=True)
    if done.returncode:
        sys.exit(f"{' '.join(command)} failed")
    return tuple(map(float, done.stdout.split()))


# a process begins with the peak of the one that started it, so that must be a small one
_CHILD = """
import resource, subprocess, sys
status = subprocess.call(sys.argv[1:], stdout=2)
usage = resource.getrusage(resource.RUSAGE_CHILDREN)
print(usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024)
sys.exit(status)
"""


def size(folder):
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def tables(measured):
    """Return the projection as Markdown: what was measured, and core-hours, disk and memory for each scale."""
    units = dict(utterances="utterance", measured="measured RIR", rendered="simulated RIR and its noise RIR",
                 simulated="simulated RIR and its noise RIR", analysed="RIR", looped="measured RIR",
                 hours="hour of far-field speech", reported="RIR")
    lines = ["| step | measured on one core | peak of a job | " + " | ".join(f"{n}×" for n in SCALES) + " |",
             "|---" * (3 + len(SCALES)) + "|"]
    total_h, total_gb = 0.0, 0.0
    for name, step in measured.items():
        each_s = step["cpu_s"] / step["done"]
        paper_h = each_s * PAPER[step["unit"]] / 3600
        total_h += paper_h
        total_gb += step["written"] / step["done"] * PAPER[step["unit"]] / 1e9
        cells = (f"{paper_h * scale:.2g}" if paper_h * scale < 100 else f"{paper_h * scale:.0f}" for scale in SCALES)
        lines.append(f"| `{name}` | {each_s:.2g} s per {units[step['unit']]} | {step['peak_mib']:.0f} MiB | "
                     + " | ".join(cells) + " |")
    lines.append("| **core-hours** | | | " + " | ".join(f"{total_h * scale:.3g}" for scale in SCALES) + " |")
    lines.append("| **disk [GB]** | | | " + " | ".join(f"{total_gb * scale:.3g}" for scale in SCALES) + " |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
