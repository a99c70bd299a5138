"""Simulate many drawn rooms with an array of eight microphones, beside pyroomacoustics on some of the same rooms.

    python tests/bench/many_rooms.py --rooms 10000 --out exp/bench

Both use two processes. The rooms are shoeboxes with one source, one array and a reverberation time at 1 kHz; both sides
have octave bands and air. pyroomacoustics gets the absorption at 1 kHz that ours ended with, 20,000 rays, and image
sources to order 3, where ours have order 6. `--peer-rooms` of the rooms are measured and scaled to all.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
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


def ours(folder, n_rooms):
    """Run `roomeq simulate`; return wall time, CPU time, peak memory, and the rows."""
    (folder / "types.toml").write_text(ROOM_TYPES)
    subprocess.run([sys.executable, "-m", "roomeq.compile_kernels"], check=True)
    start, cpu = time.perf_counter(), cpu_s()
    with PeakMemory() as memory:
        subprocess.run([sys.executable, "-m", "roomeq", "simulate", "--rooms", str(n_rooms), "--room-types",
                        folder / "types.toml", "--noise-rirs", "0", "--nj", str(JOBS), folder / "rirs"], check=True)
    seconds = time.perf_counter() - start
    with open(folder / "rirs/rirs.jsonl") as stream:
        rows = [json.loads(line) for line in stream]
    return seconds, cpu_s() - cpu, memory.gib, rows


def theirs(row):
    """Simulate the room of a row with pyroomacoustics; return wall time and CPU time."""
    absorption = np.array([row["materials"][wall]["absorption"][4] for wall in
                           ("west", "east", "south", "north", "floor", "ceiling")])
    start, cpu = time.perf_counter(), cpu_s()
    peer.hybrid(row["room_dims_m"], absorption, 0.2, row["source_pos_m"], row["channel_pos_m"], n_bands=8, threads=1,
                air=True)
    return time.perf_counter() - start, cpu_s() - cpu


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", type=int, default=10000)
    parser.add_argument("--peer-rooms", type=int, default=40)
    parser.add_argument("--out", type=Path, default=Path("exp/bench"))
    chosen = parser.parse_args()
    for name in ("NUMBA", "OMP", "OPENBLAS"):
        os.environ[f"{name}_NUM_THREADS"] = "1"
    with tempfile.TemporaryDirectory() as folder:
        seconds, cpu, gib, rows = ours(Path(folder), chosen.rooms)
    met = np.mean([abs(row["t30_s"] / row["target_t60_s"] - 1.0) <= 0.05 for row in rows if row["t30_s"]])
    lines = [["roomeq", chosen.rooms, seconds, chosen.rooms / seconds, cpu / chosen.rooms, gib]]
    result = dict(machine=machine(), rooms=chosen.rooms, ours=dict(wall_s=seconds, cpu_s=cpu, peak_gib=gib))
    if peer.load():
        sample = rows[::max(1, len(rows) // chosen.peer_rooms)][:chosen.peer_rooms]
        start = time.perf_counter()
        with PeakMemory() as memory, ProcessPoolExecutor(JOBS) as pool:
            spent = list(pool.map(theirs, sample))
        wall = time.perf_counter() - start
        scale = chosen.rooms / len(sample)
        cpu_each = float(np.mean([one for _, one in spent]))
        lines.append(["pyroomacoustics", len(sample), wall, len(sample) / wall, cpu_each, memory.gib])
        result |= dict(peer_rooms=len(sample), peer=dict(wall_s=wall, cpu_s=cpu_each * len(sample),
                                                         peak_gib=memory.gib), times_faster=scale * wall / seconds)
    print(table(["who", "rooms", "s", "rooms/s", "CPU s a room", "peak GiB"], lines))
    print(f"T30 of the first microphone within 5 % of the target of the array: {met:.1%} of the rooms")
    print(f"{result['times_faster']:.1f} times as many rooms/s" if "peer" in result else peer.ABSENT)
    chosen.out.mkdir(parents=True, exist_ok=True)
    (chosen.out / "many_rooms.json").write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
