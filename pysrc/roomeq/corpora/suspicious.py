"""Recordings that are no RIR: the mark in the row, and the check of rows that nobody has marked.

A row's key `suspicious` says why its recording is no RIR, or is null: it is one, or somebody who knows better keeps it.
`roomeq.corpora.measured` and `roomeq.corpora.characterise` write the key. A row without it is from a `rirs.jsonl` that
was written by hand, and every step that uses its audio checks it (`roomeq.acoustics.plausibility`).
"""

import logging
from collections.abc import Iterable
from pathlib import Path

from roomeq.records.rir_dir import load_rir, rir_path
from roomeq.records.schema import RirRow

logger = logging.getLogger(__name__)

REMEDY = "keep such recordings with --keep-suspicious of read-measured or characterise"


def suspicion(rir_dir: Path, row: RirRow) -> str | None:
    """Return why the recording of a row is no RIR, or None; a simulated RIR (with a seed) is one.

    Raises
    ------
    ValueError
        As from `roomeq.records.rir_dir.load_rir`.
    """
    if "suspicious" in row:
        return row["suspicious"]
    if row.get("seed") is not None:
        return None
    from roomeq.acoustics.plausibility import find_implausibility

    return find_implausibility(load_rir(rir_dir, row, row["fs_hz"]), row["fs_hz"])


def without_suspicious(rir_dir: Path, rows: Iterable[RirRow]) -> list[RirRow]:
    """Return the rows whose recordings are RIRs; the log names each of the others, and counts them.

    Raises
    ------
    ValueError
        As from `suspicion`.
    """
    rows = list(rows)
    reasons = [suspicion(rir_dir, row) for row in rows]
    for row, reason in zip(rows, reasons, strict=True):
        if reason:
            logger.warning("no RIR: %s: %s", rir_path(rir_dir, row), reason)
    kept = [row for row, reason in zip(rows, reasons, strict=True) if not reason]
    if len(kept) < len(rows):
        logger.warning("%s: %d of %d recordings are no RIR and are left out (%s)", rir_dir, len(rows) - len(kept),
                       len(rows), REMEDY)
    return kept
