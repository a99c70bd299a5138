"""Worker processes: how many, on how many threads they compute, how they end with their parent, and forked ones."""

import ctypes
import os
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from functools import wraps
from typing import Any, TypeVar, cast

from roomeq.core.progress import Meter, silence, tick

Item = TypeVar("Item")
Result = TypeVar("Result")
Work = TypeVar("Work", bound=Callable[..., Any])

SHOWN_EVERY_S = 1.0
"""How often the progress is shown while workers are waited for [s]."""

PARENT_CHECKED_S = 0.5
"""How often a worker looks whether its parent still runs [s]."""

PER_CORE = 4
"""Largest number of processes per core."""

LOG_VARIABLE = "ROOMEQ_WORKER_LOG"
"""Environment variable with a file that takes what workers say, of single items as a rule."""

_RUNS = 48  # of items that a process works on one after the other: to hand over each by itself takes time
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3

_watcher = 0  # process that watches its parent
_task: tuple[Callable[[Any], Any], list[Any]] | None = None  # in a worker: its work and all items


def n_processes(nj: int, n_items: int) -> int:
    """Return how many processes to start for `nj` jobs: at most one per item, and `PER_CORE` per core."""
    return max(1, min(nj, n_items, PER_CORE * len(os.sched_getaffinity(0))))


def end_with(parent: int) -> None:
    """Let this worker end when its parent does: one that a signal ends cannot tell its workers, which would go on.

    Parameters
    ----------
    parent : int
        Process id of the process that started this one; of this one itself where the work is done in place.
    """
    global _watcher
    if os.getpid() in (parent, _watcher):  # a fork inherits the variable, and not the thread
        return
    _watcher = os.getpid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(PARENT_CHECKED_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def return_large_arrays() -> None:
    """Let the C library return arrays of 4 MB or more to the system when they are freed.

    By itself, glibc raises this limit to the size of the largest array that was freed so far (``M_MMAP_THRESHOLD`` in
    mallopt(3)). Those of several threads then leave holes between small arrays that stay. Once the limit is set, glibc
    no longer adapts ``M_TRIM_THRESHOLD`` either: with its 128 KB, the memory of smaller arrays would go back to the
    system and come again all the time, which took a tenth of the time of a loop. Other C libraries have no such limits.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_MMAP_THRESHOLD, 4 << 20)
        mallopt(_M_TRIM_THRESHOLD, 256 << 20)


def on_one_thread(function: Work) -> Work:
    """Let the linear algebra within a function, and within processes that it forks, compute on one thread.

    Sums over several threads differ in their last bits, and results must not depend on how many a machine has, or on
    variables such as ``OPENBLAS_NUM_THREADS``. Libraries that are loaded within the function are not limited.
    """
    @wraps(function)
    def limited(*args: Any, **kwargs: Any) -> Any:
        from threadpoolctl import threadpool_limits

        with threadpool_limits(1):
            return function(*args, **kwargs)

    return cast(Work, limited)


@on_one_thread
def share_out(work: Callable[[Item], Result], items: Iterable[Item], nj: int, *,
              first_here: bool = True, label: str) -> list[Result]:
    """Return ``[work(item) for item in items]``, computed by up to `nj` forked processes, which inherit the memory.

    They compute on one thread each (`on_one_thread`). Only the results are pickled.

    Parameters
    ----------
    work : callable
        It and the items may be of any size and need not be picklable.
    items : iterable
    nj : int
    first_here : bool
        Work on the first item before forking, so that all processes inherit what it compiled and cached.
    label : str
        Name of an item for the progress, e.g. ``"render"``.

    Raises
    ------
    concurrent.futures.process.BrokenProcessPool
        A process was killed.
    """
    items = list(items)
    n_here = len(items) if nj == 1 else int(first_here)
    with Meter(len(items), label) as meter:
        results = []
        for item in items[:n_here]:
            results.append(work(item))
            meter.advance()
        rest = items[n_here:]
        size = max(1, len(rest) // (_RUNS * n_processes(nj, len(rest) or 1)))
        runs = [rest[first:first + size] for first in range(0, len(rest), size)]
        of_runs: dict[int, list[Result]] = {}
        for n, of_run in forked(lambda run: [work(item) for item in run], runs, nj):
            of_runs[n] = of_run
            meter.advance(len(of_run))
        return results + [result for n in range(len(runs)) for result in of_runs[n]]


def may_fork() -> bool:
    """Tell whether processes can be forked.

    No other thread may run, whose locks they would wait for, and daemonic processes start none.
    """
    import multiprocessing

    return threading.active_count() == 1 and not multiprocessing.current_process().daemon


def forked(work: Callable[[Item], Result], items: list[Item], nj: int) -> Iterator[tuple[int, Result]]:
    """Yield the number of each item and ``work(item)``, computed by up to `nj` forked processes, as they are done.

    For the parameters and errors see `share_out`. Where several items fail, the error is that of the first of them.
    """
    if not items:
        return
    import multiprocessing
    from concurrent.futures import Future, ProcessPoolExecutor
    from queue import Empty, SimpleQueue

    count, done = n_processes(nj, len(items)), SimpleQueue[Future[Result]]()
    failed: tuple[int, BaseException] | None = None  # the first item that failed, and its error
    with ProcessPoolExecutor(count, multiprocessing.get_context("fork"), initializer=_start_worker,
                             initargs=(work, items, count)) as pool:
        try:
            numbers = {}
            for n in range(len(items)):
                future = pool.submit(_work_on, n)
                numbers[future] = n
                future.add_done_callback(done.put)
            while numbers:
                try:
                    future = done.get(timeout=SHOWN_EVERY_S)
                except Empty:
                    tick()
                    continue
                n = numbers.pop(future)
                if future.cancelled():
                    continue
                error = future.exception()
                if error is None and failed is None:
                    yield n, future.result()
                elif error is not None and (failed is None or n < failed[0]):
                    failed = n, error
                    for other, number in numbers.items():
                        if number > n:
                            other.cancel()
            if failed is not None:
                raise failed[1]
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _start_worker(work: Callable[[Any], Any], items: list[Any], n_workers: int) -> None:
    import multiprocessing

    from threadpoolctl import threadpool_limits

    global _task
    _task = work, items
    silence()
    if LOG_VARIABLE in os.environ:
        with open(os.environ[LOG_VARIABLE], "a", encoding="utf-8") as log:
            os.dup2(log.fileno(), 2)
    threadpool_limits(1)
    os.environ.setdefault("NUMBA_NUM_THREADS", str(max(1, len(os.sched_getaffinity(0)) // n_workers)))
    if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:  # which a job in the background ignores
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # ends the worker without a message; the parent prints one
    parent = multiprocessing.parent_process()
    assert parent is not None and parent.pid is not None
    end_with(parent.pid)


def _work_on(number: int) -> Any:
    assert _task is not None
    work, items = _task
    return work(items[number])
