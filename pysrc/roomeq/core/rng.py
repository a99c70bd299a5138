"""Random generators seeded by purpose and item, so that results do not depend on the order of the draws."""

import hashlib

import numpy as np


def rng_for(seed: int, purpose: str, item_id: str) -> np.random.Generator:
    """Return the random generator of one purpose and one item.

    The result does not depend on the order of calls or on the number of jobs.

    Parameters
    ----------
    seed : int
        The user's seed.
    purpose : str
        What the numbers are drawn for, e.g. ``"materials"``.
    item_id : str
        Id of the item that the numbers belong to, e.g. an RIR id.
    """
    digest = hashlib.sha256(repr((int(seed), purpose, item_id)).encode()).digest()
    return np.random.Generator(np.random.PCG64(int.from_bytes(digest[:16], "little")))
