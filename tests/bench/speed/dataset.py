"""A data set: 200 responses in the nine rooms of BUT ReverbDB's size, targets met, as the recipe's stage 2 does it."""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from bench import ours, peer
from bench.kit import Check, Section
from roomeq.sim.target import decay_times_s

ROOMS_M = {  # the public room sizes of BUT ReverbDB, the stairwell included
    "Q301": (10.776, 6.94, 2.598), "L207": (4.585, 6.903, 3.144), "L212": (7.5, 4.63, 3.1),
    "L227": (6.161, 2.604, 14.275), "Room112": (4.433, 2.838, 2.637),
    "ConferenceRoom2": (28.201, 11.051, 3.331), "E112": (11.45, 20.1, 4.8),
    "D105": (17.2, 22.791, 6.9), "C236": (6.963, 4.115, 3.564)}
N_MICS = 31
JOBS = 2
_MOST_ABSORPTION = 0.99
TOLERANCE, MOST_TRIES = 0.05, 6  # of the peer's search for the absorption that meets a target
ONE_THREAD = dict.fromkeys(("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")  # as path.sh has it


def rows(count, seed=6):
    """Rows of an RIR directory: sources with up to 31 microphones each, the rooms in turn."""
    rng = np.random.default_rng(seed)
    per_room = [count // len(ROOMS_M) + (n < count % len(ROOMS_M)) for n in range(len(ROOMS_M))]
    made = []
    for (room, dims_m), wanted in zip(ROOMS_M.items(), per_room, strict=True):
        sources = [rng.uniform(0.5, np.asarray(dims_m) - 0.5) for _ in range(-(-wanted // N_MICS))]
        for n in range(wanted):
            source, mic = sources[n // N_MICS], None
            while mic is None or np.linalg.norm(mic - source) < 1.0:
                mic = rng.uniform(0.5, np.asarray(dims_m) - 0.5)
            name = f"{room}-s{n // N_MICS:02d}-m{n % N_MICS + 1:02d}"
            made.append(dict(id=name, wav=f"{name}.wav", room_id=room, room_dims_m=list(dims_m), fs_hz=ours.FS_HZ,
                             source_pos_m=list(map(float, source)), mic_pos_m=list(map(float, mic)),
                             source_id=f"s{n // N_MICS:02d}", mic_id=f"{n % N_MICS + 1:02d}", n_samples=1))
    return sorted(made, key=lambda row: row["id"])


def simulate_rows(count):
    """Run stage 2's function on `count` rows in a process of its own.

    Returns
    -------
    seconds, cpu_seconds, peak_mib : float
        Wall time of the simulation without interpreter start and imports, processor time with them, and the largest
        memory of any process.
    made : list of dict
        Rows of the responses.
    """
    with tempfile.TemporaryDirectory() as directory:
        measured, out = Path(directory, "measured"), Path(directory, "out")
        measured.mkdir()
        (measured / "rirs.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows(count)))
        spent = sum(os.times()[2:4])
        child = subprocess.Popen([sys.executable, "-c", _CHILD, str(measured), str(out), str(JOBS)], text=True,
                                 stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                                 env=os.environ | ONE_THREAD | {"PYTHONPATH": os.pathsep.join(sys.path)})
        peak_kib = 0
        while child.poll() is None:
            peak_kib = max([peak_kib, *map(_peak_kib, _family(child.pid))])
            time.sleep(0.05)
        printed, errors = child.communicate()
        if child.returncode:
            raise RuntimeError(f"the simulation of {count} rows failed: {errors.strip().splitlines()[-1]}")
        seconds, cpu_seconds = float(printed.split()[-1]), sum(os.times()[2:4]) - spent
        made = [json.loads(line) for line in (out / "rirs.jsonl").read_text().splitlines()]
    return seconds, cpu_seconds, peak_kib / 1024.0, made


def _meets(t30_s, target_s):
    return t30_s is not None and abs(t30_s / target_s - 1.0) <= TOLERANCE


_CHILD = """
import sys, time
import roomeq.simulate_rirs.directory  # as the peer is imported before its time is taken
from roomeq.simulate_rirs import simulate
start = time.perf_counter()
simulate(sys.argv[1], sys.argv[2], noise_rirs=0, nj=int(sys.argv[3]))
print(time.perf_counter() - start)
"""


def _family(pid):
    """A process and all its descendants, as far as they still run."""
    parents = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            parents[int(path.parent.name)] = int(path.read_text().rpartition(")")[2].split()[1])
        except OSError:
            continue
    family = {pid}
    while more := {child for child, parent in parents.items() if parent in family} - family:
        family |= more
    return family


def _peak_kib(pid):
    """Largest resident memory of a process so far, 0 if it is gone."""
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return 0
    return next((int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM")), 0)


def run(quick):
    """Responses per second and core, against pyroomacoustics on the same list."""
    count = 20 if quick else 200
    seconds, cpu_seconds, peak_mib, made = simulate_rows(count)
    within = 100.0 * np.mean([_meets(row["t30_s"], row["target_t60_s"]) for row in made])
    table = [["roomeq", count, seconds, cpu_seconds, count / seconds / JOBS, peak_mib, within]]
    checks = [Check("targets met within 5 %", within, low=95.0, unit="%"),
              Check("responses per second and core", count / seconds / JOBS)]
    notes = [f"roomeq: stage 2 itself, {JOBS} processes, materials and target of its own for each response, files "
             "written; the default of 10,000 rays, whose T20, EDT and C50 scatter over seeds as those of "
             "pyroomacoustics with 20,000; largest process's memory"]
    if peer.load():
        sample = made[::max(1, count // (9 if quick else 27))]
        once, until_met = _of_peer(sample)
        for name, (each, cpu_each, share) in (("once", once), ("until its target is met", until_met)):
            table.append([f"pyroomacoustics, {name}", count, each * count, cpu_each * count, 1.0 / each / JOBS, None,
                          100.0 * share])
        checks += [Check("times faster than pyroomacoustics", once[0] * count / seconds, low=20.0),
                   Check("times less processor time", once[1] * count / cpu_seconds),
                   Check("times faster than pyroomacoustics until its targets are met", until_met[0] * count / seconds,
                         low=25.0)]
        notes.append(f"pyroomacoustics: a room per response (materials differ), {len(sample)} of the list with the "
                     "same targets, one after the other on 2 threads and scaled to all; absorption by Sabine's formula "
                     "(it has no other), 8 bands, air, 20,000 rays. Until its target is met: simulated again, "
                     f"{MOST_TRIES} times at most, with -ln(1 - alpha) in proportion to T30 at 1 kHz over the target; "
                     "the time to measure T30 is not counted")
    else:
        notes.append(peer.ABSENT)
    return Section("dataset", f"{count} responses over 9 rooms, targets 0.2 to 2.0 s",
                   ["who", "responses", "s", "CPU s", "per second and core", "peak MiB", "within 5 %"], table,
                   checks, notes)


def _of_peer(made):
    """Simulate the rows with pyroomacoustics, once each, and until the targets are met.

    Returns
    -------
    once, until_met : tuple of float
        Mean seconds and processor time for a response, and the share of targets that are met.
    """
    first, last = [], []
    for row in made:
        seconds, exponent = np.zeros(2), -np.log(1.0 - _sabine(row))
        for tries in range(MOST_TRIES):
            start = np.array([time.perf_counter(), time.process_time()])
            (response,), _ = peer.hybrid(row["room_dims_m"], 1.0 - np.exp(-exponent), 0.2, row["source_pos_m"],
                                         [row["mic_pos_m"]], n_bands=8, air=True, n_rays=ours.N_RAYS)
            seconds += np.array([time.perf_counter(), time.process_time()]) - start
            _, t30_s = decay_times_s(response.rir, response.direct_sample, response.fs_hz)
            met = _meets(t30_s, row["target_t60_s"])
            if not tries:
                first.append([*seconds, met])
            if met or t30_s is None:
                break
            exponent = min(exponent * t30_s / row["target_t60_s"], -np.log(1.0 - _MOST_ABSORPTION))
        last.append([*seconds, met])
    return tuple(np.mean(first, axis=0)), tuple(np.mean(last, axis=0))


def _sabine(row):
    """Absorption coefficient by Sabine's formula, which has no solution for short times."""
    try:
        absorption, _ = peer.load().inverse_sabine(row["target_t60_s"], row["room_dims_m"])
    except ValueError:
        absorption = _MOST_ABSORPTION
    return min(absorption, _MOST_ABSORPTION)


def run_memory(quick):
    """Peak memory over the number of responses: flat."""
    counts = (9, 36) if quick else (36, 72, 144)
    table, peaks = [], []
    for count in counts:
        seconds, _, peak_mib, _ = simulate_rows(count)
        table.append([count, peak_mib, seconds])
        peaks.append(peak_mib)
    return Section("memory", "Peak memory over the number of responses", ["responses", "peak MiB", "s"], table,
                   [Check("largest over smallest", max(peaks) / min(peaks), high=1.3)],
                   curves={"responses": list(counts), "peak_mib": peaks})


def draw(axis, section):
    """Peak memory."""
    axis.plot(section.curves["responses"], np.array(section.curves["peak_mib"], dtype=float), "o-")
    axis.set(title="memory: largest process", xlabel="responses", ylabel="MiB", ylim=(0, None))
