"""Rooms as triangle meshes: checks, ray queries, and purely specular paths.

A room mesh is closed. It consists of an outer shell, whose normals point out of the room, and bodies inside the shell.
All triangles of the same material form one surface. Triangles in the same plane act as one mirror for image sources.
"""

import contextlib
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from roomeq.core.arrays import BoolArray, FloatArray, IntArray
from roomeq.core.extras import require_packages
from roomeq.sim.adjacency import Meetings, Planes, curved_faces, find_meetings, find_planes
from roomeq.sim.images import SpecularPaths
from roomeq.sim.in_sight import triangles_in_sight
from roomeq.sim.meshfile import read_triangles
from roomeq.sim.mirrors import find_sequences, visible_paths
from roomeq.sim.scene import MIN_WALL_DISTANCE_M
from roomeq.sim.trace import sphere_directions
from roomeq.sim.tree import Tree, find_quadrangles, first_hits, make_tree, sees
from roomeq.sim.walls import Walls

if TYPE_CHECKING:
    import trimesh

logger = logging.getLogger(__name__)

_MAX_WALLS = 32  # of a convex room that are intersected one by one, without a tree
_SPHERE_RAYS = 2000  # directions in which the distance to the surfaces is sampled
_WELD_M = 1e-5  # grid to which corners are rounded before they are merged; thinner bodies are refused
_INSIDE_POINTS = 5  # of a body, of which most must lie in the room
_BELOW_FACE_M = 1e-4
_REACHES_OUT_M = 1e-3
KEPT_POINTS, KEPT_SOURCES = 500, 16
"""For so many positions, what was found of the room around them is kept."""
Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class MeshRoom:
    """A room that is bounded by triangles.

    Attributes
    ----------
    triangles
        Corners [m], shape (n_faces, 3, 3), ordered so that the right-hand rule gives normals out of the air; the
        attribute `normals` has the opposite direction.
    surfaces
        Names of the materials, one for each surface.
    face_surface
        Index of each face's surface, shape (n_faces,).
    volume_m3
        Volume of the air.
    convex
        Whether every point of the room is visible from every other point.
    """

    triangles: FloatArray
    surfaces: tuple[str, ...]
    face_surface: IntArray
    volume_m3: float
    convex: bool
    _cache: dict[str, Any] = field(default_factory=dict, repr=False)

    def __getstate__(self) -> dict[str, Any]:
        """Return the geometry and its planes for a pickle; the rest is computed again where it is needed."""
        state = {field.name: getattr(self, field.name) for field in fields(self)}
        return state | dict(_cache={}, meetings=self.meetings, planes=self.planes)

    @cached_property
    def _cross(self) -> FloatArray:
        """Product of two sides of each face, twice its area long, out of the air, shape (n_faces, 3)."""
        a, b, c = self.triangles.transpose(1, 0, 2)
        return np.cross(b - a, c - a)

    @cached_property
    def normals(self) -> FloatArray:
        """Unit normals into the air, shape (n_faces, 3)."""
        return -self._cross / np.linalg.norm(self._cross, axis=1)[:, None]

    @cached_property
    def offsets(self) -> FloatArray:
        """Offset [m] of each face's plane along its normal, shape (n_faces,)."""
        return np.einsum("ij,ij->i", self.normals, self.triangles[:, 0])

    @cached_property
    def face_area_m2(self) -> FloatArray:
        return 0.5 * np.linalg.norm(self._cross, axis=1)

    @cached_property
    def tree(self) -> Tree:
        """The tree that rays search."""
        return make_tree(self.triangles, self.normals, self.face_surface)

    @cached_property
    def _quadrangles(self) -> tuple[IntArray, IntArray]:
        """The pairs of triangles that are one face to rays."""
        return find_quadrangles(self.triangles, self.normals, self.offsets, self.face_surface)[:2]

    @cached_property
    def meetings(self) -> Meetings:
        """The pairs of faces that meet in an edge."""
        return find_meetings(self.triangles)

    @cached_property
    def planes(self) -> Planes:
        return find_planes(self.triangles, self.normals, self.face_area_m2, self.meetings)

    @cached_property
    def curved(self) -> BoolArray:
        """Whether each face is a facet of a curved surface, which has no image sources, shape (n_faces,)."""
        low, high = self.bounds_m
        return curved_faces(self.planes, self.meetings, self.face_area_m2, float(np.linalg.norm(high - low)))

    @cached_property
    def walls(self) -> Walls | None:
        """The planes of a convex room of at most `_MAX_WALLS`, each of one surface; None for other rooms."""
        plane, mirrors = self.planes
        wall = np.unique(np.column_stack([plane, self.face_surface]), axis=0)
        if not self.convex or len(wall) > len(mirrors) or len(wall) > _MAX_WALLS:
            return None
        low, high = self.bounds_m
        curved = np.bincount(plane, self.curved) > 0
        return Walls(mirrors[:, :3].copy(), mirrors[:, 3].copy(), wall[:, 1], curved, high - low)

    @property
    def surface_area_m2(self) -> FloatArray:
        return np.asarray(np.bincount(self.face_surface, self.face_area_m2, minlength=len(self.surfaces)), dtype=float)

    @property
    def bounds_m(self) -> tuple[FloatArray, FloatArray]:
        corners = self.triangles.reshape(-1, 3)
        return corners.min(axis=0), corners.max(axis=0)

    def first_hits(self, origins: FloatArray, directions: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return the first face that each ray hits, -1 for none, and the distance [m] to it.

        A ray that hits the back of a face began outside the air: it hits none, and the distance is that to the
        back.
        """
        face, distance = first_hits(self.tree, origins, directions)
        approach = np.einsum("ij,ij->i", self.normals[face], directions)
        return np.where(approach < 0.0, face, -1), distance

    def sees(self, from_m: ArrayLike, to_m: ArrayLike) -> BoolArray:
        """Return whether each line from one point to another is unobstructed, shape (n,).

        The arguments broadcast to shape (n, 3).
        """
        from_m, to_m = np.asarray(from_m, float), np.asarray(to_m, float)
        shape = np.broadcast_shapes(from_m.shape, to_m.shape)
        from_m, to_m = (np.ascontiguousarray(np.broadcast_to(point_m, shape)) for point_m in (from_m, to_m))
        return sees(self.tree, from_m, to_m)

    def faces_in_sight(self, points_m: FloatArray) -> BoolArray:
        """Tell which faces some points surely see as a whole, shape (n_points, n_faces).

        Both triangles of a quadrangle must be seen: rays find one face of them (`tree`).
        """
        first, second = self._quadrangles

        def search(point_m: FloatArray) -> BoolArray:
            seen = triangles_in_sight(self.triangles, self.normals, point_m)
            seen[first] = seen[second] = seen[first] & seen[second]
            return seen

        return np.array([self.remember("in_sight", tuple(map(float, point_m)), KEPT_POINTS, partial(search, point_m))
                         for point_m in points_m])

    def surroundings(self, point_m: ArrayLike) -> FloatArray | None:
        """Return the distance [m] to the surfaces in `_SPHERE_RAYS` evenly spread directions; None outside the air."""
        key = tuple(np.round(np.asarray(point_m, dtype=float), 9))

        def look_around() -> FloatArray | None:
            directions = sphere_directions(_SPHERE_RAYS, np.random.default_rng(0))
            face, distance = self.first_hits(np.tile(np.asarray(key), (_SPHERE_RAYS, 1)), directions)
            return distance if np.mean(face >= 0) > 0.99 else None

        return self.remember("surroundings", key, KEPT_POINTS, look_around)

    def _surface_distances_m(self, point_m: ArrayLike) -> FloatArray:
        distance = self.surroundings(point_m)
        assert distance is not None, "positions are checked by require_inside"
        return distance

    def require_inside(self, name: str, position_m: Sequence[float] | FloatArray) -> None:
        """Raise ValueError unless a position lies in the air and keeps a minimum distance from the surfaces."""
        distance = self.surroundings(position_m)
        if distance is None or distance.min() < MIN_WALL_DISTANCE_M:
            where = "outside the air of the room" if distance is None else f"{distance.min():.3g} m from a surface"
            raise ValueError(f"{name}={[float(value) for value in position_m]} lies {where} and must lie inside, at "
                             f"least {MIN_WALL_DISTANCE_M:g} m from every surface: correct the position")

    def sphere_volume_m3(self, center_m: ArrayLike, radius_m: float) -> float:
        """Volume of the part of a sphere that is visible from its centre."""
        visible_m = np.minimum(self._surface_distances_m(center_m), radius_m)
        return float(4.0 / 3.0 * np.pi * np.mean(visible_m ** 3))

    def sphere_radius_m(self, center_m: ArrayLike, radius_m: float) -> float:
        """Radius of a receiver sphere that no surface cuts, but at least half of `radius_m`."""
        if self.convex:
            return radius_m
        return float(np.clip(self._surface_distances_m(center_m).min(), 0.5 * radius_m, radius_m))

    def cuts_sphere(self, center_m: ArrayLike, radius_m: float) -> bool:
        """Tell whether a surface cuts a sphere."""
        return bool(self._surface_distances_m(center_m).min() < radius_m - _WELD_M)

    def specular_paths(self, source_pos_m: ArrayLike, mic_pos_m: ArrayLike, order: int) -> SpecularPaths:
        """Find the purely specular paths up to an order; see `roomeq.sim.images.specular_paths`."""
        (plane, mirrors), source_m = self.planes, np.asarray(source_pos_m, dtype=float)
        sequences = self.remember(f"sequences of order {order}", tuple(source_m), KEPT_SOURCES, lambda: find_sequences(
            self.tree, plane, mirrors, self.normals, self.curved, source_m, order))
        return visible_paths(sequences, self.tree, plane, mirrors, self.face_surface, len(self.surfaces),
                             np.asarray(mic_pos_m, dtype=float))

    def remember(self, what: str, key: Any, size: int, compute: Callable[[], Result]) -> Result:
        """Return what is computed for a key; the latest `size` results of a kind are kept."""
        kept = self._cache.setdefault(what, {})
        if key in kept:
            with contextlib.suppress(KeyError):  # another thread may just have dropped it
                return cast(Result, kept[key])
        result = kept[key] = compute()
        for oldest in list(kept)[:-size]:
            kept.pop(oldest, None)
        return result


@lru_cache(maxsize=8)
def _load(path: Path, mtime_ns: int) -> MeshRoom:
    return make_room(*read_triangles(path), name=str(path))


def load_mesh(path: str | Path) -> MeshRoom:
    """Read a room from a mesh file; see `roomeq.sim.meshfile.read_triangles` for the formats.

    Raises
    ------
    ValueError
        The file cannot be read, or the mesh has holes or its normals point into the room.
    """
    path = Path(path)
    return _load(path, path.stat().st_mtime_ns if path.is_file() else 0)


def make_room(triangles: ArrayLike, names: Sequence[str], name: str = "mesh") -> MeshRoom:
    """Make a room from triangles.

    Parameters
    ----------
    triangles
        Corners [m], shape (n_faces, 3, 3). The normals of the outer shell point outward, away from the air.
    names
        Material of each face.
    name
        Name of the mesh in error messages.

    Raises
    ------
    ValueError
        The mesh is not closed, the corner order of neighbouring faces is inconsistent, or normals point into the room.
    """
    require_packages("trimesh")
    import trimesh

    corners_m, faces = _weld(np.asarray(triangles, dtype=np.float64))
    nondegenerate = ((faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2])
                     & (faces[:, 2] != faces[:, 0]))
    faces, materials = faces[nondegenerate], np.asarray(names)[nondegenerate]
    mesh = trimesh.Trimesh(corners_m, faces, process=False)
    if not mesh.is_watertight:
        edges, counts = np.unique(np.sort(mesh.edges, axis=1), axis=0, return_counts=True)
        bad = edges[counts != 2]
        where = np.round(mesh.vertices[bad[0]].mean(axis=0), 3).tolist() if len(bad) else "?"
        if len(bad) and np.all(counts % 2 == 0):
            raise ValueError(f"{name}: more than two faces of the mesh meet in {len(bad)} edges, the first near "
                             f"{where} m: move bodies that touch 1 mm apart or join them, and give walls a thickness")
        raise ValueError(f"{name}: the mesh has holes: {len(bad)} edges don't join exactly two faces, the first near "
                         f"{where} m: close the holes, and give faces that meet along an edge the same corners on it")
    if not mesh.is_winding_consistent:
        raise ValueError(f"{name}: neighbouring faces of the mesh have opposite normals: make all normals point out of "
                         "the room")
    orientation = _orient(mesh, name)
    faces = np.where(orientation.flip[:, None], faces[:, ::-1], faces)
    surfaces, face_surface = np.unique(materials, return_inverse=True)
    convex = bool(not orientation.flip.any() and mesh.body_count == 1 and _is_convex(mesh))
    solid = mesh.area_faces > 1e-12  # a polygon with a corner on one of its edges has a triangle without an area
    return MeshRoom(mesh.vertices[faces[solid]], tuple(str(surface) for surface in surfaces), face_surface[solid],
                    orientation.volume_m3, convex)


def _weld(triangles: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return the distinct corners [m], on the grid of `_WELD_M`, and each face's indices of them, shape (n_faces, 3).

    Corners in the same or in adjacent cells of the grid are one: roundings of one corner may lie on both sides of the
    border of a cell.
    """
    from scipy.spatial import cKDTree
    from trimesh.graph import connected_component_labels

    cells, index = np.unique(np.round(triangles.reshape(-1, 3) / _WELD_M).astype(np.int64), axis=0,
                             return_inverse=True)
    adjacent = cKDTree(cells).query_pairs(1.0, p=np.inf, output_type="ndarray")
    corner = connected_component_labels(adjacent, node_count=len(cells))
    _, first = np.unique(corner, return_index=True)
    corners_m: FloatArray = np.multiply(cells[first], _WELD_M, dtype=np.float64)
    return corners_m, corner[np.ravel(index)].reshape(-1, 3)


class _Orientation(NamedTuple):
    """Faces to flip so that all normals point out of the air, shape (n_faces,), and the volume of the air."""

    flip: BoolArray
    volume_m3: float


def _orient(mesh: "trimesh.Trimesh", name: str) -> _Orientation:
    import trimesh

    flip = np.zeros(len(mesh.faces), dtype=bool)
    bodies = trimesh.graph.connected_components(mesh.face_adjacency, nodes=np.arange(len(mesh.faces)))
    volumes = []
    for body in bodies:
        a, b, c = mesh.triangles[body].transpose(1, 0, 2)
        volumes.append(float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0))
    shell = int(np.argmax(np.abs(volumes)))
    if volumes[shell] <= 0.0:
        raise ValueError(f"{name}: the normals of the mesh point into the room (its volume is {volumes[shell]:.3g} "
                         "m3): turn its faces so that normals point out of the room")
    for n, body in enumerate(bodies):
        if abs(volumes[n]) < 0.5 * mesh.area_faces[body].sum() * _WELD_M:
            where = np.round(mesh.triangles[body].mean(axis=(0, 1)), 3).tolist()
            raise ValueError(f"{name}: the body around {where} m has no thickness, and rays would pass through it: "
                             "give it one, such as 1 mm")
        flip[body] = n != shell and volumes[n] > 0.0
        if n != shell and not _is_inside(mesh.triangles[bodies[shell]], mesh.triangles[body], volumes[n] > 0.0):
            where = np.round(mesh.triangles[body].mean(axis=(0, 1)), 3).tolist()
            raise ValueError(f"{name}: the body around {where} m lies outside of the largest one, which is the room: "
                             "put each room in a mesh of its own, or join them by an opening")
    _say_what_reaches_out(mesh.triangles[bodies[shell]],
                          [mesh.triangles[body] for n, body in enumerate(bodies) if n != shell], name)
    volume_m3 = volumes[shell] - sum(abs(volume) for n, volume in enumerate(volumes) if n != shell)
    if volume_m3 <= 0.0:
        raise ValueError(f"{name}: the bodies in the room fill all of its {volumes[shell]:.3g} m3: correct them")
    return _Orientation(flip, volume_m3)


