"""Giving simulated RIRs an EQ drawn from the distribution of measured ones.

Tang, Meng, Manocha, section 3.3. The filter is linear-phase and its delay is taken out again, so that the direct
sound stays where it was. What counts is the EQ of the compensated RIR, measured again.
"""

import logging
from collections import defaultdict
from pathlib import Path

import numpy as np
from scipy.signal import fftconvolve, firwin2

from roomeq.acoustics.direct import find_direct
from roomeq.acoustics.parameters import measure
from roomeq.acoustics.subband_eq import analyse
from roomeq.core.audio import write_wav
from roomeq.core.build import Build
from roomeq.core.constants import BAND_1KHZ, BANDS_HZ, FS_HZ
from roomeq.core.files import write_json
from roomeq.eq.gmm import FREE, draw_target, read_gmm, with_reference
from roomeq.records.rir_dir import load_rir, read_noises, read_rirs, relocated, rir_path, write_noises, write_rirs

logger = logging.getLogger(__name__)

SUMMARY_FILE = "compensation.json"
MAX_TAPS = 4095  # as many points as the response is sampled at in the design
PASSES = 3  # filter designs per RIR: the first is the plain window method, each further one corrects the last
MAX_MEDIAN_DB, MAX_P95_DB = 0.5, 1.5  # of |achieved - target| over all RIRs and points
_DECIMALS = 4


def compensate(sim_dir, eq_dir, out, *, taps=511, match_rooms=True, seed, part=None, nj=1):
    """Draw an EQ target for every simulated RIR and filter the RIR until it has it.

    The RIRs of a simulated RIR's noise sources (`noise_for`) pass the same filter: it stands for the room and
    the microphone, which they share.

    Parameters
    ----------
    sim_dir : Path
        Simulated RIRs.
    eq_dir : Path
        What `roomeq.eq.fit.fit_eq` made, or its `gmm.json`.
    out : Path
        RIR directory to make. Rows hold `eq_target_db`, `eq_achieved_db`, `eq_error_db` and `eq_gain_db` (what
        the filter was designed for), 8 points each; `compensation.json` sums up.
    taps : int
        Length of the filter, odd.
    match_rooms : bool
        Choose among the mixture's components as the measured RIRs of the simulated RIR's room do. With one
        simulated RIR per measured one, as in the paper, all targets together are drawn from the same mixture
        either way; this also gives each room the share of it that is its own. False: each room draws from all.
    seed : int
    part : str, optional
        ``"2/5"``: do one share of the work only.
    nj : int
        Number of processes.

    Returns
    -------
    dict or None
        What `compensation.json` says; None if it was there already or only a part was done.

    Raises
    ------
    ValueError
        An option is wrong, or an RIR has no direct sound.
    """
    if not 3 <= taps <= MAX_TAPS or taps % 2 == 0:
        raise ValueError(f"taps={taps} must be odd and lie in [3, {MAX_TAPS}]: a linear-phase filter delays by half "
                         "of them")
    sim_dir, out, gmm = Path(sim_dir), Path(out), read_gmm(eq_dir)
    groups = _groups(sim_dir, read_rirs(sim_dir))
    options = dict(taps=taps, match_rooms=bool(match_rooms), seed=seed)
    build = Build(out, step="compensate", options=options, inputs=[sim_dir, Path(eq_dir)])
    if build.done:
        return None
    summary = {}

    def one(_, rows):
        room_id = rows[0]["room_id"] if match_rooms else None
        target_db = with_reference(draw_target(gmm, seed, rows[0]["id"], room_id))
        return _compensate_group(sim_dir, rows, target_db, build.work, taps)

    def assemble(directory, records):
        rows = [row for record in records for row in record]
        write_rirs(directory, rows, final_directory=out)
        write_noises(directory, relocated(read_noises(sim_dir), sim_dir, out))
        summary.update(summarise([row for row in rows if not row.get("noise_for")]))
        write_json(directory / SUMMARY_FILE, summary)

    if build.run(groups, one, part=part, nj=nj) and build.finish(assemble):
        _log(out, summary)
    return summary or None


def compensate_rir(rir, direct_sample, target_db, *, taps=511):
    """Filter one RIR so that its measured EQ becomes a target.

    Parameters
    ----------
    rir : ndarray, shape (n_samples,)
        At 16 kHz.
    direct_sample : float
    target_db : array_like, shape (8,)
        0 dB at 1 kHz.
    taps : int
        See `compensate`.

    Returns
    -------
    compensated : ndarray, shape (n_samples,)
        Of the same level at 1 kHz, its direct sound at the same sample.
    achieved_db : ndarray, shape (8,)
        Measured on `compensated`.
    gain_db : ndarray, shape (8,)
        What the filter was designed for.
    fir : ndarray, shape (taps,)

    Raises
    ------
    ValueError
        The direct sound lies behind the end of the response.
    """
    target_db = np.asarray(target_db, dtype=np.float64)
    wanted_db = analyse(rir, direct_sample).level_db[BAND_1KHZ] + target_db
    gain_db = wanted_db - analyse(rir, direct_sample).level_db
    for _ in range(PASSES):
        fir = design_filter(gain_db, taps)
        compensated = apply_filter(rir, fir)
        measured = analyse(compensated, direct_sample)
        designed_db, gain_db = gain_db, gain_db + wanted_db - measured.level_db
    return compensated, measured.eq_db, designed_db, fir


