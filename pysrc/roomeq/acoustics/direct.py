"""Arrival time and polarity of the direct sound of an impulse response.

Detection works on ``|h|``: an inverted loudspeaker or microphone changes the reported polarity and nothing else.
"""

import os
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from roomeq.core.arrays import FloatArray, IntArray
from roomeq.records.schema import RirRow

ONSET_FRACTION = 0.1  # of the peak: ISO 3382-1 starts where the level comes within 20 dB of the maximum
NOISE_FACTOR = 6.0  # stationary noise of any length here stays below 5.5 times its standard deviation
CLIMB_S = 0.5e-3  # a larger peak this soon belongs to the same arrival (17 cm of detour)
CLIMB_RATIO = 2.0**0.5  # ... if it is 3 dB larger: steps over the pre-ringing of band-limited responses
_LEAST_S = 5e-3  # of noise before the direct sound, for a level
SINC_HALF_SAMPLES = 16
_NEAR, _OFFSETS = np.arange(-SINC_HALF_SAMPLES, SINC_HALF_SAMPLES + 1), np.linspace(-1.0, 1.0, 41)
_LAG = _OFFSETS[:, None] - _NEAR
_SINC = np.sinc(_LAG) * np.cos(np.pi * _LAG / (2 * SINC_HALF_SAMPLES + 4)) ** 2
"""Interpolation to 41 points around a peak (Hann-windowed sinc), shape (41, 33)."""


class DirectSound(NamedTuple):
    """The direct sound of an impulse response.

    Attributes
    ----------
    sample
        Arrival [samples], with its fraction.
    polarity
        +1 or -1.
    """

    sample: float
    polarity: int


def find_direct(rir: ArrayLike, fs_hz: float, expected_sample: float | None = None, *,
                search_s: float = 1e-3) -> DirectSound:
    """Find the direct sound: the first arrival, which need not be the strongest.

    The onset is the first local maximum of ``|h|`` that reaches a tenth of the maximum (20 dB, ISO 3382-1:2009,
    5.3.3) and exceeds the noise: the lower of that before it and of the quietest frames. From there the search moves to
    a peak that is at least 3 dB larger and at most 0.5 ms later, and repeats: this skips sinc pre-ringing and stops
    before a stronger first reflection. The position of the peak is refined by band-limited (sinc) interpolation.

    Parameters
    ----------
    rir
        Impulse response of any scale, shape (n_samples,).
    fs_hz
        Sample rate.
    expected_sample
        Arrival by geometry. Only `search_s` around it is searched, and the threshold is a tenth of the maximum in
        that range, so that an obstructed direct sound below its reflections is found.
    search_s
        Half width of that range [s].

    Raises
    ------
    ValueError
        The response is empty, not mono, silent or not finite, or nothing in it exceeds its noise.
    """
    h = checked_response(rir)
    first, last = 0, len(h)
    if expected_sample is not None:
        first = max(0, int(np.floor(expected_sample - search_s * fs_hz)))
        last = min(len(h), int(np.ceil(expected_sample + search_s * fs_hz)) + 1)
        if first >= last:
            raise ValueError(f"expected_sample={expected_sample:g} must lie in the response's {len(h)} samples: "
                             "correct the geometry, or leave it out where the time of flight is not in the file")
    window = np.abs(h[first:last])
    quietest = quietest_rms(h, fs_hz)
    candidates = np.flatnonzero(window >= ONSET_FRACTION * window.max())
    noise = np.minimum(_rms_before(h, first + candidates, fs_hz), quietest)
    reaches = candidates[window[candidates] > NOISE_FACTOR * noise]
    if window.max() == 0.0 or not len(reaches):
        raise ValueError(f"impulse response has no direct sound: its peak {window.max():.3g} must exceed "
                         f"{NOISE_FACTOR:g} times its noise, {quietest:.3g}: record it again")
    peak = first + _climb(window, int(reaches[0]), max(1, round(CLIMB_S * fs_hz)))
    polarity = 1 if h[peak] > 0 else -1
    return DirectSound(_refine(h, peak, polarity), polarity)


def direct_of(row: RirRow, rir: FloatArray) -> DirectSound:
    """Return the direct sound that a row states, as that of a simulated RIR does, or that is found."""
    sample, polarity = row.get("direct_sample"), row.get("direct_polarity")
    if sample is not None and polarity is not None:
        return DirectSound(sample, polarity)
    return find_direct(rir, row["fs_hz"])


