"""Devices that several corpora call by one name: the loop takes them for one, and says so."""

import logging
from collections.abc import Iterable, Mapping
from typing import Any

from roomeq.records.schema import unit_name

logger = logging.getLogger(__name__)

MOST_NAMED = 20
"""Names that one warning lists."""
_KINDS = {"source": "source_id", "mic": "mic_id"}


def warn_of_shared_devices(rows: Iterable[Mapping[str, Any]]) -> None:
    """Warn of loudspeakers and microphones whose name is in rows of several corpora, once for the same corpora.

    Nothing tells whether they are one device: a reader makes a corpus of each folder, and a laboratory may record with
    the same devices in two.

    Parameters
    ----------
    rows : iterable of mapping
        Rows of all RIRs that the loop uses, those of the test set among them.
    """
    corpora_of: dict[str, dict[str, None]] = {}
    for row in rows:
        for scope, key in _KINDS.items():
            corpora_of.setdefault(f"{key}={unit_name(row, scope)}", {})[row.get("corpus") or "rows without one"] = None
    names_in: dict[tuple[str, ...], list[str]] = {}
    for name in sorted(corpora_of):
        names_in.setdefault(tuple(sorted(corpora_of[name])), []).append(name)
    for corpora, names in names_in.items():
        if len(corpora) > 1:
            more = f" and {len(names) - MOST_NAMED} more" * (len(names) > MOST_NAMED)
            logger.warning("%s%s: in corpora %s, and taken for one device each; if they are others there, one response "
                           "is fitted to several devices: rename them in one of the corpora (if not, state one corpus)",
                           ", ".join(names[:MOST_NAMED]), more, " and ".join(corpora))
