"""Simulate many drawn rooms with an array of eight microphones, beside pyroomacoustics on some of the same rooms.

    python tests/bench/many_rooms.py --rooms 10000 --out exp/bench

Both use two processes. The rooms are shoeboxes with one source, one array and a reverberation time at 1 kHz; both sides
have octave bands and air. pyroomacoustics gets the absorption at 1 kHz that ours ended with, 20,000 rays, and image
sources to order 3, where ours have order 6. It simulates `--peer-rooms` of the rooms, half of them before and
half after ours: the speed of a shared machine drifts.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from bench import peer
from bench.kit import machine, table
from bench.memory import PeakMemory

JOBS = 2
ROOM_TYPES = """
[office]
floor_area_m2 = {median = 30, spread = 1.8, low = 9, high = 150}
aspect = [1.0, 2.0]
height_m = [2.4, 4.0]
t60_s = [0.2, 1.2]
source_mic_distance_m = 0.5
[[office.sources]]
height_m = [1.1, 1.75]
directivity = "omnidirectional"
[[office.microphones]]
height_m = [0.7, 1.5]
array_m = [[0.05, 0, 0], [0.035, 0.035, 0], [0, 0.05, 0], [-0.035, 0.035, 0],
           [-0.05, 0, 0], [-0.035, -0.035, 0], [0, -0.05, 0], [0.035, -0.035, 0]]
"""


def cpu_s():
    return sum(os.times()[:4])


def simulate(folder, n_rooms, out):
    """Run `roomeq simulate`."""
    (folder / "types.toml").write_text(ROOM_TYPES)
    subprocess.run([sys.executable, "-m", "roomeq", "simulate", "--rooms", str(n_rooms), "--room-types",
                    folder / "types.toml", "--noise-rirs", "0", "--nj", str(JOBS), folder / out], check=True)


def read_rows(directory):
    with open(directory / "rirs.jsonl") as stream:
        return [json.loads(line) for line in stream]


@dataclass
class Spent:
    """Wall time, CPU time and the highest peak memory of some work."""

    wall_s: float = 0.0
    cpu_s: float = 0.0
    peak_gib: float = 0.0

    @contextmanager
    def measure(self):
        start, cpu = time.perf_counter(), cpu_s()
        with PeakMemory() as memory:
            yield
        self.wall_s += time.perf_counter() - start
        self.cpu_s += cpu_s() - cpu
        self.peak_gib = max(self.peak_gib, memory.gib)


def theirs(row):
    """Simulate the room of a row with pyroomacoustics; return its CPU time."""
    absorption = np.array([row["materials"][wall]["absorption"][4] for wall in
                           ("west", "east", "south", "north", "floor", "ceiling")])
    cpu = cpu_s()
    peer.hybrid(row["room_dims_m"], absorption, 0.2, row["source_pos_m"], row["channel_pos_m"], n_bands=8, threads=1,
                air=True)
    return cpu_s() - cpu


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", type=int, default=10000)
    parser.add_argument("--peer-rooms", type=int, default=80)
    parser.add_argument("--out", type=Path, default=Path("exp/bench"))
    chosen = parser.parse_args()
    for name in ("NUMBA", "OMP", "OPENBLAS"):
        os.environ[f"{name}_NUM_THREADS"] = "1"
    ours, peers, n_peers = Spent(), Spent(), chosen.peer_rooms if peer.load() else 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        simulate(folder, max(chosen.peer_rooms, 1), "some")  # the same rooms; compiles the kernels, too
        some = read_rows(folder / "some")
        for turn in range(2):
            if n_peers:
                with peers.measure(), ProcessPoolExecutor(JOBS) as pool:
                    list(pool.map(theirs, some[turn:n_peers:2]))
            if turn == 0:
                with ours.measure():
                    simulate(folder, chosen.rooms, "rirs")
        rows = read_rows(folder / "rirs")
    met = np.mean([abs(row["t30_s"] / row["target_t60_s"] - 1.0) <= 0.05 for row in rows if row["t30_s"]])
    lines = [[who, n, spent.wall_s, n / spent.wall_s, spent.cpu_s / n, spent.peak_gib]
             for who, n, spent in (("roomeq", chosen.rooms, ours), ("pyroomacoustics", n_peers, peers)) if n]
    result = dict(machine=machine(), rooms=chosen.rooms, ours=asdict(ours), within_5_percent=float(met))
    if n_peers:
        result |= dict(peer_rooms=n_peers, peer=asdict(peers), times_faster=lines[0][3] / lines[1][3])
    print(table(["who", "rooms", "s", "rooms/s", "CPU s a room", "peak GiB"], lines))
    print(f"T30 of the first microphone within 5 % of the target of the array: {met:.1%} of the rooms")
    print(f"{result['times_faster']:.1f} times as many rooms/s" if "peer" in result else peer.ABSENT)
    chosen.out.mkdir(parents=True, exist_ok=True)
    (chosen.out / "many_rooms.json").write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
