"""Draw the README's figure: the EQ of measured, simulated and compensated RIRs of a run.

Usage: python docs/figures/make_eq_figure.py data docs/figures/eq.svg
"""

import sys
from pathlib import Path

import matplotlib
import numpy as np

from roomeq.acoustics.subband_eq import analyse
from roomeq.core.constants import BANDS_HZ
from roomeq.records.rir_dir import load_rir, read_rirs

SETS = (("measured, held out", "rirs.real.test", "#1f77b4"), ("simulated", "rirs.sim.train", "#d62728"),
        ("compensated", "rirs.sim.EQ.train", "#2ca02c"))


def eq_db(directory: Path) -> np.ndarray:
    """Return the EQ of the RIRs of a directory that are not screened, shape (n, 8)."""
    rows = [row for row in read_rirs(directory) if not row.get("noise_for") and not row.get("screen")]
    return np.array([analyse(load_rir(directory, row), row["acoustic_parameters"]["direct_sample"]).eq_db
                     for row in rows])


def main(data: Path, out: Path) -> None:
    """Draw the median and the range from the 10th to the 90th percentile of each set."""
    matplotlib.use("svg")
    matplotlib.rcParams.update({"svg.hashsalt": "roomeq", "font.size": 10})
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(7.2, 3.2), layout="constrained")
    for label, name, colour in SETS:
        low, middle, high = np.percentile(eq_db(data / name), (10, 50, 90), axis=0)
        axes.fill_between(BANDS_HZ, low, high, color=colour, alpha=0.15, linewidth=0)
        axes.semilogx(BANDS_HZ, middle, "o-", color=colour, label=label)
    axes.set_xticks(BANDS_HZ, [f"{hz:g}" for hz in BANDS_HZ])
    axes.minorticks_off()
    axes.set(xlabel="Frequency (Hz)", ylabel="Level relative to 1 kHz (dB)")
    axes.legend(title="median, 10 to 90 %")
    figure.savefig(out, metadata={"Date": None})


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
