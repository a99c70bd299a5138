"""The EQs of measured and simulated RIRs, and the distribution of the measured ones.

Tang, Meng, Manocha, sections 3.1 and 3.2.
"""

import logging
from collections import Counter
from pathlib import Path

import numpy as np

from roomeq.acoustics.direct import find_direct
from roomeq.acoustics.subband_eq import analyse
from roomeq.core.build import Build
from roomeq.core.constants import BANDS_HZ, FS_HZ
from roomeq.core.files import read_json, read_jsonl, write_json, write_jsonl
from roomeq.core.rng import rng_for
from roomeq.eq.gmm import FREE, GMM_FILE, JND_DB, draw_target, fit_gmm, room_weights, with_reference
from roomeq.records.rir_dir import load_rir, read_rirs, rir_path

logger = logging.getLogger(__name__)

SCREENING_FILE = "screening.json"
MEASURED_FILE, SIMULATED_FILE, RESAMPLED_FILE = "measured.jsonl", "simulated.jsonl", "resampled.jsonl"
OUTLIER_Z = 4.0  # robust standard deviations from the median of the rooms
MIN_SPREAD_DB = 4.0  # a single bin of one RIR scatters that much within a room (Schroeder's 5.6 dB, averaged)
_DECIMALS = 4


def fit_eq(real_dir, sim_dirs, out, *, n_components=7, weight_rooms=False, seed, part=None, nj=1):
    """Measure the EQ of measured and simulated RIRs and fit a Gaussian mixture to the measured ones.

    Screened RIRs (`roomeq.corpora.characterise`) are left out, and so are outliers: any point further than 4 robust
    standard deviations from the median, rooms counting equally. Points that could not be measured are drawn from
    the Gaussian of the others given those that could; a roll-off at 8 kHz is replaced by the level just below it.

    Parameters
    ----------
    real_dir : Path
        Measured RIRs of the *training* set, with acoustic parameters or without.
    sim_dirs : sequence of Path
        Simulated RIRs, for the comparison; may be empty.
    out : Path
        Directory to make: `gmm.json`; `measured.jsonl`, `simulated.jsonl` (EQ vectors) and `resampled.jsonl` (as
        many draws as measured RIRs went in); `screening.json`.
    n_components : int
        Components of the mixture.
    weight_rooms : bool
        Repeat rows so that rooms count equally; the paper's mixture weights each RIR alike.
    seed : int
    part : str, optional
        ``"2/5"``: do one share of the analysis only.
    nj : int
        Number of processes.

    Returns
    -------
    dict or None
        The mixture; None if it was there already or only a part was done.

    Raises
    ------
    ValueError
        Fewer measured RIRs than components, or an option is wrong.
    """
    if n_components < 1:
        raise ValueError(f"n_components={n_components} must be at least 1")
    real_dir, sim_dirs = Path(real_dir), [Path(path) for path in sim_dirs]
    items = {f"{name}+{row['id']}": (directory, row)
             for name, directory in [("real", real_dir), *((f"sim{n}", path) for n, path in enumerate(sim_dirs))]
             for row in read_rirs(directory) if not row.get("noise_for")}
    options = dict(n_components=n_components, weight_rooms=bool(weight_rooms), seed=seed)
    build = Build(out, step="fit-eq", options=options, inputs=[real_dir, *sim_dirs])
    if build.done:
        return None
    fitted = {}

    def assemble(directory, records):
        measured, simulated = ([record for name, record in zip(items, records, strict=True)
                                if name.startswith("real+") == is_real] for is_real in (True, False))
        screen_outliers(measured)
        used = [record for record in measured if not record["screen"]]
        if len(used) < n_components:
            raise ValueError(f"{real_dir}: {len(used)} measured RIRs are left after screening of {len(measured)}: "
                             f"must be at least {n_components}, the mixture's components: give more")
        vectors = fill_missing(used, seed)
        gmm = fit_gmm(vectors, [record["room_id"] for record in used], n_components=n_components,
                      weight_rooms=weight_rooms, seed=seed)
        for record, vector in zip(used, vectors, strict=True):
            record["fitted_db"] = _eight(vector)
        resampled = [dict(id=record["id"], room_id=record["room_id"],
                          eq_db=_eight(draw_target(gmm, seed, record["id"], what="resample"))) for record in used]
        write_json(directory / GMM_FILE, gmm)
        for name, rows in ((MEASURED_FILE, measured), (SIMULATED_FILE, simulated), (RESAMPLED_FILE, resampled)):
            write_jsonl(directory / name, rows)
        write_json(directory / SCREENING_FILE, _screening(measured))
        fitted.update(gmm)

    if build.run(items, lambda _, item: eq_row(*item), part=part, nj=nj):
        build.finish(assemble)
        screening = read_json(Path(out) / SCREENING_FILE)
        left_out = Counter(why.split(":")[0] for why in screening["screened"].values())
        logger.info("%s: %d of %d measured RIRs shape the mixture; left out (see %s): %s", out, screening["n_used"],
                    screening["n_given"], SCREENING_FILE,
                    ", ".join(f"{count} {kind}" for kind, count in sorted(left_out.items())) or "none")
    return fitted or None


