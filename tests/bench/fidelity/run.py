#!/usr/bin/env python
"""How right the simulator is: rooms and octaves against a reference, levels, paths, diffraction, air, tail, targets.

Prints a table per section, with pyroomacoustics beside ours where it is installed, and writes fidelity.json and
fidelity.png.

e.g.: python tests/bench/fidelity/run.py --out exp/bench
      python tests/bench/fidelity/run.py --quick --only decay,early
"""

import sys
from pathlib import Path

sys.path[:1] = [str(Path(__file__).resolve().parents[n] / name) for n, name in ((3, "pysrc"), (2, ""))]

from bench.threads import use_threads  # noqa: E402

use_threads()

from bench import kit  # noqa: E402
from bench.fidelity import (  # noqa: E402
    air,
    balance,
    check,
    decay,
    diffraction,
    early,
    level,
    lshape,
    octaves,
    samples,
    tail,
    targets,
)

SECTIONS = {"reference": check.run, "decay": decay.run, "unequal": decay.run_unequal, "octaves": octaves.run,
            "early": early.run, "lshape": lshape.run, "diffraction": diffraction.run, "level": level.run,
            "air": air.run, "balance": balance.run, "tail": tail.run, "targets": targets.run, "samples": samples.run}
FIGURES = {"decay": decay.draw, "unequal": decay.draw, "level": level.draw, "air": air.draw, "balance": balance.draw,
           "tail": tail.draw, "targets": targets.draw}


def main():
    """Run the chosen sections."""
    chosen = kit.arguments(__doc__, SECTIONS)
    kit.run_sections("fidelity", SECTIONS, chosen, FIGURES)


if __name__ == "__main__":
    main()
