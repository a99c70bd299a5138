#!/usr/bin/env python
"""How long people wait: for a first RIR in a new process, for the recipe in a new clone, and for the closed loop.

The recipe is cloned from HEAD and installs its packages, so it needs a network. Nothing else should run meanwhile.

e.g.: python tests/bench/waiting.py --out exp/bench
      python tests/bench/waiting.py --only first_rir --quick
"""

import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

for variable in ("OMP", "OPENBLAS", "MKL", "NUMBA"):  # as in path.sh: the recipe and the loop have processes
    os.environ.setdefault(f"{variable}_NUM_THREADS", "1")
ROOT = Path(__file__).resolve().parents[2]
sys.path[:1] = [str(ROOT / name) for name in ("pysrc", "tests")]

from bench import kit, peer  # noqa: E402
from testbed import make_room_set  # noqa: E402

JOBS = 2
FIRST_RIR = {
    "roomeq": "import roomeq; roomeq.simulate_rir(roomeq.Room((6, 4, 3), t60_s=0.6), source=(2, 1.5, 1.5), "
              "mics=[(4, 3, 1.2)], fs=16000)",
    "pyroomacoustics": "import pyroomacoustics as pra; absorption, order = pra.inverse_sabine(0.6, [6, 4, 3]); "
                       "room = pra.ShoeBox([6, 4, 3], fs=16000, materials=pra.Material(absorption), max_order=3, "
                       "ray_tracing=True, air_absorption=True); room.set_ray_tracing(n_rays=20000); "
                       "room.add_source([2, 1.5, 1.5]); room.add_microphone([4, 3, 1.2]); room.compute_rir()"}
KINDS = ("clean", "source_response", "source_directivity", "room_modes", "coupled_volume", "noise_floor",
         "air_absorption", "source_response+room_modes")
STRENGTH_JND, SEED = 2, 902
N_ROOMS = 8  # of eight RIRs each


def run_first_rir(quick):
    """Simulate one RIR in a new process, in turns with pyroomacoustics, and without compiled code in the cache."""
    section = kit.Section("first_rir", "One RIR in a new process", ["simulator", "median s", "minimum s", "maximum s"])
    chosen = ["roomeq", *(["pyroomacoustics"] if peer.load() else [])]
    spent = {name: [] for name in chosen}
    for n in range(2 if quick else 8):
        for name in chosen:
            seconds = _seconds([sys.executable, "-c", FIRST_RIR[name]], {})
            if n:  # the first one of all may have to compile
                spent[name].append(seconds)
    with tempfile.TemporaryDirectory() as cache:
        compiled_s = _seconds([sys.executable, "-c", FIRST_RIR["roomeq"]], {"NUMBA_CACHE_DIR": cache})
    section.rows = [[name, float(np.median(seconds)), min(seconds), max(seconds)] for name, seconds in spent.items()]
    section.rows.append(["roomeq, which has to compile", compiled_s, None, None])
    section.checks.append(kit.Check("first RIR", section.rows[0][1], high=3.0, unit="s"))
    section.notes.append("Same room, 0.6 s; roomeq meets the time and traces 10,000 rays with octave bands, "
                         "pyroomacoustics takes Sabine's formula, one absorption coefficient and 20,000 rays."
                         if peer.load() else peer.ABSENT)
    return section


def _seconds(command, variables):
    start = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True,
                          env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)} | variables)
    if done.returncode:
        raise RuntimeError(f"{command[0]} failed:\n{done.stderr}")
    return time.perf_counter() - start


def run_recipe(quick):
    """Run the recipe in a new clone, with the smallest configuration for a quick look."""
    section = kit.Section("recipe", "`./run.sh` in a new clone", ["stage", "what", "s"])
    with tempfile.TemporaryDirectory() as folder:
        clone = Path(folder) / "roomeq"
        subprocess.run(["git", "clone", "-q", ROOT, clone], check=True)
        config = ["--config", "conf/smallest.conf"] if quick else []
        begun = [(time.perf_counter(), "-", "install packages")]
        with subprocess.Popen(["./run.sh", "--nj", str(JOBS), *config], cwd=clone, text=True, stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT) as run:
            lines = []
            for line in run.stdout:
                lines.append(line)
                if stage := re.search(r"run\.sh: stage (\d+): (.*)", line):
                    begun.append((time.perf_counter(), *stage.groups()))
        if run.returncode:
            raise RuntimeError(f"./run.sh failed in {clone}:\n{''.join(lines[-20:])}")
        ends = [at for at, *_ in begun[1:]] + [time.perf_counter()]
    section.rows = [[stage, what, end - at] for (at, stage, what), end in zip(begun, ends, strict=True)]
    loop_s = next(seconds for stage, _, seconds in section.rows if stage == "5")
    total_s = ends[-1] - begun[0][0]
    section.checks += [kit.Check("all stages, with the installation", total_s, high=300.0, unit="s"),
                       kit.Check("stage 5, which closes the loop", loop_s, high=90.0, unit="s")]
    return section


def run_loop(quick):
    """Close the loop on sets of 64 generated RIRs, one after the other."""
    section = kit.Section("loop", f"Closed loop on {8 * N_ROOMS} generated RIRs, {JOBS} processes",
                          ["undeclared effect", "s", "CPU s"])
    for kind in KINDS[:2] if quick else KINDS:
        with tempfile.TemporaryDirectory() as folder:
            make_room_set(kind, STRENGTH_JND, SEED, Path(folder), n_fit=N_ROOMS, n_judge=0)
            cpu = sum(os.times()[2:4])
            seconds = _seconds([sys.executable, "-m", "roomeq", "close-loop", "--nj", str(JOBS), "--out",
                                f"{folder}/loop", f"{folder}/fit"], {})
            section.rows.append([kind, seconds, sum(os.times()[2:4]) - cpu])
    seconds = [row[1] for row in section.rows]
    section.checks += [kit.Check("closed loop, 64 RIRs, median", float(np.median(seconds)), high=20.0, unit="s"),
                       kit.Check("closed loop, 64 RIRs, slowest", max(seconds), high=40.0, unit="s")]
    return section


SECTIONS = {"first_rir": run_first_rir, "recipe": run_recipe, "loop": run_loop}


def draw(axis, section):
    """Draw a bar of seconds for each row."""
    columns = section.columns
    at = next(n for n, column in enumerate(columns) if column in ("s", "median s"))
    axis.barh([" ".join(str(cell) for cell in row[:at]) for row in section.rows], [row[at] for row in section.rows])
    axis.invert_yaxis()
    axis.set(title=section.title, xlabel="s")
    axis.tick_params(axis="y", labelsize=6)


def main():
    """Run the chosen sections."""
    chosen = kit.arguments(__doc__, SECTIONS)
    kit.run_sections("waiting", SECTIONS, chosen, dict.fromkeys(SECTIONS, draw))


if __name__ == "__main__":
    main()
