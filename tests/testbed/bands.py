"""Octave bands that add up to one."""

from functools import lru_cache

import numpy as np

from testbed.draws import FS_HZ, N_BANDS, OCTAVES_HZ

WIDTH_OCTAVES = 0.5  # of the raised-cosine crossover between neighbours


@lru_cache(maxsize=4)
def band_gains(n_fft):
    """Zero-phase gains of the eight bands, shape (8, n_fft // 2 + 1): lowest and highest reach to the ends."""
    octave = np.log2(np.maximum(np.fft.rfftfreq(n_fft, 1.0 / FS_HZ), 1e-3) / OCTAVES_HZ[0])
    edges = np.arange(N_BANDS - 1) + 0.5
    ramp = np.clip((octave - edges[:, None]) / WIDTH_OCTAVES + 0.5, 0.0, 1.0)
    above = 0.5 - 0.5 * np.cos(np.pi * ramp)
    return -np.diff(above, axis=0, prepend=1.0, append=0.0)
