"""Room-acoustic parameters of an impulse response in octave bands (ISO 3382), and whether each of them is valid.

Conventions
-----------
Times are in seconds, levels in dB. Octave filters have zero phase and cause no delay; energy that a filter spreads to
times before the direct sound is counted as energy of the direct sound, also where that begins the response. Decay
curves are integrated backward from the point where the decay meets the noise (`roomeq.acoustics.noise_intersection`),
with the noise subtracted and the energy of the exponential decay beyond that point added (Guski and Vorländer, Acta
Acustica 100 (2014) 320, methods D and E).

Metrics
-------
EDT, T20, T30 and C50 (ISO 3382-1:2009, ISO 3382-2:2008); direct-to-reverberant ratio (DRR); level of the noise floor,
and the time at which the decay meets it.

Why not pyrato
--------------
pyrato 1.1 (on pyfar) implements the same noise compensation, and tests/unit/acoustics/test_iso3382.py checks that both
agree. It does not tell whether a result is valid: for a response that has decayed by only 28 dB at its end, it returns
a T30. Measured corpora contain responses that end in digital silence or have a signal-to-noise ratio of 20 dB; for
these it raises an error or returns -inf. It takes several times as long per band, and every job of the recipe would
spend seconds on its import.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from roomeq.acoustics.band_energy import OCTAVES, Bands, energy_in_bands, energy_per_bin
from roomeq.acoustics.decay_kernels import decay_curve, first_below, slope_between, strongest_power
from roomeq.acoustics.decibels import TINY_POWER, power_db, ratio_db
from roomeq.acoustics.direct import find_direct
from roomeq.acoustics.fade import length_before_fade
from roomeq.acoustics.noise_intersection import (
    NOISE_MARGIN_DB,
    NoiseIntersection,
    find_noise_intersection,
    remaining_energy,
)
from roomeq.acoustics.octaves import LEAD_S, octave_bands, octave_fft_size, octave_width_hz
from roomeq.core.arrays import Array, FloatArray
from roomeq.core.constants import exact_bands_hz
from roomeq.core.jit import compiled

MIN_BT = 16.0
"""Smallest product of bandwidth and decay time for which the decay of the filter does not distort the result
(ISO 3382-2, 7.3); for each of EDT, T20 and T30, the shortest of itself, T20 and T30 counts."""
DIRECT_S = 2.5e-3
"""Energy within this time before and after the direct sound counts as direct (DRR)."""
EARLY_S = 0.05
"""Time after the direct sound that separates early from late energy (C50)."""
DECAYS_DB = {"edt": (0.0, -10.0), "t20": (-5.0, -25.0), "t30": (-5.0, -35.0)}
"""Evaluation range of each decay time: levels of the decay curve relative to its start."""
_LARGEST_DRR_ERROR_DB = 1.0
_NOISE_DEVIATIONS = 4.0  # of the energy of white noise, within which it explains what is there
_BLOCK_S = 0.01
_FEWEST_SAMPLES = 1000  # of noise, to tell how much it is
LOWEST_DB = min(bottom_db for _, bottom_db in DECAYS_DB.values()) - 1.0  # rounding must not cut a range


@dataclass(frozen=True)
class Decay:
    """The energy decay of one band.

    Attributes
    ----------
    edc
        Decay curve from the direct sound to the intersection with the noise, relative to the total energy, shape (n,).
    range_db
        Dynamic range: level of the total energy over that of the decay's energy after the intersection, or over what
        is there beyond noise if that is more. Infinite for a decay to digital silence; 0 if no decay can be fitted.
    noise_floor_db
        Power of the noise relative to the mean power of the strongest 5 ms; None if the response does not reach its
        noise floor.
    intersection
        Intersection of the decay with the noise, in samples after the direct sound.
    beyond
        Sum of the squared response from there on.
    """

    edc: FloatArray
    range_db: float
    noise_floor_db: float | None
    intersection: NoiseIntersection
    beyond: float

    @cached_property
    def edc_db(self) -> FloatArray:
        """Decay curve [dB], shape (n,)."""
        return power_db(self.edc)

    def down_to_db(self, level_db: float) -> FloatArray:
        """Return the beginning of `edc_db`, up to the first sample at or below a level if there is one."""
        return power_db(self.edc[:1 + first_below(self.edc, 10.0 ** (0.1 * level_db))])


def energy_decay(band: Array, fs_hz: float, direct_sample: float, *, bandwidth_hz: float | None = None,
                 noiseless: bool = False) -> Decay:
    """Integrate the squared response of one band backward, with compensation for noise and truncation.

    Parameters
    ----------
    band
        Band-filtered response, shape (n_samples,).
    fs_hz
        Sample rate.
    direct_sample
        Arrival time of the direct sound in samples; see `roomeq.acoustics.direct.find_direct`. What comes before it by
        up to `roomeq.acoustics.octaves.LEAD_S` is counted as its energy.
    bandwidth_hz
        Of the band; see `roomeq.acoustics.noise_intersection.find_noise_intersection`.
    noiseless
        The response is known to have no noise, and to be over at its end: a tail that bends or consists of few
        reflections is no noise floor.
    """
    start = max(0, round(direct_sample))
    before, after = band[max(0, start - round(LEAD_S * fs_hz)):start], band[start:]
    remaining = remaining_energy(after)
    intersection = (NoiseIntersection(len(after), 0.0, 0.0, is_flat=False) if noiseless
                    else find_noise_intersection(remaining, fs_hz, bandwidth_hz))
    edc, total = decay_curve(before, remaining[:intersection.sample + 1], intersection.noise_power,
                             intersection.rest_energy)
    edc[0] = total / max(total, TINY_POWER)  # 1, without rounding: EDT begins there
    rest = max(intersection.rest_energy,
               _unexplained_energy(remaining, intersection.sample, intersection.noise_power, float(fs_hz),
                                   float(bandwidth_hz or 0.5 * fs_hz)))
    range_db = ratio_db(total, rest) if rest > 0.0 else np.inf
    if intersection.noise_power > 0.0 and intersection.rest_energy == 0.0:
        range_db = 0.0
    n_block = max(1, round(0.005 * fs_hz))
    floor_db = None
    if intersection.is_flat:
        first_power = np.square(after[:20 * n_block], dtype=np.float64)
        floor_db = ratio_db(intersection.noise_power, strongest_power(first_power, n_block))
    return Decay(edc, range_db, floor_db, intersection, float(remaining[intersection.sample]))


@compiled
def _unexplained_energy(remaining: FloatArray, sample: int, noise_power: float, fs_hz: float, bandwidth_hz: float
                        ) -> float:
    """Return the largest energy within any time after the intersection, `sample`, that the noise does not explain.

    Noise may exceed its mean by `_NOISE_DEVIATIONS`, both there and in the last tenth, where it is measured. More is
    there where it ends the fitted decay too early: where its level fluctuates, as that of a fan or of traffic.
    """
    n_block, most = round(_BLOCK_S * fs_hz), 0.0
    for n in range(sample + n_block, len(remaining), n_block):
        length = n - sample
        deviation = np.sqrt(fs_hz / bandwidth_hz * (1.0 / length + 10.0 / (len(remaining) - 1)))
        noise = noise_power * length * (1.0 + _NOISE_DEVIATIONS * deviation)
        most = max(most, remaining[sample] - remaining[n] - noise)
    return most


def octave_decays(rir: FloatArray, fs_hz: float, direct_sample: float,
                  bands_hz: Sequence[float] | None = None, *, noiseless: bool = False) -> list[Decay]:
    """Return the decay of each octave; see `energy_decay` and `roomeq.acoustics.octaves.octave_bands`."""
    lead, bands_hz = round(LEAD_S * fs_hz), exact_bands_hz(fs_hz) if bands_hz is None else bands_hz
    return [energy_decay(band, fs_hz, lead + max(0.0, direct_sample), bandwidth_hz=octave_width_hz(band_hz, fs_hz),
                         noiseless=noiseless)
            for band_hz, band in zip(bands_hz, octave_bands(rir, fs_hz, bands_hz, lead=lead), strict=True)]


def decay_time(edc_db: FloatArray, fs_hz: float, decay: str) -> float | None:
    """Return the time of a 60 dB decay by linear regression over a part of a decay curve (ISO 3382-1, 5.3.3 and A.3).

    Parameters
    ----------
    edc_db
        Decay curve, shape (n,).
    fs_hz
        Sample rate.
    decay
        ``"edt"`` (0 to -10 dB), ``"t20"`` (-5 to -25 dB) or ``"t30"`` (-5 to -35 dB).

    Returns
    -------
    float or None
        Seconds; None if the curve does not fall to the lower end of the evaluation range.
    """
    slope_db = slope_between(edc_db, *DECAYS_DB[decay])
    return float(-60.0 / slope_db / fs_hz) if slope_db < 0.0 else None


def all_metrics(rir: FloatArray, fs_hz: float, direct_sample: float | None = None,
                polarity: int | None = None) -> dict[str, Any]:
    """Measure the decay times, level ratios and noise of a response; silence or a fade-out at its end do not count.

    Parameters
    ----------
    rir
        Shape (n_samples,).
    fs_hz
        Sample rate.
    direct_sample, polarity
        Arrival time [samples] and sign of the direct sound; `find_direct` detects them unless both are given.

    Returns
    -------
    dict
        Values that JSON can represent. Broadband: `direct_sample`, `direct_polarity`, `drr_db`, `noise_intersection_s`
        and `noise_floor_db`. Lists of a value for each octave below half the sample rate (62.5 Hz to 8 kHz at 16 kHz):
        `edt_s`, `t20_s`, `t30_s` and `c50_db`; their validity `edt_valid`, `t20_valid`, `t30_valid` and `c50_valid`;
        `band_noise_intersection_s`, `band_noise_floor_db` and `decay_range_db`. Intersections are counted from the
        direct sound. A value that cannot be computed is None and not valid.

    Raises
    ------
    ValueError
        See `find_direct`; or all samples from the direct sound on are 0.
    """
    rir = np.asarray(rir, dtype=np.float64)
    if direct_sample is None or polarity is None:
        direct_sample, polarity = find_direct(rir, fs_hz, direct_sample)
    rir = rir[:length_before_fade(rir, fs_hz, direct_sample)]
    if round(direct_sample) >= len(rir):
        raise ValueError(f"direct_sample={direct_sample:g} must lie before the end of the response, {len(rir)} samples "
                         "without the silence that follows: measure it again")
    broadband = energy_decay(rir, fs_hz, direct_sample)
    result: dict[str, Any] = dict(
        direct_sample=float(direct_sample), direct_polarity=int(polarity),
        drr_db=_drr_db(rir, fs_hz, direct_sample, broadband.intersection),
        noise_intersection_s=broadband.intersection.sample / fs_hz, noise_floor_db=broadband.noise_floor_db)
    curves = octave_decays(rir, fs_hz, direct_sample)
    rows = [_band_metrics(fs_hz, *band) for band in zip(exact_bands_hz(fs_hz), curves,
                                                        _c50_db(rir, fs_hz, direct_sample, curves), strict=True)]
    result.update({key: [row[key] for row in rows] for key in rows[0]})
    return result


def _octave_energies(part: FloatArray, fs_hz: float) -> FloatArray:
    """Return the energy of a part of a response in each octave below half the sample rate, shape (n_bands,)."""
    n_fft, octaves = octave_fft_size(len(part), fs_hz), Bands(np.array(exact_bands_hz(fs_hz)), OCTAVES.quality)
    return energy_in_bands(octaves, energy_per_bin(part, n_fft), n_fft, fs_hz)


def _c50_db(rir: FloatArray, fs_hz: float, direct_sample: float, curves: Sequence[Decay]) -> list[float | None]:
    """Return the early-to-late energy ratio of each octave; None if a part has no energy.

    The response is divided before it is filtered, because the filter would spread energy over the boundary. What comes
    before the direct sound by more than `LEAD_S` is another sound, or noise. What comes after the intersection, where
    noise hides what the filter spreads, is taken off the filtered response, so that all octaves share a spectrum.
    """
    boundary = round(direct_sample + EARLY_S * fs_hz)
    first = max(0, round(direct_sample - LEAD_S * fs_hz))
    if boundary >= len(rir):
        return [None] * len(curves)
    ratios_db: list[float | None] = []
    parts = (_octave_energies(rir[first:boundary], fs_hz), _octave_energies(rir[boundary:], fs_hz))
    for curve, early, late in zip(curves, *(part.tolist() for part in parts), strict=True):
        intersection = curve.intersection
        n_late = round(direct_sample) + intersection.sample - boundary
        late += intersection.rest_energy - curve.beyond - n_late * intersection.noise_power
        early -= (boundary - first) * intersection.noise_power
        ratios_db.append(ratio_db(early, late) if n_late > 0 and early > 0.0 and late > 0.0 else None)
    return ratios_db


def _band_metrics(fs_hz: float, band_hz: float, curve: Decay, c50_db: float | None) -> dict[str, Any]:
    """Return the parameters of an octave from its decay and its C50, and the validity of each."""
    edc_db = curve.down_to_db(LOWEST_DB)
    times_s = {decay: decay_time(edc_db, fs_hz, decay) for decay in DECAYS_DB}
    late_s, width_hz = min(times_s["t20"] or np.inf, times_s["t30"] or np.inf), band_hz * 0.5 ** 0.5
    row: dict[str, Any] = {}
    for decay, time_s in times_s.items():
        # of a decay as short as the filter's, each time by itself would be valid where it is too long by chance; EDT
        # may be short because of the direct sound, and tells nothing of the others
        shortest_s = min(time_s or np.inf, late_s)
        row[f"{decay}_s"] = time_s
        row[f"{decay}_valid"] = (time_s is not None and curve.range_db >= NOISE_MARGIN_DB - DECAYS_DB[decay][1]
                                 and width_hz * shortest_s > MIN_BT)
    # C50 is early relative to late energy: if it is large, late energy is nearly C50 below the total; the noise must
    # be below that by a margin
    row["c50_db"] = c50_db
    row["c50_valid"] = c50_db is not None and curve.range_db >= NOISE_MARGIN_DB + max(NOISE_MARGIN_DB, c50_db)
    row["band_noise_intersection_s"] = curve.intersection.sample / fs_hz
    row["band_noise_floor_db"] = curve.noise_floor_db
    row["decay_range_db"] = min(curve.range_db, 200.0)
    return row


def _drr_db(rir: FloatArray, fs_hz: float, direct_sample: float, intersection: NoiseIntersection) -> float | None:
    """Return the broadband direct-to-reverberant energy ratio.

    None if either part has no energy, or if what is not known of the decay may change the ratio by
    `_LARGEST_DRR_ERROR_DB`. Where no noise is seen, that is all beyond the intersection, or what is extrapolated. Where
    it is seen, it is what neither the noise at the end nor the fitted decay explains: the noise is then too high for
    the intersection to be found.
    """
    boundary = round(direct_sample + DIRECT_S * fs_hz)
    first = max(0, round(direct_sample - DIRECT_S * fs_hz))
    end = round(direct_sample) + intersection.sample
    noise_power = intersection.noise_power if intersection.is_flat else 0.0
    largest_share = 10.0 ** (0.1 * _LARGEST_DRR_ERROR_DB) - 1.0
    direct = np.sum(rir[first:boundary] ** 2) - (boundary - first) * noise_power
    reverberant = np.sum(rir[boundary:end] ** 2) - max(0, end - boundary) * noise_power
    beyond = rir[max(end, boundary):] ** 2
    if intersection.is_flat:
        reverberant += intersection.rest_energy
    else:
        rest = max(intersection.rest_energy, beyond.sum())
        if rest > largest_share * reverberant:
            return None
        reverberant += rest
    if not (direct > 0.0 and reverberant > 0.0):
        return None
    if noise_power > 0.0 and len(beyond) >= _FEWEST_SAMPLES:
        at_end = beyond[int(0.9 * len(beyond)):]
        scatter = _NOISE_DEVIATIONS * np.mean(at_end) * np.sqrt(2.0 / len(beyond) + 2.0 / len(at_end))
        missed = len(beyond) * (np.mean(beyond) - np.mean(at_end)) - intersection.rest_energy
        if missed > max(len(beyond) * scatter, largest_share * reverberant):
            return None
    return ratio_db(direct, reverberant)
