"""Energy of parts of a response in octave and third-octave bands, from their spectra: no filtered response is made."""

from typing import NamedTuple

import numpy as np
from scipy.fft import rfft

from roomeq.acoustics.octaves import SPECTRUM_HZ
from roomeq.core.arrays import Array, FloatArray
from roomeq.core.constants import EXACT_BANDS_HZ, FS_HZ
from roomeq.core.jit import compiled


class Bands(NamedTuple):
    """Band-pass filters.

    Attributes
    ----------
    mid_hz : ndarray, shape (n_bands,)
    quality : float
        Mid-band frequency over bandwidth.
    """

    mid_hz: FloatArray
    quality: float


OCTAVES = Bands(np.array(EXACT_BANDS_HZ), np.sqrt(2.0))
THIRDS = Bands(np.array(SPECTRUM_HZ), 1.0 / (10.0 ** 0.05 - 10.0 ** -0.05))


def energy_per_bin(part: FloatArray, n_fft: int) -> FloatArray:
    """Return the energy spectrum of a part of a response, both signs of frequency, shape (n_fft // 2 + 1,).

    The sum over all bins is the energy of the part (Parseval).
    """
    return _both_signs(rfft(part, n_fft), n_fft)


def energy_in_bands(bands: Bands, energy: FloatArray, n_fft: int, fs_hz: float = FS_HZ) -> FloatArray:
    """Return the energy in each band of a spectrum from `energy_per_bin`, shape (n_bands,)."""
    return _filtered(energy, fs_hz / n_fft, *bands)


@compiled
def _both_signs(spectrum: Array, n_fft: int) -> FloatArray:
    """Return the energy per bin; all but the first, and the last of an even length, stand for two frequencies."""
    energy = np.empty(len(spectrum))
    for k in range(len(spectrum)):
        energy[k] = (spectrum[k].real ** 2 + spectrum[k].imag ** 2) * (2.0 / n_fft)
    energy[0] *= 0.5
    if n_fft % 2 == 0:
        energy[-1] *= 0.5
    return energy


@compiled
def _filtered(energy: FloatArray, bin_hz: float, mid_hz: FloatArray, quality: float) -> FloatArray:
    """Add up an energy spectrum behind filters of power response ``1 / (1 + (Q (f/fm - fm/f))^8)``.

    These are those of `roomeq.acoustics.octaves`. To compute them is faster than to read them from memory, and lengths
    of parts are too many to keep their filters.
    """
    slope, inverse, total = quality / mid_hz, quality * mid_hz, np.zeros(len(mid_hz))
    for k in range(0, len(energy), 2):  # two bins share a division: nothing else takes as long
        energy_above = energy[k + 1] if k + 1 < len(energy) else 0.0
        frequency, above = max(k * bin_hz, 1e-3), (k + 1) * bin_hz
        period, period_above = 1.0 / frequency, 1.0 / above
        for band in range(len(mid_hz)):
            loss = 1.0 + (slope[band] * frequency - inverse[band] * period) ** 8
            loss_above = 1.0 + (slope[band] * above - inverse[band] * period_above) ** 8
            total[band] += (energy[k] * loss_above + energy_above * loss) / (loss * loss_above)
    return total


@compiled
def faded_part(response: FloatArray, start: int, stop: int, fade: int) -> FloatArray:
    """Return a part of a response with half-cosine edges of `fade` samples around it, cut at the response's ends."""
    low, high = max(0, start - fade), min(len(response), stop + fade)
    part = response[low:high].copy()
    for n in np.concatenate((np.arange(low, min(start, high)), np.arange(max(start, stop, low), high))):
        outside = max(start - n, n - (stop - 1))
        part[n - low] *= np.sin(0.5 * np.pi * max(1.0 - outside / max(fade, 1), 0.0)) ** 2
    return part
