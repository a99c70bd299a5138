"""Synthesis of a response from early pulses and a noise-like tail in octave bands.

The tail is one random sequence for all bands, shaped per third of an octave by the echogram, which states the energy of
each octave. Within an octave, its level follows those of the octaves beside it, as absorption is a continuous function
of frequency (`_in_thirds`): if it were the same up to the edges, the filters there would mix the decays of two octaves,
of which the longer one remains. Most thirds lie in low octaves, and are shaped at a quarter of the sample rate.

Reflections in a room arrive at a rate of ``4 pi c^3 t^2 / V`` (Kuttruff, Room Acoustics, eq. 4.6). While that is less
than one per sample, the sequence consists of single pulses, one at a random time in each interval between arrivals;
later it is Gaussian.

The direct sound is of minimum phase, as air and loudspeakers are, with gains interpolated in dB over log frequency:
nothing precedes it. Later paths and the tail pass zero-phase filters, which cost the same for any number of
paths; what rings ahead of the direct sound, or of where it would be, is cut off.

All pulses are positive and add up in phase at the lowest frequencies, where geometrical acoustics does not hold: below
`LOWEST_HZ`, reflections would raise the rumble of recordings by 5 to 17 dB. They pass a high-pass of minimum phase.
"""

from functools import lru_cache

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from roomeq.acoustics.filterbank import SPREAD_S, octave_filterbank, third_octave_filterbank, thirds_of_octaves
from roomeq.acoustics.high_pass import high_pass
from roomeq.acoustics.minimum_phase import minimum_phase
from roomeq.core.arrays import Array, FloatArray, Number
from roomeq.core.constants import FS_HZ, exact_bands_hz
from roomeq.core.jit import compiled
from roomeq.sim.echogram import FRAME_S
from roomeq.sim.trace import dense_after_s

SINC_HALF = 32
MIN_RATE_HZ = 2000.0  # diffuse reflections are dense from the start: at least two pulses per millisecond
LOWEST_HZ = 15.0
"""Of reflections, 3 dB down. 0.1 dB are lost at 25 Hz, the lowest frequency of any feature."""
MIN_LENGTH_S = 0.5
MAX_LENGTH_S = 13.1
"""Of a response: a decay time of 10 s with the margin of `roomeq.sim.response.decay_length_s`."""
DECAY_DB = 60.0
CUT_DB = 50.0
"""Below the whole energy: a response whose last 50 ms hold more was cut off, and its decay cannot be measured to T30
with the margin of ISO 3382."""
_LOWEST_GAIN = 1e-3  # of an octave of the first sound, relative to the strongest
_FIRST_FFT_S = 0.064  # length of the transform of its minimum phase: gains per octave resolve no more
_OVERSAMPLING = 256
_FFT_GRID = 4096
_LOW_RATE = 4
"""Sample rate over that at which the low thirds of octaves are shaped."""
_LOW_SHARE = 0.8  # of half the low sample rate, up to which they reach


def tail_noise(n_samples: int, volume_m3: float, speed_m_s: float, rng: np.random.Generator,
               fs_hz: float = FS_HZ) -> FloatArray:
    """Draw a random sequence of unit mean power with the echo density of a room.

    Returns
    -------
    ndarray, shape (n_samples,)
    """
    noise = rng.standard_normal(n_samples)
    dense_s = dense_after_s(volume_m3, speed_m_s, fs_hz)
    dense = min(n_samples, int(dense_s * fs_hz))
    time_s = np.arange(dense + 1) / fs_hz
    arrivals = np.cumsum(np.maximum(fs_hz * (time_s / dense_s) ** 2, MIN_RATE_HZ)) / fs_hz
    edges = np.interp(np.arange(int(arrivals[-1]) + 1), arrivals, np.arange(dense + 1.0))
    width = np.diff(edges)
    place = (edges[:-1] + width * rng.random(len(width))).astype(int)
    pulses = np.zeros(dense)
    inside = place < dense
    # Gaussian pulses pass into Gaussian noise continuously; pulses of equal size would have a lower kurtosis
    np.add.at(pulses, place[inside], (rng.standard_normal(len(width)) * np.sqrt(width))[inside])
    noise[:dense] = pulses
    return noise


