"""Acoustic parameters of measured RIRs: everything that can be measured on one, and whether it may be used for what.

An RIR is *dropped* when it adds nothing or cannot be right (a repeat, an uncommon space): it is not in the
output, only in `screening.json`. It is *screened* when it is a fine recording whose spectrum says more about
something else than the room (a dummy head, a hand clap, noise): it stays, and the EQ fit leaves it out.
"""

import hashlib
import logging
from collections import Counter
from pathlib import Path

import numpy as np

from roomeq.acoustics.iso3382 import DECAYS_DB, MARGIN_DB
from roomeq.acoustics.parameters import measure
from roomeq.acoustics.subband_eq import MIN_SNR_DB
from roomeq.core.build import Build
from roomeq.core.constants import BAND_1KHZ, BANDS_HZ, FS_HZ
from roomeq.core.files import write_json
from roomeq.records.geometry import geometry_usability, position_key
from roomeq.records.rir_dir import load_rir, read_noises, read_rirs, relocated, rir_path, write_noises, write_rirs

logger = logging.getLogger(__name__)

SCREENING_FILE = "screening.json"
MAX_DEAD_POINTS = 1  # one lost EQ point can be filled in from the others, two are a dead band
SAME_TAKE_S = 0.05
SAME_TAKE_CORRELATION = 0.8
_DECIMALS = 4


def characterise(rir_dir, out, *, skip_bad=False, part=None, nj=1):
    """Measure every RIR of a directory; drop repeats and uncommon spaces; say what the EQ fit must leave out.

    Parameters
    ----------
    rir_dir : Path
        RIR directory (`roomeq.records.rir_dir`), e.g. ``data/measured``.
    out : Path
        RIR directory to make: the same audio (not copied), its rows with `acoustic_parameters` (see `measure`),
        `screen` (why the EQ fit leaves this RIR out, or null) and `geometry_ok`; and `screening.json`.
    skip_bad : bool
        Drop recordings that cannot be measured at all (no direct sound) instead of
        stopping at the first.
    part : str, optional
        ``"2/5"``: do one share of the work only.
    nj : int
        Number of processes.

    Returns
    -------
    dict or None
        What `screening.json` says; None if only a part was done.

    Raises
    ------
    ValueError
        A recording cannot be read or measured; the message names the file.
    """
    rir_dir, out = Path(rir_dir), Path(out)
    rows = read_rirs(rir_dir)
    build = Build(out, step="characterise", options=dict(skip_bad=bool(skip_bad)), inputs=[rir_dir],
                  refers=True)
    if build.done:
        return None

    def one(_, row):
        return _characterise_one(rir_dir, row, skip_bad)

    summary = {}

    def assemble(directory, records):
        kept, dropped = _drop(rir_dir, rows, records)
        if not kept:
            raise ValueError(f"{rir_dir}: all {len(rows)} RIRs are dropped ({_counts_text(dropped)}): "
                             "measure others")
        write_rirs(directory, relocated(kept, rir_dir, out), final_directory=out)
        write_noises(directory, relocated(read_noises(rir_dir), rir_dir, out))
        summary.update(_summary(rows, kept, dropped))
        write_json(directory / SCREENING_FILE, summary)

    if build.run({row["id"]: row for row in rows}, one, part=part, nj=nj) and build.finish(assemble):
        _log(summary)
    return summary or None


def _characterise_one(rir_dir, row, skip_bad):
    """Record of one RIR: its acoustic parameters, its screening, and a hash of what it sounds like."""
    rir = load_rir(rir_dir, row)
    try:
        parameters = measure(rir)
    except ValueError as error:
        if skip_bad:
            return dict(broken=str(error))
        raise ValueError(f"{rir_path(rir_dir, row)}: {error}") from None
    # the same take at another gain is no other
    scaled = np.round(rir / np.max(np.abs(rir)) * 2 ** 15).astype("<i4")
    return dict(acoustic_parameters=parameters, screen=screen_reason(row, parameters),
                geometry_ok=geometry_usability(row, needs="consistency").usable, sound=hashlib.sha256(scaled.tobytes()).hexdigest())


