"""Signal processing of far-field speech: x_r = x*h_s + sum n_i*h_i + d (Tang et al., eq. 1; Ko et al. 2017).

Conventions
-----------
- Signals are float32, mono, at one sample rate.
- The reverberated speech is advanced by the delay of the direct sound, rounded to a sample, and cut to the length of
  the clean utterance: labels and alignments of the clean speech stay valid.
- Every SNR is a ratio of mean powers over the whole utterance: reverberated speech to that one noise as it arrives
  at the microphone. There is no activity detection: pauses count. Kaldi's `wav-reverberate` counts of the speech what
  arrives within 50 ms of the RIR's largest sample.
- What lies below `LOWEST_HZ` is rumble of the recording, and the constant offset is of the sound card: both are removed
  from speech and noises first (`without_rumble`).
- The result has the RMS of the clean utterance. If its peak would exceed `PEAK_LIMIT`, the level is reduced further.
"""

from dataclasses import dataclass

import numpy as np
from scipy import fft

from roomeq.acoustics.direct import find_direct
from roomeq.core.arrays import Array
from roomeq.core.constants import FS_HZ
from roomeq.records.schema import RirRow

PEAK_LIMIT = 0.99
LOWEST_HZ = 20.0
"""Lower end of hearing and of common features."""
_RUMBLE_RATE_HZ = 800
FADE_SAMPLES = FS_HZ // 20
"""Cross-fade at the repetition of a noise that is shorter than the utterance: 50 ms at 16 kHz."""
BLOCK = 4096
"""Samples in a block of a signal and in a partition of an RIR; FFTs are twice as long."""
_N_ROWS = 8
"""Blocks of a result that are computed at a time: what they take stays in the processor's cache."""
_N_SUMMED = 256
"""Samples whose squares are summed in single precision."""


@dataclass(frozen=True)
class MixedUtterance:
    """Result of `mix`.

    Attributes
    ----------
    samples : ndarray of float32, shape (n_samples,)
    snr_db : float or None
        Ratio of the reverberated speech to the sum of all noises [dB]; None without noise.
    gain_db : float
        Gain applied to the reverberated speech [dB], `peak_gain_db` included.
    peak_gain_db : float
        By how much the level was reduced because of the peak [dB], 0 or negative.
    """

    samples: Array
    snr_db: float | None
    gain_db: float
    peak_gain_db: float


def direct_shift(row: RirRow, rir: Array) -> int:
    """Return the delay of the direct sound of an RIR in whole samples.

    The `direct_sample` of the row, which a simulation knows from its geometry, takes precedence over that of its
    acoustic parameters, and this over the onset of the signal.

    Raises
    ------
    ValueError
        The stated sample lies outside the RIR, or the RIR has no direct sound.
    """
    stated = row.get("direct_sample")
    if stated is None:
        stated = (row.get("acoustic_parameters") or {}).get("direct_sample")
    try:
        shift = round(find_direct(rir, row.get("fs_hz", FS_HZ))[0] if stated is None else stated)
    except ValueError as error:
        raise ValueError(f"RIR {row['id']}: {error}") from None
    if not 0 <= shift < len(rir):
        raise ValueError(f"direct_sample={stated} of RIR {row['id']} must lie in its {len(rir)} samples: "
                         "characterise it again")
    return shift


