"""Characterise measured RIRs: measure each one, drop those that are useless, mark those that the EQ fit must leave out.

An RIR is *dropped* if it adds nothing (a repeat), is of an uncommon space, or is no RIR by its acoustics: it is only in
`screening.json`. It is *screened* if the recording is fine but its spectrum is not that of the room alone (a dummy
head, a hand clap, noise): it stays, and the EQ fit leaves it out.
"""

import hashlib
import logging
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median_high
from typing import Any, NamedTuple

from roomeq.core.build import Build
from roomeq.core.constants import BAND_1KHZ, BANDS_HZ
from roomeq.core.files import write_json
from roomeq.corpora.repeats import find_repeats, keeping_order
from roomeq.corpora.suspicious import suspicion
from roomeq.records.geometry import geometry_usability
from roomeq.records.rir_dir import (
    load_rir,
    read_noises,
    read_rirs,
    relocated,
    require_16_khz,
    rir_path,
    warn_of_unused_keys,
    without_detour,
    write_noises,
    write_rirs,
)
from roomeq.records.schema import RirRow

logger = logging.getLogger(__name__)

SCREENING_FILE = "screening.json"
MAX_DEAD_POINTS = 1
"""EQ points that may be invalid: one can be estimated from the others, two are a dead band."""


def characterise(rir_dir: Path, out: Path, *, skip_bad: bool = False, keep_suspicious: bool = False,
                 part: str | None = None, nj: int = 1) -> dict[str, Any] | None:
    """Measure every RIR of a directory, drop repeats and uncommon spaces, and screen RIRs for the EQ fit.

    Parameters
    ----------
    rir_dir : Path
        RIR directory (`roomeq.records.rir_dir`), e.g. ``data/measured``.
    out : Path
        RIR directory to make. It refers to the same audio; its rows also have `acoustic_parameters` (see
        `roomeq.acoustics.parameters.measure`), `screen` (why the EQ fit leaves the RIR out, or null) and `geometry_ok`.
        Beside them lies `screening.json`.
    skip_bad : bool
        Drop recordings that cannot be measured (they have no direct sound) instead of stopping at the first.
    keep_suspicious : bool
        Keep recordings that are no RIR by their acoustics. By default they are dropped
        (`roomeq.corpora.suspicious`).
    part : str, optional
        ``"2/5"``: do one share of the work only.
    nj : int
        Number of processes.

    Returns
    -------
    summary : dict or None
        Content of `screening.json`; None if `out` was up to date or only a part was done.

    Raises
    ------
    ValueError
        A recording cannot be read or measured; the message names the file.
    """
    rir_dir, out = Path(rir_dir), Path(out)
    read_rirs(rir_dir)  # refuses another directory before all of it is hashed
    build = Build(out, step="characterise", inputs=[rir_dir], refers=True,
                  options=dict(skip_bad=bool(skip_bad), keep_suspicious=bool(keep_suspicious)))
    if build.done:
        return None
    rows = read_rirs(rir_dir)  # as they are in the key
    warn_of_unused_keys(rir_dir, rows)
    require_16_khz(rir_dir, rows)

    def make(_: str, row: RirRow) -> dict[str, Any]:
        reason = None if keep_suspicious else suspicion(rir_dir, row)
        return dict(suspicious=reason) if reason else _characterise_rir(rir_dir, row, skip_bad)

    summary: dict[str, Any] = {}

    def assemble(directory: Path, records: list[dict[str, Any]]) -> None:
        _limit_to_excitation(rows, records)
        kept, dropped = _drop(rir_dir, rows, records)
        for row, record in zip(rows, records, strict=True):
            if "suspicious" in record:
                logger.warning("no RIR: %s: %s (--keep-suspicious keeps it)",
                               without_detour(rir_path(rir_dir, row)), record["suspicious"])
        if not kept:
            raise ValueError(f"{rir_dir}: all {len(rows)} RIRs are dropped ({_counts_text(dropped)}): "
                             "measure others")
        write_rirs(directory, relocated(kept, rir_dir, out), final_directory=out)
        write_noises(directory, relocated(read_noises(rir_dir), rir_dir, out))
        summary.update(_summary(rows, kept, dropped))
        write_json(directory / SCREENING_FILE, summary)

    if build.run({row["id"]: row for row in rows}, make, part=part, nj=nj) and build.finish(assemble):
        _log(summary)
    return summary or None