def screen_reason(row, parameters):
    """Why an RIR may not shape the EQ distribution, by what is known of this one recording; or None.

    The first words, up to the colon, are the kind of reason that summaries count.
    """
    if row.get("binaural"):
        return "binaural: the dummy head's ears are part of the spectrum"
    if row.get("excitation") == "clap":
        return "hand clap: its spectrum is part of the response"
    if not parameters["t20_valid"][BAND_1KHZ]:
        needed_db = MARGIN_DB - DECAYS_DB["t20"][1]
        return (f"too noisy: {parameters['decay_range_db'][BAND_1KHZ]:.1f} dB of decay at 1 kHz, "
                f"T20 needs {needed_db:.0f}")
    rolled_off = parameters["eq_edge_db"] is not None
    dead = [f"{hz:g}" for k, (hz, valid) in enumerate(zip(BANDS_HZ, parameters["eq_valid"], strict=True))
            if not valid and not (rolled_off and k == len(BANDS_HZ) - 1)]
    if len(dead) > MAX_DEAD_POINTS:
        return f"dead bands: less than {MIN_SNR_DB:g} dB above the noise at {', '.join(dead)} Hz"
    return None


def _drop(rir_dir, rows, records):
    """Split rows into those that stay (with acoustic parameters) and {id: reason} of those that go."""
    kept, dropped, first_of = [], {}, {}
    ids = {row["id"] for row in rows}
    # a reader names as repeat_of the take to keep: that one comes first
    order = sorted(range(len(rows)), key=lambda n: (rows[n].get("repeat_of") is not None, rows[n]["id"]))
    for n in order:
        row, record = rows[n], records[n]
        if "broken" in record:
            dropped[row["id"]] = f"broken: {record['broken']}"
        elif row.get("uncommon"):
            dropped[row["id"]] = "uncommon space: not one that speech is usually spoken in"
        elif row.get("repeat_of") in ids and row["repeat_of"] not in dropped:
            dropped[row["id"]] = f"repeat: same positions as {row['repeat_of']}"
        else:
            row = row | {key: record[key] for key in ("acoustic_parameters", "screen", "geometry_ok")}
            sound, place = record["sound"], position_key(row)
            if sound in first_of:
                dropped[row["id"]] = f"repeat: same audio as {first_of[sound]['id']}"
            elif place in first_of and same_take(rir_dir, first_of[place], row):
                dropped[row["id"]] = f"repeat: same positions as {first_of[place]['id']}"
            else:
                first_of.setdefault(sound, row)
                if place is not None:
                    first_of.setdefault(place, row)
                kept.append(row)
    return kept, dropped


def same_take(rir_dir, row, other):
    """Tell whether two RIRs of one stated position are alike: channels of an array or of a dummy head are not.

    Correlated over the 50 ms after their direct sounds, at the best shift of up to 0.5 ms.
    """
    n, reach = round(SAME_TAKE_S * FS_HZ), round(5e-4 * FS_HZ)
    parts = []
    for one, margin in ((row, 0), (other, reach)):
        start = max(0, round(one["acoustic_parameters"]["direct_sample"]))
        rir = np.pad(load_rir(rir_dir, one), (margin, n + margin))
        parts.append(rir[start:start + n + 2 * margin])
    windows = np.lib.stride_tricks.sliding_window_view(parts[1], n)
    size = np.linalg.norm(parts[0]) * np.linalg.norm(windows, axis=1)
    return bool(np.max(np.abs(windows @ parts[0]) / np.maximum(size, 1e-300)) > SAME_TAKE_CORRELATION)


def _summary(rows, kept, dropped):
    screened = {row["id"]: row["screen"] for row in kept if row["screen"]}
    return dict(n_given=len(rows), n_kept=len(kept), n_for_eq=len(kept) - len(screened),
                n_geometry_not_ok=sum(not row["geometry_ok"] for row in kept),
                n_roll_off_at_8khz=sum(row["acoustic_parameters"]["eq_edge_db"] is not None for row in kept),
                dropped_counts=_counts(dropped), dropped=dropped,
                screened_counts=_counts(screened), screened=screened)


def _counts(reasons):
    return dict(sorted(Counter(reason.split(":")[0] for reason in reasons.values()).items()))


def _counts_text(reasons):
    return ", ".join(f"{count} {kind}" for kind, count in _counts(reasons).items()) or "none"


def _log(summary):
    if summary:
        logger.info("%d RIRs given, %d kept; dropped: %s", summary["n_given"], summary["n_kept"],
                    _counts_text(summary["dropped"]))
        logger.info("%d of them may shape the EQ distribution; screened: %s; 8 kHz behind an anti-alias filter: "
                    "%d; positions not to be believed: %d", summary["n_for_eq"], _counts_text(summary["screened"]),
                    summary["n_roll_off_at_8khz"], summary["n_geometry_not_ok"])
