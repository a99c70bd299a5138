"""The number of threads that both sides of a comparison use; to be set before they are imported."""

import os
import sys

THREADS = 2


def use_threads() -> None:
    """Let numba, OpenMP and pyroomacoustics use `THREADS` threads, whatever the environment says (path.sh says one)."""
    count = str(min(THREADS, len(os.sched_getaffinity(0))))
    os.environ.update({f"{library}_NUM_THREADS": count for library in ("NUMBA", "OMP", "PRA")})
    if "numba" in sys.modules:  # it would notice at the next compilation, and refuse if its threads run by then
        sys.modules["numba"].config.reload_config()
