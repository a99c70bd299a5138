"""Directivities of sources and microphones, for `roomeq.simulate_rir`.

A directivity maps unit vectors that point away from the source or microphone to gains of sound pressure per octave
band. Patterns of the first order may have a negative rear lobe; a measured table has gains without phase.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from roomeq.core.arrays import FloatArray, IntArray
from roomeq.core.constants import exact_bands_hz, is_number

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

PATTERNS = {"omnidirectional": 1.0, "subcardioid": 0.75, "cardioid": 0.5, "supercardioid": 0.366,
            "hypercardioid": 0.25, "figure_eight": 0.0}
"""Share a of the omnidirectional part in the pattern ``a + (1 - a) cos(theta)``."""
_N_NEIGHBOURS = 4  # measured directions that a gain is interpolated from where they do not surround the device
_PER_BAND = 24  # frequencies over which an octave is averaged
_SAME_RAD = 0.005  # between directions in one half-plane, about the axis, and between the axis and what lies on it
_LEAST_SURROUND = 0.05  # distance of the planes through them from the device, on the unit sphere
_CANDIDATES = (2, 8, 32, 128, 512)  # triangles that a direction is tested against: several may share a plane
_ROUNDING = 1e-12  # of the weights of a triangle's corners
_ELEMENTS = 2 ** 20  # of the matrices of triangles that are in memory at once


@dataclass(frozen=True)
class FirstOrder:
    """A directivity of the first order, the same in all bands: ``a + (1 - a) cos(theta)``.

    Attributes
    ----------
    pattern
        A name of `PATTERNS`, or the share a in [0, 1].
    facing
        Direction of the main axis, shape (3,); its length does not matter.
    """

    pattern: str | float
    facing: Sequence[float] | FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "facing", tuple(unit(self.facing).tolist()))  # may be compared and hashed
        known = self.pattern in PATTERNS if isinstance(self.pattern, str) else is_number(self.pattern)
        if not known:
            raise ValueError(f"pattern={self.pattern!r} must be one of {', '.join(PATTERNS)}, or a share in [0, 1]: "
                             "correct it")
        if not 0.0 <= self.share <= 1.0:
            raise ValueError(f"pattern={self.pattern!r} must lie in [0, 1]: correct it")

    @property
    def share(self) -> float:
        """The share a of the omnidirectional part."""
        return PATTERNS[self.pattern] if isinstance(self.pattern, str) else float(self.pattern)

    def pressure(self, directions: FloatArray, fs_hz: float) -> FloatArray:
        """Return the gains in some directions, shape (n, n_bands)."""
        gain = self.share + (1.0 - self.share) * (directions @ np.asarray(self.facing))
        return np.repeat(gain[:, None], len(exact_bands_hz(fs_hz)), axis=1)


@dataclass(frozen=True)
class DirectivityTable:
    """A measured directivity: gains at some directions and frequencies, without phase.

    Gains are interpolated in dB over log frequency. An octave in which several frequencies were measured has their mean
    energy, up to half the sample rate: notches are narrower than octaves. Beyond the lowest and highest frequency the
    gain is that of the outermost one.

    Between directions, pressure is interpolated linearly over the triangle of measured directions that a direction lies
    in. Polar diagrams, which are measured in one plane through the main axis or a few, are interpolated over the angle
    from the axis, in the half-planes on either side of a direction. The weights of both are the squares of a cosine and
    a sine, so that a single plane is turned about the axis. Other directions that do not lie all around the device
    count by the four nearest ones, weighted by the inverse of their distance.

    Attributes
    ----------
    directions
        In the coordinates of the device, whose main axis is x and whose top is z, shape (n_directions, 3).
    frequencies_hz
        Ascending, shape (n_frequencies,).
    gains_db
        Shape (n_directions, n_frequencies).
    facing
        Direction of the main axis in the room, shape (3,).
    up
        A direction in the room that lies in the plane of the device's x and z axes, shape (3,).
    """

    directions: FloatArray
    frequencies_hz: FloatArray
    gains_db: FloatArray
    facing: Sequence[float] | FloatArray
    up: Sequence[float] | FloatArray = (0.0, 0.0, 1.0)
    _bands: dict[float, FloatArray] = field(default_factory=dict, repr=False, compare=False)

    def __post_init__(self) -> None:
        directions, frequencies_hz, gains_db = (
            _numbers(name, getattr(self, name)) for name in ("directions", "frequencies_hz", "gains_db"))
        if (directions.ndim != 2 or directions.shape[1] != 3 or frequencies_hz.ndim != 1
                or gains_db.shape != (len(directions), len(frequencies_hz))):
            raise ValueError(f"gains_db of shape {gains_db.shape} must have one row for each of {directions.shape} "
                             f"directions and one column for each of {frequencies_hz.shape} frequencies: correct them")
        if not len(frequencies_hz) or frequencies_hz[0] <= 0.0 or np.any(np.diff(frequencies_hz) <= 0.0):
            raise ValueError("frequencies_hz must be positive and ascending: sort them")
        if not np.all(np.isfinite(gains_db)):
            raise ValueError("gains_db must be finite: leave out directions that were not measured")
        for n, direction in enumerate(directions):
            if not np.all(np.isfinite(direction)) or not np.any(direction):
                raise ValueError(f"directions[{n}]={direction.tolist()} must be three finite numbers, not all 0: "
                                 "correct it or leave it out")
        object.__setattr__(self, "directions", directions / np.linalg.norm(directions, axis=1, keepdims=True))
        object.__setattr__(self, "frequencies_hz", frequencies_hz)
        object.__setattr__(self, "gains_db", gains_db)
        object.__setattr__(self, "facing", tuple(unit(self.facing).tolist()))  # may be compared and hashed
        object.__setattr__(self, "up", unit(self.up))
        if np.linalg.norm(np.cross(self.facing, self.up)) < 1e-6:
            raise ValueError(f"up={list(self.up)} must not be parallel to facing={list(self.facing)}: choose another")

    def pressure(self, directions: FloatArray, fs_hz: float) -> FloatArray:
        """Return the gains in some directions, shape (n, n_bands)."""
        front = np.asarray(self.facing)
        left = unit(np.cross(np.asarray(self.up), front))
        local = directions @ np.stack([front, left, np.cross(front, left)], axis=1)
        measured = self._half_planes or self._triangles
        near, weight = self._nearest(local) if measured is None else measured.around(local)
        return np.einsum("nk,nkb->nb", weight, self._in_bands(fs_hz)[near])

    @cached_property
    def _half_planes(self) -> "_HalfPlanes | None":
        """The half-planes of polar diagrams: there are no more of them than directions in each."""
        from_axis, about = _polar(self.directions)
        on_axis = np.flatnonzero(np.sin(from_axis) < _SAME_RAD)
        rows = np.setdiff1d(np.argsort(about, kind="stable"), on_axis, assume_unique=True)
        begins = np.mod(about[rows] - np.roll(about[rows], 1), 2.0 * np.pi) > _SAME_RAD
        begins[:1] |= not begins.any()
        n_planes = np.count_nonzero(begins)
        if not len(rows) or n_planes ** 2 > len(self.directions):
            return None
        plane = (np.cumsum(begins) - 1) % n_planes  # the last one may reach beyond a full turn
        angles, measured = [], []
        for n in range(n_planes):
            of_plane = np.concatenate([rows[plane == n], on_axis])
            of_plane = of_plane[np.unique(from_axis[of_plane], return_index=True)[1]]
            angles.append(from_axis[of_plane])
            measured.append(of_plane)
        return _HalfPlanes(about[rows[begins]], angles, measured)

    @cached_property
    def _triangles(self) -> "_Triangles | None":
        """Triangles of measured directions, where these surround the device.

        The convex hull of points on a sphere is their Delaunay triangulation.
        """
        from scipy.spatial import ConvexHull, QhullError, cKDTree

        _, first = np.unique(np.round(self.directions, 9), axis=0, return_index=True)
        try:
            hull = ConvexHull(self.directions[first])
        except (QhullError, ValueError):  # too few, or all in one plane
            return None
        if hull.equations[:, 3].max() > -_LEAST_SURROUND:
            return None
        corners = first[hull.simplices]
        met = hull.equations[:, :3] / -hull.equations[:, 3:]
        squared = np.sum(met ** 2, axis=1, keepdims=True)
        return _Triangles(corners, np.linalg.inv(self.directions[corners].transpose(0, 2, 1)),
                          cKDTree(np.concatenate([met, np.sqrt(squared.max() - squared)], axis=1)))

    def _nearest(self, directions: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return the nearest measured directions and their weights, shape (n, `_N_NEIGHBOURS`)."""
        from scipy.spatial import cKDTree

        count = min(_N_NEIGHBOURS, len(self.directions))
        distance, near = cKDTree(self.directions).query(directions, k=count)
        weight = 1.0 / np.maximum(np.reshape(distance, (-1, count)), 1e-6)
        return np.reshape(near, (-1, count)), weight / weight.sum(axis=1, keepdims=True)

    def _in_bands(self, fs_hz: float) -> FloatArray:
        if fs_hz not in self._bands:
            at_hz = [self._frequencies_in(band_hz, 0.5 * fs_hz) for band_hz in exact_bands_hz(fs_hz)]
            counts = np.array([len(of_band) for of_band in at_hz])
            place, known = np.log(np.concatenate(at_hz)), np.log(self.frequencies_hz)
            energy = 10.0 ** (0.1 * np.array([np.interp(place, known, row) for row in self.gains_db]))
            first = np.cumsum(counts) - counts
            self._bands[fs_hz] = np.sqrt(np.add.reduceat(energy, first, axis=1) / counts)
        return self._bands[fs_hz]

    def _frequencies_in(self, band_hz: float, highest_hz: float) -> FloatArray:
        """Return frequencies over which the energy in an octave is averaged, its middle where at most one was measured.
        """
        low_hz, high_hz = band_hz / np.sqrt(2.0), min(band_hz * np.sqrt(2.0), highest_hz)
        n_measured = np.count_nonzero((self.frequencies_hz >= low_hz) & (self.frequencies_hz <= high_hz))
        share = (np.arange(_PER_BAND) + 0.5) / _PER_BAND
        return low_hz * (high_hz / low_hz) ** share if n_measured > 1 else np.array([band_hz])


