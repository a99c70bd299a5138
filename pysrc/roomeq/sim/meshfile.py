"""Reading room meshes: triangles and the material name of each."""

import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from roomeq.core.arrays import FloatArray
from roomeq.core.constants import MAX_ROOM_M, MIN_ROOM_M
from roomeq.core.extras import require_packages
from roomeq.core.limits import MESH_MB
from roomeq.sim.gltf import load_gltf

FORMATS = (".obj", ".ply", ".glb", ".gltf", ".stl", ".off")
UNNAMED = "surface"
MAX_FROM_ORIGIN_M = 1e4
"""Rays are traced in single precision, which at this distance tells millimetres apart."""
MAX_CORNERS = 500
"""Of one face: for a face whose edges cross, triangulation takes the cube of this number of steps."""

_TRIANGLE_BYTES = 72


class Triangles(NamedTuple):
    """The faces of a mesh.

    Attributes
    ----------
    corners_m
        Shape (n_faces, 3, 3).
    materials
        Name of each face's material; ``"surface"`` if the file gives none.
    """

    corners_m: FloatArray
    materials: Sequence[str]


def read_triangles(path: str | Path) -> Triangles:
    """Read a mesh file.

    Parameters
    ----------
    path
        OBJ (materials by ``usemtl``, no MTL file needed), GLB (materials by name), STL (of several solids: by the
        name of the solid), PLY or OFF; metres.

    Raises
    ------
    ValueError
        The file is missing, of another format, too large (`roomeq.core.limits`), broken or holds no triangles.
    """
    path = Path(path)
    if not path.is_file():
        raise ValueError(f"{path}: no such mesh file: check the path")
    if path.suffix.lower() not in FORMATS:
        raise ValueError(f"{path}: a mesh must be one of {', '.join(FORMATS)}: export it as such")
    _check_size(path, path.stat().st_size)
    require_packages("trimesh")
    try:
        triangles, names = _read_obj(path) if path.suffix.lower() == ".obj" else _read_other(path)
    except (_TooLarge, OSError, MemoryError):
        raise
    except Exception as error:  # broken bytes can raise any exception in trimesh
        raise ValueError(f"{path}: cannot be read as a mesh ({str(error) or type(error).__name__}): export it "
                         "again") from None
    if not len(triangles):
        raise ValueError(f"{path}: holds no triangles: export it again")
    _check_lengths(path, triangles)
    return Triangles(triangles, names)


def _check_lengths(path: Path, triangles: FloatArray) -> None:
    """Refuse a room that is far from the origin, or so large or small that it cannot be in metres."""
    corners = triangles.reshape(-1, 3)
    if not np.isfinite(corners).all():
        raise ValueError(f"{path}: every vertex must be a finite number of metres: export it again")
    length_m = float(np.ptp(corners, axis=0).max())
    if not MIN_ROOM_M <= length_m <= MAX_ROOM_M:
        larger = "inches or centimetres" if length_m <= 1000 else "millimetres"
        unit = "kilometres" if length_m < MIN_ROOM_M else larger
        raise ValueError(f"{path}: the room is {length_m:,.4g} m long and must be {MIN_ROOM_M:g} m to "
                         f"{MAX_ROOM_M:g} m: is it in {unit}? Export it in metres")
    if not np.all(np.abs(corners) <= MAX_FROM_ORIGIN_M):
        raise ValueError(f"{path}: every vertex must lie within {MAX_FROM_ORIGIN_M:g} m of the origin: move the room "
                         "there")


class _TooLarge(ValueError):
    """A file above the size limit. `read_triangles` passes the message on, since the format is not at fault."""


def _check_size(path: Path, n_bytes: int) -> None:
    bound = round(1e6 * MESH_MB.value())
    if n_bytes > bound:
        raise _TooLarge(f"{path}: {n_bytes} bytes must be at most {bound} ({MESH_MB.value():g} MB): use fewer "
                        f"triangles, or raise the bound with roomeq --{MESH_MB.option}")


def _read_other(path: Path) -> Triangles:
    import trimesh

    suffix = path.suffix.lower()
    scene: Any
    if suffix in (".glb", ".gltf"):
        scene = load_gltf(path, partial(_check_size, path))
    elif suffix == ".ply":
        scene = trimesh.load(path, force="scene", process=False, skip_materials=True)
    else:
        scene = trimesh.load(path, force="scene", process=False)
    # several nodes may hold the same mesh
    _check_size(path, _TRIANGLE_BYTES * sum(len(getattr(scene.geometry[scene.graph[node][1]], "faces", ()))
                                            for node in scene.graph.nodes_geometry))
    triangles: list[FloatArray] = [np.empty((0, 3, 3))]
    names: list[str] = []
    several = suffix == ".stl" and len(scene.geometry) > 1
    solids = dict(zip(scene.geometry, _solid_names(path), strict=True)) if several else {}
    for node in sorted(scene.graph.nodes_geometry):
        transform, geometry = scene.graph[node]
        mesh = scene.geometry[geometry]
        if not isinstance(mesh, trimesh.Trimesh):
            continue
        material = solids.get(geometry) or getattr(getattr(mesh.visual, "material", None), "name", None)
        placed, faces = trimesh.transform_points(mesh.vertices, transform), np.asarray(mesh.faces)
        if suffix in (".glb", ".gltf"):
            placed = placed[:, [0, 2, 1]] * [1.0, -1.0, 1.0]  # there y is up (glTF 2.0, 3.4); here z is
            if np.linalg.det(transform[:3, :3]) < 0.0:  # a mirror image is wound the other way (3.7.4)
                faces = faces[:, ::-1]
        triangles.append(placed[faces])
        names += [material or UNNAMED] * len(mesh.faces)
    return Triangles(np.concatenate(triangles), names)