def _characterise_rir(rir_dir: Path, row: RirRow, skip_bad: bool) -> dict[str, Any]:
    """Return what was measured on an RIR and a hash of its samples, or ``{"broken": reason}``."""
    import numpy as np

    from roomeq.acoustics.excitation import excited_from_hz, excited_to_hz
    from roomeq.acoustics.parameters import measure

    rir = load_rir(rir_dir, row)
    try:
        parameters = measure(rir)
    except ValueError as error:
        if skip_bad:
            return dict(broken=str(error))
        raise ValueError(f"{rir_path(rir_dir, row)}: {error}") from None
    # scaled, so that the same samples at another gain have the same hash
    scaled = np.round(rir / np.max(np.abs(rir)) * 2 ** 15).astype("<i4")
    return dict(acoustic_parameters=parameters, excited_from_hz=excited_from_hz(rir), excited_to_hz=excited_to_hz(rir),
                geometry_ok=geometry_usability(row, needs="consistency").usable,
                sound=hashlib.sha256(scaled.tobytes()).hexdigest())


def _limit_to_excitation(rows: Sequence[RirRow], records: Sequence[dict[str, Any]]) -> None:
    """Make EQ points, decay times and C50 outside the band of the excitation invalid.

    Its lower end is the same for all RIRs of a source in a room, its upper end that of each recording. Of two values in
    the middle, the median is the higher: their mean is no end if one of the recordings shows none.
    """
    from roomeq.acoustics.excitation import eq_to_hz, limit_to_excitation

    of_source = defaultdict(list)
    for row, record in zip(rows, records, strict=True):
        if "acoustic_parameters" in record:
            of_source[row.get("corpus"), row["source_id"], row["room_id"]].append(record)
    for (_, source_id, room_id), measured in of_source.items():
        from_hz = median_high(record["excited_from_hz"] for record in measured)
        if from_hz > BANDS_HZ[0]:
            logger.info("source %s in room %s, %d RIRs: the excitation begins at %.0f Hz; what lies below is not "
                        "measured", source_id, room_id, len(measured), from_hz)
        ends_hz = [eq_to_hz(record["excited_to_hz"]) for record in measured]
        if n_ended := sum(end_hz < BANDS_HZ[-1] for end_hz in ends_hz):
            logger.info("source %s in room %s: %d of %d RIRs hold nothing above %.0f Hz, like recordings of a lower "
                        "sample rate; what lies above is not measured", source_id, room_id, n_ended, len(measured),
                        min(ends_hz))
        for record in measured:
            limit_to_excitation(record["acoustic_parameters"], from_hz, record["excited_to_hz"])


def screen_reason(row: Mapping[str, Any], parameters: Mapping[str, Any]) -> str | None:
    """Return why an RIR may not shape the EQ distribution, by what is known of this recording alone; or None.

    The words before the colon are the kind of reason, by which summaries count.
    """
    from roomeq.acoustics.iso3382 import DECAYS_DB
    from roomeq.acoustics.noise_intersection import NOISE_MARGIN_DB
    from roomeq.acoustics.subband_eq import MIN_SNR_DB

    if row.get("binaural"):
        return "binaural: the dummy head's ears are part of the spectrum"
    if row.get("excitation") == "clap":
        return "hand clap: its spectrum is part of the response"
    if not parameters["t20_valid"][BAND_1KHZ]:
        needed_db = NOISE_MARGIN_DB - DECAYS_DB["t20"][1]
        return (f"too noisy: {parameters['decay_range_db'][BAND_1KHZ]:.1f} dB of decay at 1 kHz, "
                f"T20 needs {needed_db:.0f}")
    rolled_off = parameters["eq_edge_db"] is not None
    dead = [f"{hz:g}" for k, (hz, valid) in enumerate(zip(BANDS_HZ, parameters["eq_valid"], strict=True))
            if not valid and not (rolled_off and k == len(BANDS_HZ) - 1)]
    if len(dead) > MAX_DEAD_POINTS:
        return f"dead bands: not excited, or less than {MIN_SNR_DB:g} dB above the noise, at {', '.join(dead)} Hz"
    return None


