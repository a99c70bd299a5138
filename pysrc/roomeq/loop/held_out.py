"""What a test set may hold: no recording that the loop is closed on. Its rooms may be the same."""

from collections.abc import Sequence

import numpy as np

from roomeq.acoustics.direct import find_direct
from roomeq.core.arrays import FloatArray
from roomeq.core.constants import FS_HZ
from roomeq.core.workers import share_out
from roomeq.corpora.copies import SKETCH_SIZE, first_copy, sketch
from roomeq.loop.doubtful_recordings import cut_parts
from roomeq.loop.usable import Located
from roomeq.records.rir_dir import load_rir, rir_path

_RULE = "the error of a test set is that of recordings which took no part in a fit: take it out of one of the two sets"


def require_held_out(test: Sequence[Located], rirs: Sequence[Located], nj: int = 1) -> None:
    """Refuse a test set that shares recordings with the RIRs that the loop is closed on.

    Shared is an RIR of the same id and room, or the same audio between 2.5 and 200 ms after its direct sound, whatever
    its level, polarity, format or time of flight.

    Parameters
    ----------
    test, rirs : sequence of Located
        Usable RIRs (`roomeq.loop.usable`).
    nj : int
        Number of processes that read them.

    Raises
    ------
    ValueError
        The first RIR that is in both; the message names its file, the other RIR, the rule and the remedy.
    """
    named = {(rir.row["room_id"], rir.row["id"]): rir for rir in rirs}
    for rir in test:
        if same := named.get((rir.row["room_id"], rir.row["id"])):
            raise ValueError(f"test set: {rir_path(*rir)}: {_name(rir)} is in {same.directory} as well: {_RULE}")
    sketches = np.array(_sketches(rirs, nj)).reshape(-1, SKETCH_SIZE)
    for rir, of_rir in zip(test, _sketches(test, nj), strict=True):
        if (n := first_copy(of_rir, sketches)) is not None:
            raise ValueError(f"test set: {rir_path(*rir)}: {_name(rir)} is the recording of {_name(rirs[n])} in "
                             f"{rirs[n].directory}: {_RULE}")


def _name(rir: Located) -> str:
    return f"RIR {rir.row['id']} of room {rir.row['room_id']}"


def _sketches(rirs: Sequence[Located], nj: int) -> list[FloatArray]:
    def of_rir(rir: Located) -> FloatArray:
        samples = load_rir(*rir)
        return sketch(cut_parts(samples, find_direct(samples, FS_HZ).sample))

    return share_out(of_rir, rirs, nj, label="compare RIRs")
