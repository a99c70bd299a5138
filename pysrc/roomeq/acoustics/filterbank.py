"""Zero-phase octave filter bank whose bands add up to one: what a simulated response is put together with."""

from functools import lru_cache

import numpy as np

from roomeq.constants import EXACT_BANDS_HZ


@lru_cache(maxsize=16)
def octave_filterbank(n_fft, fs_hz):
    """Amplitude responses of the eight complementary octave bands.

    Between two neighbouring mid-band frequencies the gains are ``cos^2`` and ``sin^2`` of log frequency, so
    that they add up to exactly one; the lowest band takes everything below, the highest everything above.

    Parameters
    ----------
    n_fft : int
        Length of the transform.
    fs_hz : float

    Returns
    -------
    gains : ndarray, shape (8, n_fft // 2 + 1)
        Read-only.
    """
    frequency = np.maximum(np.fft.rfftfreq(n_fft, 1.0 / fs_hz), 1e-3)
    position = np.interp(np.log2(frequency), np.log2(EXACT_BANDS_HZ), np.arange(len(EXACT_BANDS_HZ)))
    distance = np.abs(position - np.arange(len(EXACT_BANDS_HZ))[:, None])
    gains = np.cos(0.5 * np.pi * np.minimum(distance, 1.0)) ** 2
    gains.flags.writeable = False
    return gains