def _say_what_reaches_out(shell: FloatArray, bodies: list[FloatArray], name: str) -> None:
    """Warn of bodies that reach out of the box around the room; triangles of shape (n_faces, 3, 3) each."""
    low_m, high_m = shell.min(axis=(0, 1)), shell.max(axis=(0, 1))
    out_m = [float(max((low_m - body.min(axis=(0, 1))).max(), (body.max(axis=(0, 1)) - high_m).max()))
             for body in bodies]
    if out_m and max(out_m) > _REACHES_OUT_M:
        where = np.round(bodies[int(np.argmax(out_m))].mean(axis=(0, 1)), 3).tolist()
        logger.warning("%s: bodies that reach out of the room: %d, the one around %s m by %.2g m: volume and area of "
                       "what is outside count as if it were inside: cut it off", name,
                       np.count_nonzero(np.array(out_m) > _REACHES_OUT_M), where, max(out_m))


def _is_inside(shell: FloatArray, body: FloatArray, outward: bool) -> bool:
    """Tell whether most of a body lies in a shell, by the solid angle of the shell seen from just below its faces.

    Van Oosterom and Strackee, IEEE Trans. Biomed. Eng. 30 (1983) 125.

    Parameters
    ----------
    shell, body
        Triangles, shape (n_faces, 3, 3).
    outward
        Whether the normals of the body point out of it.
    """
    body = body[:: -(-len(body) // _INSIDE_POINTS)]
    normals = np.cross(body[:, 1] - body[:, 0], body[:, 2] - body[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    points = body.mean(axis=1) - (1.0 if outward else -1.0) * _BELOW_FACE_M * normals
    around = []
    for point in points:
        a, b, c = (shell - point).transpose(1, 0, 2)
        x, y, z = (np.linalg.norm(corner, axis=1) for corner in (a, b, c))
        dot = partial(np.einsum, "ij,ij->i")
        half = np.arctan2(dot(a, np.cross(b, c)), x * y * z + dot(a, b) * z + dot(b, c) * x + dot(c, a) * y)
        around.append(half.sum() / (2.0 * np.pi))  # 1 inside, 0 outside
    return float(np.median(around)) > 0.5


def _is_convex(mesh: "trimesh.Trimesh") -> bool:
    """Return whether all vertices lie on or behind the plane of every face, the front being where normals point."""
    normals, corners = mesh.face_normals, mesh.triangles[:, 0]
    unique = np.unique(np.round(np.column_stack([normals, np.einsum("ij,ij->i", normals, corners)]), 5), axis=0)
    if len(unique) > 200:
        return False  # a curved surface in many small planes: too many to test
    return bool(np.all(mesh.vertices @ unique[:, :3].T <= unique[:, 3] + 1e-4))
