"""Traces in a file: the same paths, and nothing is left of it."""

import gc
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import roomeq
from roomeq.core.workers import share_out
from roomeq.loop.traces import TraceFile
from roomeq.sim.path_sample import sample_paths
from roomeq.sim.response import trace_source
from roomeq.sim.scene import Material, Scene, Shoebox


def trace():
    scene = Scene(Shoebox((5.0, 4.0, 3.0)), [Material("wall", (0.2,) * 8, (0.3,) * 8)] * 6)
    return trace_source(scene, (1.0, 1.5, 1.2), num_rays=200, max_length_s=0.2, rng=np.random.default_rng(0))


def test_stored_trace_loads_the_same_rays_without_their_paths():
    traced = trace()
    stored = TraceFile().store(traced)
    (before,), (bare,), (after,) = traced.paths, stored.bare.paths, stored.load().paths
    np.testing.assert_array_equal(after.directions, before.directions)
    assert after.directions.dtype == before.directions.dtype
    assert type(after.directions) is np.ndarray and after.directions.flags.writeable  # kernels are compiled for these
    assert not any(len(getattr(bare, name)) for name in ("directions", "hits", "codes", "first", "counts"))


def test_change_of_a_loaded_ray_is_not_stored():
    stored = TraceFile().store(trace())
    stored.load().paths[0].directions[:] = 0.0
    assert stored.load().paths[0].directions.any()


def test_file_is_closed_with_its_last_trace():
    stored = TraceFile().store(trace())
    descriptor = stored.file._file.fileno()
    os.fstat(descriptor)
    del stored
    gc.collect()
    with pytest.raises(OSError):
        os.fstat(descriptor)


def test_forked_process_cannot_store():
    file, traced = TraceFile(), trace()
    with pytest.raises(RuntimeError, match="stores in the file of another"):
        share_out(lambda _: file.store(traced), range(2), 2, first_here=False, label="store")


def test_stored_sample_loads_the_same_paths():
    traced, mics_m = trace(), np.array([[3.0, 2.0, 1.2], [3.0, 2.01, 1.2], [4.0, 3.0, 1.2]])
    samples = sample_paths(traced, mics_m, np.full((6, 8), 0.2), [np.random.default_rng(n) for n in range(3)],
                           ism_order=2, n_frames=200)
    stored = TraceFile().store_samples(samples)
    assert stored[0] is stored[1] and stored[1] is not stored[2]  # as the samples of close microphones
    for sample, of_mic in zip(samples, stored, strict=True):
        for name, value in vars(of_mic.load()).items():
            np.testing.assert_array_equal(value, getattr(sample, name))


def test_full_disk_of_temporary_files_is_named():
    traced, before = trace(), resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (3000, before[1]))
    try:
        with pytest.raises(ValueError, match="/.*: File too large: free some space there, or name another folder for "
                                             "temporary files in TMPDIR"):
            TraceFile().store(traced)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_nothing_is_left_where_the_process_is_killed(tmp_path):
    script = ("import os, signal; from test_traces import trace; from roomeq.loop.traces import TraceFile; "
              "stored = TraceFile().store(trace()); assert stored.load().paths[0].directions.any(); "
              "os.kill(os.getpid(), signal.SIGKILL)")
    paths = os.pathsep.join(map(str, (Path(__file__).parent, Path(roomeq.__file__).parents[1])))
    done = subprocess.run([sys.executable, "-c", script], env=os.environ | dict(TMPDIR=str(tmp_path), PYTHONPATH=paths))
    assert done.returncode == -signal.SIGKILL and not list(tmp_path.iterdir())
