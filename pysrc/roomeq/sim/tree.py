"""A tree of boxes around the faces of a mesh, which rays search for what they hit.

Each node has eight children, whose boxes are tested at once (Wald, Benthin and Boulos, IEEE Symp. on Interactive Ray
Tracing 2008, 49). It is divided where the expected cost of a search is least: the surface area heuristic, with binned
centroids (Wald, IEEE Symp. on Interactive Ray Tracing 2007, 33). Boxes are searched in single precision and stand wider
than its rounding; faces are intersected in double precision.

A line that begins in the air leaves it first through the front of a face. Where only fronts count, a ray can start
exactly on the face that it left. Faces overlap by `EDGE_M`, so that no ray passes between them.
"""

from typing import NamedTuple

import numpy as np

from roomeq.core.arrays import Array, BoolArray, FloatArray, IntArray, Number, Numbers
from roomeq.core.jit import compiled, for_chunks, inlined
from roomeq.sim.lanes import WIDTH, lowest, meet_boxes, meet_faces

_BINS = 16
_CACHE_LINE = 64  # bytes
EDGE_M = 1e-6  # by which faces overlap, so that no ray passes between two of them
_TOUCH_M = 1e-4  # from its end, where a line may touch a face
_WIDER = 2e-6  # by which boxes are wider, of the largest coordinate: single precision rounds to a thirtieth of that
_FLAT_M = 1e-9  # by which the corners of a quadrangle may differ from one plane
BEHIND_M = 1e-9  # by which rounding may put a ray behind a face
FRONTS = 1e-12
"""Least approach of a ray to a face that it meets: only its front counts."""
BOTH_SIDES = -np.inf
"""The same where the back of a face counts, too."""


class Tree(NamedTuple):
    """Boxes and faces, for kernels.

    Attributes
    ----------
    bounds
        Of the children of each node: low and high x, low and high y, low and high z [m], shape (n_nodes, 6, 8),
        float32. A child that does not exist has a box that nothing hits.
    children
        Number of the node, or -1 less that of the leaf, shape (n_nodes, 8).
    planes
        Of the triangles and quadrangles of each leaf: normal and offset of the plane, then of the planes through four
        edges, which it is in front of, shape (n_leaves, 20, 8). A triangle has its third edge twice.
    faces
        Number of the face, of a quadrangle that of one of its triangles, -1 where there is none, shape (n_leaves, 8).
    n_waiting
        Most children that wait in a search.
    """

    bounds: Array
    children: Array
    planes: Array
    faces: Array
    n_waiting: int


def make_tree(triangles: FloatArray, normals: FloatArray, face_surface: IntArray) -> Tree:
    """Build the tree of a closed mesh.

    Parameters
    ----------
    triangles : ndarray, shape (n_faces, 3, 3)
    normals : ndarray, shape (n_faces, 3)
        Unit vectors into the air, opposite to those of the right-hand rule.
    face_surface : ndarray, shape (n_faces,)
        Triangles of a surface are joined to quadrangles where they lie in one plane.
    """
    offsets = np.einsum("ij,ij->i", normals, triangles[:, 0])
    ahead = np.roll(triangles, -1, axis=1) - triangles
    inward = np.cross(ahead, normals[:, None])
    inward /= np.linalg.norm(inward, axis=2)[:, :, None]
    edges = np.concatenate([inward, np.einsum("nij,nij->ni", inward, triangles)[:, :, None] - EDGE_M], axis=2)
    first, second, edge_of_first, edge_of_second = find_quadrangles(triangles, normals, offsets, face_surface)
    four = edges[:, [0, 1, 2, 2]]
    for n in (1, 2):
        four[first, n - 1] = edges[first, (edge_of_first + n) % 3]
        four[first, n + 1] = edges[second, (edge_of_second + n) % 3]
    low, high = triangles.min(axis=1), triangles.max(axis=1)
    low[first], high[first] = np.minimum(low[first], low[second]), np.maximum(high[first], high[second])
    kept = np.delete(np.arange(len(triangles)), second)
    bounds = np.empty((len(kept), 6, WIDTH), np.float32)
    children = np.empty((len(kept), WIDTH), np.int32)
    faces = np.full((len(kept), WIDTH), -1, np.int32)
    wider_m = EDGE_M + _WIDER * np.abs(triangles).max()
    n_nodes, n_leaves, depth = _divide(low, high, kept, wider_m, bounds, children, faces)
    planes = np.concatenate([normals, offsets[:, None], four.reshape(-1, 16)], axis=1)
    faces = faces[:n_leaves].copy()
    of_leaves = np.where((faces >= 0)[:, :, None], planes[faces], 0.0).transpose(0, 2, 1)
    return Tree(_aligned(bounds[:n_nodes]), children[:n_nodes].copy(), _aligned(of_leaves), faces,
                (WIDTH - 1) * depth + 1)


