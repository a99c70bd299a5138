"""Measure the EQs of measured and simulated RIRs, and fit a Gaussian mixture to the measured ones.

Tang, Meng, Manocha, sections 3.1 and 3.2.
"""

import logging
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import NotRequired, TypedDict

import numpy as np

from roomeq.acoustics.direct import find_direct
from roomeq.acoustics.excitation import eq_to_hz, excited_from_hz, excited_to_hz
from roomeq.acoustics.subband_eq import analyse
from roomeq.core.arrays import BoolArray, FloatArray
from roomeq.core.build import Build
from roomeq.core.constants import BANDS_HZ, FS_HZ
from roomeq.core.files import read_json, write_json, write_jsonl
from roomeq.core.rng import rng_for
from roomeq.corpora.suspicious import without_suspicious
from roomeq.eq.gmm import FREE, GMM_FILE, JND_DB, Gmm, draw_target, fit_gmm, read_gmm, room_weights, with_reference
from roomeq.records.rir_dir import load_rir, read_rirs, require_16_khz, rir_path
from roomeq.records.schema import OF_SIMULATED, RirRow

logger = logging.getLogger(__name__)

SCREENING_FILE = "screening.json"
MEASURED_FILE, SIMULATED_FILE, RESAMPLED_FILE = "measured.jsonl", "simulated.jsonl", "resampled.jsonl"
OUTLIER_Z = 4.0  # robust standard deviations from the median of the rooms
MIN_SPREAD_DB = 4.0  # a single bin of one RIR scatters that much within a room (Schroeder's 5.6 dB, averaged)
_EM_STEPS = 50
_ROUNDING_DB2 = 1e-6  # keeps a covariance positive definite
_ROUNDING = 1e-12  # of sums of weights
_DECIMALS = 4


class EqRecord(TypedDict):
    """The EQ of one RIR, as `measured.jsonl` and `simulated.jsonl` hold it; lists have the eight points."""

    id: str
    room_id: str
    corpus: str | None
    eq_db: list[float]
    valid: list[bool]
    edge_db: float | None
    """Level just below a roll-off at 8 kHz; None if there is none, or if it begins below."""
    screen: str | None
    """Why the RIR is left out of the fit, or None."""
    fitted_db: NotRequired[list[float]]
    """EQ that the mixture was fitted to, with missing points filled in."""


def make(build: Build, directories: dict[str, Path], n_components: int, weight_rooms: bool, seed: int,
         part: str | None, nj: int) -> Gmm | None:
    """Make the output of a build; `directories` holds the measured RIRs (``real``) and the simulated ones.

    Raises
    ------
    ValueError
        See `roomeq.eq.steps.fit_eq`.
    """
    rows = {name: [row for row in read_rirs(directory) if not row.get("noise_for")]
            for name, directory in directories.items()}
    for name, directory in directories.items():
        require_16_khz(directory, rows[name])
    rows["real"] = _measured(directories["real"], rows["real"])
    items = {f"{name}+{row['id']}": (directories[name], row) for name in rows for row in rows[name]}

    def assemble(directory: Path, records: list[EqRecord]) -> None:
        measured, simulated = ([record for name, record in zip(items, records, strict=True)
                                if name.startswith("real+") == is_measured] for is_measured in (True, False))
        used = _screened(measured, directories["real"], n_components)
        vectors_db = fill_missing(used, seed)
        gmm = fit_gmm(vectors_db, [record["room_id"] for record in used], n_components=n_components,
                      weight_rooms=weight_rooms, seed=seed)
        for record, vector_db in zip(used, vectors_db, strict=True):
            record["fitted_db"] = _eight_points(vector_db)
        resampled = [dict(id=record["id"], room_id=record["room_id"],
                          eq_db=_eight_points(draw_target(gmm, seed, record["id"], purpose="resample")))
                     for record in used]
        write_json(directory / GMM_FILE, gmm)
        write_jsonl(directory / MEASURED_FILE, measured)
        write_jsonl(directory / SIMULATED_FILE, simulated)
        write_jsonl(directory / RESAMPLED_FILE, resampled)
        write_json(directory / SCREENING_FILE, _screening(measured))

    if not build.run(items, lambda _, item: eq_row(*item), part=part, nj=nj):
        return None
    assembled = build.finish(assemble)
    _log_screening(build.out)
    return read_gmm(build.out) if assembled else None


