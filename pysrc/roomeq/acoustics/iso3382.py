"""Room-acoustic quantities of one impulse response per octave, and whether each can be believed.

Conventions
-----------
Times are seconds, levels dB. Octave filters have zero phase: nothing is delayed, and what a filter spreads
ahead of the direct sound is counted as having arrived with it. Decay curves are integrated backward, less the
noise, from the intersection where decay meets noise (Lundeby et al., Acustica 81 (1995) 344), and hold the exponential
rest beyond it (Guski & Vorländer, Acta Acustica 100 (2014) 320, methods D and E).

Metrics
-------
EDT, T20, T30 and C50 (ISO 3382-1:2009, ISO 3382-2:2008), direct-to-reverberant ratio, noise floor and intersection.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from roomeq.acoustics.decibels import TINY_POWER, power_db
from roomeq.acoustics.direct import find_direct
from roomeq.core.constants import EXACT_BANDS_HZ

FILTER_ORDER = 4  # of the Butterworth prototype; IEC 61260-1 class 1 needs 3, neighbouring bands ask for more
MIN_BT = 16.0  # ISO 3382-2, 7.3: bandwidth times decay time, below which the filter's own decay shows
MARGIN_DB = 10.0  # ISO 3382-2, 7.2: the noise lies at least this far below the end of the evaluated range
DIRECT_S = 2.5e-3  # what arrives this soon after the direct sound counts as direct (DRR)
EARLY_S = 0.05  # early sound of C50
DECAYS_DB = {"edt": (0.0, -10.0), "t20": (-5.0, -25.0), "t30": (-5.0, -35.0)}
_FFT_GRID = 4096  # a few sizes for responses of all lengths: their filters are kept


@dataclass(frozen=True)
class NoiseIntersection:
    """Where a decay meets its noise floor, and the regression line of the late decay.

    Attributes
    ----------
    sample : int
        Samples from the start to the intersection; the length of the response where its end still decays.
    noise_power : float
        Mean square of the noise; 0 where no floor is seen.
    rest_energy : float
        Sum of the squared response that the late decay would still bring beyond the intersection.
    """

    sample: int
    noise_power: float
    rest_energy: float


@dataclass(frozen=True)
class Decay:
    """The energy decay of one band.

    Attributes
    ----------
    edc_db : ndarray, shape (n,)
        Decay curve from the direct sound to the intersection; 0 dB is everything that arrived.
    range_db : float
        How far the curve falls before the intersection; infinite for a decay to digital silence.
    noise_floor_db : float or None
        Noise relative to the strongest 5 ms; None where no floor is seen.
    intersection : NoiseIntersection
        Counted from the direct sound.
    """

    edc_db: np.ndarray
    range_db: float
    noise_floor_db: float | None
    intersection: NoiseIntersection


def _fft_size(n_samples, fs_hz):
    """Length of transform in which no octave filter reaches around a response."""
    return next_fast_len(-(-(n_samples + round(0.1 * fs_hz)) // _FFT_GRID) * _FFT_GRID, real=True)


@lru_cache(maxsize=128)
def octave_gains(n_fft, fs_hz, band_hz):
    """Amplitude response of a zero-phase octave filter.

    The magnitude is that of a Butterworth band-pass, ``1 / sqrt(1 + (Q (f/fm - fm/f))^2n)`` with Q = sqrt 2:
    3 dB down at the band's edges ``fm 2^(-1/2)`` and ``fm 2^(1/2)``.

    Parameters
    ----------
    n_fft : int
        Length of the transform.
    fs_hz : float
    band_hz : float
        Exact mid-band frequency [Hz].

    Returns
    -------
    gains : ndarray, shape (n_fft // 2 + 1,)
        Read-only.
    """
    ratio = np.maximum(np.fft.rfftfreq(n_fft, 1.0 / fs_hz), 1e-3) / band_hz
    gains = 1.0 / np.sqrt(1.0 + (np.sqrt(2.0) * (ratio - 1.0 / ratio)) ** (2 * FILTER_ORDER))
    gains.flags.writeable = False
    return gains


def octave_bands(rir, fs_hz, bands_hz=EXACT_BANDS_HZ):
    """Split a response into octave bands with zero-phase filters.

    Parameters
    ----------
    rir : ndarray, shape (n_samples,)
    fs_hz : float
    bands_hz : sequence of float
        Exact mid-band frequencies [Hz].

    Returns
    -------
    bands : ndarray, shape (n_bands, n_samples)
    """
    n_fft = _fft_size(len(rir), fs_hz)
    gains = np.array([octave_gains(n_fft, fs_hz, band_hz) for band_hz in bands_hz])
    return irfft(rfft(rir, n_fft) * gains, n_fft, axis=-1)[:, :len(rir)]


def find_noise_intersection(power, fs_hz):
    """Find where a decay meets the noise floor, by Lundeby's iteration.

    The noise is what the end of the response holds beyond the extrapolated decay. Where that is less than the
    decay itself, the response ends before its noise floor.

    Parameters
    ----------
    power : ndarray, shape (n_samples,)
        Squared response from the direct sound on.
    fs_hz : float

    Returns
    -------
    NoiseIntersection
    """
    n_samples = len(power)
    noise = tail = float(np.mean(power[int(0.9 * n_samples):]))
    n_block, span_db, intersection = max(1, round(0.01 * fs_hz)), np.inf, n_samples
    if noise <= TINY_POWER:
        return NoiseIntersection(n_samples, 0.0, 0.0)
    for _ in range(8):
        line = _late_decay(power, noise, n_block, span_db)
        if line is None:
            return _drowned(power, tail, n_block)
        slope_db, offset_db = line
        previous, intersection = intersection, int(np.clip((power_db(noise) - offset_db) / slope_db, 1, n_samples))
        start = int(min(intersection - MARGIN_DB / slope_db, 0.9 * n_samples))
        tail = float(np.mean(power[start:]))
        noise = tail - _line_energy(line, start, n_samples) / (n_samples - start)
        if noise < 0.5 * tail:
            return NoiseIntersection(n_samples, 0.0, _line_energy(line, n_samples))
        n_block = int(np.clip(-MARGIN_DB / slope_db / 4, 0.002 * fs_hz, 0.05 * fs_hz))
        span_db = 20.0
        if abs(intersection - previous) < 0.002 * fs_hz:
            break
    return NoiseIntersection(intersection, noise, _line_energy(line, intersection))


def _late_decay(power, noise, n_block, span_db):
    """Regression line (slope [dB/sample], offset [dB]) of the decay from `span_db` above the noise margin down."""
    n_blocks = len(power) // n_block
    level_db = power_db(np.mean(power[:n_blocks * n_block].reshape(n_blocks, n_block), axis=1))
    below = np.flatnonzero(level_db < power_db(noise) + 7.0)
    stop = int(below[0]) if len(below) else n_blocks
    if stop < 2:
        return None
    start = int(np.argmax(level_db[:stop]))
    above = np.flatnonzero(level_db[:stop] > power_db(noise) + 7.0 + span_db)
    start = max(start, min(int(above[-1]) if len(above) else 0, stop - 4))
    if stop - start < 2:
        return None
    centre = (np.arange(start, stop) + 0.5) * n_block
    middle, level_db = centre.mean(), level_db[start:stop]
    slope_db = _dot(centre - middle, level_db) / _dot(centre - middle, centre - middle)
    offset_db = level_db.mean() - slope_db * middle
    return (slope_db, offset_db) if slope_db < 0.0 else None


def _drowned(power, noise, n_block):
    """NoiseIntersection of a response in which no decay can be followed: where it first comes down to the noise."""
    n_blocks = len(power) // n_block
    level = np.mean(power[:n_blocks * n_block].reshape(n_blocks, n_block), axis=1) if n_blocks else power[:1]
    below = np.flatnonzero(level < 2.0 * noise)
    return NoiseIntersection(max(1, int(below[0]) * n_block) if len(below) else len(power), noise, 0.0)


def _line_energy(line, start, stop=None):
    """Sum over samples start to stop (or to infinity) of the power of a decay line."""
    slope_db, offset_db = line
    rate = -slope_db * np.log(10.0) / 10.0
    energy = 10.0 ** ((offset_db + slope_db * start) / 10.0) / rate
    return energy if stop is None else energy * -np.expm1(-rate * (stop - start))


def _dot(first, second):
    """Inner product without BLAS, whose threads wait for each other longer than so little work takes."""
    return float(np.einsum("i,i->", first, second))


def energy_decay(band, fs_hz, direct_sample):
    """Backward-integrated decay of one band, compensated for noise and truncation.

    Parameters
    ----------
    band : ndarray, shape (n_samples,)
        Band-filtered response.
    fs_hz : float
    direct_sample : float

    Returns
    -------
    Decay
    """
    start = max(0, round(direct_sample))
    power = band ** 2
    after = power[start:]
    intersection = find_noise_intersection(after, fs_hz)
    net = after[:intersection.sample] - intersection.noise_power
    energy = np.cumsum(net[::-1])[::-1] + intersection.rest_energy
    total = energy[0] + power[:start].sum()
    energy[0] = total
    edc_db = power_db(energy / max(total, TINY_POWER))
    range_db = float(power_db(total) - power_db(intersection.rest_energy)) if intersection.rest_energy > 0.0 else np.inf
    if intersection.noise_power > 0.0 and intersection.rest_energy == 0.0:
        range_db = 0.0
    n_block = max(1, round(0.005 * fs_hz))
    strongest = np.convolve(after[:20 * n_block], np.full(n_block, 1.0 / n_block), "same").max()
    floor_db = float(power_db(intersection.noise_power) - power_db(strongest)) if intersection.noise_power > 0.0 else None
    return Decay(edc_db, range_db, floor_db, intersection)


def decay_time(edc_db, fs_hz, decay):
    """Time for 60 dB from the regression line over a part of a decay curve (ISO 3382-1, 5.3.3 and A.3).

    Parameters
    ----------
    edc_db : ndarray, shape (n,)
    fs_hz : float
    decay : str
        ``"edt"`` (0 to -10 dB), ``"t20"`` (-5 to -25 dB) or ``"t30"`` (-5 to -35 dB).

    Returns
    -------
    float or None
        Seconds; None where the curve doesn't come down that far.
    """
    top_db, bottom_db = DECAYS_DB[decay]
    reached = edc_db <= bottom_db
    last = int(np.argmax(reached))
    first = int(np.argmax(edc_db[:last + 1] <= top_db))
    if not reached[last] or last - first < 2:
        return None
    level = edc_db[first:last + 1]
    time = np.arange(len(level)) - (len(level) - 1) / 2.0
    slope_db = _dot(time, level) / _dot(time, time)
    return float(-60.0 / slope_db / fs_hz) if slope_db < 0.0 else None


def reverberation_time(rir, fs_hz, band_hz=1000.0, decay="t30", *, direct_sample=None):
    """Decay time of one octave band; quick, for solving for a target.

    Parameters
    ----------
    rir : ndarray, shape (n_samples,)
    fs_hz : float
    band_hz : float
        Mid-band frequency, nominal or exact [Hz].
    decay : str
        ``"edt"``, ``"t20"`` or ``"t30"``.
    direct_sample : float, optional
        Found by `find_direct` if not given.

    Returns
    -------
    float
        Seconds.

    Raises
    ------
    ValueError
        The response doesn't decay that far.
    """
    rir = np.asarray(rir, dtype=np.float64)
    if direct_sample is None:
        direct_sample, _ = find_direct(rir, fs_hz)
    exact_hz = 1000.0 * 10.0 ** (0.3 * round(np.log2(band_hz / 1000.0)))
    curve = energy_decay(octave_bands(rir, fs_hz, [exact_hz])[0], fs_hz, direct_sample)
    time_s = decay_time(curve.edc_db, fs_hz, decay)
    if time_s is None:
        raise ValueError(f"{decay} at {band_hz:g} Hz needs a decay of {-DECAYS_DB[decay][1]:g} dB and "
                         f"{len(rir)} samples hold {-curve.edc_db.min():.1f} dB: use a longer response")
    return time_s


def all_metrics(rir, fs_hz, direct_sample=None, polarity=None):
    """Measure everything that the acoustic parameters says about decay and level ratios.

    Parameters
    ----------
    rir : ndarray, shape (n_samples,)
    fs_hz : float
    direct_sample : float, optional
        Found by `find_direct`, like `polarity`, if not given.
    polarity : int, optional

    Returns
    -------
    dict
        JSON-able: `direct_sample`, `direct_polarity`, `drr_db`, `noise_intersection_s` and `noise_floor_db` of the whole
        band, and lists of 8 (octaves 62.5 Hz to 8 kHz): `edt_s, t20_s, t30_s, c50_db` with `*_valid`,
        `band_noise_intersection_s`, `band_noise_floor_db`, `decay_range_db`. What cannot be computed is None and not valid.

    Raises
    ------
    ValueError
        See `find_direct`.
    """
    rir = np.asarray(rir, dtype=np.float64)
    if direct_sample is None or polarity is None:
        direct_sample, polarity = find_direct(rir, fs_hz, direct_sample)
    last = int(np.flatnonzero(rir)[-1]) + 1  # digital silence behind the response is no noise floor
    rir = rir[:last]
    whole = energy_decay(rir, fs_hz, direct_sample)
    result = dict(direct_sample=float(direct_sample), direct_polarity=int(polarity),
                  drr_db=_drr_db(rir, fs_hz, direct_sample, whole.intersection), noise_intersection_s=whole.intersection.sample / fs_hz,
                  noise_floor_db=whole.noise_floor_db)
    spectra = _Spectra(rir, _fft_size(len(rir), fs_hz))
    rows = [_band_metrics(spectra, band, fs_hz, band_hz, direct_sample)
            for band, band_hz in zip(octave_bands(rir, fs_hz), EXACT_BANDS_HZ, strict=True)]
    result.update({key: [row[key] for row in rows] for key in rows[0]})
    return result


class _Spectra:
    """Energy spectra of parts of a response, each computed once for all bands."""

    def __init__(self, rir, n_fft):
        self.rir, self.n_fft, self._known = rir, n_fft, {}

    def energy(self, first, last, fs_hz, band_hz):
        """Energy of samples `first` to `last` in an octave."""
        if (first, last) not in self._known:
            power = np.abs(rfft(self.rir[first:last], self.n_fft)) ** 2
            power[1:(self.n_fft + 1) // 2] *= 2.0  # both signs of frequency
            self._known[first, last] = power
        return _dot(octave_gains(self.n_fft, fs_hz, band_hz) ** 2, self._known[first, last]) / self.n_fft


def _band_metrics(spectra, band, fs_hz, band_hz, direct_sample):
    """Metrics of one octave, each with its validity."""
    curve = energy_decay(band, fs_hz, direct_sample)
    row = {}
    for decay, (_, bottom_db) in DECAYS_DB.items():
        time_s = decay_time(curve.edc_db, fs_hz, decay)
        row[f"{decay}_s"] = time_s
        row[f"{decay}_valid"] = bool(time_s is not None and curve.range_db >= MARGIN_DB - bottom_db
                                     and band_hz * np.sqrt(0.5) * time_s > MIN_BT)
    row["c50_db"] = _c50_db(spectra, fs_hz, band_hz, direct_sample, curve.intersection)
    # the late part lies C50 below the whole, the noise must lie below the late part
    row["c50_valid"] = bool(row["c50_db"] is not None
                            and curve.range_db >= MARGIN_DB + max(MARGIN_DB, row["c50_db"]))
    row["band_noise_intersection_s"] = curve.intersection.sample / fs_hz
    row["band_noise_floor_db"] = curve.noise_floor_db
    row["decay_range_db"] = float(min(curve.range_db, 200.0))
    return row


def _c50_db(spectra, fs_hz, band_hz, direct_sample, intersection):
    """Early-to-late ratio of one octave: gated before filtering, so that the filter smears nothing across."""
    gate = round(direct_sample + EARLY_S * fs_hz)
    end = round(direct_sample) + intersection.sample
    if end <= gate:
        return None
    early, late = (spectra.energy(*part, fs_hz, band_hz) for part in ((0, gate), (gate, end)))
    late += intersection.rest_energy - (end - gate) * intersection.noise_power
    early -= gate * intersection.noise_power
    return float(power_db(early) - power_db(late)) if early > 0.0 and late > 0.0 else None


def _drr_db(rir, fs_hz, direct_sample, intersection):
    """Direct-to-reverberant ratio of the whole band, None where one of the two is nothing."""
    gate = round(direct_sample + DIRECT_S * fs_hz)
    first = max(0, round(direct_sample - DIRECT_S * fs_hz))
    end = round(direct_sample) + intersection.sample
    direct = np.sum(rir[first:gate] ** 2) - (gate - first) * intersection.noise_power
    reverberant = np.sum(rir[gate:end] ** 2) - max(0, end - gate) * intersection.noise_power + intersection.rest_energy
    return float(power_db(direct) - power_db(reverberant)) if direct > 0.0 and reverberant > 0.0 else None
