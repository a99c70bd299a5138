"""A high-pass filter, without the half second that the import of `scipy.signal` takes."""

import numpy as np
from scipy.fft import rfftfreq

from roomeq.core.arrays import Array


def high_pass(n_fft: int, fs_hz: float, lowest_hz: float) -> Array:
    """Return the spectrum of a Butterworth high-pass of fourth order, shape (n_fft // 2 + 1,), complex.

    Bilinear transform of the low-pass prototype ``1 / prod(p - pole)`` with ``p = w_c / s``; 3 dB down at `lowest_hz`.
    """
    poles = np.exp(0.125j * np.pi * np.array([5.0, 7.0, 9.0, 11.0]))
    warped = np.tan(np.pi * rfftfreq(n_fft, 1.0 / fs_hz)[1:] / fs_hz)
    prototype = -1j * np.tan(np.pi * lowest_hz / fs_hz) / warped
    return np.concatenate([[0.0], 1.0 / np.prod(prototype[:, None] - poles, axis=1)])