def checked_response(rir: ArrayLike, direct_sample: float = 0.0) -> FloatArray:
    """Return a response as float64; raise ValueError if it cannot hold a direct sound at that sample."""
    require_samples(rir, "impulse response")
    h = np.asarray(rir, dtype=np.float64)
    if h.ndim != 1:
        raise ValueError(f"impulse response has shape {h.shape}: must be mono, one axis: choose one channel")
    if not len(h):
        raise ValueError("impulse response has 0 samples: must hold a direct sound: record it again or drop it")
    if not np.all(np.isfinite(h)):
        bad = int(np.flatnonzero(~np.isfinite(h))[0])
        raise ValueError(f"impulse response holds {h[bad]} at sample {bad}: must be finite: export it again")
    if not h.any():
        raise ValueError("impulse response is silent: must hold a direct sound: record it again or drop it")
    if not -1.0 < direct_sample < len(h):
        raise ValueError(f"direct_sample={direct_sample:g} must lie in the response's {len(h)} samples: find it again")
    return h


def require_samples(values: ArrayLike, name: str) -> None:
    """Raise a `ValueError` for a path or a spectrum where samples are expected."""
    if isinstance(values, str | os.PathLike):
        raise ValueError(f"{name} {os.fspath(values)!r} is a path: must be samples: read the file, for example with "
                         "soundfile.read")
    if np.iscomplexobj(values):
        raise ValueError(f"{name} holds complex numbers: must be samples: give the inverse Fourier transform")


def _rms_before(h: FloatArray, samples: IntArray, fs_hz: float) -> FloatArray:
    """Return the RMS of what precedes some samples by `CLIMB_S` or more; infinite where that is too short to tell.

    Digital silence at the beginning is excluded. Where nothing else precedes, except for what a filter may spread, the
    RMS is 0.
    """
    begin = int(np.argmax(h != 0.0))
    ends = np.maximum(samples - max(1, round(CLIMB_S * fs_hz)), begin)
    energy = np.concatenate([[0.0], np.cumsum(np.square(h[begin:int(ends.max(initial=begin))]))])[ends - begin]
    count = ends - begin
    rms = np.sqrt(energy / np.maximum(count, 1))
    silence = begin > 0
    return np.where(silence & (count < SINC_HALF_SAMPLES), 0.0, np.where(silence | (count >= _LEAST_S * fs_hz), rms,
                                                                         np.inf))


def quietest_rms(h: FloatArray, fs_hz: float) -> float:
    """Return the RMS of the quieter frames (20 ms, 10th percentile): the noise floor where there is one.

    Digital silence is padding before or after the sound; it is excluded.
    """
    n_frame = max(1, round(0.02 * fs_hz))
    n_frames = len(h) // n_frame
    if n_frames < 4:
        return 0.0
    power = np.mean(h[:n_frames * n_frame].reshape(n_frames, n_frame) ** 2, axis=1)
    power = np.sort(power[power > 0])
    rank = np.arange(len(power))
    return float(np.sqrt(np.interp(0.1 * (len(power) - 1), rank, power))) if len(power) >= 4 else 0.0


def _climb(magnitude: FloatArray, start: int, reach: int) -> int:
    """Return the peak of the arrival that begins with an onset; see `find_direct`."""
    peak = _local_maximum(magnitude, start)
    while True:
        later = magnitude[peak + 1:peak + 1 + reach]
        larger = np.flatnonzero(later > CLIMB_RATIO * magnitude[peak])
        if not len(larger):
            return peak
        peak = _local_maximum(magnitude, peak + 1 + int(larger[0]))


def _local_maximum(magnitude: FloatArray, start: int) -> int:
    """Return the first sample from `start` on that its successor does not exceed."""
    while start + 1 < len(magnitude) and magnitude[start + 1] > magnitude[start]:
        start += 1
    return start


def _refine(h: FloatArray, peak: int, polarity: int) -> float:
    """Return the position of a peak between samples, by a Hann-windowed sinc and a parabola on its fine grid."""
    values, start = np.zeros(len(_NEAR)), peak - SINC_HALF_SAMPLES
    near = h[max(0, start):start + len(_NEAR)]
    values[max(0, -start):][:len(near)] = near
    fine = polarity * np.sum(_SINC * values, axis=1)
    best = int(np.argmax(fine))
    shift = _OFFSETS[best]
    if 0 < best < len(_OFFSETS) - 1:
        left, middle, right = fine[best - 1:best + 2]
        curve = left - 2 * middle + right
        if curve < 0:
            shift += 0.5 * (left - right) / curve * (_OFFSETS[1] - _OFFSETS[0])
    return float(peak + shift)
