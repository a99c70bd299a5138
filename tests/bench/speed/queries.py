"""How far the ray queries are from embree's rate on this machine."""

import os
import time

import numpy as np

from bench import ours
from bench.kit import Check, Section
from bench.rooms import FURNISHED_M, furnished_triangles
from bench.speed.single import ABSORPTION, SCATTERING, SOURCE, scenes
from bench.speed.timing import repeated

ABSENT = "embreex is not installed (tests/run.sh --install-only): its columns are empty"


def run(quick):
    """Closest hits a second of embree and of the simulator, and reflections a second of a trace."""
    n_rays, rows, checks = 200_000 if quick else 1_000_000, [], []
    large = ours.mesh_scene(*furnished_triangles(20_000), ABSORPTION, SCATTERING, ours.real_air())
    for name, scene in (scenes() | {"furnished mesh, 20,000 triangles": large}).items():
        if "mesh" not in name:
            continue
        source = (5.2, 1.1, 1.4) if name.startswith("L") else SOURCE
        rays = _scattered_rays(scene.room, source, n_rays)
        threads = os.environ["NUMBA_NUM_THREADS"]
        os.environ["NUMBA_NUM_THREADS"] = "1"
        own = n_rays / _best(lambda: ours.closest_hits(scene.room, *rays))  # noqa: B023
        os.environ["NUMBA_NUM_THREADS"] = threads
        bare = _embree_rate(scene.room, *rays)
        seconds, _, _ = repeated(lambda n: ours.traced(scene, source, seed=n), 3)  # noqa: B023
        reflections = ours.reflections(ours.traced(scene, source, seed=1))
        rows.append([name, None if bare is None else 1e-6 * bare, 1e-6 * own, 1e-6 * reflections / seconds])
        if bare is not None and name.startswith("furnished"):
            checks.append(Check(f"{name}: closest hits a second over embree's", own / bare))
    notes = ["closest hits of scattered rays, arrays ready, one call on one thread; the trace has two threads, and a "
             "convex room of few planes asks no queries"]
    columns = ["mesh", "embree, million/s", "closest hits, million/s", "trace, million reflections/s"]
    return Section("queries", "Ray queries against embree's rate", columns, rows, checks,
                   notes if rows[0][1] else [*notes, ABSENT])


def _scattered_rays(room, source, n_rays):
    """Origins and directions of incoherent rays around a source, shape (n_rays, 3) each."""
    rng = np.random.default_rng(0)
    low, high = room.bounds_m
    origins = np.asarray(source) + rng.uniform(-0.3, 0.3, (n_rays, 3))
    directions = rng.standard_normal((n_rays, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    origins += 0.9 * rng.random((n_rays, 1)) * np.minimum(1.0, (high - low).min() / FURNISHED_M[0]) * directions
    return origins, directions


def _best(work):
    """Seconds of the fastest of three calls."""
    times = []
    for _ in range(3):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def _embree_rate(room, origins, directions):
    """Closest hits a second, or None where embreex isn't installed."""
    try:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene
    except ImportError:
        return None
    scene = EmbreeScene()
    TriangleMesh(scene, np.ascontiguousarray(room.triangles, dtype=np.float32))
    origins, directions = origins.astype(np.float32), directions.astype(np.float32)
    return len(origins) / _best(lambda: scene.run(origins, directions, output=True))