class _HalfPlanes(NamedTuple):
    """Half-planes from the main axis in which directions were measured.

    Attributes
    ----------
    about
        Angle of each about the axis, ascending [rad].
    from_axis
        Angles of the directions in each from the axis, ascending [rad].
    rows
        Indices of these directions.
    """

    about: FloatArray
    from_axis: list[FloatArray]
    rows: list[IntArray]

    def around(self, directions: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return two measured directions in the half-plane on either side, and their weights, shape (n, 4) each."""
        from_axis, about = _polar(directions)
        after = np.searchsorted(self.about, about, side="right")
        sides = (after - 1) % len(self.about), after % len(self.about)
        apart, since = (np.mod(angle - self.about[sides[0]], 2.0 * np.pi) for angle in (self.about[sides[1]], about))
        turned = np.sin(0.5 * np.pi * since / np.where(apart > 0.0, apart, 2.0 * np.pi)) ** 2
        near, weight = np.empty((len(directions), 4), int), np.empty((len(directions), 4))
        for side, (of_side, share) in enumerate(zip(sides, (1.0 - turned, turned), strict=True)):
            for plane in np.unique(of_side):
                at, rows = np.flatnonzero(of_side == plane), self.rows[plane]
                place = np.interp(from_axis[at], self.from_axis[plane], np.arange(len(rows)))
                low = place.astype(int)
                near[at, 2 * side], near[at, 2 * side + 1] = rows[low], rows[np.minimum(low + 1, len(rows) - 1)]
                weight[at, 2 * side] = share[at] * (1.0 - place + low)
                weight[at, 2 * side + 1] = share[at] * (place - low)
        return near, weight


class _Triangles(NamedTuple):
    """Triangles of measured directions that surround the device: the convex hull of points on a sphere.

    Attributes
    ----------
    corners
        Indices of measured directions, shape (n_triangles, 3).
    inverses
        Of the matrices whose columns are the corners, shape (n_triangles, 3, 3): times a direction, the weights of the
        corners. None is negative in the triangle that the direction lies in.
    tree
        Finds the triangles whose planes a direction meets first. A plane with the unit normal n at the distance d from
        the device meets the direction u at ``1 / (n u / d)``, and the largest product of u with a vector p is with the
        nearest point ``(p, sqrt(max |p|^2 - |p|^2))`` to ``(u, 0)``.
    """

    corners: IntArray
    inverses: FloatArray
    tree: "cKDTree"

    def around(self, directions: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return the corners of the triangle that each direction lies in, and their weights, shape (n, 3) each."""
        chosen, weights = np.empty((len(directions), 3), int), np.empty((len(directions), 3))
        left = np.arange(len(directions))
        for count in [*(few for few in _CANDIDATES if few < len(self.corners)), len(self.corners)]:
            step = max(1, _ELEMENTS // (9 * count))
            for rows in (left[first:first + step] for first in range(0, len(left), step)):
                chosen[rows], weights[rows] = self._best_of(count, directions[rows])
            left = left[weights[left].min(axis=1) < -_ROUNDING]
        weights = np.maximum(weights, 0.0)
        return chosen, weights / weights.sum(axis=1, keepdims=True)

    def _best_of(self, count: int, directions: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return corners and weights, shape (n, 3) each, of the best of the triangles whose planes are met first."""
        near = self.tree.query(np.pad(directions, ((0, 0), (0, 1))), k=np.arange(1, count + 1))[1]
        weights = np.einsum("nfij,nj->nfi", self.inverses[near], directions)
        best = weights.min(axis=2).argmax(axis=1)
        each = np.arange(len(directions))
        return self.corners[near[each, best]], weights[each, best]


def _polar(directions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return angles from the main axis, and about it from 0 to 2 pi, of directions of shape (n, 3) [rad]."""
    x, y, z = directions.T
    return np.arctan2(np.hypot(y, z), x), np.mod(np.arctan2(z, y), 2.0 * np.pi)


def unit(vector: ArrayLike) -> FloatArray:
    """Return a vector of shape (3,) with length 1.

    Raises
    ------
    ValueError
        It is not three finite numbers, or its length is 0.
    """
    values = _numbers("direction", vector)
    if values.shape != (3,) or not np.all(np.isfinite(values)) or not np.any(values):
        raise ValueError(f"direction {vector!r} must be three finite numbers, not all 0: correct it")
    return values / np.linalg.norm(values)


def _numbers(name: str, values: ArrayLike) -> FloatArray:
    try:
        return np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"{name}={values!r:.80} must be numbers: correct it") from None
