"""Compiled kernels: how they are compiled, run on threads and given random numbers.

A kernel works on a chunk of rays. Chunks do not depend on the number of threads and are added up in their order, and
every random number is a hash of seed, ray and purpose: results do not depend on the number of threads.
"""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar, cast

import numpy as np
from numba import config, njit, uint64

N_CHUNKS = 8
config.SLP_VECTORIZE = 1  # type: ignore[attr-defined]  # off by default; adds the eight bands of an echogram at once

Function = TypeVar("Function", bound=Callable[..., Any])
Result = TypeVar("Result")


def compiled(function: Function) -> Function:
    """Compile a kernel that releases the interpreter lock; cache the machine code on disk where possible.

    Division by zero gives infinity, as in NumPy: a check for it would keep loops from being vectorised.
    """
    try:
        return cast(Function, njit(cache=True, nogil=True, error_model="numpy")(function))
    except RuntimeError:  # neither the package nor the home directory can be written
        return cast(Function, njit(nogil=True, error_model="numpy")(function))


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
    """Return ``[work(*job) for job in jobs]``, computed on threads: for work that releases the interpreter lock."""
    threads = min(n_threads(), len(jobs))
    if threads <= 1:
        return [work(*job) for job in jobs]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(lambda job: work(*job), jobs))


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
