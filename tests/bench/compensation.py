#!/usr/bin/env python3
"""Measure how near compensation brings the EQ of simulated RIRs to that of held-out measured RIRs.

Usage: tests/bench/compensation.py --out DIR DATA_DIR
e.g.:  ./run.sh --measured RIRS --stop-stage 4 && tests/bench/compensation.py --out exp/bench data
The EQ is measured at the eight points that compensation corrects, and independently of them as the energy in each
octave of the whole response. Also measures how far an onset that is 10 samples off changes the EQ of the measured RIRs.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

PROJECT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(PROJECT / name) for name in ("pysrc", "tests")]

from bench import kit  # noqa: E402
from roomeq.acoustics.subband_eq import analyse, eq_part  # noqa: E402
from roomeq.core.constants import BAND_1KHZ, BANDS_HZ, FS_HZ  # noqa: E402
from roomeq.core.files import write_json  # noqa: E402
from roomeq.eq.distance import EqSet, gap_closed  # noqa: E402
from roomeq.records.rir_dir import load_rir, read_rirs  # noqa: E402

SETS = ("sim.train", "sim.EQ.train", "real.train", "real.test")
FREE = [n for n in range(len(BANDS_HZ)) if n != BAND_1KHZ]
TO_4KHZ = slice(0, 6)
SHIFTS = (-10, -5, 5, 10)


def eq_points_db(rir, direct_sample):
    """EQ at the eight points, shape (8,)."""
    return analyse(rir, direct_sample).eq_db


def octave_levels_db(rir, direct_sample):
    """Energy density in each octave of the whole response relative to that at 1 kHz, shape (8,) [dB]."""
    start, stop = eq_part(rir, direct_sample)
    power = np.abs(np.fft.rfft(rir[start:stop], 1 << 17)) ** 2
    f_hz = np.fft.rfftfreq(1 << 17, 1 / FS_HZ)
    level_db = np.array([10 * np.log10(power[(f_hz >= hz / 2**0.5) & (f_hz < hz * 2**0.5)].mean()) for hz in BANDS_HZ])
    return level_db - level_db[BAND_1KHZ]


def main():
    """Measure, print, and write compensation.json."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data_dir", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    rirs, rooms = {}, {}
    for name in SETS:
        directory = given.data_dir / f"rirs.{name}"
        rows = [row for row in read_rirs(directory) if not row.get("noise_for") and not row.get("screen")]
        rirs[name] = [(load_rir(directory, row), row["acoustic_parameters"]["direct_sample"]) for row in rows]
        rooms[name] = [row["room_id"] for row in rows]
    distances = []
    for measure, label in ((eq_points_db, "EQ points"), (octave_levels_db, "octave energy")):
        eq_db = {name: np.array([measure(*pair) for pair in pairs])[:, FREE] for name, pairs in rirs.items()}
        for bands, range_hz in ((slice(None), "62.5 Hz to 8 kHz"), (TO_4KHZ, "62.5 Hz to 4 kHz")):
            gap = gap_closed(*(EqSet(eq_db[name][:, bands], rooms[name]) for name in SETS), np.random.default_rng(0))
            interval = gap["closed_interval"]
            limits = f" [{100 * interval[0]:.0f}, {100 * interval[1]:.0f}]" if interval else ""
            distances.append([label, range_hz, *(gap[key]["wasserstein_db"] for key in ("sim", "comp", "floor")),
                              f"{100 * gap['closed']:.0f} %{limits}",
                              f"{100 * gap['closed_energy']:.0f} %"])
    measured = rirs["real.train"] + rirs["real.test"]
    changes = np.array([max(np.abs(eq_points_db(rir, at + shift) - eq_points_db(rir, at)).max()
                            for shift in SHIFTS if at + shift > 0) for rir, at in measured])
    result = dict(machine=kit.machine(), tables=[
        dict(title="Mean Wasserstein distance to held-out measured RIRs [dB]", rows=distances,
             columns=["EQ measured by", "bands", "simulated", "compensated", "measured training set",
                      "gap closed [95 % interval]", "by the energy distance"],
             notes=[f"{len(rirs['real.test'])} held-out and {len(rirs['real.train'])} training RIRs of "
                    f"{len(set(rooms['real.train'] + rooms['real.test']))} rooms, split by RIR. The gap lies between "
                    "the simulated RIRs and the measured training set, which is as near as a model of it can come."]),
        dict(title="Largest change of the EQ by an onset error of up to 10 samples [dB]", columns=["RIRs", "median",
             "95th percentile", "worst"], rows=[[len(changes), *map(float, np.percentile(changes, (50, 95, 100)))]])])
    for table in result["tables"]:
        print(f"\n{table['title']}\n{kit.table(table['columns'], table['rows'])}")
    write_json(given.out / "compensation.json", result)


if __name__ == "__main__":
    main()
