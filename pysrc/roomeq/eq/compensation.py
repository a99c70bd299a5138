"""Compensation filters: give each simulated RIR an EQ drawn from the distribution of measured ones.

Tang, Meng, Manocha, section 3.3. The filter is linear-phase, and its delay is removed again, so that the direct sound
stays at its sample. The design is corrected by the EQ of the compensated RIR, measured again, until it is met. Where no
linear-phase filter comes within `MAX_P95_DB`, one of minimum phase may: it puts nothing ahead of the direct sound.
"""

import logging
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import fftconvolve, firwin2

from roomeq.acoustics.direct import checked_response, direct_of
from roomeq.acoustics.minimum_phase import minimum_phase
from roomeq.acoustics.parameters import measure
from roomeq.acoustics.subband_eq import analyse
from roomeq.core.arrays import FloatArray
from roomeq.core.audio import write_wav
from roomeq.core.build import Build
from roomeq.core.constants import BAND_1KHZ, BANDS_HZ, FS_HZ
from roomeq.core.files import write_json
from roomeq.eq.gmm import FREE, draw_target, read_gmm, with_reference
from roomeq.eq.steps import MAX_TAPS, check_taps
from roomeq.records.rir_dir import (
    load_channels,
    read_noises,
    read_rirs,
    relocated,
    require_16_khz,
    rir_path,
    with_meshes_relocated,
    write_noises,
    write_rirs,
)
from roomeq.records.schema import OF_SIMULATED, RirRow

logger = logging.getLogger(__name__)

SUMMARY_FILE = "compensation.json"
MAX_PASSES = 15  # filter designs per RIR: the first is the plain window method, each further one corrects the last
_CLOSE_DB = 0.05  # largest error at which a design is not corrected further
_PROGRESS = 0.9  # of the largest error that a further design must fall below
MAX_MEDIAN_DB, MAX_P95_DB = 0.5, 1.5  # goals for |achieved - target| over all RIRs and points
_MAX_LOGGED = 5
_CEPSTRUM = 2 * (MAX_TAPS + 1)  # length of the transform that a filter of minimum phase is designed with
_REFERENCE_DB = 1e-6  # that a target may differ from 0 dB at 1 kHz
_DECIMALS = 4


class CompensatedRir(NamedTuple):
    """What `compensate_rir` returns."""

    samples: FloatArray
    """Shape (n_samples,). The level at 1 kHz and the sample of the direct sound are those of the input."""
    achieved_db: FloatArray
    """EQ measured on `samples`, shape (8,)."""
    gain_db: FloatArray
    """Gains that the filter was designed for, shape (8,)."""
    fir: FloatArray
    """The filter, shape (taps,)."""


def make(build: Build, sim_dir: Path, eq_dir: Path, taps: int, match_rooms: bool, seed: int, part: str | None,
         nj: int) -> dict | None:
    """Make the output of a build.

    Raises
    ------
    ValueError
        See `roomeq.eq.steps.compensate`.
    """
    rows = read_rirs(sim_dir)
    require_16_khz(sim_dir, rows)
    if done := next((row for row in rows if row.get("eq_gain_db") is not None), None):
        raise ValueError(f"{sim_dir}: RIR {done['id']} was compensated already (key 'eq_gain_db'), and would be "
                         "filtered twice: give the simulated RIRs that it was made of")
    if n_others := sum(all(row.get(key) is None for key in OF_SIMULATED) for row in rows):
        logger.warning("%s: rows of %d of %d RIRs do not say that they are simulated: measured ones have the EQ of "
                       "their room already, and must not be compensated", sim_dir, n_others, len(rows))
    out, gmm = build.out, read_gmm(eq_dir)
    groups = _group_by_filter(sim_dir, rows)
    summary: dict[str, Any] = {}

    def compensate_group(_: str, rows: list[RirRow]) -> list[dict]:
        room_id = rows[0]["room_id"] if match_rooms else None
        target_db = with_reference(draw_target(gmm, seed, rows[0]["id"], room_id))
        return _compensate_group(sim_dir, rows, target_db, build.work, taps)

    def assemble(directory: Path, records: list[list[dict]]) -> None:
        rows = with_meshes_relocated((row for record in records for row in record), sim_dir, out)
        write_rirs(directory, rows, final_directory=out)
        write_noises(directory, relocated(read_noises(sim_dir), sim_dir, out))
        summary.update(summarise([row for row in rows if not row.get("noise_for")]))
        write_json(directory / SUMMARY_FILE, summary)

    if build.run(groups, compensate_group, part=part, nj=nj) and build.finish(assemble):
        _log_summary(out, summary)
    return summary or None


