"""How far the ray queries are from embree's own rate on this machine."""

import time

import numpy as np

from bench import ours
from bench.kit import Check, Section
from bench.rooms import FURNISHED_M
from bench.speed.single import SOURCE, scenes


def run(quick):
    """Closest hits a second of bare embree, and of the simulator while it traces."""
    n_rays = 200_000 if quick else 1_000_000
    rows, checks = [], []
    for name, scene in scenes().items():
        if "mesh" not in name:
            continue
        source = (5.2, 1.1, 1.4) if name.startswith("L") else SOURCE
        bare = _bare_rate(scene.room, source, n_rays)
        seconds, in_queries, queries, reflections = ours.traced_with_clock(scene, source)
        share = in_queries / seconds
        rows.append([name, 1e-6 * bare, 1e-6 * reflections / seconds, 100.0 * share,
                     1e-6 * queries / in_queries if in_queries > 0 else None])
        if name == "furnished mesh":
            checks = [Check("furnished mesh: reflections a second over embree's hits", reflections / seconds / bare),
                      Check("furnished mesh: share of the trace in ray queries", 100.0 * share, unit="%")]
    return Section("queries", "Ray queries against embree's own rate",
                   ["mesh", "embree, million/s", "trace, million reflections/s", "in queries, %",
                    "million/s in queries"], rows, checks,
                   ["embree: closest hits of scattered rays, arrays ready, one call on one thread; a convex room of "
                    "few planes asks no queries"])


def _bare_rate(room, source, n_rays):
    """Closest hits a second of `n_rays` incoherent rays, best of three."""
    rng = np.random.default_rng(0)
    low, high = room.bounds_m
    origins = (np.asarray(source) + rng.uniform(-0.3, 0.3, (n_rays, 3))).astype(np.float32)
    directions = rng.standard_normal((n_rays, 3))
    directions = (directions / np.linalg.norm(directions, axis=1)[:, None]).astype(np.float32)
    query = ours.embree_of(room)
    origins += (0.9 * rng.random((n_rays, 1)) * np.minimum(1.0, (high - low).min() / FURNISHED_M[0])).astype(
        np.float32) * directions
    times = []
    for _ in range(3):
        start = time.perf_counter()
        query.run(origins, directions, output=True)
        times.append(time.perf_counter() - start)
    return n_rays / min(times)
