"""The memory of a process and its descendants together, where pages that they share count once."""

import os
import threading
from pathlib import Path

INTERVAL_S = 1.0


class PeakMemory:
    """Context that samples the memory of this process and all its descendants.

    Attributes
    ----------
    gib : float
        Largest sum of their proportional set sizes (`proc_pid_smaps_rollup`) [GiB]. The resident set sizes would count
        the pages that forked workers share with their parent again for each of them.
    """

    def __init__(self):
        self.gib = 0.0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._sample, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._ended.set()
        self._thread.join()

    def _sample(self):
        while True:
            self.gib = max(self.gib, sum(_pss_gib(pid) for pid in _tree(os.getpid())))
            if self._ended.wait(INTERVAL_S):
                return


def _tree(pid):
    """Return the process and its descendants."""
    found = [pid]
    for parent in found:
        for children in Path(f"/proc/{parent}/task").glob("*/children"):
            try:
                found += [int(child) for child in children.read_text().split()]
            except OSError:  # it has ended
                continue
    return found


def _pss_gib(pid):
    try:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0.0
    return sum(float(line.split()[1]) for line in lines if line.startswith("Pss:")) / 2 ** 20
