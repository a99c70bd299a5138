"""Work shared out to processes that see all that their parent has: only what they return travels."""

import multiprocessing
import os
import signal
import threading
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import connection

_share = None  # a worker's work and items


def share_out(work, items, nj, *, first_here=True):
    """Return ``[work(item) for item in items]``, done by up to `nj` forked processes.

    Parameters
    ----------
    work : callable
        It and the items may be of any size and kind; what it returns is pickled.
    items : iterable
    nj : int
    first_here : bool
        Do the first item before there are processes: they all have then what it compiled and computed for all.

    Raises
    ------
    concurrent.futures.process.BrokenProcessPool
        A process was killed.
    """
    items = list(items)
    n_here = len(items) if nj == 1 else int(first_here)
    done, items = [work(item) for item in items[:n_here]], items[n_here:]
    nj = min(nj, len(items))
    if not nj:
        return done
    with ProcessPoolExecutor(nj, multiprocessing.get_context("fork"), initializer=_begin,
                             initargs=(work, items)) as pool:
        return [*done, *pool.map(_call, range(len(items)))]


def _begin(*share):
    global _share
    _share = share
    if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:  # as of a job in the background
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # ends it at once and without a word; the parent has one to say
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent():
    """A killed parent cannot tell its workers, which would wait for work forever."""
    connection.wait([multiprocessing.parent_process().sentinel])
    os._exit(1)


def _call(number):
    work, items = _share
    return work(items[number])