def compensate_rir(rir: FloatArray, direct_sample: float, target_db: FloatArray, *, taps: int = 511) -> CompensatedRir:
    """Filter one RIR so that its measured EQ becomes a target.

    Parameters
    ----------
    rir : ndarray, shape (n_samples,)
        At 16 kHz.
    direct_sample
        Sample of the direct sound.
    target_db : array_like, shape (8,)
        0 dB at 1 kHz.
    taps
        Length of the filter, odd.

    Raises
    ------
    ValueError
        The direct sound lies outside the response, the response or the target is not finite or has another
        shape, the target is not 0 dB at 1 kHz, or the length of the filter is even.
    """
    rir, target_db = checked_response(rir, direct_sample), np.asarray(target_db, dtype=np.float64)
    if target_db.shape != (len(BANDS_HZ),) or not np.all(np.isfinite(target_db)):
        raise ValueError(f"target_db={target_db.tolist()} must be {len(BANDS_HZ)} finite levels: correct the target")
    if abs(target_db[BAND_1KHZ]) > _REFERENCE_DB:
        raise ValueError(f"target_db[{BAND_1KHZ}]={target_db[BAND_1KHZ]:g} must be 0 dB, the level at 1 kHz: subtract "
                         "it from all")
    check_taps(taps)
    level_db = analyse(rir, direct_sample).level_db
    wanted_db = level_db[BAND_1KHZ] + target_db
    linear, error_db = _approach(rir, direct_sample, level_db, wanted_db, partial(design_filter, taps=taps))
    if error_db <= MAX_P95_DB:
        return linear
    # mostly a response that begins shortly before its direct sound: what the filter puts ahead of it is cut off
    causal, causal_error_db = _approach(rir, direct_sample, level_db, wanted_db, partial(_causal_filter, taps=taps))
    return causal if causal_error_db < error_db else linear


def _approach(rir: FloatArray, direct_sample: float, level_db: FloatArray, wanted_db: FloatArray,
              design: Callable[[FloatArray], FloatArray]) -> tuple[CompensatedRir, float]:
    """Design filters until the levels are the wanted ones; return the best RIR and its largest error [dB]."""
    gain_db, results, errors_db = wanted_db - level_db, [], [np.inf]
    for _ in range(MAX_PASSES):
        fir = design(gain_db)
        compensated = apply_filter(rir, fir)
        achieved = analyse(compensated, direct_sample)
        results.append(CompensatedRir(compensated, achieved.eq_db, gain_db, fir))
        errors_db.append(float(np.abs(achieved.level_db - wanted_db).max()))
        if errors_db[-1] <= _CLOSE_DB or errors_db[-1] >= _PROGRESS * min(errors_db[:-1]):
            break
        gain_db = gain_db + wanted_db - achieved.level_db
    best = int(np.argmin(errors_db))
    return results[best - 1], errors_db[best]


def design_filter(gain_db: FloatArray, taps: int) -> FloatArray:
    """Design a linear-phase FIR filter by the window method (Hamming), shape (taps,).

    Parameters
    ----------
    gain_db : array_like, shape (8,)
        At 62.5, 125, ... 8000 Hz; interpolated in dB over log frequency, constant below 62.5 Hz.
    """
    f_hz = np.linspace(0.0, FS_HZ / 2, MAX_TAPS + 2)
    gain = 10.0 ** (np.interp(np.log(np.maximum(f_hz, 1.0)), np.log(BANDS_HZ), gain_db) / 20.0)
    return firwin2(taps, f_hz, gain, nfreqs=len(f_hz), fs=FS_HZ)


def _causal_filter(gain_db: FloatArray, taps: int) -> FloatArray:
    """Design a filter of minimum phase, behind as many zeros as `apply_filter` removes, shape (2 * taps - 1,)."""
    return np.concatenate([np.zeros(taps - 1), minimum_phase(BANDS_HZ, gain_db, _CEPSTRUM)[:taps]])


def apply_filter(rir: FloatArray, fir: FloatArray) -> FloatArray:
    """Filter a response and remove the delay of the filter; the length stays."""
    delay = (len(fir) - 1) // 2
    return fftconvolve(rir, fir)[delay:delay + len(rir)]


