"""Purely specular paths in a mesh: rays find sequences of reflecting planes, image sources the paths by them."""

import logging
from typing import NamedTuple

import numpy as np
import scipy  # its submodules are slow to import and load themselves when first used

from roomeq.core.arrays import Array, BoolArray, FloatArray, IntArray, Number
from roomeq.core.jit import compiled, for_chunks, inlined
from roomeq.sim.adjacency import FACET_RAD
from roomeq.sim.images import SpecularPaths
from roomeq.sim.trace import sphere_directions
from roomeq.sim.tree import FRONTS, Tree, crosses, first_hit, memory

logger = logging.getLogger(__name__)

_ON_PLANE_M = 1e-4
"""A path that meets a face this close to another plane meets both: corners are rounded."""
_EDGE_COSINE = np.cos(FACET_RAD)  # of the angle between planes that are close to each other at an edge alone
_SAME_M = 1e-3  # between image sources of different sequences that are one
_RAYS = 20000  # that search for sequences
_UNEVEN = 0.25  # share of them that find different sequences of second order: far fewer do where surfaces are flat


class Sequences(NamedTuple):
    """Sequences of planes that reflect rays of a source, up to an order.

    Attributes
    ----------
    planes
        Indices of the planes, shape (n_sequences, order).
    n_reflections
        Length of each sequence, shape (n_sequences,).
    images
        Positions of the image sources after 0, 1, ... reflections [m], shape (n_sequences, order + 1, 3).
    """

    planes: IntArray
    n_reflections: IntArray
    images: FloatArray


def find_sequences(tree: Tree, plane: IntArray, mirrors: FloatArray, normals: FloatArray, curved: BoolArray,
                   source_m: FloatArray, order: int) -> Sequences:
    """Find the sequences of planes that reflect rays of a source.

    Facets of curved surfaces are no mirrors: several of them show the same reflection, or its parts, and image sources
    of full strength, in phase, would be far too loud.

    Parameters
    ----------
    tree
        Of the room.
    plane
        Plane of each face, shape (n_faces,).
    mirrors
        Unit normal and offset [m] of each plane, shape (n_planes, 4).
    normals
        Of the faces, shape (n_faces, 3).
    curved
        Whether each face is a facet of a curved surface, shape (n_faces,).
    source_m
        Shape (3,).
    order
        Largest number of reflections.

    Returns
    -------
    Sequences
        Shorter ones first.
    """
    directions = sphere_directions(_RAYS, np.random.default_rng(1))
    hit = np.full((len(directions), order), -1, dtype=np.int64)
    for_chunks(len(directions), lambda chunk, low, high: _reflect(tree, plane, normals, curved, source_m,
                                                                  directions[low:high], hit[low:high]))
    planes, lengths = [np.full((1, order), -1)], [np.zeros(1, dtype=np.int64)]
    same = np.zeros(len(hit), dtype=np.int64)  # number of the sequence so far
    for k in range(order):
        reflected = hit[:, k] >= 0
        hit, same = hit[reflected], same[reflected]
        _, first, same = np.unique(same * len(mirrors) + hit[:, k], return_index=True, return_inverse=True)
        planes.append(np.where(np.arange(order) <= k, hit[first], -1))
        lengths.append(np.full(len(first), k + 1))
        if k == 1 and len(first) > _UNEVEN * _RAYS:
            logger.warning("the mesh has uneven surfaces of many small faces: %d rays find only a part of the image "
                           "sources, and specular sound is too weak; make the faces larger, or use ism_order 0 or 1",
                           _RAYS)
    joined = np.concatenate(planes)
    return Sequences(joined, np.concatenate(lengths), _images(mirrors, joined, source_m))


def _images(mirrors: FloatArray, planes: IntArray, source_m: FloatArray) -> FloatArray:
    images = np.empty((len(planes), planes.shape[1] + 1, 3))
    images[:, 0] = source_m
    for k in range(planes.shape[1]):
        normal, offset = mirrors[planes[:, k], :3], mirrors[planes[:, k], 3]
        height = np.einsum("ij,ij->i", images[:, k], normal) - offset
        images[:, k + 1] = images[:, k] - 2.0 * height[:, None] * normal
    return images


