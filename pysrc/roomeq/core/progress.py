"""Progress of long work: a bar on a terminal, a line now and then in a log."""

import logging
import sys
import time
from collections.abc import Iterable, Iterator

logger = logging.getLogger(__name__)

LOG_EVERY_S = 20.0


def progress(items: Iterable, total: int, what: str) -> Iterator:
    """Yield the items of an iterable, showing how far along it is.

    Parameters
    ----------
    items : iterable
    total : int
        How many items there will be.
    what : str
        What is being done, e.g. ``"simulate"``.
    """
    if sys.stderr.isatty():
        from tqdm import tqdm

        yield from tqdm(items, total=total, desc=what, unit="item", dynamic_ncols=True)
        return
    last = time.monotonic()
    for n, item in enumerate(items, start=1):
        yield item
        if time.monotonic() - last > LOG_EVERY_S:
            last = time.monotonic()
            logger.info("%s: %d of %d", what, n, total)
