"""What the recordings of a set can tell: the band of their excitation, and whether their levels are comparable."""

import logging
from collections.abc import Hashable, Sequence
from dataclasses import replace
from statistics import median_high, median_low

import numpy as np

from roomeq.acoustics.excitation import NO_END_HZ
from roomeq.core.arrays import BoolArray, FloatArray, IntArray
from roomeq.core.groups import numbers_by
from roomeq.loop.features import JND, Features, excited, feature_slice
from roomeq.records.schema import RirRow, session_name, unit_name

logger = logging.getLogger(__name__)

_MIN_RIRS = 4
"""Fewest RIRs whose peaks and late levels have standard deviations that can be compared."""
_MIN_SPREAD_DB = 1.0
_NORMALISED_SHARE = 0.5
_EQUAL_DB = 0.02
"""By which peaks of RIRs differ that were normalised to one value: rounding to 16 bits changes one at -40 dB by half as
much. Of pairs of RIRs that were not normalised, and whose distances differ by `_MIN_SPREAD_DB`, 0.4 % have such peaks
(27 of 6,856 of C4DM, 1 of 2,060 of R3VIVAL); of three RIRs at random, none in 38,000 draws."""


def limit_to_excitation(rows: Sequence[RirRow], features: Sequence[Features]) -> list[Features]:
    """Return features that are valid only within the band of the excitation.

    Its ends are those of the recordings of a source in a room: another room may have another sweep, or another sample
    rate. Of an even number of recordings, the median is one of the two in the middle, for their mean is no end if one
    of them shows none: that which shows the end of the sweep, and that which shows the whole upper band.
    """
    limited = list(features)
    for name, members in _groups([unit_name(row, "source") for row in rows]).items():
        ends_hz = np.tile([0.0, NO_END_HZ], (len(members), 1))
        for of_room in _groups([rows[n]["room_id"] for n in members]).values():
            recordings = [features[n] for n in members[of_room]]
            ends_hz[of_room] = (median_high(recording.excited_from_hz for recording in recordings),
                                median_low(recording.excited_to_hz for recording in recordings))
        from_hz, to_hz = ends_hz.T
        if np.any(from_hz > 0.0):
            logger.info("source %s: the excitation of %d of %d RIRs begins at %s Hz; features below it are left out",
                        name, np.sum(from_hz > 0.0), len(members), _range_text(from_hz[from_hz > 0.0]))
        if np.any(to_hz < NO_END_HZ):
            logger.info("source %s: %d of %d RIRs hold nothing above %.0f Hz, like recordings of a lower sample rate; "
                        "features above it are left out", name, np.sum(to_hz < NO_END_HZ), len(members), to_hz.min())
        for n, of_rir_hz in zip(members, ends_hz, strict=True):
            measurable = excited(*of_rir_hz)
            limited[n] = replace(features[n], valid=features[n].valid & measurable,
                                 bounded=features[n].bounded & measurable,
                                 white=np.where(measurable[feature_slice("early")], features[n].white, 0.0))
    return limited


def _range_text(values: FloatArray) -> str:
    low, high = (f"{value:.0f}" for value in (values.min(), values.max()))
    return low if low == high else f"{low} to {high}"


def comparable_levels(rows: Sequence[RirRow], features: Sequence[Features], distance_m: FloatArray) -> BoolArray:
    """Tell for each RIR whether its level can be compared with those of the same room and session, shape (n_rirs,).

    The peaks of RIRs vary with distance (20 dB per decade), and late reverberation is equally loud everywhere in a
    room. If the peaks vary by less than half as much, and by less than the late levels, the RIRs were normalised one by
    one. Peaks alone do not tell, unless they are equal: an obstacle may weaken those of near sources.

    The sessions of a room that have too few RIRs for that are tested together, by the deviations from the means of
    their sessions. The only RIR of a session has none to be compared with, unless its room has no other.
    """
    comparable = np.ones(len(rows), dtype=bool)
    for room_id, members in _groups([row["room_id"] for row in rows]).items():
        distances_db, peaks_db = 20.0 * np.log10(distance_m[members]), [features[n].peak_db for n in members]
        if np.ptp(distances_db) > _MIN_SPREAD_DB and np.ptp(peaks_db) <= _EQUAL_DB:
            comparable[members] = False
            logger.info("room %s: the peaks of its %d RIRs are equal within %.2f dB, and their distances demand up to "
                        "%.1f dB: each was normalised, so that levels are compared within an RIR only", room_id,
                        len(members), _EQUAL_DB, np.ptp(distances_db))
            continue
        sessions = [members[of_session] for of_session in _groups([session_name(rows[n]) for n in members]).values()]
        for tested in _tested_together(sessions):
            rirs, session = np.concatenate(tested), np.repeat(np.arange(len(tested)), [len(part) for part in tested])
            of_distance = _deviation(20.0 * np.log10(distance_m[rirs]), session)
            of_peaks = _deviation(np.array([features[n].peak_db for n in rirs]), session)
            late = _late_spread_db([features[n] for n in rirs], session)
            if (len(rirs) - len(tested) + 1 >= _MIN_RIRS and of_distance > _MIN_SPREAD_DB
                    and of_peaks < min(_NORMALISED_SHARE * of_distance, late)):
                comparable[rirs] = False
                logger.info("room %s: the peaks of %d RIRs vary by %.1f dB%s, less than their late levels, and their "
                            "distances demand %.1f dB: each was normalised, so that levels are compared within an RIR "
                            "only", room_id, len(rirs), of_peaks, " within sessions" if len(sessions) > 1 else "",
                            of_distance)
        if len(sessions) > 1:
            comparable[[rirs[0] for rirs in sessions if len(rirs) == 1]] = False
    return comparable


def _tested_together(sessions: list[IntArray]) -> list[list[IntArray]]:
    """Return each session of a room that has enough RIRs by itself, and all others together."""
    small = [rirs for rirs in sessions if len(rirs) < _MIN_RIRS]
    return [[rirs] for rirs in sessions if len(rirs) >= _MIN_RIRS] + ([small] if small else [])


def _deviation(values: FloatArray, session: IntArray) -> float:
    """Return the standard deviation of values, shape (n_rirs,), from the means of their sessions; NaN are left out."""
    known = np.isfinite(values)
    _, of_value = np.unique(session[known], return_inverse=True)
    means = np.bincount(of_value, values[known]) / np.bincount(of_value)
    return float(np.std(values[known] - means[of_value]))


def _late_spread_db(features: Sequence[Features], session: IntArray) -> float:
    """Return the standard deviation within sessions of late levels, the median over octaves; infinite if unknown."""
    at = feature_slice("late")
    levels = np.array([np.where(of_rir.valid[at], of_rir.values[at], np.nan) for of_rir in features]) * JND["late"]
    spread = [_deviation(of_octave, session) for of_octave in levels.T if np.isfinite(of_octave).sum() >= _MIN_RIRS]
    return float(np.median(spread)) if spread else np.inf


def _groups(keys: Sequence[Hashable]) -> dict[Hashable, IntArray]:
    return {key: np.array(members) for key, members in numbers_by(keys).items()}
