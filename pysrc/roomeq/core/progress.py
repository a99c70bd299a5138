"""Progress of long work: a bar on a terminal, an occasional line in a log."""

import logging
import sys
import time
from collections.abc import Iterable, Iterator
from typing import TypeVar

logger = logging.getLogger(__name__)

LOG_EVERY_S = 20.0

Item = TypeVar("Item")


def progress(items: Iterable[Item], total: int, label: str) -> Iterator[Item]:
    """Yield the items of an iterable and show how many have been yielded.

    Parameters
    ----------
    items : iterable
    total : int
        Number of items.
    label : str
        Name of the work, e.g. ``"simulate"``.
    """
    if sys.stderr.isatty():
        from tqdm import tqdm

        yield from tqdm(items, total=total, desc=label, unit="item", dynamic_ncols=True)
        return
    last = time.monotonic()
    for n, item in enumerate(items, start=1):
        yield item
        if time.monotonic() - last > LOG_EVERY_S:
            last = time.monotonic()
            logger.info("%s: %d of %d", label, n, total)