def _group_by_filter(sim_dir: Path, rows: list[RirRow]) -> dict[str, list[RirRow]]:
    """Return each RIR followed by the RIRs of its noise sources, by its id."""
    groups = {row["id"]: [row] for row in rows if not row.get("noise_for")}
    for row in rows:
        main_id = row.get("noise_for")
        if main_id and main_id not in groups:
            raise ValueError(f"{sim_dir}: noise_for={main_id!r} of RIR {row['id']} is no RIR of this directory: "
                             "simulate it again")
        if main_id:
            groups[main_id].append(row)
    return groups


def _compensate_group(sim_dir: Path, rows: list[RirRow], target_db: FloatArray, work: Path, taps: int) -> list[dict]:
    """Compensate an RIR, filter its noise RIRs alike, write their audio, return their rows."""
    fir, compensated_rows = None, []
    for row in rows:
        channels = load_channels(sim_dir, row)
        rir = channels if channels.ndim == 1 else channels[:, 0]
        eq_keys: dict[str, list[float]] = {}
        try:
            sample, polarity = direct_of(row, rir)
            if fir is None:
                samples, achieved_db, gain_db, fir = compensate_rir(rir, sample, target_db, taps=taps)
                eq_keys = dict(eq_target_db=_rounded(target_db), eq_achieved_db=_rounded(achieved_db),
                               eq_error_db=_rounded(achieved_db - target_db), eq_gain_db=_rounded(gain_db))
            else:
                samples = apply_filter(rir, fir)
            parameters = measure(samples, direct=(sample, polarity))
        except ValueError as error:
            raise ValueError(f"{rir_path(sim_dir, row)}: {error}") from None
        wav = f"wav/{row['id']}.wav"
        if channels.ndim > 1:  # the further microphones of an array pass through the filter of the first
            samples = np.column_stack([samples, *(apply_filter(channel, fir) for channel in channels.T[1:])])
        write_wav(work / wav, samples)
        compensated_rows.append(dict(row) | dict(
            wav=wav, model=[*(row.get("model") or []), "room_eq"], direct_sample=sample, direct_polarity=polarity,
            acoustic_parameters=parameters, t30_s=parameters["t30_s"][BAND_1KHZ]) | eq_keys)
    return compensated_rows


def _rounded(values: FloatArray) -> list[float]:
    return [round(float(value), _DECIMALS) for value in values]


def summarise(rows: list[dict]) -> dict:
    """Summarise how closely compensated rows meet their targets.

    Returns
    -------
    dict
        `median_db` and `p95_db` of |achieved - target| over RIRs and the seven free points, the same per point
        (`points_hz`), `held` (whether both goals are met), and `missed`: RIRs with a point off by more than
        `MAX_P95_DB`, each with the frequency, the error, and the steepest step of its filter [dB per octave]. One
        31.25 Hz bin at 62.5 Hz cannot stand out by more than some 20 dB from its neighbours.
    """
    errors_db = np.abs([[row["eq_error_db"][k] for k in FREE] for row in rows])
    missed = {}
    for row, error_db in zip(rows, errors_db, strict=True):
        if error_db.max() > MAX_P95_DB:
            worst = FREE[int(np.argmax(error_db))]
            missed[row["id"]] = dict(hz=BANDS_HZ[worst], error_db=row["eq_error_db"][worst],
                                     steepest_db=round(float(np.abs(np.diff(row["eq_gain_db"])).max()), 1))
    median_db, p95_db = float(np.median(errors_db)), float(np.percentile(errors_db, 95))
    return dict(n_rirs=len(rows), median_db=round(median_db, 3), p95_db=round(p95_db, 3),
                points_hz=[BANDS_HZ[k] for k in FREE],
                point_median_db=np.median(errors_db, axis=0).round(3).tolist(),
                point_p95_db=np.percentile(errors_db, 95, axis=0).round(3).tolist(),
                held=bool(median_db <= MAX_MEDIAN_DB and p95_db <= MAX_P95_DB), missed=missed)


def _log_summary(out: Path, summary: dict) -> None:
    logger.info("%s: |achieved - target| %.2f dB (median), %.2f dB (95th percentile) at the seven points; %s the goal "
                "of %g and %g dB", out, summary["median_db"], summary["p95_db"],
                "within" if summary["held"] else "not within", MAX_MEDIAN_DB, MAX_P95_DB)
    for rir_id, miss in list(summary["missed"].items())[:_MAX_LOGGED]:
        logger.info("%s: off by %+.1f dB at %g Hz: no filter came closer, the best one has a step of %.0f dB per "
                    "octave", rir_id, miss["error_db"], miss["hz"], miss["steepest_db"])