def require_enough_rirs(real_dir: Path, n_components: int) -> None:
    """Refuse measured RIRs to which no mixture of so many components can be fitted, as the fit does.

    Raises
    ------
    ValueError
        Screening leaves too few, none has a value at some point, or the directory is invalid.
    """
    rows = [row for row in read_rirs(real_dir) if not row.get("noise_for")]
    require_16_khz(real_dir, rows)
    _screened([eq_row(real_dir, row) for row in _measured(real_dir, rows)], real_dir, n_components)


def _measured(real_dir: Path, rows: list[RirRow]) -> list[RirRow]:
    """Return the measured rows to analyse; refuse simulated ones, as where directories are given in another order."""
    for row in rows:
        if stated := next((key for key in OF_SIMULATED if row.get(key) is not None), None):
            raise ValueError(f"{real_dir}: RIR {row['id']} is simulated (key {stated!r}), but measured RIRs are "
                             "expected here: give REAL_DIR first, then SIM_DIRS")
    return without_suspicious(real_dir, rows)


def _screened(measured: list[EqRecord], real_dir: Path, n_components: int) -> list[EqRecord]:
    """Screen outliers, and return the records to fit the mixture to.

    They are as many as it has components or more, and every point is known of some.
    """
    screen_outliers(measured)
    used = [record for record in measured if not record["screen"]]
    if len(used) < n_components:
        reasons = _reasons(record["screen"] for record in measured if record["screen"])
        raise ValueError(f"{real_dir}: {len(used)} measured RIRs are left after screening of {len(measured)}"
                         f"{reasons and f' ({reasons})'}: must be at least {n_components}, the mixture's components: "
                         "give more, or fewer --num-components")
    lacking = np.isnan([usable_eq(record) for record in used]).all(axis=0)
    if lacking.any():
        raise ValueError(f"{real_dir}: none of {len(used)} measured RIRs has a valid EQ at "
                         f"{BANDS_HZ[FREE[int(np.argmax(lacking))]]:g} Hz: give recordings that reach it")
    return used


def eq_row(directory: Path, row: RirRow) -> EqRecord:
    """Return the EQ of one row: from its acoustic parameters if it has them, else measured.

    Points outside the band of the recording's own excitation are then invalid.

    Raises
    ------
    ValueError
        The EQ cannot be measured; the message names the file.
    """
    parameters = row.get("acoustic_parameters") or {}
    if "eq_db" in parameters:
        eq_db, valid, edge_db = parameters["eq_db"], parameters["eq_valid"], parameters["eq_edge_db"]
    else:
        rir = load_rir(directory, row)
        try:
            sample = row.get("direct_sample")
            eq = analyse(rir, find_direct(rir, FS_HZ)[0] if sample is None else sample)
        except ValueError as error:
            raise ValueError(f"{rir_path(directory, row)}: {error}") from None
        from_hz, to_hz = excited_from_hz(rir), eq_to_hz(excited_to_hz(rir))
        eq_db, edge_db = eq.eq_db.round(_DECIMALS).tolist(), eq.edge_db
        valid = [bool(is_valid) and from_hz <= hz <= to_hz for is_valid, hz in zip(eq.valid, BANDS_HZ, strict=True)]
    return EqRecord(id=row["id"], room_id=row["room_id"], corpus=row.get("corpus"), eq_db=eq_db, valid=valid,
                    edge_db=edge_db, screen=row.get("screen"))


def usable_eq(record: EqRecord) -> FloatArray:
    """Return the EQ at the seven free points, shape (7,).

    A point that was not measured is NaN; above a roll-off stands the level at its edge.
    """
    values = np.where(record["valid"], record["eq_db"], np.nan)
    if record["edge_db"] is not None:
        values[-1] = record["edge_db"]
    return values[list(FREE)]


def screen_outliers(records: list[EqRecord]) -> None:
    """Set `screen` of the records that lie far from all rooms and had none.

    The distance from the median is counted per point in robust standard deviations: 1.4826 times the median absolute
    deviation, at least `MIN_SPREAD_DB`. In both medians rooms weigh the same, since one room often has most of the
    files.
    """
    used = [record for record in records if not record["screen"]]
    if not used:
        return
    vectors = np.array([usable_eq(record) for record in used])
    weights = room_weights([record["room_id"] for record in used])
    for record, vector in zip(used, vectors, strict=True):
        if np.isnan(vector).sum() > 1:
            record["screen"] = "dead bands: more than one EQ point could not be measured"
    for point, k in enumerate(FREE):
        known = ~np.isnan(vectors[:, point])
        if not known.any():
            continue
        centre_db = weighted_median(vectors[known, point], weights[known])
        deviation_db = np.abs(vectors[:, point] - centre_db)
        spread_db = max(MIN_SPREAD_DB, 1.4826 * weighted_median(deviation_db[known], weights[known]))
        for outlier in np.flatnonzero(known & (deviation_db > OUTLIER_Z * spread_db)):
            record = used[outlier]
            record["screen"] = record["screen"] or (
                f"outlier: {vectors[outlier, point]:.1f} dB at {BANDS_HZ[k]:g} Hz where rooms have {centre_db:.1f} "
                f"dB, {deviation_db[outlier] / spread_db:.1f} robust standard deviations away")


