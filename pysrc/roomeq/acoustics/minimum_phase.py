"""Causal filters of minimum phase from a magnitude response."""

from collections.abc import Sequence

import numpy as np

from roomeq.core.arrays import FloatArray
from roomeq.core.constants import FS_HZ


def minimum_phase(frequencies_hz: Sequence[float] | FloatArray, gains_db: Sequence[float] | FloatArray,
                  n_taps: int = 2048, fs_hz: float = FS_HZ) -> FloatArray:
    """Design a causal minimum-phase filter from a magnitude response, interpolated in dB over log frequency.

    The phase follows from the real cepstrum (Oppenheim and Schafer, Discrete-Time Signal Processing, 3rd ed.,
    sec. 13.3). Loudspeakers and microphones are close to minimum phase.

    Parameters
    ----------
    frequencies_hz : array_like, shape (n,)
        Ascending.
    gains_db : array_like, shape (n,)
        Gain at each frequency; constant beyond the ends.
    n_taps : int
        Length of the transform.
    fs_hz : float

    Returns
    -------
    taps : ndarray, shape (n_taps // 2,)
    """
    frequency = np.fft.rfftfreq(n_taps, 1.0 / fs_hz)
    log_gain = np.interp(np.log(np.maximum(frequency, 1.0)), np.log(frequencies_hz), gains_db) * np.log(10.0) / 20.0
    cepstrum = np.fft.irfft(log_gain, n_taps)
    cepstrum[1:n_taps // 2] *= 2.0
    cepstrum[n_taps // 2 + 1:] = 0.0
    return np.fft.irfft(np.exp(np.fft.rfft(cepstrum)), n_taps)[:n_taps // 2]