def design_filter(gain_db, taps):
    """Linear-phase FIR filter by the window method (Hamming).

    Parameters
    ----------
    gain_db : array_like, shape (8,)
        At 62.5, 125, ... 8000 Hz; in between interpolated in dB over log frequency, flat below 62.5 Hz.
    taps : int

    Returns
    -------
    fir : ndarray, shape (taps,)
    """
    f = np.linspace(0.0, FS_HZ / 2, 4097)
    gain = 10.0 ** (np.interp(np.log(np.maximum(f, 1.0)), np.log(BANDS_HZ), gain_db) / 20.0)
    return firwin2(taps, f, gain, nfreqs=len(f), fs=FS_HZ)


def apply_filter(rir, fir):
    """Filter a response and take out the filter's delay; the length stays."""
    delay = (len(fir) - 1) // 2
    return fftconvolve(rir, fir)[delay:delay + len(rir)]


def _groups(sim_dir, rows):
    """Rows that share a filter, by the id of the RIR they belong to, which comes first."""
    groups = {row["id"]: [row] for row in rows if not row.get("noise_for")}
    for row in rows:
        main = row.get("noise_for")
        if main and main not in groups:
            raise ValueError(f"{sim_dir}: noise_for={main!r} of RIR {row['id']} is no RIR of this directory: "
                             "simulate it again")
        if main:
            groups[main].append(row)
    return groups


def _compensate_group(sim_dir, rows, target_db, work, taps):
    """Compensate an RIR and its noise RIRs; write their audio; return their rows."""
    fir, done = None, []
    for row in rows:
        rir = load_rir(sim_dir, row)
        try:
            sample, polarity = _direct(row, rir)
            if fir is None:
                compensated, achieved_db, gain_db, fir = compensate_rir(rir, sample, target_db, taps=taps)
            else:
                compensated, achieved_db = apply_filter(rir, fir), None
            parameters = measure(compensated, direct=(sample, polarity))
        except ValueError as error:
            raise ValueError(f"{rir_path(sim_dir, row)}: {error}") from None
        row = row | dict(wav=f"wav/{row['id']}.wav", model=[*(row.get("model") or []), "room_eq"],
                         direct_sample=sample, direct_polarity=polarity, acoustic_parameters=parameters,
                         t30_s=parameters["t30_s"][BAND_1KHZ])
        if achieved_db is not None:
            row.update(eq_target_db=_rounded(target_db), eq_achieved_db=_rounded(achieved_db),
                       eq_error_db=_rounded(achieved_db - target_db), eq_gain_db=_rounded(gain_db))
        write_wav(work / row["wav"], compensated)
        done.append(row)
    return done


def _direct(row, rir):
    """Sample and polarity of the direct sound: the simulator's word, else found."""
    if row.get("direct_sample") is not None and row.get("direct_polarity") is not None:
        return row["direct_sample"], row["direct_polarity"]
    return find_direct(rir, FS_HZ)


def _rounded(values):
    return [round(float(value), _DECIMALS) for value in values]


def summarise(rows):
    """Sum up how closely targets were met.

    Parameters
    ----------
    rows : list of dict
        Compensated rows.

    Returns
    -------
    dict
        `median_db` and `p95_db` of |achieved - target| over RIRs and the seven free points, the same per point
        (`points_hz`), `held` (0.5 dB and 1.5 dB) and `missed`: RIRs with a point off by more than 1.5 dB, each
        with frequency, error, and the steepest step of its filter [dB per octave], which is why: one 31.25 Hz bin
        at 62.5 Hz cannot hold more than some 20 dB against its neighbours.
    """
    errors = np.abs([[row["eq_error_db"][k] for k in FREE] for row in rows])
    missed = defaultdict(dict)
    for row, error in zip(rows, errors, strict=True):
        if error.max() > MAX_P95_DB:
            worst = int(np.argmax(error))
            missed[row["id"]] = dict(hz=BANDS_HZ[FREE[worst]], error_db=row["eq_error_db"][FREE[worst]],
                                     steepest_db=round(float(np.abs(np.diff(row["eq_gain_db"])).max()), 1))
    median_db, p95_db = float(np.median(errors)), float(np.percentile(errors, 95))
    return dict(n_rirs=len(rows), median_db=round(median_db, 3), p95_db=round(p95_db, 3),
                points_hz=[BANDS_HZ[k] for k in FREE], point_median_db=np.median(errors, axis=0).round(3).tolist(),
                point_p95_db=np.percentile(errors, 95, axis=0).round(3).tolist(),
                held=bool(median_db <= MAX_MEDIAN_DB and p95_db <= MAX_P95_DB), missed=dict(missed))


def _log(out, summary):
    if not summary:
        return
    logger.info("%s: |achieved - target| %.2f dB (median), %.2f dB (95th percentile) at the seven points; %s",
                out, summary["median_db"], summary["p95_db"],
                f"{'within' if summary['held'] else 'not within'} the goal of {MAX_MEDIAN_DB} and {MAX_P95_DB} dB")
    for rir_id, why in list(summary["missed"].items())[:5]:
        logger.info("%s: off by %+.1f dB at %g Hz: 31 Hz bins do not follow steps of %.0f dB per octave", rir_id,
                    why["error_db"], why["hz"], why["steepest_db"])
