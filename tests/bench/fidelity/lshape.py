"""Specular paths in an L-shaped room: those that exist, and none that doesn't.

An L-shaped prism can be done by hand. Seen from above, a path is a chain of reflections at the six sides (all
sequences are tried, the image source is traced back, and every leg must stay inside the L); its height is that of a
source between two parallel mirrors, where all images are seen. Any chain goes with any image of the height.
"""

import numpy as np

from bench import ours
from bench.fidelity.reference import SPEED_M_S
from bench.kit import Check, Section
from bench.rooms import L_CORNERS_M, L_HEIGHT_M

ORDER = 3
SOURCE = (5.213, 1.127, 1.431)
MICS = {"hidden": (1.219, 5.143, 1.637), "seen": (1.127, 1.913, 1.219), "same leg": (3.911, 2.231, 0.913)}
_EPSILON = 1e-9


def run(quick):
    """The simulator's list against the one found by hand, source and microphone in and out of sight."""
    rows, missing, extra, shifts = [], 0, 0, []
    for name, mic in MICS.items():
        expected = hand_lengths(SOURCE, mic, ORDER)
        found = ours.l_room_lengths(SOURCE, mic, ORDER)
        absent, surplus, shift = _match(expected, found)
        rows.append([name, len(expected), len(found), absent, surplus,
                     "yes" if np.linalg.norm(np.subtract(SOURCE, mic)) > expected[0] - 1e-6 else "no", shift])
        missing, extra = missing + absent, extra + surplus
        shifts.append(shift)
    checks = [Check("paths that exist and were not found", missing, high=0),
              Check("paths found that do not exist", extra, high=0),
              Check("arrival, worst path", float(np.max(shifts)), high=0.1, unit="samples")]
    return Section("lshape", f"Specular paths up to order {ORDER} in an L-shaped room",
                   ["microphone", "by hand", "found", "missing", "too many", "direct", "arrival, samples"],
                   rows, checks)


def hand_lengths(source, mic, order):
    """Lengths of all specular paths up to an order, sorted [m]."""
    lengths = []
    for walls, ground in _chains(np.array(source[:2]), np.array(mic[:2]), order):
        for k in range(-(order - walls), order - walls + 1):
            height = k * L_HEIGHT_M + (source[2] if k % 2 == 0 else L_HEIGHT_M - source[2]) - mic[2]
            lengths.append(np.hypot(ground, height))
    return np.sort(lengths)


def _chains(source, mic, order):
    """All valid chains seen from above: (number of reflections, length)."""
    corners = np.array(L_CORNERS_M)
    sides = list(zip(corners, np.roll(corners, -1, axis=0), strict=True))
    open_chains = [((), source)]
    for _ in range(order + 1):
        following = []
        for chain, image in open_chains:
            if _valid(chain, source, mic, sides):
                yield len(chain), float(np.linalg.norm(image - mic))
            following += [((*chain, n), _mirror(image, *side)) for n, side in enumerate(sides)
                          if not chain or chain[-1] != n]
        open_chains = following


def _mirror(point, start, end):
    along = (end - start) / np.linalg.norm(end - start)
    return start + 2.0 * np.dot(point - start, along) * along - (point - start)


def _valid(chain, source, mic, sides):
    images = [source]
    for n in chain:
        images.append(_mirror(images[-1], *sides[n]))
    here = mic
    for k in range(len(chain) - 1, -1, -1):
        point = _crossing(here, images[k + 1], *sides[chain[k]])
        if point is None or not _inside(here, point, sides):
            return False
        here = point
    return _inside(here, source, sides)


def _crossing(start, end, low, high):
    """Where the way from `start` to `end` crosses a side, or None."""
    way, side = end - start, high - low
    across = way[0] * side[1] - way[1] * side[0]
    if abs(across) < _EPSILON:
        return None
    gap = low - start
    along, beside = (gap[0] * side[1] - gap[1] * side[0]) / across, (gap[0] * way[1] - gap[1] * way[0]) / across
    return start + along * way if _EPSILON < along < 1.0 - _EPSILON and 0.0 <= beside <= 1.0 else None


def _inside(start, end, sides):
    """No side is crossed between two points (that may lie on sides), and what is between lies in the L."""
    way = end - start
    inner = (start + 1e-6 * way, end - 1e-6 * way)
    if any(_crossing(*inner, *side) is not None for side in sides):
        return False
    x, y = 0.5 * (start + end)
    arm = L_CORNERS_M[3]
    return 0.0 <= x <= L_CORNERS_M[1][0] and 0.0 <= y <= L_CORNERS_M[4][1] and (x <= arm[0] or y <= arm[1])


def _match(expected, found):
    """How many are missing, how many too many, and the largest difference of the others [samples]."""
    tolerance_m = 0.01
    used = np.zeros(len(found), dtype=bool)
    shift_m, absent = 0.0, 0
    for length in expected:
        gap = np.where(used, np.inf, np.abs(found - length))
        nearest = int(np.argmin(gap)) if len(found) else -1
        if nearest < 0 or gap[nearest] > tolerance_m:
            absent += 1
            continue
        used[nearest] = True
        shift_m = max(shift_m, float(gap[nearest]))
    return absent, int((~used).sum()), shift_m / SPEED_M_S * ours.FS_HZ
