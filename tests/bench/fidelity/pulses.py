"""Read arrival and level of known pulses out of a rendered response, whatever kernel they were rendered with."""

import numpy as np
from scipy.signal import butter, sosfilt

CUTOFF = 0.8  # of the Nyquist frequency: above it, windowed-sinc kernels differ
HALF_WIDTH = 48  # samples


def fit_pulses(rir, delays, gains, cut_hz=None):
    """Fit amplitude and shift of those pulses that stand alone, all others being taken as they should be.

    The response is low-passed, which turns any band-limited pulse into the low-pass filter itself, and what is
    left after the expected pulses is fitted with ``a h(n - d) + b h'(n - d)`` per pulse: amplitude a more, and
    later by -b over the amplitude.

    Parameters
    ----------
    rir : ndarray, shape (n_samples,)
    delays, gains : ndarray, shape (n_pulses,)
        As they should be [samples; pressure].
    cut_hz : tuple of float, optional
        Frequency below which a Butterworth high-pass of fourth order should cut off all pulses but the first, and the
        sample rate.

    Returns
    -------
    level_db, shift : ndarray, shape (n_alone,)
        Measured relative to expected; shift in samples.
    """
    n_samples = min(len(rir), int(np.max(delays)) + HALF_WIDTH)
    taps = kernel(np.arange(-HALF_WIDTH, HALF_WIDTH + 1.0))
    smooth = np.convolve(np.asarray(rir, dtype=float)[:n_samples + HALF_WIDTH], taps)
    offset = np.arange(n_samples)[:, None] - np.asarray(delays)[None, :]
    expected = kernel(offset) * gains
    if cut_hz is not None:
        frequency_hz, fs_hz = cut_hz
        first = np.argmin(delays)
        later = np.delete(expected, first, axis=1).sum(axis=1)
        filtered = sosfilt(butter(4, frequency_hz, "highpass", fs=fs_hz, output="sos"), later)
        expected = np.stack([expected[:, first], filtered], axis=1)
    rest = smooth[HALF_WIDTH:HALF_WIDTH + n_samples] - expected.sum(axis=1)
    alone = isolated(delays)
    slope = (kernel(offset[:, alone] + 1e-3) - kernel(offset[:, alone] - 1e-3)) / 2e-3
    solution, *_ = np.linalg.lstsq(np.hstack([kernel(offset[:, alone]), slope]), rest, rcond=None)
    more, moved = np.split(solution, 2)
    amplitude = gains[alone] + more
    return 20.0 * np.log10(np.abs(amplitude) / gains[alone]), -moved / amplitude


def kernel(position):
    """Impulse response of the low-pass at any real position [samples]: a Kaiser-windowed sinc (beta 8)."""
    inside = np.maximum(1.0 - (position / HALF_WIDTH) ** 2, 0.0)
    window = np.where(inside > 0.0, np.i0(8.0 * np.sqrt(inside)) / np.i0(8.0), 0.0)
    return CUTOFF * np.sinc(CUTOFF * position) * window


def isolated(delays, apart=2.5):
    """Which pulses stand alone, at least `apart` samples from the next."""
    delays = np.asarray(delays, dtype=float)
    gap = np.diff(delays, prepend=-np.inf, append=np.inf)
    return np.minimum(gap[:-1], gap[1:]) >= apart
