"""Features of an RIR: all metrics, by band and time region, in which measured and simulated RIRs are compared.

Conventions
-----------
All features are in just noticeable differences (JND), so that a difference of features is an error: levels in units of
1 dB, logarithms of decay times of 5 %, C50 of 1.1 dB, DRR of 2 dB (`roomeq.acoustics.jnd`). Two metrics have no such
threshold and a unit of their own: the arrival of the direct sound is in units of 0.1 ms (3.4 cm, about the accuracy of
positions), and noise is scored in dB relative to white noise plus a -55 dB floor.

Levels are those of the recording: all of them contain an unknown gain of the recording chain (`HAS_GAIN`).
"""

from dataclasses import dataclass
from functools import cache, partial
from typing import NamedTuple

import numpy as np
from scipy.fft import next_fast_len
from scipy.special import gammaincinv

from roomeq.acoustics.band_energy import OCTAVES, THIRDS, Bands, energy_in_bands, energy_per_bin, faded_part
from roomeq.acoustics.decibels import FLOOR_POWER, power_db
from roomeq.acoustics.direct import find_direct
from roomeq.acoustics.excitation import NO_END_HZ, excited_from_hz, excited_to_hz, is_excited
from roomeq.acoustics.fade import length_before_fade, length_before_zeros
from roomeq.acoustics.iso3382 import DIRECT_S, EARLY_S, all_metrics
from roomeq.acoustics.jnd import C50_JND_DB, DECAY_JND, DRR_JND_DB, LEVEL_JND_DB
from roomeq.acoustics.octaves import (
    OCTAVE_OF_THIRD,
    OCTAVE_WIDTH_HZ,
    SPECTRUM_HZ,
    THIRD_WIDTH_HZ,
    THIRDS_HZ,
    nearest_octave,
)
from roomeq.core.arrays import Array, BoolArray, FloatArray
from roomeq.core.constants import BANDS_HZ, EXACT_BANDS_HZ, FS_HZ
from roomeq.effects.noise_floor import NOISE_S, QUIET_DB, SHARE_OF_THIRD

LEAD_S = 1.5e-3
LATE_S = 0.2  # end of the late level, ahead of the noise of most recordings
DIRECT_THIRDS_HZ = THIRDS_HZ[11:]  # from 630 Hz: lower ones are not resolved within `DIRECT_S`
_N_BELOW = len(SPECTRUM_HZ) - len(THIRDS_HZ)  # third octaves below the octaves
_BELOW = Bands(THIRDS.mid_hz[:_N_BELOW], THIRDS.quality)
NEAR_S, NEAR_SHARE = 4e-4, 0.05
"""Tolerance of the arrival of the direct sound: positions (14 cm) plus a speed of sound that is wrong by 5 %."""
MIN_SNR_DB = 10.0
_HANN_SHARE = 18.0 / 35.0  # of the degrees of freedom of noise that a Hann window leaves
_LOW_NOISE_S = 0.5  # at the end of a recording, of which the noise below 45 Hz is measured
_UNDERESTIMATED = 0.05  # how often it may be larger than is assumed
_CONTRADICTED = 0.5  # the level of white noise is found too high as often as too low
QUIET = 10.0 ** (QUIET_DB / 10.0)
JND = dict(direct=LEVEL_JND_DB, early=LEVEL_JND_DB, late=LEVEL_JND_DB, spectrum=LEVEL_JND_DB, edt=DECAY_JND,
           t20=DECAY_JND, t30=DECAY_JND, curvature=DECAY_JND, c50=C50_JND_DB, drr=DRR_JND_DB, arrival=1e-4, ahead=1.0,
           floor=1.0)
REGION = dict(direct="direct", early="early", late="late", spectrum="whole", edt="early", t20="late", t30="late",
              curvature="late", c50="early", drr="direct", arrival="direct", ahead="ahead", floor="floor")