def response_length_s(energy: FloatArray, early_s: float = 0.0) -> float:
    """Return the time after which every band has decayed by `DECAY_DB`, from `MIN_LENGTH_S` to `MAX_LENGTH_S`.

    Parameters
    ----------
    energy
        Total energy per frame, shape (n_frames, n_bands).
    early_s
        Time that the response covers in any case.
    """
    remaining = np.cumsum(energy.T[:, ::-1], axis=1)
    held = np.any(remaining > 10.0 ** (-DECAY_DB / 10.0) * np.maximum(remaining[:, -1:], 1e-300), axis=0)
    last = len(held) - int(np.argmax(held)) if held.any() else 0
    return float(np.clip(max(last * FRAME_S, early_s), MIN_LENGTH_S, MAX_LENGTH_S))


def is_cut(energy: FloatArray) -> bool:
    """Tell whether an echogram ends before the decay does: in some band, its last 50 ms are above `CUT_DB`.

    Parameters
    ----------
    energy
        Total energy per frame, shape (n_frames, n_bands).
    """
    last = energy[-round(0.05 / FRAME_S):].sum(axis=0)
    return bool(np.any(last > 10.0 ** (-CUT_DB / 10.0) * energy.sum(axis=0)))


def render(distance_m: FloatArray, gains: FloatArray, echogram: FloatArray, noise: Array, *, speed_m_s: float,
           n_samples: int, fs_hz: float = FS_HZ, hidden_m: float | None = None) -> FloatArray:
    """Synthesise a response.

    Parameters
    ----------
    distance_m
        Lengths of the specular paths, shape (n_paths,).
    gains
        Their pressure per band, shape (n_paths, n_bands).
    echogram
        Squared pressure per frame of all other sound, air absorption included, shape (n_frames, n_bands).
    noise
        From `tail_noise`, at least `n_samples` long.
    speed_m_s
    n_samples
    fs_hz
    hidden_m
        Distance of the source if it is hidden. No specular path is the first sound then: scattered sound may come
        before all of them.

    Returns
    -------
    ndarray, shape (n_samples,)
        Sample 0 is the emission.
    """
    guard = int(SPREAD_S * fs_hz) // _LOW_RATE * _LOW_RATE
    n_fft = _fft_length(n_samples + 2 * guard)
    earliest = np.zeros(n_fft)
    delays, gains = guard + distance_m / speed_m_s * fs_hz, np.ascontiguousarray(gains)
    first = int(np.argmin(distance_m)) if len(distance_m) and hidden_m is None else None
    onset = int(np.ceil(delays[first] if first is not None else guard + (hidden_m or 0.0) / speed_m_s * fs_hz))
    later = np.arange(len(distance_m)) != first
    pulses = _merged_pulses(delays[later], gains[later], n_fft, fs_hz)
    if first is not None:
        _add_first(earliest, delays[first], gains[first], fs_hz)
    spectrum = rfft(pulses, n_fft)
    _add_tail(spectrum, echogram, noise.astype(np.float32, copy=False), onset - guard, guard, n_samples, n_fft, fs_hz)
    response = irfft(spectrum * _high_pass(n_fft, fs_hz), n_fft).astype(np.float64)
    response[:onset - SINC_HALF] = 0.0  # nothing precedes the first sound, though the filters of the others ring
    return (response + earliest)[guard:guard + n_samples]


