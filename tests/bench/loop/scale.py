#!/usr/bin/env python3
"""Measure time and memory of the closed loop over the number of RIRs, in generated rooms with eight RIRs each.

e.g.: python tests/bench/loop/scale.py --out exp/bench                # 250, 500 and 1,000 RIRs: half an hour
      python tests/bench/loop/scale.py --out exp/bench --rooms 8,16   # a look

The rooms hold an undeclared loudspeaker response and noise floor (`tests/testbed`), so that the loop adds effects as it
does on recordings. Each size is closed in a process of its own with `--nj` jobs; rooms are generated before the clock
starts. Memory is that of all processes, shared pages counted once.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

for variable in ("OMP", "OPENBLAS", "MKL", "NUMBA"):  # as in path.sh: the loop has processes
    os.environ.setdefault(f"{variable}_NUM_THREADS", "1")
ROOT = Path(__file__).resolve().parents[3]
sys.path[:1] = [str(ROOT / name) for name in ("pysrc", "tests")]

from bench.kit import machine, table  # noqa: E402
from bench.memory import PeakMemory  # noqa: E402
from roomeq.loop.ledger import added_effects  # noqa: E402
from testbed import make_room_set  # noqa: E402

KIND, STRENGTH_JND, SEED = "noise_floor+source_response", 2, 901
PER_ROOM = 8


def measure(n_rooms, nj):
    """Return RIRs, wall and CPU seconds, peak memory [GiB] and the effects that were added."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_room_set(KIND, STRENGTH_JND, SEED, folder, n_fit=n_rooms, n_judge=0)
        start, cpu = time.perf_counter(), sum(os.times()[2:4])
        with PeakMemory() as memory:
            subprocess.run([sys.executable, "-m", "roomeq", "close-loop", "--nj", str(nj), "--out", folder / "loop",
                            folder / "fit"], check=True,
                           env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)})
        wall_s, cpu_s = time.perf_counter() - start, sum(os.times()[2:4]) - cpu
        ledger = json.loads((folder / "loop" / "ledger.json").read_text())
    return [PER_ROOM * n_rooms, n_rooms, wall_s, cpu_s, memory.gib,
            ", ".join(entry["effect"] for entry in added_effects(ledger))]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", default="31,62,125", help="numbers of rooms, with eight RIRs each")
    parser.add_argument("--nj", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("exp/bench"))
    given = parser.parse_args()
    rows = [measure(int(n_rooms), given.nj) for n_rooms in given.rooms.split(",")]
    print(table(["RIRs", "rooms", "s", "CPU s", "peak GiB", "added"], rows))
    given.out.mkdir(parents=True, exist_ok=True)
    (given.out / "loop_scale.json").write_text(json.dumps(dict(machine=machine(), nj=given.nj, rows=rows), indent=1)
                                               + "\n")


if __name__ == "__main__":
    main()
