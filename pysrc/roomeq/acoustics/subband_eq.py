"""Sub-band EQ of an impulse response: its level at eight frequencies, relative to 1 kHz.

Tang, Meng, Manocha, "Low-frequency compensated synthetic impulse responses", section 3.1: "the Fourier transform with a
window size of 512" of the whole response. Here that is the power spectrum of the response from 16 ms before the direct
sound to the noise floor, summed over Hann-windowed frames of 512 samples, hop 128, with zeros before the first sample
and after the last. Squared Hann windows a quarter of a frame apart add up to a constant (Harris, Proc. IEEE 66 (1978)
51), so every sample has the same weight wherever the frames begin, and the result is the periodogram of the whole
response smoothed by the squared transform of the Hann window. With a hop of 256 samples the weight of the direct sound
would vary by 3 dB with its position in the frame.

At 16 kHz the bins are 31.25 Hz apart and the eight points are bins 2, 4, 8, ... 256.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from roomeq.acoustics.decibels import power_db
from roomeq.acoustics.fade import length_before_silence
from roomeq.acoustics.noise_intersection import find_noise_intersection, remaining_energy
from roomeq.core.arrays import BoolArray, FloatArray
from roomeq.core.constants import BAND_1KHZ, BANDS_HZ, FS_HZ

N_FRAME = 512
N_HOP = 128
N_LEAD = 256  # samples before the direct sound that are included: its onset is known to within a few samples only
POINT_BINS = tuple(round(f * N_FRAME / FS_HZ) for f in BANDS_HZ)
MIN_SNR_DB = 10.0  # at a point: noise adds at most 0.4 dB
MIN_NOISE = 2 * N_FRAME  # samples after the noise intersection from which the noise spectrum is estimated
BELOW_HZ = (5000.0, 6000.0)
PASS_HZ, PASS_END_HZ = (6500.0, 7250.0), (7000.0, 7250.0)  # pass band of anti-alias filters, and its end
STOP_HZ = (7900.0, 8000.0)
ROLL_OFF_DB = 20.0  # at least 60 dB per octave between two of these: steeper than loudspeakers, and than their scatter


@dataclass(frozen=True)
class EqAnalysis:
    """The EQ of a response at the eight points, each array of shape (8,).

    Attributes
    ----------
    level_db
        Energy, relative to that of a unit impulse.
    eq_db
        The same relative to 1 kHz.
    valid
        Whether the point and 1 kHz lie at least 10 dB above the noise, and 8 kHz is not in the stop band of an
        anti-alias filter.
    snr_db
        Signal-to-noise ratio; infinite if the response ends above its noise.
    edge_db
        EQ just below an anti-alias roll-off at 8 kHz (6.5 to 7.25 kHz); None if there is no roll-off, or if it begins
        below, as in recordings of a lower sample rate.
    """

    level_db: FloatArray
    eq_db: FloatArray
    valid: BoolArray
    snr_db: FloatArray
    edge_db: float | None


class EqPart(NamedTuple):
    """Range of samples of a response that its EQ is measured on."""

    start: int
    stop: int


def frame_length(fs_hz: float) -> int:
    """Return the length of frames of 32 ms at any sample rate: `N_FRAME` at 16 kHz, a multiple of four hops."""
    return 4 * round(N_HOP * fs_hz / FS_HZ)


def energy_spectrum(part: FloatArray, n_frame: int = N_FRAME) -> FloatArray:
    """Return the energy spectrum of a part of a response with equal weight for each sample; see the module docstring.

    Parameters
    ----------
    part
        Shape (n_samples,), of any length.
    n_frame
        Length of a frame; see `frame_length`.

    Returns
    -------
    ndarray, shape (n_frame // 2 + 1,)
        Energy at multiples of 31.25 Hz; 1 everywhere for a unit impulse. The mean over all 512 bins of the two-sided
        spectrum is the energy of the part (Parseval).
    """
    n_hop = n_frame // 4
    n_frames = -(-(len(part) + n_frame - n_hop) // n_hop)
    padded = np.zeros((n_frames - 1) * n_hop + n_frame)
    padded[n_frame - n_hop:][:len(part)] = part
    frames = np.lib.stride_tricks.sliding_window_view(padded, n_frame)[::n_hop]
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(n_frame) / n_frame)
    weight = np.sum(window ** 2) / n_hop  # of each sample in the sum over frames
    return np.sum(np.abs(np.fft.rfft(frames * window, axis=1)) ** 2, axis=0) / weight


def eq_part(rir: FloatArray, direct_sample: float, fs_hz: float = FS_HZ) -> EqPart:
    """Return the range of samples that the EQ of a response is measured on.

    It extends from 16 ms before the direct sound to the noise intersection point, or to the silence at the end, and
    holds at least one frame if the response does.

    Raises
    ------
    ValueError
        The direct sound lies after the end of the response.
    """
    return _eq_part(rir, direct_sample, fs_hz, length_before_silence(rir, fs_hz))


def _eq_part(rir: FloatArray, direct_sample: float, fs_hz: float, last: int) -> EqPart:
    direct = max(0, round(direct_sample))
    if last <= direct:
        raise ValueError(f"direct_sample={direct_sample:g} must lie before the response's end, {last}: "
                         "find it again")
    start = max(0, direct - round(N_LEAD * fs_hz / FS_HZ))
    stop = direct + find_noise_intersection(remaining_energy(rir[direct:last]), fs_hz).sample
    return EqPart(start, min(max(stop, start + frame_length(fs_hz)), len(rir)))


def response_and_noise(rir: FloatArray, direct_sample: float, fs_hz: float = FS_HZ
                       ) -> tuple[FloatArray, FloatArray | None]:
    """Return the energy spectrum of `eq_part`, and that of as much noise; None where hardly anything is behind it.

    Silence after the response is no noise; see `roomeq.acoustics.fade.length_before_silence`.
    """
    last = length_before_silence(rir, fs_hz)
    start, stop = _eq_part(rir, direct_sample, fs_hz, last)
    n_frame, noise = frame_length(fs_hz), rir[stop:last]
    power = energy_spectrum(rir[start:stop], n_frame)
    if len(noise) < MIN_NOISE * fs_hz / FS_HZ:
        return power, None
    return power, energy_spectrum(noise, n_frame) * (stop - start) / len(noise)


def analyse(rir: FloatArray, direct_sample: float) -> EqAnalysis:
    """Measure the EQ of a response at 16 kHz.

    Parameters
    ----------
    rir
        Shape (n_samples,).
    direct_sample
        See `roomeq.acoustics.direct.find_direct`.

    Returns
    -------
    EqAnalysis

    Raises
    ------
    ValueError
        The direct sound lies after the end of the response.
    """
    rir = np.asarray(rir, dtype=np.float64)
    power, noise = response_and_noise(rir, direct_sample)
    points = list(POINT_BINS)
    snr_db = np.full(len(points), np.inf)
    if noise is not None:
        snr_db = power_db(power[points]) - power_db(noise[points])
    valid = (snr_db >= MIN_SNR_DB) & (power[points] > 0.0) & (snr_db[BAND_1KHZ] >= MIN_SNR_DB)
    level_db = power_db(power[points])
    below_db, passed_db, end_db, stopped_db = (
        _mean_db(power, band_hz) for band_hz in (BELOW_HZ, PASS_HZ, PASS_END_HZ, STOP_HZ))
    edge_db = None
    if passed_db - stopped_db > ROLL_OFF_DB:
        valid[-1] = False
        if below_db - end_db <= ROLL_OFF_DB:
            edge_db = passed_db - float(level_db[BAND_1KHZ])
    return EqAnalysis(level_db, level_db - level_db[BAND_1KHZ], valid, snr_db, edge_db)


def _mean_db(power: FloatArray, band_hz: tuple[float, float]) -> float:
    """Return the level of an energy spectrum at 16 kHz between two frequencies."""
    low, high = (round(hz * N_FRAME / FS_HZ) for hz in band_hz)
    return float(power_db(np.mean(power[low:high + 1])))
