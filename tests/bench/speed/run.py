#!/usr/bin/env python
"""How fast the simulator is: one response, 31 microphones, meshes, new materials, a data set, curves, ray queries.

Everything runs in one process tree on two threads, pyroomacoustics beside ours where it is installed. Prints a table
per section and writes speed.json and speed.png.

e.g.: python tests/bench/speed/run.py --out exp/bench
      python tests/bench/speed/run.py --quick --only single
"""

import sys
from pathlib import Path

sys.path[:1] = [str(Path(__file__).resolve().parents[n] / name) for n, name in ((3, "pysrc"), (2, ""))]

from bench.threads import use_threads  # noqa: E402

use_threads()

from bench import kit  # noqa: E402
from bench.speed import curves, dataset, queries, single  # noqa: E402

SECTIONS = {"single": single.run, "stages": single.run_stages, "dataset": dataset.run, "memory": dataset.run_memory,
            "curves": curves.run, "queries": queries.run}
FIGURES = {"single": single.draw, "curves": curves.draw, "memory": dataset.draw}


def main():
    """Run the chosen sections."""
    chosen = kit.arguments(__doc__, SECTIONS)
    kit.run_sections("speed", SECTIONS, chosen, FIGURES)


if __name__ == "__main__":
    main()