def visible_paths(sequences: Sequences, tree: Tree, plane: IntArray, mirrors: FloatArray, face_surface: IntArray,
                  n_surfaces: int, mic_m: FloatArray) -> SpecularPaths:
    """Return the paths to a microphone, shape (3,), that no surface obstructs; see `find_sequences`.

    Where a path meets the edge between two planes, both orders of them lead to the same image source: one is returned.
    """
    n_sequences = len(sequences.planes)
    visible, counts = np.empty(n_sequences, np.bool_), np.zeros((n_sequences, n_surfaces), np.int64)
    for_chunks(n_sequences, lambda chunk, low, high: _walk_back(tree, plane, mirrors, face_surface, *sequences, mic_m,
                                                                low, high, visible, counts))
    valid = np.flatnonzero(visible)
    images = sequences.images[valid, sequences.n_reflections[valid]]
    again = scipy.spatial.cKDTree(images).query_pairs(_SAME_M, output_type="ndarray")[:, 1]
    valid = np.delete(valid, again)
    offset = mic_m - sequences.images[valid, sequences.n_reflections[valid]]
    distance_m = np.linalg.norm(offset, axis=1)
    by_length = np.argsort(distance_m, kind="stable")
    valid, distance_m = valid[by_length], distance_m[by_length]
    arrival = -offset[by_length] / distance_m[:, None]
    return SpecularPaths(distance_m, counts[valid], _departures(mirrors, sequences.planes[valid], -arrival), arrival)


def _departures(mirrors: FloatArray, planes: IntArray, direction: FloatArray) -> FloatArray:
    """Return the directions of departure at the source for directions at its images, shape (n_sequences, 3)."""
    for k in range(planes.shape[1] - 1, -1, -1):
        normal = np.where(planes[:, k, None] >= 0, mirrors[planes[:, k], :3], 0.0)
        direction = direction - 2.0 * np.einsum("ij,ij->i", direction, normal)[:, None] * normal
    return direction


@compiled
def _reflect(tree: Tree, plane: Array, normals: Array, curved: Array, source_m: Array, directions: Array,
             hit: Array) -> None:
    """Write the planes that reflect rays up to a curved surface, one after the other, to `hit`, (n_rays, order)."""
    search = memory(tree)
    for ray in range(len(directions)):
        x, y, z = source_m[0], source_m[1], source_m[2]
        u, v, w = directions[ray, 0], directions[ray, 1], directions[ray, 2]
        for k in range(hit.shape[1]):
            face, distance = first_hit(tree, search, (x, y, z), (u, v, w), FRONTS)
            if face < 0 or curved[face]:
                break
            hit[ray, k] = plane[face]
            x, y, z = x + distance * u, y + distance * v, z + distance * w
            normal = normals[face]
            twice = 2.0 * (u * normal[0] + v * normal[1] + w * normal[2])
            u, v, w = u - twice * normal[0], v - twice * normal[1], w - twice * normal[2]


@inlined
def _form_an_edge(one: Array, other: Array) -> bool:
    """Tell whether two planes form an edge; those of an uneven wall are close to each other far beyond their faces."""
    return abs(one[0] * other[0] + one[1] * other[1] + one[2] * other[2]) < _EDGE_COSINE


@compiled
def _walk_back(tree: Tree, plane: Array, mirrors: Array, face_surface: Array, planes: Array, n_reflections: Array,
               images: Array, mic_m: Array, low: Number, high: Number, visible: BoolArray, counts: Array) -> None:
    """Tell for sequences `low` to `high` whether their path exists, and count its reflections at each surface.

    A path that meets the edge between two planes hits both at once, but for rounding: either face counts for both, and
    the second reflection may be missed, as its plane lies behind.
    """
    search = memory(tree)
    for n in range(low, high):
        x, y, z, exists, met = mic_m[0], mic_m[1], mic_m[2], True, 0
        for k in range(n_reflections[n] - 1, -1, -1):
            u, v, w = images[n, k + 1, 0] - x, images[n, k + 1, 1] - y, images[n, k + 1, 2] - z
            length = np.sqrt(u * u + v * v + w * w)
            u, v, w = u / length, v / length, w / length
            face, distance = first_hit(tree, search, (x, y, z), (u, v, w), FRONTS)
            mirror = mirrors[planes[n, k]]
            to_plane = (mirror[3] - x * mirror[0] - y * mirror[1] - z * mirror[2]) / min(
                u * mirror[0] + v * mirror[1] + w * mirror[2], -1e-9)
            if face >= 0 and distance < length and (plane[face] == planes[n, k] or (
                    abs(distance - to_plane) <= _ON_PLANE_M and _form_an_edge(mirror, mirrors[plane[face]]))):
                met = face
            elif (k + 1 < n_reflections[n] and abs(to_plane) <= _ON_PLANE_M
                  and _form_an_edge(mirror, mirrors[planes[n, k + 1]])):
                distance = to_plane
            else:
                exists = False
                break
            counts[n, face_surface[met]] += 1
            x, y, z = x + distance * u, y + distance * v, z + distance * w
        visible[n] = exists and not crosses(tree, search, (x, y, z), (images[n, 0, 0] - x, images[n, 0, 1] - y,
                                                                      images[n, 0, 2] - z))