def weighted_median(values: FloatArray, weights: FloatArray) -> float:
    """Return the value with half of the weight on either side: of two middle values, the mean."""
    order = np.argsort(values, kind="stable")
    cumulative = np.cumsum(weights[order])
    middle = np.searchsorted(cumulative, 0.5 * cumulative[-1] + np.array([-_ROUNDING, _ROUNDING]))
    return float(values[order][middle].mean())


def fill_missing(records: list[EqRecord], seed: int) -> FloatArray:
    """Return the EQs of records at the free points, shape (n, 7), with missing points drawn given the others.

    Mean and covariance come from expectation-maximisation over the incomplete vectors (Little & Rubin, Statistical
    Analysis with Missing Data, 11.2.2). A missing point is *drawn* from the Gaussian given the known points of its
    RIR, which are taken as measured to `JND_DB` (ridge regression), so that a few RIRs determine it too. The
    conditional mean would make the mixture too narrow. Every point must be known of some record.
    """
    vectors = np.array([usable_eq(record) for record in records])
    missing = np.isnan(vectors)
    if not missing.any():
        return vectors
    incomplete = np.flatnonzero(missing.any(axis=1))
    mean = np.nanmean(vectors, axis=0)
    covariance = np.diag(np.nanvar(vectors, axis=0))
    for _ in range(_EM_STEPS):
        filled, unexplained = vectors.copy(), np.zeros_like(covariance)
        for n in incomplete:
            filled[n, missing[n]], conditional = _condition(vectors[n], missing[n], mean, covariance)
            unexplained[np.ix_(missing[n], missing[n])] += conditional
        mean = filled.mean(axis=0)
        covariance = np.cov(filled.T, bias=True) + unexplained / len(filled)
    for n in incomplete:
        expected, conditional = _condition(vectors[n], missing[n], mean, covariance)
        rng = rng_for(seed, "missing EQ points", records[n]["id"])
        factor = np.linalg.cholesky(conditional + _ROUNDING_DB2 * np.eye(len(expected)))
        vectors[n, missing[n]] = expected + factor @ rng.standard_normal(len(expected))
    return vectors


def _condition(vector: FloatArray, missing: BoolArray, mean: FloatArray,
               covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the mean of the missing points given the others, and the covariance that their mean leaves unexplained.

    With that covariance, mean and unexplained part together vary as much as `covariance` says.
    """
    known = ~missing
    of_known = covariance[np.ix_(known, known)]
    measured = of_known + JND_DB ** 2 * np.eye(len(of_known))
    gain = np.linalg.solve(measured, covariance[np.ix_(known, missing)]).T
    unexplained = covariance[np.ix_(missing, missing)] - gain @ of_known @ gain.T
    return mean[missing] + gain @ (vector[known] - mean[known]), unexplained


def _eight_points(vector_db: FloatArray) -> list[float]:
    return [round(float(value), _DECIMALS) for value in with_reference(vector_db)]


def _screening(measured: list[EqRecord]) -> dict:
    """Return what `screening.json` holds."""
    screened = {record["id"]: record["screen"] for record in measured if record["screen"]}
    used = [record for record in measured if not record["screen"]]
    return dict(n_given=len(measured), n_used=len(used), screened=screened,
                n_roll_off_at_8khz=sum(record["edge_db"] is not None for record in used),
                n_points_filled_in=int(sum(np.isnan(usable_eq(record)).sum() for record in used)))


def _log_screening(out: Path) -> None:
    screening = read_json(out / SCREENING_FILE)
    logger.info("%s: the mixture is fitted to %d of %d measured RIRs; left out (see %s): %s", out,
                screening["n_used"], screening["n_given"], SCREENING_FILE,
                _reasons(screening["screened"].values()) or "none")


def _reasons(screens: Iterable[str]) -> str:
    """Return how many RIRs were left out for each reason; nothing if none was."""
    counts = Counter(screen.split(":")[0] for screen in screens)
    return ", ".join(f"{count} {reason}" for reason, count in sorted(counts.items()))
