"""One RIR as a vector of features: every metric, band and time region that measured and simulated RIRs are compared in.

Conventions
-----------
All features are in just noticeable differences (JND), so that a difference of features is an error: levels per 1 dB,
logarithms of decay times per 5 %, C50 per 1.1 dB, DRR per 2 dB (ISO 3382-1:2009, table A.1; Bradley et al.,
J. Acoust. Soc. Am. 105 (1999) 3446; Larsen et al., J. Acoust. Soc. Am. 124 (2008) 450). Two features have no such
threshold and a unit of their own: the arrival of the direct sound, per 0.1 ms (3.4 cm, about what positions are known
to), and noise, per dB by which it raises what any recording has: white noise, and what is too quiet to disturb a decay.

Levels are those of the recording: one unknown gain per chain stands in all of them (`HAS_GAIN`).
"""

from dataclasses import dataclass

import numpy as np
from scipy.fft import next_fast_len, rfft

from roomeq.acoustics.direct import find_direct
from roomeq.acoustics.iso3382 import EARLY_S, all_metrics, octave_gains
from roomeq.core.constants import BANDS_HZ, EXACT_BANDS_HZ, FS_HZ
from roomeq.effects.noise_floor import NOISE_S, OCTAVE_WIDTH_HZ, QUIET_DB

DIRECT_S = 2.5e-3
LEAD_S = 1.5e-3
LATE_S = 0.2  # end of the late level: longer, and noise would be part of it
THIRDS_HZ = tuple(1000.0 * 10.0 ** (0.1 * k) for k in range(-13, 9))
"""Exact mid-bands of third octaves, 50 Hz to 6.3 kHz."""
DIRECT_THIRDS_HZ = THIRDS_HZ[11:]  # from 630 Hz: lower ones are not resolved within `DIRECT_S`
NEAR_S, NEAR_SHARE = 4e-4, 0.05
"""By how much the direct sound may miss its geometry: positions (14 cm), and a speed of sound that is 5 % off."""
MIN_SNR_DB = 10.0
QUIET = 10.0 ** (QUIET_DB / 10.0)
JND = dict(direct=1.0, early=1.0, late=1.0, spectrum=1.0, edt=np.log(1.05), t20=np.log(1.05), t30=np.log(1.05),
           c50=1.1, drr=2.0, arrival=1e-4, ahead=1.0, floor=1.0)
REGION = dict(direct="direct", early="early", late="late", spectrum="whole", edt="early", t20="late", t30="late",
              c50="early", drr="direct", arrival="direct", ahead="ahead", floor="floor")
_BANDS_OF = dict(direct=DIRECT_THIRDS_HZ, early=EXACT_BANDS_HZ, late=EXACT_BANDS_HZ, spectrum=THIRDS_HZ,
                 edt=EXACT_BANDS_HZ, t20=EXACT_BANDS_HZ, t30=EXACT_BANDS_HZ, c50=EXACT_BANDS_HZ, drr=(0.0,),
                 arrival=(0.0,), ahead=EXACT_BANDS_HZ, floor=EXACT_BANDS_HZ)
METRIC = np.array([metric for metric, bands in _BANDS_OF.items() for _ in bands])
"""Metric of each feature, shape (n_features,)."""
BAND_HZ = np.array([band_hz for bands in _BANDS_OF.values() for band_hz in bands])
"""Mid-band frequency of each feature [Hz], 0 for the whole band, shape (n_features,)."""
N_FEATURES = len(METRIC)
HAS_GAIN = np.isin(METRIC, ["direct", "early", "late", "spectrum"])
"""Whether the gain of the recording stands in a feature, shape (n_features,)."""
LARGEST = 20.0
"""Error of a feature that a model cannot produce [JND]."""


def feature_slice(metric):
    """Slice of a metric's features."""
    found = np.flatnonzero(METRIC == metric)
    return slice(int(found[0]), int(found[-1]) + 1)


@dataclass(frozen=True)
class Features:
    """What was measured on one RIR.

    Attributes
    ----------
    values : ndarray, shape (n_features,)
        In JND; NaN where there is nothing to measure.
    valid : ndarray of bool, shape (n_features,)
        Whether a feature can be believed: decay range, bandwidth and distance to the noise suffice.
    direct_sample : float
    white : ndarray, shape (8,)
        White noise of the recording: energy of 100 ms relative to the response, per octave.
    """

    values: np.ndarray
    valid: np.ndarray
    direct_sample: float
    white: np.ndarray


