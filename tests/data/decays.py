"""Decay time of one octave band."""

import numpy as np

from roomeq.acoustics.direct import find_direct
from roomeq.acoustics.iso3382 import decay_time, octave_decays


def reverberation_time(rir, fs_hz, band_hz=1000.0, decay="t30", *, direct_sample=None):
    """Return the decay time ("edt", "t20" or "t30") in the octave about `band_hz` [s]."""
    if direct_sample is None:
        direct_sample, _ = find_direct(rir, fs_hz)
    exact_hz = 1000.0 * 10.0 ** (0.3 * round(np.log2(band_hz / 1000.0)))
    (curve,) = octave_decays(np.asarray(rir, dtype=np.float64), fs_hz, direct_sample, [exact_hz])
    return decay_time(curve.edc_db, fs_hz, decay)
