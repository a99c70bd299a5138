"""Compiled kernels: one place for how they are compiled, run on threads and given random numbers.

A kernel works on a chunk of rays. Chunks are the same whatever the number of threads and are added up in their
own order, and every random number is a hash of seed, ray and purpose: results don't depend on the threads.
"""

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numba import config, njit, uint64

N_CHUNKS = 8
config.SLP_VECTORIZE = 1  # off by default; it lets the eight bands of an echogram be added at once


# dividing by zero gives infinity as in numpy: a check for it would keep loops from being vectorised
_HOW = dict(nogil=True, error_model="numpy")


def compiled(function):
    """Compile a kernel that holds no lock of the interpreter; keep the result on disk where that is possible."""
    try:
        return njit(cache=True, **_HOW)(function)
    except RuntimeError:  # neither the package nor the home directory can be written
        return njit(**_HOW)(function)


def n_threads():
    """Threads to use: `NUMBA_NUM_THREADS` if set (jobs set it to 1), else one per usable core."""
    chosen = os.environ.get("NUMBA_NUM_THREADS", "")
    return max(1, int(chosen)) if chosen.isdigit() else len(os.sched_getaffinity(0))


def for_chunks(n_rays, work):
    """Call ``work(chunk, first, last)`` for every chunk of rays, on threads.

    Returns
    -------
    list
        What the calls returned, in the order of the chunks.
    """
    edges = np.linspace(0, n_rays, N_CHUNKS + 1).astype(int)
    return on_threads(work, [(chunk, int(edges[chunk]), int(edges[chunk + 1])) for chunk in range(N_CHUNKS)])


def on_threads(work, jobs):
    """Return ``[work(*job) for job in jobs]``, done on threads: for work that lets go of the interpreter."""
    threads = min(n_threads(), len(jobs))
    if threads <= 1:
        return [work(*job) for job in jobs]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(lambda job: work(*job), jobs))


@compiled
def mix(value):
    """Hash a 64-bit number (the finaliser of SplitMix64, Steele et al., OOPSLA 2014)."""
    value = (value ^ (value >> uint64(30))) * uint64(0xBF58476D1CE4E5B9)
    value = (value ^ (value >> uint64(27))) * uint64(0x94D049BB133111EB)
    return value ^ (value >> uint64(31))


@compiled
def uniform(stream, counter):
    """Return number `counter` of a stream, uniform in [0, 1)."""
    word = mix(uint64(stream) + (uint64(counter) + uint64(1)) * uint64(0x9E3779B97F4A7C15))
    return (word >> uint64(11)) * (1.0 / 9007199254740992.0)
