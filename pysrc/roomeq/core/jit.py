"""Compiled kernels: how they are compiled, run on threads and given random numbers.

A kernel works on a chunk of rays. Chunks do not depend on the number of threads and are added up in their order, and
every random number is a hash of seed, ray and purpose: results do not depend on the number of threads.
"""

import contextlib
import logging
import os
import sys
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from numba import config, njit, uint64

from roomeq.core.digests import code_digest
from roomeq.core.files import user_cache

logger = logging.getLogger(__name__)

N_CHUNKS = 8
# off by default; adds the eight bands of an echogram at once. Numba reads its variables again when one has changed
os.environ["NUMBA_SLP_VECTORIZE"] = "1"
config.SLP_VECTORIZE = 1  # type: ignore[attr-defined]

_of_thread = threading.local()  # `works` in a thread of `on_threads`
_PACKAGE = Path(__file__).resolve().parents[1]

Function = TypeVar("Function", bound=Callable[..., Any])
Result = TypeVar("Result")


@cache
def _cache_directory() -> Path | None:
    """Return the directory for the machine code of this version of the package, or None if none can be written.

    Numba finds cached code by the kernel's own file only. A change in another module that the kernel calls would be
    missed, so the directory is named by a digest of all sources and of the numerical libraries.
    """
    name = f"kernels-{code_digest()[:16]}"
    setting = os.environ.get("NUMBA_CACHE_DIR")
    for parent in [Path(setting)] if setting else [_PACKAGE / "__pycache__", user_cache()]:
        with contextlib.suppress(OSError):
            (parent / name).mkdir(parents=True, exist_ok=True)
            if os.access(parent / name, os.W_OK):
                if sys.stderr.isatty() and not any((parent / name).iterdir()):
                    logger.info("kernels are compiled at the first use of this version, for some 15 s, and kept in %s",
                                parent / name)
                return parent / name
    return None


def compiled(function: Function) -> Function:
    """Compile a kernel that releases the interpreter lock; cache the machine code on disk where possible.

    Division by zero gives infinity, as in NumPy: a check for it would keep loops from being vectorised.
    """
    directory = _cache_directory()
    before = config.CACHE_DIR  # type: ignore[attr-defined]
    config.CACHE_DIR = str(directory or "")  # type: ignore[attr-defined]
    try:
        kernel = njit(cache=directory is not None, nogil=True, error_model="numpy")(function)
    finally:
        config.CACHE_DIR = before  # type: ignore[attr-defined]
    if directory is not None:
        _tolerate_damage(cast(Any, kernel)._cache)
    return cast(Function, kernel)


def _tolerate_damage(machine_code: Any) -> None:
    """Compile again where cached machine code cannot be read, and continue without where it cannot be written."""
    load, save = machine_code.load_overload, machine_code.save_overload

    def load_or_discard(*arguments: Any) -> Any:
        try:
            return load(*arguments)
        except Exception:  # an empty or truncated file ends in any of pickle's errors
            with contextlib.suppress(OSError):
                machine_code.flush()
            return None

    def save_if_possible(*arguments: Any) -> None:
        with contextlib.suppress(OSError):
            save(*arguments)

    machine_code.load_overload, machine_code.save_overload = load_or_discard, save_if_possible


def inlined(function: Function) -> Function:
    """Compile a function that kernels call in their innermost loops: its code becomes part of theirs."""
    return cast(Function, njit(forceinline=True, nogil=True, error_model="numpy")(function))


def n_threads() -> int:
    """Return the number of threads: `NUMBA_NUM_THREADS` if set (jobs set it to 1), else one per usable core."""
    setting = os.environ.get("NUMBA_NUM_THREADS", "")
    return max(1, int(setting)) if setting.isdigit() else len(os.sched_getaffinity(0))


def for_chunks(n_rays: int, work: Callable[[int, int, int], Result]) -> list[Result]:
    """Call ``work(chunk, first, last)`` for every chunk of rays, on threads.

    Returns
    -------
    results : list
        Results of the calls, in the order of the chunks.
    """
    edges = np.linspace(0, n_rays, N_CHUNKS + 1).astype(int)
    return on_threads(work, [(chunk, int(edges[chunk]), int(edges[chunk + 1])) for chunk in range(N_CHUNKS)])


def on_threads(work: Callable[..., Result], jobs: Sequence[tuple[Any, ...]]) -> list[Result]:
    """Return ``[work(*job) for job in jobs]``, computed on threads: for work that releases the interpreter lock.

    There are `n_threads` at most, and one for each usable core. What a thread hands to this function is computed in it.
    """
    threads = min(n_threads(), len(jobs), len(os.sched_getaffinity(0)))
    if threads <= 1 or getattr(_of_thread, "works", False):
        return [work(*job) for job in jobs]
    results: list[Any] = [None] * len(jobs)
    numbers = iter(range(len(jobs)))

    def take_jobs() -> None:
        _of_thread.works = True
        try:
            for n in numbers:
                results[n] = work(*jobs[n])
        finally:
            _of_thread.works = False

    with ThreadPoolExecutor(threads - 1) as pool:  # this thread works, too: to start one takes time
        others = [pool.submit(take_jobs) for _ in range(threads - 1)]
        take_jobs()
        for other in others:
            other.result()
    return results


@compiled
def mix(value: np.uint64) -> np.uint64:
    """Hash a 64-bit number (the finaliser of SplitMix64, Steele et al., OOPSLA 2014)."""
    value = (value ^ (value >> uint64(30))) * uint64(0xBF58476D1CE4E5B9)
    value = (value ^ (value >> uint64(27))) * uint64(0x94D049BB133111EB)
    return value ^ (value >> uint64(31))


@compiled
def uniform(stream: int | np.uint64, counter: int | np.uint64) -> float:
    """Return number `counter` of a stream, uniform in [0, 1)."""
    word = mix(uint64(stream) + (uint64(counter) + uint64(1)) * uint64(0x9E3779B97F4A7C15))
    return (word >> uint64(11)) * (1.0 / 9007199254740992.0)