def eq_row(directory, row):
    """EQ record of one row: from its acoustic parameters if it has them, else measured.

    Returns
    -------
    dict
        `id`, `room_id`, `eq_db`, `valid` (8 each), `edge_db` and `screen`; see `roomeq.corpora.characterise.measure`.
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
        eq_db, valid, edge_db = eq.eq_db.round(_DECIMALS).tolist(), eq.valid.tolist(), eq.edge_db
    return dict(id=row["id"], room_id=row["room_id"], corpus=row.get("corpus"), eq_db=eq_db, valid=valid,
                edge_db=edge_db, screen=row.get("screen"))


def usable_eq(record):
    """Seven-vector of an EQ record with NaN where it was not measured; below a roll-off, the level at its edge.

    Parameters
    ----------
    record : dict
        See `eq_row`.

    Returns
    -------
    vector_db : ndarray, shape (7,)
    """
    values = np.where(record["valid"], record["eq_db"], np.nan)
    if record["edge_db"] is not None:
        values[-1] = record["edge_db"]
    return values[list(FREE)]


def screen_outliers(records):
    """Mark records that lie far from all rooms: sets `screen` of those that had none.

    The distance is counted per point in robust standard deviations (1.4826 times the median absolute deviation,
    at least 4 dB) from the median. Both medians weight rooms equally, since one room is often most of the files.
    """
    used = [record for record in records if not record["screen"]]
    if not used:
        return
    vectors = np.array([usable_eq(record) for record in used])
    weights = room_weights([record["room_id"] for record in used])
    for n, record in enumerate(used):
        if np.isnan(vectors[n]).sum() > 1:
            record["screen"] = "dead bands: more than one EQ point could not be measured"
    for point, k in enumerate(FREE):
        known = ~np.isnan(vectors[:, point])
        if not known.any():
            continue
        centre_db = weighted_median(vectors[known, point], weights[known])
        away_db = np.abs(vectors[:, point] - centre_db)
        spread_db = max(MIN_SPREAD_DB, 1.4826 * weighted_median(away_db[known], weights[known]))
        for n in np.flatnonzero(known & (away_db > OUTLIER_Z * spread_db)):
            used[n]["screen"] = used[n]["screen"] or (
                f"outlier: {vectors[n, point]:.1f} dB at {BANDS_HZ[k]:g} Hz where rooms have {centre_db:.1f} dB, "
                f"{away_db[n] / spread_db:.1f} robust standard deviations away")


def weighted_median(values, weights):
    """Smallest value that at least half of the weight doesn't exceed."""
    order = np.argsort(values, kind="stable")
    below = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(below, 0.5 * below[-1] - 1e-12)])


def fill_missing(records, seed):
    """Seven-vectors of records with what could not be measured drawn from what could.

    Mean and covariance come from expectation-maximisation over the incomplete vectors (Little & Rubin, Statistical
    Analysis with Missing Data, 11.2.2). A missing point is *drawn* from the Gaussian given the known points
    of its RIR, not set to the conditional mean, which would narrow the mixture.

    Parameters
    ----------
    records : list of dict
    seed : int

    Returns
    -------
    vectors_db : ndarray, shape (n, 7)

    Raises
    ------
    ValueError
        No record has a value at some point.
    """
    vectors = np.array([usable_eq(record) for record in records])
    missing = np.isnan(vectors)
    if not missing.any():
        return vectors
    if missing.all(axis=0).any():
        k = FREE[int(np.argmax(missing.all(axis=0)))]
        raise ValueError(f"none of {len(records)} measured RIRs has a valid EQ at {BANDS_HZ[k]:g} Hz: "
                         "give recordings that reach it")
    mean = np.nanmean(vectors, axis=0)
    covariance = np.diag(np.nanvar(vectors, axis=0)) + JND_DB ** 2 * np.eye(len(FREE))
    for _ in range(50):
        filled, extra = vectors.copy(), np.zeros_like(covariance)
        for n in np.flatnonzero(missing.any(axis=1)):
            filled[n, missing[n]], rest = _conditional(vectors[n], missing[n], mean, covariance)
            extra[np.ix_(missing[n], missing[n])] += rest
        mean = filled.mean(axis=0)
        covariance = (np.cov(filled.T, bias=True) + extra / len(filled)) + JND_DB ** 2 * np.eye(len(FREE))
    for n in np.flatnonzero(missing.any(axis=1)):
        expected, rest = _conditional(vectors[n], missing[n], mean, covariance)
        rng = rng_for(seed, "missing EQ points", records[n]["id"])
        vectors[n, missing[n]] = expected + np.linalg.cholesky(rest) @ rng.standard_normal(len(expected))
    return vectors


def _conditional(vector, missing, mean, covariance):
    """Mean and covariance of the missing points given the others."""
    known = ~missing
    gain = np.linalg.solve(covariance[np.ix_(known, known)], covariance[np.ix_(known, missing)]).T
    rest = covariance[np.ix_(missing, missing)] - gain @ covariance[np.ix_(known, missing)]
    return mean[missing] + gain @ (vector[known] - mean[known]), rest


def read_eq_rows(path):
    """Read the records of `measured.jsonl`, `simulated.jsonl` or `resampled.jsonl`."""
    return read_jsonl(path)


def _eight(vector_db):
    return [round(float(value), _DECIMALS) for value in with_reference(vector_db)]


def _screening(measured):
    screened = {record["id"]: record["screen"] for record in measured if record["screen"]}
    used = [record for record in measured if not record["screen"]]
    return dict(n_given=len(measured), n_used=len(used), screened=screened,
                n_roll_off_at_8khz=sum(record["edge_db"] is not None for record in used),
                n_points_filled_in=int(sum(np.isnan(usable_eq(record)).sum() for record in used)))