def measure_features(rir, expected_sample=None, *, timed=True, white=None):
    """Measure all features of an RIR.

    Parameters
    ----------
    rir : ndarray, shape (n_samples,)
        At `FS_HZ`.
    expected_sample : float, optional
        Where geometry puts the direct sound, if sample 0 is the emission.
    timed : bool
        Whether the arrival of the direct sound means something: not where the time of flight was removed.
    white : ndarray, shape (8,), optional
        White noise to be thought of as there: that of the recording that a rendered RIR is compared with.

    Returns
    -------
    Features

    Raises
    ------
    ValueError
        There is no direct sound.
    """
    rir = np.asarray(rir, dtype=np.float64)
    direct, polarity, timed = _direct(rir, expected_sample, timed)
    found = all_metrics(rir, FS_HZ, direct, polarity)
    values, valid = np.full(N_FEATURES, np.nan), np.zeros(N_FEATURES, dtype=bool)
    for metric in ("edt", "t20", "t30"):
        times_s = np.array([np.nan if time_s is None else time_s for time_s in found[f"{metric}_s"]])
        _put(values, valid, metric, np.log(times_s), np.array(found[f"{metric}_valid"]))
    _put(values, valid, "c50", np.array([np.nan if one is None else one for one in found["c50_db"]]),
         np.array(found["c50_valid"]))
    drr_db = found["drr_db"]
    _put(values, valid, "drr", np.array([np.nan if drr_db is None else drr_db]), np.array([drr_db is not None]))
    _put(values, valid, "arrival", np.array([direct / FS_HZ]), np.array([timed]))
    noise = _noise_density(rir, found)
    for metric, (level_db, snr_db) in _levels(rir, direct, found, noise).items():
        _put(values, valid, metric, level_db, snr_db > MIN_SNR_DB)
    levels, white = _noise_levels(rir, direct, noise, white)
    for metric, (level_db, believed) in levels.items():
        _put(values, valid, metric, level_db, believed)
    return Features(values, valid & np.isfinite(values), direct, white)


def _direct(rir, expected_sample, timed):
    """Direct sound, its polarity, and whether its arrival counts: not where an obstacle drowned it.

    What comes later than positions and the air explain is another path; geometry says then where the direct sound is.
    """
    if expected_sample is None:
        return *find_direct(rir, FS_HZ), timed
    most = NEAR_S * FS_HZ + NEAR_SHARE * expected_sample
    try:
        sample, polarity = find_direct(rir, FS_HZ, expected_sample, search_s=most / FS_HZ)
        if abs(sample - expected_sample) < most - 1.0:
            return sample, polarity, timed
    except ValueError:
        find_direct(rir, FS_HZ)  # there must be some sound
    return float(expected_sample), 1, False


def _put(values, valid, metric, amounts, believed):
    values[feature_slice(metric)] = amounts / JND[metric]
    valid[feature_slice(metric)] = believed


def _segment(rir, start, stop, fade):
    """A part of a response with half-cosine edges that lie outside it, as long as they fit."""
    low, high = max(0, start - fade), min(len(rir), stop + fade)
    position = np.arange(low, high)
    window = np.clip(np.minimum(position - start, stop - 1 - position) / max(fade, 1) + 1.0, 0.0, 1.0)
    return rir[low:high] * np.sin(0.5 * np.pi * window) ** 2