def _add_tail(spectrum: Array, echogram: FloatArray, noise: Array, onset: int, guard: int, n_samples: int, n_fft: int,
              fs_hz: float) -> None:
    """Add noise, shaped per third of an octave by an echogram from sample `onset` on, to a spectrum in place.

    The noise begins at sample `guard`. In the low thirds it is shaped at a lower sample rate. Single precision is
    enough: its rounding lies 140 dB below the peak.
    """
    bank, frame_samples = third_octave_filterbank(n_fft, fs_hz), FRAME_S * fs_hz
    power = _in_thirds(_padded(echogram, n_samples, fs_hz) / np.float32(frame_samples), fs_hz)
    n_low = sum(passband.bins.stop <= _LOW_SHARE * n_fft / (2 * _LOW_RATE) for passband in bank)
    low = irfft(rfft(noise[:n_samples], n_fft)[:n_fft // (2 * _LOW_RATE) + 1], n_fft // _LOW_RATE) / _LOW_RATE
    for step, of_rate, thirds in ((_LOW_RATE, low, slice(n_low)), (1, noise, slice(n_low, None))):
        passbands = bank[thirds]
        # scipy's FFT transforms four rows of single precision in the time of one
        shaped = np.zeros((-(-len(passbands) // 4) * 4, n_fft // step), np.float32)
        begin, end = guard // step, -(-(guard + n_samples) // step)
        _shape_noise(shaped[:len(passbands)], begin, of_rate[:end - begin], power[thirds], -(-onset // step),
                     frame_samples / step, 0.5 / step)
        for third, (bins, passed) in zip(rfft(shaped, n_fft // step), passbands, strict=False):
            spectrum[bins] += step * passed * third[bins]


def _merged_pulses(delays: FloatArray, gains: FloatArray, longest: int, fs_hz: float) -> Array:
    """Return the sum over the octaves of band-limited pulses at fractional delays, at most `longest` samples."""
    if not len(delays):
        return np.zeros(longest, np.float32)
    n_fft = min(_fft_length(int(delays.max()) + int(SPREAD_S * fs_hz)), longest)
    octaves = np.zeros((gains.shape[1], n_fft), np.float32)
    _add_pulses(octaves, delays, gains, _sinc_table())
    bank = octave_filterbank(n_fft, fs_hz)
    return irfft(np.einsum("bf,bf->f", rfft(octaves, n_fft), bank.astype(np.float32)), n_fft)


def _fft_length(n_samples: int) -> int:
    """Return a length of transform: few for all lengths, so that their filters stay cached."""
    return 2 * _LOW_RATE * next_fast_len(-(-n_samples // _FFT_GRID) * _FFT_GRID // (2 * _LOW_RATE), real=True)


def _add_first(signal: FloatArray, delay: float, gains: FloatArray, fs_hz: float) -> None:
    """Add the first sound in minimum phase, its gains interpolated in dB over log frequency, in place."""
    n_fft = 2 ** round(np.log2(_FIRST_FFT_S * fs_hz))
    pulse = np.zeros((1, 2 * SINC_HALF))
    start = int(np.ceil(delay)) - SINC_HALF
    _add_pulses(pulse, np.array([delay - start]), np.ones((1, 1)), _sinc_table())
    strongest = gains[np.argmax(np.abs(gains))]  # all bands have its sign: that of a lobe of a directivity
    gains_db = 20.0 * np.log10(np.maximum(np.abs(gains), max(_LOWEST_GAIN * abs(strongest), 1e-30)))
    taps = minimum_phase(np.array(exact_bands_hz(fs_hz)), gains_db, n_fft, fs_hz)
    sound = np.sign(strongest) * np.convolve(pulse[0], taps)
    low, high = max(0, start), min(len(signal), start + len(sound))
    signal[low:high] += sound[low - start:high - start]


@lru_cache(maxsize=8)
def _high_pass(n_fft: int, fs_hz: float) -> Array:
    return high_pass(n_fft, fs_hz, LOWEST_HZ).astype(np.complex64)


def _padded(echogram: FloatArray, n_samples: int, fs_hz: float) -> FloatArray:
    """Return an echogram with one frame more than the samples need, shape (n_bands, n)."""
    n_frames = int(np.ceil(n_samples / (FRAME_S * fs_hz))) + 1
    kept = echogram[:n_frames].T
    return np.pad(kept, ((0, 0), (0, n_frames - kept.shape[1]))).astype(np.float32, order="C")


def _in_thirds(power: FloatArray, fs_hz: float) -> FloatArray:
    """Return the power of the thirds of octaves below half the sample rate, from that of octaves, (n_bands, n).

    The level of a third follows from those of its octave and of the one beside it by interpolation over log frequency.
    Then those of an octave are changed alike, so that the power of the octave remains.
    """
    third_root = np.cbrt(power)
    below, above = (np.concatenate(parts) for parts in ((third_root[:1], third_root[:-1]),
                                                        (third_root[1:], third_root[-1:])))
    level = np.stack([below, third_root, above], axis=1)
    width_hz = np.diff(thirds_of_octaves(fs_hz), axis=1)
    mean = np.einsum("bk,bkn->bn", width_hz / width_hz.sum(axis=1, keepdims=True), level)
    return (level * (power / np.maximum(mean, 1e-30))[:, None])[width_hz > 0.0].astype(np.float32)


@compiled
def _shape_noise(bands: Array, begin: Number, noise: Array, energy: Array, first: Number, frame_samples: Number,
                 middle: Number) -> None:
    """Give noise the power per sample of frames, linear between their middles, from its sample `first` on.

    In each of the `bands`, whole rows in memory, it begins at sample `begin`. What lies before the first sample, as the
    frame of the first sound begins earlier, is added to the following length of a frame. `middle` is the time from the
    beginning of the first frame to the middle of the noise's sample 0.
    """
    n_samples = len(noise)
    soon = min(first + int(np.ceil(frame_samples)), n_samples)
    for band in range(len(bands)):
        lost, kept = np.float32(0.0), np.float32(1e-30)
        for n in range(soon):
            place = max((n + middle) / frame_samples - 0.5, 0.0)
            before = energy[band, int(place)]
            power = before + (energy[band, int(place) + 1] - before) * np.float32(place - int(place))
            if n < first:
                lost += power
            else:
                kept += power
        n, frame = first, int(np.floor((first + middle) / frame_samples - 0.5))
        while n < n_samples:
            # from the middle of a frame to that of the next; ahead of the first middle (frame -1), the first frame's
            end = min(n_samples, int(np.ceil((frame + 1.5) * frame_samples - middle)))
            before = energy[band, max(frame, 0)]
            rise = energy[band, frame + 1] - before if frame >= 0 else np.float32(0.0)
            step, start = np.float32(1.0 / frame_samples), np.float32((n + middle) / frame_samples - 0.5 - frame)
            part, own = bands[band, begin + n:begin + end], noise[n:end]
            for k in range(len(part)):  # without branches, so that it is vectorised; below 0 by rounding only
                part[k] = own[k] * np.sqrt(np.abs(before + rise * (start + np.float32(k) * step)))
            n, frame = end, frame + 1
        for n in range(first, soon):
            bands[band, begin + n] *= np.sqrt(np.float32(1.0) + lost / kept)


@lru_cache(maxsize=1)
def _sinc_table() -> FloatArray:
    """Return a Hann-windowed sinc at `_OVERSAMPLING` delays of a fraction of a sample, and at one of a whole one.

    Row n holds it from ``-SINC_HALF`` samples on, ``n / _OVERSAMPLING`` of a sample late.
    """
    late = np.arange(_OVERSAMPLING + 1) / _OVERSAMPLING
    position = late[:, None] + np.arange(-SINC_HALF, SINC_HALF)
    return np.sinc(position) * np.cos(0.5 * np.pi * position / SINC_HALF) ** 2


@compiled
def _add_pulses(bands: Array, delays: Array, gains: Array, table: Array) -> None:
    """Add band-limited pulses at fractional delays [samples]; what falls outside is left out."""
    n_bands, n_samples = bands.shape
    n_taps, pulse = table.shape[1], np.empty(table.shape[1], bands.dtype)
    for path in range(len(delays)):
        start = int(np.ceil(delays[path])) - n_taps // 2
        place = (start + n_taps // 2 - delays[path]) * (len(table) - 1)
        row = min(int(place), len(table) - 2)
        for tap in range(n_taps):
            pulse[tap] = table[row, tap] * (1.0 - (place - row)) + table[row + 1, tap] * (place - row)
        low, high = min(max(start, 0), n_samples), min(max(start + n_taps, 0), n_samples)
        inside = pulse[low - start:high - start]
        for band in range(n_bands):
            gain, part = bands.dtype.type(gains[path, band]), bands[band, low:high]
            for n in range(len(part)):
                part[n] += gain * inside[n]