def spectra_of(x: Array) -> Array:
    """Return the spectra of all blocks of `BLOCK` samples, each transformed with the block before it.

    Parameters
    ----------
    x : ndarray of float32, shape (n,)

    Returns
    -------
    spectra : ndarray of complex64, shape (n_blocks, BLOCK + 1)
        The last blocks may be silent: scipy's FFT transforms four rows of float32 in the time of one.
    """
    n_blocks = _multiple_of_four(-(-len(x) // BLOCK) + 1)
    padded = np.zeros((n_blocks + 1) * BLOCK, dtype=np.float32)
    padded[BLOCK:BLOCK + len(x)] = x
    return fft.rfft(np.lib.stride_tricks.sliding_window_view(padded, 2 * BLOCK)[::BLOCK], axis=1)


def convolve(spectra: Array, rir: Array, start: int, n_samples: int) -> Array:
    """Return samples `start` to ``start + n_samples`` of the linear convolution x*rir.

    Overlap-save with partitions of equal length (Stockham, AFIPS 1966; Gardner, JAES 43(3), 1995): block j of the
    result is the sum over k of block j - k of x by partition k of the RIR. The blocks do not depend on the RIR, so the
    spectra of an utterance serve all its copies.

    Parameters
    ----------
    spectra
        `spectra_of` x.
    rir : ndarray of float32, shape (n_taps,)
    start
        First sample to return, at least 0.

    Returns
    -------
    y : ndarray of float32, shape (n_samples,)
    """
    n_parts, first, last = -(-len(rir) // BLOCK), start // BLOCK, -(-(start + n_samples) // BLOCK)
    parts = np.zeros((n_parts, BLOCK), dtype=np.float32)
    parts.reshape(-1)[:len(rir)] = rir
    responses = fft.rfft(parts, 2 * BLOCK, axis=1)
    y = np.empty((_multiple_of_four(last - first), BLOCK), dtype=np.float32)
    all_sums, products = np.empty((2, _N_ROWS, BLOCK + 1), dtype=np.complex64)
    for row in range(0, len(y), _N_ROWS):
        sums = all_sums[:len(y) - row]
        sums[:] = 0
        for part, response in enumerate(responses):
            block = first + row - part
            known = spectra[max(0, block):max(0, block + len(sums))]
            sums[max(0, -block):][:len(known)] += np.multiply(known, response, out=products[:len(known)])
        y[row:row + _N_ROWS] = fft.irfft(sums, axis=1)[:, BLOCK:]
    return y.reshape(-1)[start - first * BLOCK:][:n_samples]


def _multiple_of_four(at_least: int) -> int:
    return -(-at_least // 4) * 4


def mean_power(x: Array) -> float:
    """Return the mean square of a signal, 0 if it is empty: sums of few samples in float32, and theirs in float64.

    A dot product would depend on the number of BLAS threads in its last bits.
    """
    whole = len(x) // _N_SUMMED * _N_SUMMED
    rows, rest = x[:whole].reshape(-1, _N_SUMMED), x[whole:]
    total = np.einsum("ij,ij->i", rows, rows).sum(dtype=np.float64) + np.einsum("i,i->", rest, rest)
    return float(total) / max(1, len(x))


def without_rumble(x: Array, fs_hz: int) -> Array:
    """Return a signal of float32 less its part below `LOWEST_HZ`.

    In geometrical acoustics reflections add up there: RIRs that were simulated without a high-pass would raise the
    rumble of clean recordings by 14 to 19 dB. The filter, of 100 ms, has no phase. What it takes away is computed at a
    low rate, from means of blocks, and interpolated. The signal goes on as its mirror image at both ends.
    """
    x = x - np.float32(x.mean(dtype=np.float64))
    n_block = round(fs_hz / _RUMBLE_RATE_HZ)
    n_blocks, half = -(-len(x) // n_block), round(0.05 * fs_hz / n_block)
    blocks = np.pad(x, (0, n_blocks * n_block - len(x)), mode="symmetric").reshape(n_blocks, n_block)
    means = np.einsum("ij->i", blocks) / np.float32(n_block)
    n = np.arange(-half, half) + 0.5  # from the middle of blocks to their edges
    low_pass = np.sinc(2.0 * LOWEST_HZ * n_block / fs_hz * n) * np.cos(0.5 * np.pi * n / half) ** 2
    low_pass = (low_pass / low_pass.sum()).astype(np.float32)
    at_edges = np.convolve(np.pad(means, half, mode="symmetric"), low_pass, "valid")
    rise = (np.arange(n_block, dtype=np.float32) + np.float32(0.5)) / np.float32(n_block)
    rumble = at_edges[:-1, None] + np.diff(at_edges)[:, None] * rise
    return np.asarray(x - rumble.reshape(-1)[:len(x)])


def ring_length(n_samples: int) -> int:
    """Return the number of samples after which a noise of `n_samples` repeats in `loop`."""
    return n_samples - min(FADE_SAMPLES, n_samples // 4)


def loop(noise: Array, offset: int, n_samples: int) -> Array:
    """Return `n_samples` of a noise that repeats without clicks: its end is cross-faded into its start.

    Parameters
    ----------
    noise : ndarray, shape (n,)
        It becomes a ring of ``n - fade`` samples. The cross-fade keeps the power of uncorrelated ends.
    offset
        First sample on the ring.
    """
    ring = noise[:ring_length(len(noise))].copy()
    fade = len(noise) - len(ring)
    if fade:
        angle = (np.arange(fade, dtype=np.float32) + 0.5) * np.float32(np.pi / 2 / fade)
        ring[:fade] = noise[:fade] * np.sin(angle) + noise[len(noise) - fade:] * np.cos(angle)
    return np.resize(np.roll(ring, -(offset % len(ring))), n_samples)


def mix(clean: Array, reverberated: Array, noises: list[tuple[Array, float]]) -> MixedUtterance:
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
    samples: Array = reverberated
    total_noise: Array = np.zeros(1, dtype=np.float32)
    clean_power, speech_power = mean_power(clean), mean_power(reverberated)
    if not clean_power > 0:
        raise ValueError("utterance is silent (all samples the same): leave it out of the data directory")
    if not speech_power > 0:
        raise ValueError("reverberated utterance is silent: the RIR must hold its direct sound: drop the RIR")
    for noise, snr_db in noises:
        power = mean_power(noise)
        if not power > 0:
            raise ValueError("noise is silent (all samples the same): leave it out")
        total_noise = total_noise + noise * np.float32(np.sqrt(speech_power / power * 10 ** (-snr_db / 10)))
    if noises:
        samples = reverberated + total_noise
    gain = np.sqrt(clean_power / mean_power(samples))
    peak = float(max(samples.max(), -samples.min())) * gain
    peak_gain = min(1.0, PEAK_LIMIT / peak)
    snr = 10 * np.log10(speech_power / mean_power(total_noise)) if noises else None
    return MixedUtterance(samples * np.float32(gain * peak_gain), None if snr is None else float(snr),
                          float(20 * np.log10(gain * peak_gain)), float(20 * np.log10(peak_gain)))
