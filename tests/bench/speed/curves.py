"""How the cost grows: with rays, with triangles, with responses."""

import numpy as np

from bench import ours
from bench.kit import Check, Section
from bench.rooms import FURNISHED_M, furnished_triangles
from bench.speed.single import ABSORPTION, SCATTERING, SOURCE, microphones
from bench.speed.timing import repeated


def run(quick):
    """Time over rays (linear) and over triangles (logarithmic)."""
    repeats = 1 if quick else 3
    rows, curves = [], {}
    air = ours.real_air()
    box = ours.box_scene(FURNISHED_M, ABSORPTION, SCATTERING, air)
    for count in (5_000, 20_000, 80_000) if quick else (2_500, 5_000, 10_000, 20_000, 40_000, 80_000, 160_000):
        median, spread, _ = repeated(
            lambda n, count=count: ours.simulate(box, SOURCE, microphones()[:1], n_rays=count, seed=n), repeats)
        rows.append(["shoebox", "rays", count, median, spread])
        curves.setdefault("rays", []).append([count, median])
    for count in (200, 2_000) if quick else (200, 500, 2_000, 8_000, 32_000):
        triangles, names = furnished_triangles(count)
        scene = ours.mesh_scene(triangles, names, ABSORPTION, SCATTERING, air)
        median, spread, _ = repeated(
            lambda n, scene=scene: ours.traced(scene, SOURCE, seed=n), repeats)
        rows.append(["furnished mesh, trace only", "triangles", len(triangles), median, spread])
        curves.setdefault("triangles", []).append([len(triangles), median])
    checks = [Check("rays: exponent of the cost", exponent(curves["rays"][-3:]), high=1.1),
              Check("triangles: exponent of the cost", exponent(curves["triangles"]), high=0.5)]
    return Section("curves", "How the cost grows", ["what", "over", "count", "median s", "+- s"], rows, checks,
                   ["exponent: slope in log-log, 1 is linear; over triangles the closest-hit search is logarithmic, "
                    "but more furniture also means shorter paths between reflections"], curves)


def exponent(points):
    """Slope of the cost in log-log."""
    count, seconds = np.array(points, dtype=float).T
    return float(np.polyfit(np.log(count), np.log(seconds), 1)[0])


def draw(axis, section):
    """Both curves."""
    for name, points in section.curves.items():
        count, seconds = np.array(points, dtype=float).T
        axis.loglog(count, seconds, "o-", label=f"over {name}")
    axis.set(title="curves: cost", xlabel="rays, triangles", ylabel="s")
    axis.legend()
