"""Random numbers that depend on what they are for, never on when they are drawn."""

import hashlib

import numpy as np


def rng_for(seed: int, what: str, item_id: str) -> np.random.Generator:
    """Return the generator of one purpose and one item.

    The result does not depend on the order of calls or on the number of jobs.

    Parameters
    ----------
    seed : int
        The user's seed.
    what : str
        Purpose, e.g. ``"materials"``.
    item_id : str
        Id of the thing that is drawn for, e.g. an RIR id.
    """
    digest = hashlib.sha256(repr((int(seed), what, item_id)).encode()).digest()
    return np.random.Generator(np.random.PCG64(int.from_bytes(digest[:16], "little")))