"""Time region of each metric. The curvature of a decay, T30 relative to T20 (ISO 3382-2:2008, annex B), is no feature:
residuals are tested for it (`roomeq.loop.unexplained`)."""
_BANDS_OF = dict(direct=DIRECT_THIRDS_HZ, early=EXACT_BANDS_HZ, late=EXACT_BANDS_HZ, spectrum=SPECTRUM_HZ,
                 edt=EXACT_BANDS_HZ, t20=EXACT_BANDS_HZ, t30=EXACT_BANDS_HZ, c50=EXACT_BANDS_HZ, drr=(0.0,),
                 arrival=(0.0,), ahead=EXACT_BANDS_HZ, floor=THIRDS_HZ)
METRIC = np.array([metric for metric, bands in _BANDS_OF.items() for _ in bands])
"""Metric of each feature, shape (n_features,)."""
BAND_HZ = np.array([band_hz for bands in _BANDS_OF.values() for band_hz in bands])
"""Mid-band frequency of each feature [Hz], 0 for the whole band, shape (n_features,)."""
BAND_OF_FEATURE = np.where(BAND_HZ > 0, nearest_octave(np.maximum(BAND_HZ, 1.0)), -1)
"""Number of the octave band of each feature, -1 for the whole band, shape (n_features,)."""
N_FEATURES = len(METRIC)
_WIDTH = np.where(np.isin(METRIC, ["direct", "spectrum", "floor"]), 1.0 / 3.0, 1.0)  # of each feature's band [octaves]
HAS_GAIN = np.isin(METRIC, ["direct", "early", "late", "spectrum"])
"""Whether a feature contains the gain of the recording, shape (n_features,)."""
SHOW_DIRECT_SOUND = np.isin(METRIC, ("direct", "spectrum", "c50", "drr", "edt"))
"""Features that depend on the level of the direct sound."""
CALIBRATION_FEATURES = (METRIC == "direct") & (np.arange(N_FEATURES) % 2 == 0)
"""Features of scored RIRs that calibration may use, and that are not scored: they show an obstructed direct sound, and
where a source faces."""
SCORED = ~CALIBRATION_FEATURES & (METRIC != "ahead")
"""Features by whose errors a model is judged. Sound ahead of the direct sound comes from no room: it is noise,
distortion or ringing of the measurement, which a simulation rightly lacks. It is reported as unexplained."""
LARGEST = 20.0
"""Error of a feature that a model cannot produce [JND]."""
_db = partial(power_db, floor=FLOOR_POWER)


@cache
def feature_slice(metric: str) -> slice:
    """Return the slice of a metric's features."""
    at = np.flatnonzero(METRIC == metric)
    return slice(int(at[0]), int(at[-1]) + 1)


def with_noise_in_octaves(features: FloatArray) -> FloatArray:
    """Return features, shape (..., n_features), whose noise in each third octave is that of the octave around it.

    Noise in a narrow band scatters: that of 100 ms in the third octave at 63 Hz by 4 dB. Errors are those of octaves.
    """
    at = feature_slice("floor")
    of_octave = np.equal.outer(OCTAVE_OF_THIRD, OCTAVE_OF_THIRD) * SHARE_OF_THIRD
    result = features.copy()
    result[..., at] = _db(10.0 ** (features[..., at] / 10.0) @ (of_octave / of_octave.sum(axis=1, keepdims=True)).T)
    return result


@dataclass(frozen=True)
class Features:
    """Features of one RIR.

    Attributes
    ----------
    values : ndarray, shape (n_features,)
        [JND]; NaN where nothing can be measured.
    valid : ndarray of bool, shape (n_features,)
        Whether decay range, bandwidth and distance to the noise suffice.
    bounded : ndarray of bool, shape (n_features,)
        Whether the value is no measurement but an upper limit: of a direct sound that is lost in the noise, in the
        features of `CALIBRATION_FEATURES`, and of noise where the decay goes on at the end of the recording.
    direct_sample : float
    white : ndarray, shape (8,)
        White noise of the recording: energy of 100 ms relative to the response, per octave.
    excited_from_hz : float
        Lower end of the excitation's band; 0 where the response shows none, and for a rendering.
    excited_to_hz : float
        Upper end of the band that was played and recorded; `NO_END_HZ` where the response shows none.
    peak_db : float
        Level of the largest sample.
    n_samples : int
        Length without zeros or a fade-out at the end.
    end_level : ndarray, shape (22,)
        Of a rendering: the feature "floor" as it would be measured if the RIR ended with the recording.
    """

    values: FloatArray
    valid: BoolArray
    bounded: BoolArray
    direct_sample: float
    white: FloatArray
    excited_from_hz: float
    excited_to_hz: float
    peak_db: float
    n_samples: int
    end_level: FloatArray


