"""The acoustic parameters of an RIR: all that is measured on it, as its row in `rirs.jsonl` stores it.

Decay times and level ratios come from `roomeq.acoustics.iso3382`, whose docstring says why they are not taken from
pyrato, and the EQ from `roomeq.acoustics.subband_eq`.
"""

import math
from typing import Any

from roomeq.acoustics.direct import DirectSound, checked_response, find_direct
from roomeq.acoustics.iso3382 import DECAYS_DB, all_metrics
from roomeq.acoustics.subband_eq import analyse
from roomeq.core.arrays import FloatArray
from roomeq.core.constants import FS_HZ, require_fs

_DECIMALS = 4


def measure(rir: FloatArray, fs_hz: float = FS_HZ, *,
            direct: DirectSound | tuple[float, int] | None = None) -> dict[str, Any]:
    """Measure the acoustic parameters of an RIR.

    Parameters
    ----------
    rir
        Shape (n_samples,).
    fs_hz
        From 8 to 48 kHz.
    direct
        Sample and polarity of the direct sound if they are known, as for simulated RIRs; by default they are found.

    Returns
    -------
    dict
        JSON-able. `roomeq.acoustics.iso3382.all_metrics`, with None for a decay time that rounds to 0 s; at 16 kHz, the
        rate of the EQ, also `eq_db` (8 points, relative to 1 kHz), `eq_valid`,
        `eq_snr_db` (null: no noise seen) and `eq_edge_db` (level below an anti-alias roll-off that makes the 8 kHz
        point invalid, or null).

    Raises
    ------
    ValueError
        There is no direct sound, it lies outside the response, its polarity is neither 1 nor -1, the response is not
        mono or not finite, or the sample rate is out of range.
    """
    fs_hz = require_fs(fs_hz)
    sample, polarity = find_direct(rir, fs_hz) if direct is None else direct
    if polarity not in (1, -1):
        raise ValueError(f"direct: polarity {polarity!r} must be 1 or -1: correct it")
    rir = checked_response(rir, sample)
    parameters = all_metrics(rir, fs_hz, sample, polarity)
    if fs_hz == FS_HZ:
        eq = analyse(rir, sample)
        parameters.update(eq_db=eq.eq_db.tolist(), eq_valid=eq.valid.tolist(), eq_edge_db=eq.edge_db,
                          eq_snr_db=[value if math.isfinite(value) else None for value in eq.snr_db.tolist()])
    rounded = {key: _rounded(value) for key, value in parameters.items()}
    for decay in DECAYS_DB:  # a response that is cut off may seem to decay within a sample or two
        rounded[f"{decay}_s"] = [time_s or None for time_s in rounded[f"{decay}_s"]]
    return rounded


def _rounded(value: Any) -> Any:
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return round(value, _DECIMALS) if isinstance(value, float) else value