def _solid_names(path: Path) -> list[str]:
    """Return the name of each solid of an STL file that has triangles; trimesh numbers those of one name."""
    solids = re.findall(r"^\s*solid\b[ \t]*(.*?)[ \t]*$(.*?)^\s*endsolid", path.read_text(errors="replace"),
                        flags=re.DOTALL | re.IGNORECASE | re.MULTILINE)
    return [name for name, facets in solids if "vertex" in facets.lower()]


def _read_obj(path: Path) -> Triangles:
    """Read vertices, faces and materials of an OBJ file; polygons are cut into triangles."""
    vertices: list[list[float]] = []
    triangles: list[FloatArray] = []
    names: list[str] = []
    material = UNNAMED
    text = path.read_text(encoding="utf-8-sig", errors="replace")
    # a line that ends in a backslash goes on in the next one
    for line in re.sub(r"^(?!\s*#)(.*)\\\n", r"\1 ", text, flags=re.MULTILINE).splitlines():
        # a name may hold the sign of comments
        key, *words = re.split(r"(?:^|\s)#" if "usemtl" in line else "#", line)[0].split() or [""]
        if key == "v":
            if len(words) < 3:
                raise ValueError(f"vertex {len(vertices) + 1} has {len(words)} coordinates where three are needed")
            vertices.append([float(word) for word in words[:3]])
        elif key == "usemtl":
            material = " ".join(words) or UNNAMED
        elif key == "f":
            index = [int(word.split("/")[0]) for word in words]
            if len(index) > MAX_CORNERS:
                raise ValueError(f"a face of {len(index)} corners; at most {MAX_CORNERS} are cut into triangles")
            if 0 in index:
                raise ValueError("a face refers to vertex 0; OBJ counts from 1")
            corners = np.array([vertices[n - 1 if n > 0 else n] for n in index])
            cut = triangulate(corners)
            if _overlap(corners, cut):
                raise ValueError(f"face {' '.join(words)} crosses itself")
            triangles += [corners[list(three)] for three in cut]
            names += [material] * len(cut)
    return Triangles(np.array(triangles).reshape(-1, 3, 3), names)


def triangulate(corners: FloatArray) -> list[tuple[int, ...]]:
    """Cut a planar polygon into triangles by clipping ears (Meisters, Amer. Math. Monthly 82 (1975) 648).

    Parameters
    ----------
    corners
        Shape (n, 3).

    Returns
    -------
    list of tuple
        Indices of the three corners of each triangle, in the polygon's sense of rotation.
    """
    rest = list(range(len(corners)))
    following = np.roll(corners, -1, axis=0)
    normal = np.cross(corners, following).sum(axis=0)
    triangles: list[tuple[int, ...]] = []
    while len(rest) > 3:
        for n in range(len(rest)):
            ear = rest[n - 1], rest[n], rest[(n + 1) % len(rest)]
            if _is_ear(corners, ear, rest, normal):
                break
        triangles.append(ear)  # a polygon that is not simple has no ear: cut anywhere, the mesh check will reject it
        rest.pop(n)
    return [*triangles, tuple(rest)] if len(rest) == 3 else triangles


def _overlap(corners: FloatArray, triangles: list[tuple[int, ...]]) -> bool:
    """Tell whether a triangle of a polygon is turned around, so that others lie over it."""
    normal = np.cross(corners, np.roll(corners, -1, axis=0)).sum(axis=0)
    a, b, c = (corners[[three[n] for three in triangles]] for n in range(3))
    return bool((np.cross(b - a, c - a) @ normal < -1e-6 * np.dot(normal, normal)).any())


def _is_ear(corners: FloatArray, ear: tuple[int, ...], rest: list[int], normal: FloatArray) -> bool:
    a, b, c = corners[list(ear)]
    if np.dot(np.cross(b - a, c - b), normal) <= 0.0:
        return False
    others = corners[[n for n in rest if n not in ear]]
    first, second, cut = ((np.cross(q - p, others - p) * normal).sum(axis=1) for p, q in ((a, b), (b, c), (c, a)))
    rounding = 1e-12 * np.dot(normal, normal)
    # a corner on the cut is inside: beyond it, the triangle would leave the polygon
    return not bool(((first > rounding) & (second > rounding) & (cut > -rounding)).any())
