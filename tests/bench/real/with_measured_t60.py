#!/usr/bin/env python3
"""Write the rows of an RIR directory with the measured T20 of each RIR as the T60 that a simulation is scaled to.

Usage: tests/bench/real/with_measured_t60.py RIR_DIR OUT
e.g.:  tests/bench/real/with_measured_t60.py data/rirs.real.train exp/with_t60 && roomeq simulate exp/with_t60 rirs

RIRs whose T20 at 1 kHz is not known are left out.
"""

import argparse
import sys
from pathlib import Path

sys.path[:1] = [str(Path(__file__).resolve().parents[3] / "pysrc")]

from roomeq.core.constants import BAND_1KHZ  # noqa: E402
from roomeq.records.rir_dir import read_rirs, write_rirs  # noqa: E402


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rirs", type=Path, metavar="RIR_DIR")
    parser.add_argument("out", type=Path, metavar="OUT")
    given = parser.parse_args()
    rows = [dict(row, target_t60_s=row["acoustic_parameters"]["t20_s"][BAND_1KHZ]) for row in read_rirs(given.rirs)
            if not row.get("noise_for") and row["acoustic_parameters"]["t20_valid"][BAND_1KHZ]]
    given.out.mkdir(parents=True, exist_ok=True)
    write_rirs(given.out, rows)


if __name__ == "__main__":
    main()