def _aligned(values: Array) -> Array:
    """Return a copy whose rows of eight numbers each lie in one line of the processor's cache, which is faster."""
    memory = np.empty(values.nbytes + _CACHE_LINE, np.uint8)
    start = -memory.ctypes.data % _CACHE_LINE
    copy = memory[start:start + values.nbytes].view(values.dtype).reshape(values.shape)
    copy[...] = values
    return copy


def find_quadrangles(triangles: FloatArray, normals: FloatArray, offsets: FloatArray,
                     face_surface: IntArray) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """Return pairs of triangles that are a convex quadrangle of one surface, and the edge of each that they share."""
    _, corner = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    corner = np.ravel(corner).reshape(-1, 3)
    ends = np.sort(np.stack([corner, np.roll(corner, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    order = np.lexsort(ends.T)
    adjacent = np.flatnonzero(np.all(ends[order[1:]] == ends[order[:-1]], axis=1))
    (first, edge_of_first), (second, edge_of_second) = (np.divmod(order[adjacent + n], 3) for n in (0, 1))
    a, b, c = (triangles[first, (edge_of_first + n) % 3] for n in (2, 0, 1))
    d = triangles[second, (edge_of_second + 2) % 3]  # a, b, d, c is the way around
    normal = normals[first]
    flat = np.abs(np.einsum("ij,ij->i", d, normal) - offsets[first]) < _FLAT_M
    same = (face_surface[first] == face_surface[second]) & (np.einsum("ij,ij->i", normal, normals[second]) > 0.0)
    turns = [np.einsum("ij,ij->i", np.cross(y - x, z - y), normal) for x, y, z in ((a, b, d), (d, c, a))]
    chosen = np.flatnonzero(flat & same & (turns[0] < 0.0) & (turns[1] < 0.0))
    free, pairs = np.ones(len(triangles), np.bool_), []
    for n in chosen:
        if free[first[n]] and free[second[n]]:
            free[first[n]] = free[second[n]] = False
            pairs.append(n)
    index = np.array(pairs, dtype=np.int64)
    return first[index], second[index], edge_of_first[index], edge_of_second[index]


@inlined
def _half_area(low: Array, high: Array) -> Number:
    x, y, z = high[0] - low[0], high[1] - low[1], high[2] - low[2]
    return x * y + y * z + z * x


@inlined
def _include(low: Array, high: Array, other_low: Array, other_high: Array) -> None:
    for axis in range(3):
        low[axis], high[axis] = min(low[axis], other_low[axis]), max(high[axis], other_high[axis])


@compiled
def _split(low: Array, high: Array, order: Array, start: Number, stop: Number) -> int:
    """Sort the triangles `start` to `stop` of an order into two parts; return where the second starts."""
    least, most = np.full(3, np.inf), np.full(3, -np.inf)
    for n in range(start, stop):
        for axis in range(3):
            twice = low[order[n], axis] + high[order[n], axis]
            least[axis], most[axis] = min(least[axis], twice), max(most[axis], twice)
    best_cost, best_axis, best_edge = np.inf, -1, 0
    counts, after = np.empty(_BINS, np.int64), np.empty(_BINS)
    lows, highs, box_low, box_high = np.empty((_BINS, 3)), np.empty((_BINS, 3)), np.empty(3), np.empty(3)
    for axis in range(3):
        if not most[axis] > least[axis]:
            continue
        per_bin = _BINS * (1.0 - 1e-9) / (most[axis] - least[axis])
        counts[:], lows[:], highs[:] = 0, np.inf, -np.inf
        for n in range(start, stop):
            place = int((low[order[n], axis] + high[order[n], axis] - least[axis]) * per_bin)
            counts[place] += 1
            _include(lows[place], highs[place], low[order[n]], high[order[n]])
        box_low[:], box_high[:], n_after = np.inf, -np.inf, 0
        for place in range(_BINS - 1, 0, -1):
            _include(box_low, box_high, lows[place], highs[place])
            n_after += counts[place]
            after[place] = n_after * _half_area(box_low, box_high) if n_after else 0.0
        box_low[:], box_high[:], n_before = np.inf, -np.inf, 0
        for edge in range(1, _BINS):
            _include(box_low, box_high, lows[edge - 1], highs[edge - 1])
            n_before += counts[edge - 1]
            cost = (n_before * _half_area(box_low, box_high) if n_before else 0.0) + after[edge]
            if 0 < n_before < stop - start and cost < best_cost:
                best_cost, best_axis, best_edge = cost, axis, edge
    if best_axis < 0:  # all in one place
        return (start + stop) // 2
    per_bin = _BINS * (1.0 - 1e-9) / (most[best_axis] - least[best_axis])
    first = start
    for n in range(start, stop):
        triangle = order[n]
        if int((low[triangle, best_axis] + high[triangle, best_axis] - least[best_axis]) * per_bin) < best_edge:
            order[n], order[first] = order[first], triangle
            first += 1
    return first


@compiled
def _box(low: Array, high: Array, order: Array, start: Number, stop: Number, box_low: Array, box_high: Array) -> None:
    box_low[:], box_high[:] = np.inf, -np.inf
    for n in range(start, stop):
        _include(box_low, box_high, low[order[n]], high[order[n]])


@compiled
def _divide(low: Array, high: Array, order: Array, wider_m: Number, bounds: Array, children: Array,
            faces: Array) -> Numbers:
    """Fill the arrays of a tree; return how many nodes and leaves there are, and how many levels of nodes."""
    n_nodes, n_leaves, depth, top = 1, 0, 1, 1
    waiting = np.empty((len(order) + 1, 4), np.int64)  # node, its first triangle, that after its last, and its level
    waiting[0, 0], waiting[0, 1], waiting[0, 2], waiting[0, 3] = 0, 0, len(order), 1
    starts, stops, area = np.empty(WIDTH, np.int64), np.empty(WIDTH, np.int64), np.empty(WIDTH)
    box_low, box_high = np.empty(3), np.empty(3)
    while top > 0:
        top -= 1
        node, starts[0], stops[0], level = waiting[top, 0], waiting[top, 1], waiting[top, 2], waiting[top, 3]
        count, area[0], depth = 1, np.inf, max(depth, level)
        while count < WIDTH:
            largest = -1
            for n in range(count):
                if stops[n] - starts[n] > WIDTH and (largest < 0 or area[n] > area[largest]):
                    largest = n
            if largest < 0:
                break
            middle = _split(low, high, order, starts[largest], stops[largest])
            starts[count], stops[count], stops[largest] = middle, stops[largest], middle
            for n in (largest, count):
                _box(low, high, order, starts[n], stops[n], box_low, box_high)
                area[n] = _half_area(box_low, box_high)
            count += 1
        for n in range(WIDTH):
            if n >= count:
                children[node, n] = 0
                for axis in range(3):
                    bounds[node, 2 * axis, n], bounds[node, 2 * axis + 1, n] = np.inf, -np.inf
                continue
            _box(low, high, order, starts[n], stops[n], box_low, box_high)
            for axis in range(3):
                bounds[node, 2 * axis, n] = box_low[axis] - wider_m
                bounds[node, 2 * axis + 1, n] = box_high[axis] + wider_m
            if stops[n] - starts[n] <= WIDTH:
                for k in range(starts[n], stops[n]):
                    faces[n_leaves, k - starts[n]] = order[k]
                children[node, n] = -1 - n_leaves
                n_leaves += 1
            else:
                waiting[top, 0], waiting[top, 1] = n_nodes, starts[n]
                waiting[top, 2], waiting[top, 3] = stops[n], level + 1
                children[node, n] = n_nodes
                n_nodes, top = n_nodes + 1, top + 1
    return n_nodes, n_leaves, depth


class Search(NamedTuple):
    """Memory of a search: children that wait, how far they are [m], and results for eight boxes or triangles."""

    waiting: Array
    distance: Array
    near: Array
    reach: Array


@inlined
def memory(tree: Tree) -> Search:
    """Allocate the memory of searches, one for each thread."""
    return Search(np.empty(tree.n_waiting, np.int32), np.empty(tree.n_waiting, np.float32), np.empty(WIDTH, np.float32),
                  np.empty(WIDTH))


@inlined
def _per_m(component: Number) -> Number:
    """Return the inverse of a component of a direction, in single precision and without infinity."""
    return np.float32(1.0 / component if abs(component) > 1e-20 else (1e20 if component >= 0.0 else -1e20))


@inlined
def first_hit(tree: Tree, search: Search, origin: Numbers, way: Numbers, least_approach: Number) -> Numbers:
    """Return the first face that a ray from a point in a direction meets, -1 for none, and how far it is [m].

    `least_approach` is `FRONTS` or `BOTH_SIDES`.
    """
    face, nearest, most = -1, np.inf, np.float32(np.inf)
    sides, start, per_m = _prepare(origin, way)
    search.waiting[0], search.distance[0], top = 0, np.float32(0.0), 1
    while top > 0:
        top -= 1
        child = search.waiting[top]
        if search.distance[top] > most:
            continue
        if child < 0:
            met = meet_faces(tree.planes[-1 - child], origin, way, least_approach, BEHIND_M, search.reach)
            while met:
                n = lowest(met)
                met &= met - 1
                if search.reach[n] < nearest:
                    face, nearest = tree.faces[-1 - child, n], search.reach[n]
                    most = np.float32(nearest * (1.0 + 1e-6) + 1e-6)
            continue
        met = meet_boxes(tree.bounds[child], sides, start, per_m, most, search.near)
        bottom = top
        while met:
            n = lowest(met)
            met &= met - 1
            near, place = search.near[n], top
            while place > bottom and search.distance[place - 1] < near:
                search.distance[place], search.waiting[place] = search.distance[place - 1], search.waiting[place - 1]
                place -= 1
            search.distance[place], search.waiting[place] = near, tree.children[child, n]
            top += 1
    return face, max(nearest, 0.0)


@inlined
def crosses(tree: Tree, search: Search, origin: Numbers, way: Numbers) -> bool:
    """Tell whether the line from a point over a vector meets a face, except within `_TOUCH_M` of its end."""
    most = 1.0 - _TOUCH_M / np.sqrt(way[0] * way[0] + way[1] * way[1] + way[2] * way[2])
    sides, start, per_m = _prepare(origin, way)
    search.waiting[0], top = 0, 1
    while top > 0:
        top -= 1
        child = search.waiting[top]
        if child < 0:
            met = meet_faces(tree.planes[-1 - child], origin, way, FRONTS, 0.0, search.reach)
            while met:
                if search.reach[lowest(met)] < most:
                    return True
                met &= met - 1
            continue
        met = meet_boxes(tree.bounds[child], sides, start, per_m, np.float32(1.0), search.near)
        while met:
            search.waiting[top] = tree.children[child, lowest(met)]
            met &= met - 1
            top += 1
    return False


@inlined
def _prepare(origin: Numbers, way: Numbers) -> Numbers:
    """Return what `meet_boxes` needs of a ray."""
    return ((0 if way[0] >= 0.0 else 1, 0 if way[1] >= 0.0 else 1, 0 if way[2] >= 0.0 else 1),
            (np.float32(origin[0]), np.float32(origin[1]), np.float32(origin[2])),
            (_per_m(way[0]), _per_m(way[1]), _per_m(way[2])))


def first_hits(tree: Tree, origins: FloatArray, directions: FloatArray) -> tuple[Array, FloatArray]:
    """Return the first face that each ray meets on either side, -1 for none, and the distance to it [m]."""
    faces, distances = np.empty(len(origins), np.int64), np.empty(len(origins))
    for_chunks(len(origins), lambda chunk, low, high: _first_hits(
        tree, origins[low:high], directions[low:high], faces[low:high], distances[low:high]))
    return faces, distances


def sees(tree: Tree, from_m: FloatArray, to_m: FloatArray) -> BoolArray:
    """Return whether each line from one point in the air to another, or on a face, is unobstructed, shape (n,)."""
    result = np.empty(len(from_m), np.bool_)
    for_chunks(len(from_m), lambda chunk, low, high: _sees(tree, from_m[low:high], to_m[low:high], result[low:high]))
    return result


@compiled
def _first_hits(tree: Tree, origins: Array, directions: Array, faces: Array, distances: Array) -> None:
    search = memory(tree)
    for n in range(len(origins)):
        faces[n], distances[n] = first_hit(tree, search, (origins[n, 0], origins[n, 1], origins[n, 2]),
                                           (directions[n, 0], directions[n, 1], directions[n, 2]), BOTH_SIDES)


@compiled
def _sees(tree: Tree, from_m: Array, to_m: Array, result: Array) -> None:
    search = memory(tree)
    for n in range(len(from_m)):
        x, y, z = from_m[n, 0], from_m[n, 1], from_m[n, 2]
        result[n] = not crosses(tree, search, (x, y, z), (to_m[n, 0] - x, to_m[n, 1] - y, to_m[n, 2] - z))
