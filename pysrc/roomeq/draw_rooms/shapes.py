"""Shapes of drawn rooms: rectangular or L-shaped plans with boxes for furniture, and the meshes made of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from roomeq.core.arrays import FloatArray
from roomeq.draw_rooms.distributions import Distribution
from roomeq.draw_rooms.room_types import Furniture, RoomType, draw_index
from roomeq.sim.mesh import make_room
from roomeq.sim.meshfile import triangulate
from roomeq.sim.room import Room
from roomeq.sim.scene import Shoebox

CUT_SHARE = (0.3, 0.55)
"""Share of each side of the plan that an L-shaped room lacks."""
GAP_M = 0.03
"""Between furniture and the wall or floor: bodies of a mesh do not touch."""
TOP_M = 0.04
"""Thickness of the top of a table."""
_WALKWAY_M = 0.4  # between furniture that stands free and the walls
_APART_M = 0.1  # between pieces of furniture
_LARGEST_SHARE = 0.6  # of a side of the room that a piece of furniture takes
_TRIES = 60
_FACING = {(-1, 0): "west", (1, 0): "east", (0, -1): "south", (0, 1): "north"}


class Box(NamedTuple):
    """A box along the axes: two opposite corners [m]."""

    low: tuple[float, ...]
    high: tuple[float, ...]

    def distance_m(self, position_m: Sequence[float]) -> float:
        """Return the distance of a point from the box, 0 inside it."""
        return float(np.linalg.norm(np.maximum(np.maximum(np.subtract(self.low, position_m),
                                                          np.subtract(position_m, self.high)), 0.0)))

    def meets(self, other: "Box", margin_m: float) -> bool:
        """Tell whether two boxes are closer than a margin along both horizontal axes."""
        return all(self.low[axis] < other.high[axis] + margin_m and other.low[axis] < self.high[axis] + margin_m
                   for axis in (0, 1))


class Piece(NamedTuple):
    """A piece of furniture: its box, the surface of the room that it belongs to, and whether devices stand on it."""

    box: Box
    surface: str
    is_table: bool


class Edge(NamedTuple):
    """A wall of the plan: its ends in counter-clockwise order, and the unit vectors along it and into the room."""

    start: tuple[float, float]
    end: tuple[float, float]
    along: tuple[float, float]
    inward: tuple[float, float]

    @property
    def length_m(self) -> float:
        return float(np.hypot(self.end[0] - self.start[0], self.end[1] - self.start[1]))


@dataclass(frozen=True)
class Shape:
    """The geometry of a drawn room.

    Attributes
    ----------
    dims_m
        Of the box around the room, one corner of which is the origin.
    cut
        The part of that box which an L-shaped room lacks.
    pieces
        Furniture.
    """

    dims_m: tuple[float, float, float]
    cut: Box | None = None
    pieces: tuple[Piece, ...] = ()

    @property
    def is_shoebox(self) -> bool:
        return self.cut is None and not self.pieces

    @property
    def plan(self) -> list[tuple[float, float]]:
        """The corners of the plan, counter-clockwise."""
        length, width, _ = self.dims_m
        corners = [(0.0, 0.0), (length, 0.0), (length, width), (0.0, width)]
        if self.cut is None:
            return corners
        (x0, y0, _), (x1, y1, _) = self.cut
        at = corners.index((0.0 if x0 == 0.0 else length, 0.0 if y0 == 0.0 else width))
        inner_x, inner_y = (x1 if x0 == 0.0 else x0), (y1 if y0 == 0.0 else y0)
        on_x, on_y = (inner_x, corners[at][1]), (corners[at][0], inner_y)
        turn = [on_y, (inner_x, inner_y), on_x] if at % 2 == 0 else [on_x, (inner_x, inner_y), on_y]
        return corners[:at] + turn + corners[at + 1:]

    @property
    def edges(self) -> list[Edge]:
        """The walls."""
        edges = []
        for start, end in pairwise([*self.plan, self.plan[0]]):
            along = np.sign(np.subtract(end, start)) + 0.0
            edges.append(Edge(start, end, (along[0], along[1]), (-along[1] + 0.0, along[0] + 0.0)))
        return edges

    def wall_distance_m(self, position_m: Sequence[float]) -> float:
        """Return the horizontal distance of a point in the box from the walls; 0 in the part that is cut out."""
        x, y = position_m[:2]
        distance_m = min(x, self.dims_m[0] - x, y, self.dims_m[1] - y)
        return distance_m if self.cut is None else min(distance_m, self.cut.distance_m((x, y, self.cut.low[2])))

    def furniture_distance_m(self, position_m: Sequence[float]) -> float:
        """Return the distance of a point from the nearest furniture."""
        return min((piece.box.distance_m(position_m) for piece in self.pieces), default=np.inf)

    def footprint_distance_m(self, position_m: Sequence[float]) -> float:
        """Return the horizontal distance of a point from the nearest furniture."""
        return min((piece.box.distance_m((*position_m[:2], piece.box.low[2])) for piece in self.pieces), default=np.inf)

    def polygons(self) -> list[tuple[FloatArray, str]]:
        """Return the faces, shape (n_corners, 3) each, with the names of their surfaces."""
        faces = _prism(self.plan, 0.0, self.dims_m[2], None)
        for (low, high), surface, _ in self.pieces:
            base = [(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]
            faces += _prism(base, low[2], high[2], surface)
        return faces

    def room(self) -> Room:
        """Return the room for the simulation.

        Raises
        ------
        ValueError
            The mesh is not closed.
        """
        if self.is_shoebox:
            return Shoebox(self.dims_m)
        triangles, names = [], []
        for corners, surface in self.polygons():
            cut = triangulate(corners)
            triangles += [corners[list(three)] for three in cut]
            names += [surface] * len(cut)
        return make_room(np.array(triangles), names)

    def obj(self) -> str:
        """Return the mesh as the text of an OBJ file."""
        lines, count = [], 0
        for corners, surface in self.polygons():
            lines += [f"v {x:.3f} {y:.3f} {z:.3f}" for x, y, z in corners]
            lines += [f"usemtl {surface}", "f " + " ".join(str(count + n + 1) for n in range(len(corners)))]
            count += len(corners)
        return "\n".join(lines) + "\n"


def _prism(plan: Sequence[tuple[float, float]], low_m: float, high_m: float,
           surface: str | None) -> list[tuple[FloatArray, str]]:
    """Return the faces of an upright prism with a counter-clockwise plan; without a surface, those of a room."""
    bottom, top = (np.array([(x, y, z) for x, y in plan]) for z in (low_m, high_m))
    faces = [(bottom[::-1], surface or "floor"), (top, surface or "ceiling")]
    for a in range(len(plan)):
        b = (a + 1) % len(plan)
        along = np.sign(np.subtract(plan[b], plan[a])).astype(int)
        faces.append((np.array([bottom[a], bottom[b], top[b], top[a]]),
                      surface or _FACING[int(along[1]), int(-along[0])]))
    return faces


def draw_shape(room_type: RoomType, rng: np.random.Generator) -> Shape:
    """Draw the shape of a room and its furniture; furniture that finds no place is left out."""
    is_l, furnished = rng.random() < room_type.l_shaped, rng.random() < room_type.furnished
    area_m2, aspect = room_type.floor_area_m2.draw(rng), room_type.aspect.draw(rng)
    height_m = round(room_type.height_m.draw(rng), 3)
    shares, corner = rng.uniform(*CUT_SHARE, size=2), rng.integers(2, size=2)
    area_m2 /= 1.0 - (shares[0] * shares[1] if is_l else 0.0)
    width_m = np.sqrt(area_m2 / aspect)
    dims_m = round(float(width_m * aspect), 3), round(float(width_m), 3), height_m
    cut = None
    if is_l:
        size_m = [round(float(share * dim), 3) for share, dim in zip(shares, dims_m[:2], strict=True)]
        low = [0.0 if at == 0 else round(dims_m[axis] - size_m[axis], 3) for axis, at in enumerate(corner)]
        high = [size_m[axis] if at == 0 else dims_m[axis] for axis, at in enumerate(corner)]
        cut = Box((*low, 0.0), (*high, height_m))
    shape = Shape(dims_m, cut)
    if furnished:
        for number, furniture in enumerate(room_type.furniture, start=1):
            for _ in range(draw_count(furniture.count, rng)):
                box = _place(shape, furniture, rng)
                if box is not None:
                    piece = Piece(box, f"furniture{number}", furniture.kind == "table")
                    shape = Shape(dims_m, cut, (*shape.pieces, piece))
    return shape


def draw_count(distribution: Distribution, rng: np.random.Generator) -> int:
    """Draw a whole number; each from the lowest to the highest is equally likely where the distribution is uniform."""
    if distribution.median is not None:
        return round(distribution.draw(rng))
    low, high = round(distribution.low), round(distribution.high)
    return min(low + int(rng.random() * (high - low + 1)), high)


def _place(shape: Shape, furniture: Furniture, rng: np.random.Generator) -> Box | None:
    """Draw the size of a piece of furniture and a place where it keeps clear of walls and other pieces."""
    height_m = min(furniture.height_m.draw(rng), shape.dims_m[2] - 0.2)
    low_m = height_m - TOP_M if furniture.kind == "table" else GAP_M
    most_m = _LARGEST_SHARE * min(shape.dims_m[:2])
    size_m = np.minimum([furniture.length_m.draw(rng), furniture.width_m.draw(rng)], most_m)
    for _ in range(_TRIES):
        if furniture.at_wall:
            edges = shape.edges
            edge = edges[draw_index([edge.length_m for edge in edges], rng)]
            start_m = GAP_M + rng.random() * (edge.length_m - size_m[0] - 2.0 * GAP_M)
            near = np.add(edge.start, np.multiply(edge.along, start_m)) + np.multiply(edge.inward, GAP_M)
            far = near + np.multiply(edge.along, size_m[0]) + np.multiply(edge.inward, size_m[1])
            corners, margin_m = np.array([near, far]), 0.5 * GAP_M
        else:
            footprint = size_m if rng.random() < 0.5 else size_m[::-1]
            near = rng.random(2) * (np.array(shape.dims_m[:2]) - footprint)
            corners, margin_m = np.array([near, near + footprint]), _WALKWAY_M
        low, high = np.round(corners.min(axis=0), 3), np.round(corners.max(axis=0), 3)
        box = Box((float(low[0]), float(low[1]), round(low_m, 3)), (float(high[0]), float(high[1]), round(height_m, 3)))
        inside = (low >= margin_m).all() and (high <= np.array(shape.dims_m[:2]) - margin_m).all()
        if (inside and not (shape.cut and box.meets(shape.cut, margin_m))
                and not any(box.meets(piece.box, _APART_M) for piece in shape.pieces)):
            return box
    return None