class _Drop(NamedTuple):
    """Rows that stay, with their acoustic parameters, and the reasons of the others by id."""

    kept: list[dict[str, Any]]
    dropped: dict[str, str]


def _drop(rir_dir: Path, rows: Sequence[RirRow], records: Sequence[dict[str, Any]]) -> _Drop:
    reasons: list[str | None] = [_useless(row, record) for row, record in zip(rows, records, strict=True)]
    rest = [n for n, reason in enumerate(reasons) if reason is None]
    repeats = find_repeats([(rir_dir, rows[n]) for n in rest], [records[n]["sound"] for n in rest])
    for n, repeat in zip(rest, repeats, strict=True):
        reasons[n] = f"repeat: {repeat}" if repeat else None
    kept: list[dict[str, Any]] = []
    dropped: dict[str, str] = {}
    for n in keeping_order(rows):
        row, record, reason = rows[n], records[n], reasons[n]
        if reason:
            dropped[row["id"]] = reason
        else:
            kept.append({**row, "suspicious": None, "screen": screen_reason(row, record["acoustic_parameters"]),
                         **{key: record[key] for key in ("acoustic_parameters", "geometry_ok")}})
    return _Drop(kept, dropped)


def _useless(row: RirRow, record: Mapping[str, Any]) -> str | None:
    """Return why an RIR is dropped, by what is known of this recording alone; or None."""
    if "broken" in record:
        return f"broken: {record['broken']}"
    if "suspicious" in record:
        kind, _, detail = record["suspicious"].partition(": ")
        return f"no RIR ({kind}): {detail}"
    return "uncommon space: not one that speech is usually spoken in" if row.get("uncommon") else None


def _summary(rows: Sequence[RirRow], kept: Sequence[dict[str, Any]], dropped: dict[str, str]) -> dict[str, Any]:
    screened = {row["id"]: row["screen"] for row in kept if row["screen"]}
    return dict(n_given=len(rows), n_kept=len(kept), n_for_eq=len(kept) - len(screened),
                n_geometry_not_ok=sum(not row["geometry_ok"] for row in kept),
                n_roll_off_at_8khz=sum(row["acoustic_parameters"]["eq_edge_db"] is not None for row in kept),
                dropped_counts=_counts(dropped), dropped=dropped,
                screened_counts=_counts(screened), screened=screened)


def _counts(reasons: dict[str, str]) -> dict[str, int]:
    return dict(sorted(Counter(reason.split(":")[0] for reason in reasons.values()).items()))


def _counts_text(reasons: dict[str, str]) -> str:
    return ", ".join(f"{count} {kind}" for kind, count in _counts(reasons).items()) or "none"


def _log(summary: dict[str, Any]) -> None:
    if summary:
        logger.info("%d RIRs read, %d kept; dropped: %s", summary["n_given"], summary["n_kept"],
                    _counts_text(summary["dropped"]))
        logger.info("%d of them shape the EQ distribution; screened: %s; %d lose their 8 kHz point to an anti-alias "
                    "filter; %d have positions that cannot be right", summary["n_for_eq"],
                    _counts_text(summary["screened"]), summary["n_roll_off_at_8khz"], summary["n_geometry_not_ok"])