def _power(part, n_fft):
    """Energy per bin, both signs of frequency, shape (n_fft // 2 + 1,)."""
    power = np.abs(rfft(part, n_fft)) ** 2 / n_fft
    power[1:(n_fft + 1) // 2] *= 2.0
    return power


def third_gains(n_fft):
    """Power response of third-octave filters, Butterworth of order 4, shape (22, n_fft // 2 + 1)."""
    ratio = np.maximum(np.fft.rfftfreq(n_fft, 1.0 / FS_HZ), 1e-3) / np.array(THIRDS_HZ)[:, None]
    quality = 1.0 / (10.0 ** 0.05 - 10.0 ** -0.05)
    return 1.0 / (1.0 + (quality * (ratio - 1.0 / ratio)) ** 8)


def _octave_power_gains(n_fft):
    return np.array([octave_gains(n_fft, FS_HZ, band_hz) ** 2 for band_hz in EXACT_BANDS_HZ])


_known = {}


def _gains(kind, n_fft):
    """Filters of a length that was asked for before are not made again."""
    if (kind, n_fft) not in _known:
        if len(_known) > 32:
            _known.clear()
        _known[kind, n_fft] = {"third": third_gains, "octave": _octave_power_gains}[kind](n_fft)
    return _known[kind, n_fft]


def _noise_density(rir, found):
    """Noise energy per sample in octaves and third octaves; 0 where the response ends before its noise.

    `end` is what there is at the end, of `n_samples`, noise or not.
    """
    last = int(np.flatnonzero(rir)[-1]) + 1
    start = max(int(0.9 * last), min(last, int(max(found["band_noise_intersection_s"]) * FS_HZ + found["direct_sample"])))
    start = min(start, last - int(0.05 * FS_HZ)) if last > int(0.2 * FS_HZ) else int(0.9 * last)
    seen = np.array([one is not None for one in found["band_noise_floor_db"]])
    part = rir[start:last]
    n_fft = next_fast_len(max(len(part), 2048), real=True)
    power = _power(part, n_fft) / max(len(part), 1)
    end = _gains("octave", n_fft) @ power
    return dict(octave=np.where(seen, end, 0.0), end=end, n_samples=len(part),
                third=np.where(seen[_octave_of_third()], _gains("third", n_fft) @ power, 0.0))


def _octave_of_third():
    return np.argmin(np.abs(np.log(np.array(THIRDS_HZ)[:, None] / np.array(EXACT_BANDS_HZ))), axis=1)


def _levels(rir, direct, found, noise):
    """Level and distance to the noise of the level features [dB]: {metric: (level, snr)}."""
    at = round(direct)
    gate, early, late = (at + round(seconds * FS_HZ) for seconds in (DIRECT_S, EARLY_S, LATE_S))
    end = max(late, at + round(found["noise_intersection_s"] * FS_HZ))
    parts = {"direct": (at - round(LEAD_S * FS_HZ), gate, 8, "third"), "early": (gate, early, 16, "octave"),
             "late": (early, late, 40, "octave"), "spectrum": (at - round(LEAD_S * FS_HZ), end, 40, "third")}
    result = {}
    for metric, (start, stop, fade, kind) in parts.items():
        part = _segment(rir, max(0, start), min(stop, len(rir)), fade)
        n_fft = 1024 if metric == "direct" else next_fast_len(max(2048, len(part)), real=True)
        energy = _gains(kind, n_fft) @ _power(part, n_fft)
        disturbed = noise[kind] * len(part)
        if metric == "direct":
            energy, disturbed = energy[-len(DIRECT_THIRDS_HZ):], disturbed[-len(DIRECT_THIRDS_HZ):]
        level_db = 10.0 * np.log10(np.maximum(energy - disturbed, 1e-30))
        result[metric] = level_db, level_db - 10.0 * np.log10(np.maximum(disturbed, 1e-30))
    return result


def _noise_levels(rir, direct, noise, white):
    """By how much noise behind the response and sound ahead of it raise what any recording has, per octave [dB].

    Any recording has white noise, of a level of its own, and what is quiet disturbs nothing: both stand below every
    ratio, so that it goes to 0 smoothly where there is no more.

    Returns
    -------
    levels : dict
        {metric: (level, whether it can be believed)}.
    white : ndarray, shape (8,)
    """
    n_fft = next_fast_len(len(rir), real=True)
    per_energy = NOISE_S * FS_HZ / np.maximum(_gains("octave", n_fft) @ _power(rir, n_fft), 1e-30)
    end, seen = noise["end"] * per_energy, noise["octave"] > 0.0
    if white is None:
        besides, white = 0.0, _white(noise) * per_energy
        behind = np.where(seen, end, white) + QUIET
    else:  # a rendering goes on until it is over
        besides, behind = white, end + white + QUIET
    # a response that ends before its noise tells of it only where even its end is quiet
    believed = seen | (_db(end / QUIET + 1.0) < JND["floor"])
    result = {"floor": (_db(behind / (white + QUIET)), believed)}
    n_ahead = round(direct) - round(3e-3 * FS_HZ) - 16
    ahead, resolved = np.full(len(BANDS_HZ), np.nan), (OCTAVE_WIDTH_HZ * n_ahead > FS_HZ) & (n_ahead > 48)
    # a rendering's direct sound may come earlier than the recording's: what is believed of one, the other must have
    if n_ahead > 8:
        part = _segment(rir, 16, 16 + n_ahead, 16)
        n_fft = next_fast_len(max(2048, len(part)), real=True)
        ahead = _db((_gains("octave", n_fft) @ _power(part, n_fft) / len(part) * per_energy + besides + QUIET) / behind)
    result["ahead"] = ahead, resolved & believed
    return result, white


def _white(noise):
    """Level of the white noise that all octaves have at least, energy per sample in each.

    Energy over a time T in a bandwidth B is known to a share of 1 / sqrt(B T): the least of all octaves would be that
    of the narrowest by chance.
    """
    share = 1.0 / np.sqrt(OCTAVE_WIDTH_HZ * noise["n_samples"] / FS_HZ)
    most = noise["octave"] / OCTAVE_WIDTH_HZ * (1.0 + 2.0 * share)
    return OCTAVE_WIDTH_HZ * (most[most > 0.0].min() if np.any(most > 0.0) else 0.0)


def _db(power):
    return 10.0 * np.log10(np.maximum(power, 1e-30))
