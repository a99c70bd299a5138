"""RIRs whose rows their recordings contradict, so that no effect is named because of an error in the rows.

An error that no recording contradicts, or by less than the stated uncertainty, is not found.
"""

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from roomeq.acoustics.direct import find_direct
from roomeq.acoustics.iso3382 import all_metrics
from roomeq.acoustics.same_recordings import cut_parts
from roomeq.core.arrays import FloatArray
from roomeq.core.constants import FS_HZ
from roomeq.core.groups import numbers_by
from roomeq.core.workers import share_out
from roomeq.loop.arrivals import Arrivals, measure_arrivals
from roomeq.loop.doubtful_geometry import (
    DirectLimits,
    Doubt,
    direct_limits,
    find_other_unit,
    find_wrong_distance,
)
from roomeq.loop.doubtful_recordings import find_copies, find_other_decays
from roomeq.loop.latency import find_latencies
from roomeq.loop.misnamed_devices import find_misnamed_devices, reverberation_levels
from roomeq.records.rir_dir import load_rir, rir_path
from roomeq.records.schema import RirRow

logger = logging.getLogger(__name__)


class _Heard(NamedTuple):
    """What one recording says: limits of its direct sound, arrivals, log of T20 per octave, and so on."""

    direct: DirectLimits
    arrivals: Arrivals
    log_t20: FloatArray
    parts: FloatArray
    levels_db: FloatArray


class Checked(NamedTuple):
    """What recordings say of their rows.

    Attributes
    ----------
    doubts : list of (Doubt or None)
        What does not fit about each RIR.
    latencies_s : ndarray, shape (n_rirs,)
        Latency that it has in common with others, although its row says that sample 0 is the emission; 0 for none
        (`roomeq.loop.latency`).
    """

    doubts: list[Doubt | None]
    latencies_s: FloatArray


def find_mislabelled(rirs: Sequence[tuple[Path, RirRow]], nj: int = 1) -> Checked:
    """Return what does not fit about each RIR; the log has the details.

    Parameters
    ----------
    rirs : sequence of (Path, RirRow)
        Directories and rows that the closed loop could use (`roomeq.loop.usable`), sorted by room.
    nj : int
        Number of processes that read them.

    Raises
    ------
    ValueError
        A recording cannot be read or has no direct sound; the message names the file.
    """
    rows = [row for _, row in rirs]
    heard = share_out(lambda rir: _listen(*rir), rirs, nj, label="check RIRs")
    doubts = _other_units(rows, heard)
    latencies_s = find_latencies(rows, np.array([of_rir.arrivals.direct_s for of_rir in heard]))
    distances = [find_wrong_distance(row, of_rir.direct, latency_s)
                 for row, of_rir, latency_s in zip(rows, heard, latencies_s, strict=True)]
    for found in (distances,
                  find_other_decays(rows, np.array([of_rir.log_t20 for of_rir in heard]).reshape(-1, 8))):
        doubts = [doubt or other for doubt, other in zip(doubts, found, strict=True)]
    for find, said in ((find_copies, [of_rir.parts for of_rir in heard]),
                       (find_misnamed_devices, [of_rir.levels_db for of_rir in heard])):
        fitting = [n for n, doubt in enumerate(doubts) if doubt is None]
        found = find([rows[n] for n in fitting], np.array([said[n] for n in fitting]))
        for n, doubt in zip(fitting, found, strict=True):
            doubts[n] = doubt
    for detail in dict.fromkeys(doubt.detail for doubt in doubts if doubt):
        logger.warning("left out: %s", detail)
    return Checked(doubts, latencies_s)


def _listen(directory: Path, row: RirRow) -> _Heard:
    rir = load_rir(directory, row)
    try:
        direct = find_direct(rir, FS_HZ)
        arrivals = measure_arrivals(rir)
    except ValueError as error:
        raise ValueError(f"{rir_path(directory, row)}: {error}") from None
    metrics = all_metrics(rir, FS_HZ, direct.sample, direct.polarity)
    t20_s = [time_s if valid and time_s else np.nan
             for time_s, valid in zip(metrics["t20_s"], metrics["t20_valid"], strict=True)]
    return _Heard(direct_limits(rir), arrivals, np.log(t20_s), cut_parts(rir, direct.sample),
                  reverberation_levels(rir, direct.sample))


def _other_units(rows: Sequence[RirRow], heard: Sequence[_Heard]) -> list[Doubt | None]:
    """Return the doubts about the units of rooms, for each RIR."""
    doubts: list[Doubt | None] = [None] * len(rows)
    for members in numbers_by(None if row.get("mesh") else row["room_id"] for row in rows).values():
        doubt = find_other_unit([rows[n] for n in members], [heard[n].arrivals for n in members])
        for n in members:
            doubts[n] = doubt
    return doubts
