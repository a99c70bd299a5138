"""What the recordings of a set can tell: the band of their excitation, and whether their levels are comparable."""

import logging
from collections.abc import Hashable, Sequence
from dataclasses import replace

import numpy as np

from roomeq.core.arrays import BoolArray, FloatArray, IntArray
from roomeq.loop.features import Features, excited
from roomeq.records.schema import RirRow

logger = logging.getLogger(__name__)

_MIN_RIRS = 4
_MIN_SPREAD_DB = 1.0
_NORMALISED_SHARE = 0.5


def limit_to_excitation(rows: Sequence[RirRow], features: Sequence[Features]) -> list[Features]:
    """Return features that are valid only within the band of the excitation, which is the same for all of a source."""
    limited = list(features)
    for source_id, members in _groups([row["source_id"] for row in rows]).items():
        from_hz = float(np.median([features[n].excited_from_hz for n in members]))
        if from_hz:
            logger.info("source %s: the excitation begins at %.0f Hz; features below it are left out", source_id,
                        from_hz)
        for n in members:
            limited[n] = replace(features[n], valid=features[n].valid & excited(from_hz))
    return limited


def comparable_levels(rows: Sequence[RirRow], features: Sequence[Features], distance_m: FloatArray) -> BoolArray:
    """Tell for each RIR whether its level can be compared with those of the same room and session, shape (n_rirs,).

    The peaks of RIRs vary with distance (20 dB per decade). If they vary by less than half as much, the RIRs were
    normalised one by one.
    """
    comparable = np.ones(len(rows), dtype=bool)
    for room_id, members in _groups([row["room_id"] for row in rows]).items():
        of_distance = np.std(20.0 * np.log10(distance_m[members]))
        of_peaks = np.std([features[n].peak_db for n in members])
        if (len(members) >= _MIN_RIRS and of_distance > _MIN_SPREAD_DB
                and of_peaks < _NORMALISED_SHARE * of_distance):
            comparable[members] = False
            logger.info("room %s: the peaks of its %d RIRs vary by %.1f dB, their distances demand %.1f dB: each was "
                        "normalised, so that levels are compared within an RIR only", room_id, len(members), of_peaks,
                        of_distance)
    return comparable


def _groups(keys: Sequence[Hashable]) -> dict[Hashable, IntArray]:
    return {key: np.flatnonzero([other == key for other in keys]) for key in dict.fromkeys(keys)}
