"""The sub-band EQ of an impulse response: its level at eight frequencies, relative to 1 kHz.

Tang, Meng, Manocha, "Low-frequency compensated synthetic impulse responses", section 3.1. What the paper
leaves open is fixed here: the mean power of Hann-windowed frames of 512 samples, hop 256, from 2 ms before the
direct sound down to the noise floor. At 16 kHz the bins are 31.25 Hz apart and the eight points are bins 2, 4,
8, ... 256.
"""

from dataclasses import dataclass

import numpy as np

from roomeq.acoustics.metrics import find_knee
from roomeq.constants import BAND_1KHZ, BANDS_HZ, FS_HZ

N_FRAME = 512
N_HOP = 256
LEAD_S = 2e-3
POINT_BINS = tuple(round(f * N_FRAME / FS_HZ) for f in BANDS_HZ)
MIN_SNR_DB = 10.0  # at a point: less noise than that adds at most 0.4 dB
PASS_HZ = (6500.0, 7250.0)  # anti-alias filters still pass here ...
ROLL_OFF_HZ = 7900.0  # ... and no longer from here up
ROLL_OFF_DB = 20.0  # 100 dB per octave between the two: steeper than any loudspeaker, and than chance in a few bins
_WINDOW = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(N_FRAME) / N_FRAME)


@dataclass(frozen=True)
class EqAnalysis:
    """What `analyse` finds at the eight EQ points.

    Attributes
    ----------
    level_db : ndarray, shape (8,)
        Mean frame power, relative to a frame power of 1.
    eq_db : ndarray, shape (8,)
        The same relative to 1 kHz.
    valid : ndarray of bool, shape (8,)
        The point stands 10 dB above the noise, as does 1 kHz, and (8 kHz) is no anti-alias filter's stop band.
    snr_db : ndarray, shape (8,)
        Signal to noise at the points; infinite where the response ends above its noise.
    edge_db : float or None
        EQ just below an anti-alias roll-off at 8 kHz (6.5 to 7.25 kHz); None where there is no roll-off.
    """

    level_db: np.ndarray
    eq_db: np.ndarray
    valid: np.ndarray
    snr_db: np.ndarray
    edge_db: float | None


def frame_power(rir, start, stop):
    """Mean power spectrum of the frames that lie in a part of a response.

    Parameters
    ----------
    rir : ndarray, shape (n_samples,)
    start, stop : int
        Part [samples]; only whole frames count.

    Returns
    -------
    power : ndarray, shape (257,)

    Raises
    ------
    ValueError
        The part is shorter than a frame.
    """
    if stop - start < N_FRAME:
        raise ValueError(f"impulse response has {stop - start} samples from the direct sound on: EQ analysis "
                         f"needs {N_FRAME} (32 ms): record longer or drop it")
    frames = np.lib.stride_tricks.sliding_window_view(rir[start:stop], N_FRAME)[::N_HOP]
    return np.mean(np.abs(np.fft.rfft(frames * _WINDOW, axis=1)) ** 2, axis=0)


def eq_part(rir, direct_sample):
    """Part of a response that its EQ is measured on: (start, stop) [samples], at least a frame if there is one."""
    start = max(0, round(direct_sample - LEAD_S * FS_HZ))
    direct = max(0, round(direct_sample))
    occupied = np.flatnonzero(rir)
    last = int(occupied[-1]) + 1 if len(occupied) else 0
    if last <= direct:
        raise ValueError(f"direct_sample={direct_sample:g} must lie before the response's end, {last}: "
                         "find it again")
    stop = direct + find_knee(np.square(rir[direct:last], dtype=np.float64), FS_HZ).sample
    return start, min(max(stop, start + N_FRAME), len(rir))


def analyse(rir, direct_sample):
    """Measure the EQ of a response at 16 kHz.

    Parameters
    ----------
    rir : ndarray, shape (n_samples,)
    direct_sample : float
        See `roomeq.acoustics.direct.find_direct`.

    Returns
    -------
    EqAnalysis

    Raises
    ------
    ValueError
        Fewer than 512 samples follow the direct sound.
    """
    rir = np.asarray(rir, dtype=np.float64)
    start, stop = eq_part(rir, direct_sample)
    power = frame_power(rir, start, stop)
    points = list(POINT_BINS)
    snr_db = np.full(len(points), np.inf)
    if len(rir) - stop >= 2 * N_FRAME:
        noise = frame_power(rir, stop, len(rir))
        if noise.max() > 0.0:
            snr_db = _db(power[points]) - _db(noise[points])
    valid = (snr_db >= MIN_SNR_DB) & (power[points] > 0.0) & (snr_db[BAND_1KHZ] >= MIN_SNR_DB)
    level_db = _db(power[points])
    edge_db = _edge_db(power)
    if edge_db is not None:
        valid[-1] = False
        edge_db -= level_db[BAND_1KHZ]
    return EqAnalysis(level_db, level_db - level_db[BAND_1KHZ], valid, snr_db, edge_db)


def _edge_db(power):
    """Level just below an anti-alias roll-off, or None where there is none."""
    bin_hz = FS_HZ / N_FRAME
    passed = float(np.mean(power[round(PASS_HZ[0] / bin_hz):round(PASS_HZ[1] / bin_hz) + 1]))
    stopped = float(np.mean(power[round(ROLL_OFF_HZ / bin_hz):]))
    return float(_db(passed)) if _db(passed) - _db(stopped) > ROLL_OFF_DB else None


def _db(power):
    return 10.0 * np.log10(np.maximum(power, 1e-300))
