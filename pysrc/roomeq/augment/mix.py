"""Far-field speech at the level of signals: x_r = x*h_s + sum n_i*h_i + d (Tang et al., eq. 1; Ko et al. 2017).

Conventions
-----------
- Signals are float32, mono, at `FS_HZ`.
- The reverberated speech is advanced by the direct sound's delay, rounded to a sample, and cut to the length of
  the clean utterance: labels and alignments of the clean speech stay valid.
- Every SNR is a ratio of mean powers over the whole utterance: reverberated speech to that one noise as it arrives
  at the microphone. No activity detection: pauses count, as they do in Kaldi's `wav-reverberate`.
- The mixture gets the RMS of the clean utterance; where its peak would exceed `PEAK_LIMIT` it is turned down
  further.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy import fft

from roomeq.acoustics.direct import find_direct
from roomeq.core.constants import FS_HZ
from roomeq.records.schema import RirRow

PEAK_LIMIT = 0.99
FADE_SAMPLES = FS_HZ // 20
"""Cross-fade where a noise that is shorter than the utterance starts again: 50 ms."""
_FFT_SIZES = [odd << shift for shift in range(8, 24) for odd in (4, 5, 6, 7)]


@dataclass(frozen=True)
class Mixture:
    """What `mix` returns.

    Attributes
    ----------
    samples : ndarray of float32, shape (n_samples,)
    snr_db : float or None
        Reverberated speech to the sum of all noises [dB]; None without noise.
    gain_db : float
        Gain applied to the reverberated speech [dB], `peak_gain_db` included.
    peak_gain_db : float
        How far the mixture was turned down because of its peak [dB], 0 or negative.
    """

    samples: np.ndarray
    snr_db: float | None
    gain_db: float
    peak_gain_db: float


def direct_shift(row: RirRow, rir: np.ndarray) -> int:
    """Return the delay of an RIR's direct sound in whole samples.

    The row's own `direct_sample` (from a simulation's known geometry) comes first, then its acoustic parameters', then the
    onset found in the signal, whatever its polarity.

    Raises
    ------
    ValueError
        The stated sample lies outside the RIR, or the RIR has no direct sound.
    """
    stated = row.get("direct_sample")
    if stated is None:
        stated = (row.get("acoustic_parameters") or {}).get("direct_sample")
    try:
        shift = round(find_direct(rir, FS_HZ)[0] if stated is None else stated)
    except ValueError as error:
        raise ValueError(f"RIR {row['id']}: {error}") from None
    if not 0 <= shift < len(rir):
        raise ValueError(f"direct_sample={stated} of RIR {row['id']} must lie in its {len(rir)} samples: "
                         "characterise it again")
    return shift


def convolve(x: np.ndarray, rir: np.ndarray, start: int, n_samples: int) -> np.ndarray:
    """Return samples `start` to ``start + n_samples`` of the linear convolution x*rir (overlap-save).

    Parameters
    ----------
    x : ndarray of float32, shape (n,)
    rir : ndarray of float32, shape (n_taps,)
    start : int
        First sample wanted, at least 0.
    n_samples : int

    Returns
    -------
    y : ndarray of float32, shape (n_samples,)
    """
    overlap = len(rir) - 1
    n_fft, n_blocks = _blocks(len(rir), n_samples)
    hop = n_fft - overlap
    padded = np.zeros(n_blocks * hop + overlap, dtype=np.float32)
    first = start - overlap
    piece = x[max(0, first):max(0, first + len(padded))]
    offset = max(0, -first)
    padded[offset:offset + len(piece)] = piece
    blocks = np.lib.stride_tricks.sliding_window_view(padded, n_fft)[::hop]
    spectra = fft.rfft(blocks, axis=1)
    spectra *= fft.rfft(rir, n_fft)
    return fft.irfft(spectra, n_fft, axis=1)[:, overlap:].reshape(-1)[:n_samples]


def _blocks(n_taps: int, n_samples: int) -> tuple[int, int]:
    """Return length and number of the FFT blocks that cost least, by n log n.

    The number is a multiple of four: scipy's FFT takes four rows of float32 in the time of one.
    """
    sizes = [(n_fft, 4 * -(-n_samples // (4 * (n_fft - n_taps + 1)))) for n_fft in _FFT_SIZES if n_fft >= n_taps]
    return min(sizes, key=lambda size: size[0] * size[1] * math.log2(size[0]))


def mean_power(x: np.ndarray) -> float:
    """Return the mean square of a signal. Not a dot product: BLAS sums differently with other thread counts."""
    return float(np.mean(np.square(x)))


def loop(noise: np.ndarray, offset: int, n_samples: int) -> np.ndarray:
    """Return `n_samples` of a noise that repeats without a click: its end is cross-faded into its start.

    Parameters
    ----------
    noise : ndarray, shape (n,)
        Counts as a ring of ``n - fade`` samples; the cross-fade keeps the power of uncorrelated ends.
    offset : int
        Where on the ring to start.
    """
    fade = min(FADE_SAMPLES, len(noise) // 4)
    ring = noise[:len(noise) - fade].copy()
    if fade:
        angle = (np.arange(fade, dtype=np.float32) + 0.5) * np.float32(np.pi / 2 / fade)
        ring[:fade] = noise[:fade] * np.sin(angle) + noise[len(noise) - fade:] * np.cos(angle)
    return np.resize(np.roll(ring, -(offset % len(ring))), n_samples)


def mix(clean: np.ndarray, reverberated: np.ndarray, noises: list[tuple[np.ndarray, float]]) -> Mixture:
    """Add noises to reverberated speech at given SNRs and set the level.

    Parameters
    ----------
    clean : ndarray of float32, shape (n_samples,)
        Its RMS is the level of the result.
    reverberated : ndarray of float32, shape (n_samples,)
    noises : list of (ndarray of float32, shape (n_samples,), float)
        Each noise as it arrives at the microphone, and its SNR [dB].

    Raises
    ------
    ValueError
        The clean or reverberated utterance, or a noise, is silent.
    """
    clean_power, speech_power = mean_power(clean), mean_power(reverberated)
    if not clean_power > 0:
        raise ValueError("utterance is silent (all samples 0): leave it out of the data directory")
    if not speech_power > 0:
        raise ValueError("reverberated utterance is silent: the RIR must hold its direct sound: drop the RIR")
    samples, total_noise = reverberated, np.float32(0)
    for noise, snr_db in noises:
        power = mean_power(noise)
        if not power > 0:
            raise ValueError("noise is silent (all samples 0): leave it out")
        total_noise = total_noise + noise * np.float32(np.sqrt(speech_power / power * 10 ** (-snr_db / 10)))
    if noises:
        samples = reverberated + total_noise
    gain = np.sqrt(clean_power / mean_power(samples))
    peak = float(max(samples.max(), -samples.min())) * gain
    peak_gain = min(1.0, PEAK_LIMIT / peak)
    snr = 10 * np.log10(speech_power / mean_power(total_noise)) if noises else None
    return Mixture(samples * np.float32(gain * peak_gain), None if snr is None else float(snr),
                   float(20 * np.log10(gain * peak_gain)), float(20 * np.log10(peak_gain)))