class _Noise(NamedTuple):
    """Energy per sample at the end of a response.

    Attributes
    ----------
    octave, third : ndarray, shape (8,), (22,)
        In octaves and in third octaves.
    seen : ndarray of bool, shape (8,)
        Whether that is noise: not where the response ends before its noise.
    possible : ndarray of bool, shape (8,)
        Whether it may be noise: more than the decay explains, also where its end is too short to tell.
    has_response : ndarray of bool, shape (8,)
        Whether the excitation reaches the octave.
    n_samples : float
        Length of the part that was measured, as its window leaves it.
    """

    octave: FloatArray
    third: FloatArray
    seen: BoolArray
    possible: BoolArray
    has_response: BoolArray
    n_samples: float


def measure_features(rir: Array, expected_sample: float | None = None, *, timed: bool = True,
                     white: FloatArray | None = None, end: int | None = None) -> Features:
    """Measure all features of an RIR.

    Parameters
    ----------
    rir : ndarray, shape (n_samples,)
        At `FS_HZ`.
    expected_sample : float, optional
        Direct sample according to geometry, if sample 0 is the emission.
    timed : bool
        Whether the arrival of the direct sound is known: not if the time of flight was removed.
    white : ndarray, shape (8,), optional
        White noise to assume in a rendered RIR: that of the recording that it is compared with.
    end : int, optional
        Sample of a rendered RIR at which that recording ends.

    Raises
    ------
    ValueError
        There is no direct sound.
    """
    rir, is_recording = np.asarray(rir, dtype=np.float64), white is None
    direct, polarity, timed = _direct(rir, expected_sample, timed)
    if white is None and (n_samples := length_before_fade(rir, FS_HZ, direct)) < length_before_zeros(rir):
        rir = rir[:n_samples]  # what fades out, or is silent, is not the noise of the recording
    metrics = all_metrics(rir, FS_HZ, direct, polarity)
    values, valid = np.full(N_FEATURES, np.nan), np.zeros(N_FEATURES, dtype=bool)
    for metric in ("edt", "t20", "t30"):
        times_s = np.array(metrics[f"{metric}_s"], dtype=float)  # None becomes NaN
        _put(values, valid, metric, np.log(times_s), np.array(metrics[f"{metric}_valid"]))
    _put(values, valid, "c50", np.array(metrics["c50_db"], dtype=float),
         np.array(metrics["c50_valid"]))
    drr_db = metrics["drr_db"]
    _put(values, valid, "arrival", np.array([direct / FS_HZ]), np.array([timed]))
    # a rendering is excited at all frequencies
    band_hz = (excited_from_hz(rir), excited_to_hz(rir)) if white is None else (0.0, NO_END_HZ)
    has_response = excited(*band_hz)[feature_slice("early")]
    noise = _noise_density(rir, metrics, has_response)
    levels = _levels(rir, direct, metrics, noise)
    whole = {metric: np.ones(len(level_db), dtype=bool) for metric, (level_db, _) in levels.items()}
    if white is None and length_before_zeros(rir) < direct + LATE_S * FS_HZ:  # a rendering ends when its decay is over
        whole = _before_the_end(rir, direct, metrics, levels)
    for metric, (level_db, snr_db) in levels.items():
        _put(values, valid, metric, level_db, (snr_db > MIN_SNR_DB) & whole[metric])
    at, bounded = feature_slice("direct"), np.zeros(N_FEATURES, dtype=bool)
    if white is None:  # a rendering has no noise
        level_db, snr_db = levels["direct"]
        bounded[at] = CALIBRATION_FEATURES[at] & noise.seen[OCTAVE_OF_THIRD][-len(DIRECT_THIRDS_HZ):] & ~valid[at]
        values[at] = np.where(bounded[at], (level_db - snr_db + MIN_SNR_DB) / JND["direct"], values[at])
    _put(values, valid, "drr", np.array([drr_db], dtype=float),
         np.array([drr_db is not None and valid[at].any() and whole["late"].any()]))
    per_energy = _per_energy(rir)
    behind = _behind(noise, white, per_energy)
    end_level = behind.floor_db
    if end is not None and end < len(rir):
        end_level = _behind(_noise_density(rir[:end], metrics, has_response), behind.white, per_energy).floor_db
    _put(values, valid, "floor", behind.floor_db, behind.known[OCTAVE_OF_THIRD])
    _put(values, valid, "ahead", *_ahead(rir, direct, behind, per_energy, 0.0 if is_recording else behind.white))
    if is_recording:
        at = feature_slice("floor")
        bounded[at] = noise.has_response[OCTAVE_OF_THIRD] & ~valid[at]
    return Features(values, valid & np.isfinite(values), bounded, direct, behind.white, *band_hz,
                    float(20.0 * np.log10(np.max(np.abs(rir)))), length_before_zeros(rir), end_level / JND["floor"])


