"""Forked worker processes: they inherit the memory of their parent, so that only their results are pickled."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import connection
from typing import Any, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

_task: tuple[Callable[[Any], Any], list[Any]] | None = None  # in a worker: its work and all items


def share_out(work: Callable[[Item], Result], items: Iterable[Item], nj: int, *,
              first_here: bool = True) -> list[Result]:
    """Return ``[work(item) for item in items]``, computed by up to `nj` forked processes.

    Parameters
    ----------
    work : callable
        It and the items may be of any size and need not be picklable; its results are pickled.
    items : iterable
    nj : int
    first_here : bool
        Work on the first item before forking, so that all processes inherit what it compiled and cached.

    Raises
    ------
    concurrent.futures.process.BrokenProcessPool
        A process was killed.
    """
    items = list(items)
    n_here = len(items) if nj == 1 else int(first_here)
    results, items = [work(item) for item in items[:n_here]], items[n_here:]
    nj = min(nj, len(items))
    if not nj:
        return results
    with ProcessPoolExecutor(nj, multiprocessing.get_context("fork"), initializer=_start_worker,
                             initargs=(work, items)) as pool:
        return [*results, *pool.map(_work_on, range(len(items)))]


def _start_worker(work: Callable[[Any], Any], items: list[Any]) -> None:
    global _task
    _task = work, items
    if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:  # which a job in the background ignores
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # ends the worker without a message; the parent prints one
    threading.Thread(target=_exit_with_parent, daemon=True).start()


def _exit_with_parent() -> None:
    """Exit when the parent does: a parent that is killed cannot tell its workers, which would wait for ever."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    connection.wait([parent.sentinel])
    os._exit(1)


def _work_on(number: int) -> Any:
    assert _task is not None
    work, items = _task
    return work(items[number])
