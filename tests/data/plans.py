"""Rooms with a polygon for a plan, as OBJ texts."""

from itertools import pairwise


def prism_obj(plan, height_m, material="wall"):
    """OBJ of a room with a polygon for a plan (counter-clockwise); floor and ceiling are one polygon each."""
    n = len(plan)
    lines = [f"v {x} {y} {z}" for z in (0.0, height_m) for x, y in plan]
    lines += ["usemtl floor", "f " + " ".join(str(k) for k in range(n, 0, -1))]
    lines += ["usemtl ceiling", "f " + " ".join(str(k) for k in range(n + 1, 2 * n + 1)), f"usemtl {material}"]
    for a, b in pairwise([*range(1, n + 1), 1]):
        lines.append(f"f {a} {b} {b + n} {a + n}")
    return "\n".join(lines) + "\n"


def box_plan(length_m, width_m, x=0.0, y=0.0):
    return [(x, y), (x + length_m, y), (x + length_m, y + width_m), (x, y + width_m)]


L_PLAN = [(0, 0), (6, 0), (6, 2), (2, 2), (2, 6), (0, 6)]