def excited(from_hz: float, to_hz: float = NO_END_HZ) -> BoolArray:
    """Tell which features are measurable with an excitation between two frequencies, shape (n_features,)."""
    return (BAND_HZ == 0.0) | is_excited(np.maximum(BAND_HZ, 1.0), _WIDTH, from_hz, to_hz)


def _direct(rir: FloatArray, expected_sample: float | None, timed: bool) -> tuple[float, int, bool]:
    """Return the direct sample, its polarity, and whether its arrival is known: not if an obstacle hides the sound.

    A first sound later than the tolerances of geometry allow is another path; the direct sample is then the expected.
    """
    if expected_sample is None:
        return *find_direct(rir, FS_HZ), timed
    most = NEAR_S * FS_HZ + NEAR_SHARE * expected_sample
    try:
        sample, polarity = find_direct(rir, FS_HZ, expected_sample, search_s=most / FS_HZ)
        if abs(sample - expected_sample) < most - 1.0:
            return sample, polarity, timed
    except ValueError:
        find_direct(rir, FS_HZ)  # raises if there is no sound at all
    return float(expected_sample), 1, False


def _put(values: FloatArray, valid: BoolArray, metric: str, amounts: FloatArray, is_valid: BoolArray) -> None:
    values[feature_slice(metric)] = amounts / JND[metric]
    valid[feature_slice(metric)] = is_valid


def _noise_density(rir: FloatArray, metrics: dict, has_response: BoolArray) -> _Noise:
    """Return the energy per sample at the end of a response, where only noise is left as a rule.

    Octaves that the excitation does not reach have no response, and what is in them says nothing of the noise.
    """
    last = length_before_zeros(rir)
    intersections = np.array(metrics["band_noise_intersection_s"]) * FS_HZ + metrics["direct_sample"]
    start = max(int(0.9 * last), min(last, int(intersections.max())))
    start = min(start, last - int(0.05 * FS_HZ)) if last > int(0.2 * FS_HZ) else int(0.9 * last)
    seen = has_response & [floor_db is not None for floor_db in metrics["band_noise_floor_db"]]
    possible = has_response & (intersections < last - 1)
    part = rir[start:last]
    window = np.hanning(len(part) + 2)[1:-1]  # hum at a low frequency would leak into all bands
    n_fft = next_fast_len(max(len(part), 2048), real=True)
    power = energy_per_bin(part * window, n_fft) / max(np.sum(window ** 2), 1e-30)
    return _Noise(energy_in_bands(OCTAVES, power, n_fft), energy_in_bands(THIRDS, power, n_fft)[_N_BELOW:], seen,
                  possible, has_response, _HANN_SHARE * len(part))


def _most_noise_below(rir: FloatArray) -> FloatArray:
    """Return an upper limit of the energy per sample of noise in the third octaves below the octaves, shape (3,).

    A few periods at the end of a recording tell little of such noise (`_quantile`). What has not decayed there counts
    as noise.
    """
    last = length_before_zeros(rir)
    end = rir[max(0, last - round(_LOW_NOISE_S * FS_HZ)):last]
    n_fft = next_fast_len(max(len(end), 2048), real=True)
    energy = energy_in_bands(_BELOW, energy_per_bin(end, n_fft), n_fft)
    return energy / len(end) / np.maximum(_quantile(_BELOW.mid_hz / _BELOW.quality, len(end), _UNDERESTIMATED), 1e-30)


