"""What a test set may hold: no recording that the loop is closed on. Its rooms may be the same."""

import logging
from collections.abc import Sequence

import numpy as np

from roomeq.acoustics.direct import find_direct
from roomeq.acoustics.same_recordings import cut_parts, find_same
from roomeq.core.arrays import FloatArray
from roomeq.core.constants import FS_HZ
from roomeq.core.workers import share_out
from roomeq.corpora.repeats import find_further_takes
from roomeq.loop.usable import Located, UsableRirs, leave_out
from roomeq.records.rir_dir import load_rir, rir_path

logger = logging.getLogger(__name__)

FURTHER_TAKE = "the recording is a further take of an RIR that the loop is closed on: same devices and positions"

_RULE = "the error of a test set is that of recordings which took no part in a fit: take it out of one of the two sets"


def held_out_rirs(test: UsableRirs, rirs: Sequence[Located], nj: int = 1) -> UsableRirs:
    """Return the RIRs of a test set that are held out, and refuse a test set that shares recordings with the loop.

    Shared is an RIR of the same id and room, or the same audio between 2.5 and 200 ms after its direct sound, whatever
    its level, polarity, format or time of flight (`roomeq.acoustics.same_recordings`). Further takes of an RIR that the
    loop is closed on have its room, devices, positions and reflections: they are left out and counted.

    Parameters
    ----------
    test : UsableRirs
    rirs : sequence of Located
        Usable RIRs that the loop is closed on (`roomeq.loop.usable`).
    nj : int
        Number of processes that read them.

    Raises
    ------
    ValueError
        The first RIR that is in both; the message names its file, the other RIR, the rule and the remedy. Or a
        recording cannot be read.
    """
    named = {(rir.row["room_id"], rir.row["id"]): rir for rir in rirs}
    for rir in test.rirs:
        if same := named.get((rir.row["room_id"], rir.row["id"])):
            raise ValueError(f"test set: {rir_path(*rir)}: {_name(rir)} is in {same.directory} as well: {_RULE}")
    test = _without_further_takes(test, rirs)
    for n, m, _ in find_same(_parts(test.rirs, nj), _parts(rirs, nj)):
        raise ValueError(f"test set: {rir_path(*test.rirs[n])}: {_name(test.rirs[n])} is the recording of "
                         f"{_name(rirs[m])} in {rirs[m].directory}: {_RULE}")
    return test


def _without_further_takes(test: UsableRirs, rirs: Sequence[Located]) -> UsableRirs:
    takes = find_further_takes(test.rirs, rirs)
    for rir, take in zip(test.rirs, takes, strict=True):
        if take:
            logger.info("test set: left out: %s: %s", _name(rir), take)
    return leave_out(test, [FURTHER_TAKE if take else None for take in takes])


def _name(rir: Located) -> str:
    return f"RIR {rir.row['id']} of room {rir.row['room_id']}"


def _parts(rirs: Sequence[Located], nj: int) -> FloatArray:
    def of_rir(rir: Located) -> FloatArray:
        samples = load_rir(*rir)
        return cut_parts(samples, find_direct(samples, FS_HZ).sample)

    return np.array(share_out(of_rir, rirs, nj, label="compare RIRs"))
