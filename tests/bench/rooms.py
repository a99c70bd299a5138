"""Rooms as triangles for the benches: a box, an L, and a box full of furniture."""

import numpy as np

L_CORNERS_M = ((0.0, 0.0), (6.0, 0.0), (6.0, 3.0), (3.0, 3.0), (3.0, 6.0), (0.0, 6.0))  # counter-clockwise
L_HEIGHT_M = 3.0
FURNISHED_M = (12.0, 8.0, 4.0)


def box_triangles(dims_m, origin_m=(0.0, 0.0, 0.0)):
    """Twelve triangles of a box, normals outward, in the order of the six walls, shape (12, 3, 3)."""
    triangles = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for upper in (0, 1):
            corner = np.zeros((4, 3))
            corner[:, axis] = upper
            corner[:, u], corner[:, v] = [0, 1, 1, 0], [0, 0, 1, 1]
            if not upper:
                corner = corner[::-1]
            corner = corner * dims_m + np.asarray(origin_m)
            triangles += [corner[[0, 1, 2]], corner[[0, 2, 3]]]
    return np.array(triangles)


def l_triangles():
    """Triangles of an L-shaped prism, normals outward, and the material name of each."""
    base = np.array(L_CORNERS_M)
    triangles, names = [], []
    for n, (here, there) in enumerate(zip(base, np.roll(base, -1, axis=0), strict=True)):
        low, high = ([*here, 0.0], [*there, 0.0]), ([*here, L_HEIGHT_M], [*there, L_HEIGHT_M])
        triangles += [[low[0], low[1], high[1]], [low[0], high[1], high[0]]]
        names += [f"side{n}"] * 2
    for a, b, c in ((0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)):
        floor = [[*base[k], 0.0] for k in (c, b, a)]
        ceiling = [[*base[k], L_HEIGHT_M] for k in (a, b, c)]
        triangles += [floor, ceiling]
        names += ["floor", "ceiling"]
    return np.array(triangles), names


def furnished_triangles(n_triangles=2000, seed=3):
    """A box of `FURNISHED_M` with table tops and globes in it, about `n_triangles` in all.

    Returns
    -------
    triangles : ndarray, shape (about n_triangles, 3, 3)
    names : list of str
    """
    rng = np.random.default_rng(seed)
    triangles, names = [box_triangles(FURNISHED_M)], ["wall"] * 12
    globe = _sphere_triangles()
    n_globes = max(0, int(0.8 * (n_triangles - 12) / len(globe)))
    n_tables = max(0, (n_triangles - 12 - n_globes * len(globe)) // 12)
    columns = int(np.ceil(np.sqrt(1.5 * max(n_globes, n_tables, 1))))
    pitch = np.array([FURNISHED_M[0] / columns, FURNISHED_M[1] / columns])
    cells = rng.permutation(columns * columns)
    for cell in cells[:n_tables]:
        corner = (np.array(divmod(cell, columns)) + 0.15) * pitch
        triangles.append(box_triangles([*(0.7 * pitch), 0.05], [*corner, 0.72]))
        names += ["table"] * 12
    for cell in rng.permutation(columns * columns)[:n_globes]:
        centre = (np.array(divmod(cell, columns)) + 0.5) * pitch
        triangles.append(min(0.3, 0.3 * pitch.min()) * globe + [*centre, 2.9])
        names += ["globe"] * len(globe)
    return np.concatenate(triangles), names


def _sphere_triangles():
    """A unit sphere of 80 triangles, normals outward: an icosahedron, each face cut in four."""
    golden = 0.5 * (1.0 + np.sqrt(5.0))
    corners = np.array([(0, s, t * golden) for s in (-1, 1) for t in (-1, 1)], dtype=float)
    corners = np.concatenate([np.roll(corners, shift, axis=1) for shift in range(3)])
    distance = np.linalg.norm(corners[:, None] - corners[None], axis=2)
    close = np.isclose(distance, 2.0)
    faces = [(a, b, c) for a in range(12) for b in range(a) for c in range(b)
             if close[a, b] and close[b, c] and close[a, c]]
    triangles = []
    for face in faces:
        a, b, c = corners[list(face)]
        if np.dot(np.cross(b - a, c - a), a) < 0:
            b, c = c, b
        ab, bc, ca = a + b, b + c, c + a
        triangles += [(2 * a, ab, ca), (ab, 2 * b, bc), (ca, bc, 2 * c), (ab, bc, ca)]
    triangles = np.array(triangles)
    return triangles / np.linalg.norm(triangles, axis=2, keepdims=True)