def _quantile(bandwidth_hz: FloatArray, n_samples: float, probability: float) -> FloatArray:
    """Return the quantile of the energy of white noise in some bands, relative to its expectation.

    In a time T and a bandwidth B, it is distributed as chi-squared with 2 B T degrees of freedom.
    """
    half_freedom = bandwidth_hz * n_samples / FS_HZ
    return gammaincinv(half_freedom, probability) / half_freedom


def _levels(rir: FloatArray, direct: float, metrics: dict, noise: _Noise) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return the level and the signal-to-noise ratio of the level metrics [dB]: {metric: (level, snr)}."""
    at = round(direct)
    gate, early, late = (at + round(seconds * FS_HZ) for seconds in (DIRECT_S, EARLY_S, LATE_S))
    end = max(late, at + round(metrics["noise_intersection_s"] * FS_HZ))
    parts = {"direct": (at - round(LEAD_S * FS_HZ), gate, 8, THIRDS), "early": (gate, early, 16, OCTAVES),
             "late": (early, late, 40, OCTAVES), "spectrum": (at - round(LEAD_S * FS_HZ), end, 40, THIRDS)}
    result = {}
    for metric, (start, stop, fade, bands) in parts.items():
        part = faded_part(rir, max(0, start), min(stop, len(rir)), fade)
        n_fft = 1024 if metric == "direct" else next_fast_len(max(2048, len(part)), real=True)
        energy = energy_in_bands(bands, energy_per_bin(part, n_fft), n_fft)
        per_sample, possible = ((noise.third, noise.possible[OCTAVE_OF_THIRD]) if bands is THIRDS
                                else (noise.octave, noise.possible))
        of_noise = np.where(possible, per_sample, 0.0) * len(part)
        if metric == "direct":
            energy, of_noise = energy[-len(DIRECT_THIRDS_HZ):], of_noise[-len(DIRECT_THIRDS_HZ):]
        elif metric == "spectrum":
            of_noise = np.concatenate([np.zeros(_N_BELOW), of_noise])
        level_db = _db(energy - of_noise)
        if metric == "spectrum":  # below the octaves a limit is known, which is not subtracted
            of_noise[:_N_BELOW] = _most_noise_below(rir) * len(part)
        result[metric] = level_db, level_db - _db(of_noise)
    return result


def _before_the_end(rir: FloatArray, direct: float, metrics: dict, levels: dict[str, tuple[FloatArray, FloatArray]]
                    ) -> dict[str, BoolArray]:
    """Tell which levels a recording that ends within the window of the late level still has as a whole.

    What its decay would add after its end lies below them by `MIN_SNR_DB`.
    """
    n_fft = next_fast_len(max(2048, len(rir)), real=True)
    total_db = _db(energy_in_bands(OCTAVES, energy_per_bin(rir, n_fft), n_fft))
    lost_db = total_db - np.array(metrics["decay_range_db"])
    of_thirds = np.concatenate([lost_db[[0] * _N_BELOW], lost_db[OCTAVE_OF_THIRD]])
    has_early = length_before_zeros(rir) >= direct + EARLY_S * FS_HZ
    lost_of = {"direct": np.full(len(DIRECT_THIRDS_HZ), -np.inf), "late": lost_db, "spectrum": of_thirds,
               "early": np.full(len(total_db), -np.inf) if has_early else lost_db}
    return {metric: level_db > lost_of[metric] + MIN_SNR_DB for metric, (level_db, _) in levels.items()}


class _Behind(NamedTuple):
    """Noise behind a response.

    Attributes
    ----------
    floor_db : ndarray, shape (22,)
        Per third octave. It is relative to white noise of the recording's own level plus a floor (`QUIET`), so that it
        goes to 0 smoothly where there is no other noise.
    known : ndarray of bool, shape (8,)
        Whether that is noise, or so quiet that it does not matter.
    energy : ndarray, shape (8,)
        Of `NOISE_S`, relative to the response.
    white : ndarray, shape (8,)
        The same of white noise alone.
    """

    floor_db: FloatArray
    known: BoolArray
    energy: FloatArray
    white: FloatArray


def _per_energy(rir: FloatArray) -> FloatArray:
    """Return the number of samples in `NOISE_S` over the energy of the response in each octave, shape (8,)."""
    n_fft = next_fast_len(len(rir), real=True)
    return NOISE_S * FS_HZ / np.maximum(energy_in_bands(OCTAVES, energy_per_bin(rir, n_fft), n_fft), 1e-30)


def _behind(noise: _Noise, white: FloatArray | None, per_energy: FloatArray) -> _Behind:
    """Return the noise behind a response; its `white` noise is known if it is a rendering."""
    end, end_of_thirds = noise.octave * per_energy, noise.third * per_energy[OCTAVE_OF_THIRD]
    # without visible noise, the level is known only if even the end of the response is quiet
    known = noise.seen | (_db(end / QUIET + 1.0) < JND["floor"])
    if white is None:
        white = _white(noise) * per_energy
        white_of_thirds = white[OCTAVE_OF_THIRD] * SHARE_OF_THIRD
        energy = np.where(noise.seen, end, white)
        # an unknown level is at most that of the end, where the decay goes on
        is_end = (noise.seen | ~known)[OCTAVE_OF_THIRD]
        of_thirds = np.where(is_end, end_of_thirds, white_of_thirds)
    else:  # a rendering has no noise of its own, and ends when its decay is over
        white_of_thirds = white[OCTAVE_OF_THIRD] * SHARE_OF_THIRD
        energy, of_thirds = end + white, end_of_thirds + white_of_thirds
    quiet_of_thirds = QUIET * SHARE_OF_THIRD
    return _Behind(_db((of_thirds + quiet_of_thirds) / (white_of_thirds + quiet_of_thirds)), known, energy, white)


def _ahead(rir: FloatArray, direct: float, behind: _Behind, per_energy: FloatArray, added: FloatArray | float
           ) -> tuple[FloatArray, BoolArray]:
    """Return the level of the sound ahead of the direct sound over that of the noise behind the response [dB].

    And whether it is valid, both per octave. `added` is the noise that the response lacks, as `_Behind.energy`.
    """
    n_ahead = round(direct) - round(3e-3 * FS_HZ) - 16
    level_db, resolved = np.full(len(BANDS_HZ), np.nan), (OCTAVE_WIDTH_HZ * n_ahead > FS_HZ) & (n_ahead > 48)
    # finite wherever there are samples: the direct sound of a rendering may be earlier than that of the recording
    if n_ahead > 8:
        part = faded_part(_without_trend(rir[:min(32 + n_ahead, len(rir))]), 16, 16 + n_ahead, 16)
        n_fft = next_fast_len(max(2048, len(part)), real=True)
        energy = energy_in_bands(OCTAVES, energy_per_bin(part, n_fft), n_fft)
        level_db = _db((energy / len(part) * per_energy + added + QUIET) / (behind.energy + QUIET))
    return level_db, resolved & behind.known


def _without_trend(part: FloatArray) -> FloatArray:
    """Return a part without its parabola of least squares.

    The offset or the slow pre-ringing of a recording, of which a few milliseconds hold less than a period, would leak
    into all octaves.
    """
    x = np.linspace(-1.0, 1.0, len(part))
    orthogonal = (np.ones(len(part)), x, x ** 2 - np.mean(x ** 2))
    return part - sum(np.sum(part * basis) / np.sum(basis ** 2) * basis for basis in orthogonal)


def _white(noise: _Noise) -> FloatArray:
    """Return the energy per sample in each octave of the largest white noise that no third octave contradicts, (8,).

    A band whose response ends before its noise contradicts white noise above that end. If no octave shows noise, there
    is none to speak of. Octaves without a response have no noise relative to it.
    Any of the bands contradicts true white noise with a probability of `_CONTRADICTED`.
    """
    most = noise.third / THIRD_WIDTH_HZ / _quantile(THIRD_WIDTH_HZ, noise.n_samples, _CONTRADICTED / len(THIRDS_HZ))
    lowest = most[noise.has_response[OCTAVE_OF_THIRD]].min() if noise.seen.any() else 0.0
    return np.where(noise.has_response, OCTAVE_WIDTH_HZ * lowest, 0.0)
