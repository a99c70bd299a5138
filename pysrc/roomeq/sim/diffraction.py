"""Diffraction at the edges of a mesh: first order here, two edges of one face in `double_diffraction`.

The line integral of Svensson, Fred and Vanderkooy (J. Acoust. Soc. Am. 106 (1999) 2331, eq. 8) over a rigid wedge
of the open angle ``theta_w``, in the coordinate ``eta`` of Biot and Tolstoy instead of the position z along the edge
(``d eta = (1/m + 1/l) dz``, where m and l are the two legs):

    h(t) = -nu / (4 pi)^2  integral of  delta(t - L / c) beta(eta) / L  d eta,     nu = pi / theta_w
    beta = sum over the signs of sin x / (cosh(nu eta) - cos x),                   x = nu (pi +- theta_s +- theta_r)
    L^2 = r_s^2 + r_r^2 + (z_s - z_r)^2 + 2 r_s r_r cosh eta

A term of beta has the integral ``2 / nu atan(cot(x / 2) tanh(nu eta / 2))``, so that each short bin of time gets
its exact share, even at shadow boundaries, where beta is unbounded. Of the four terms two continue the
direct sound across its shadow boundary; the other two continue the reflection at either face and are weighted with
the ``sqrt((1 - alpha) (1 - s))`` that the face reflects (as Luebbers, IEEE Trans. Antennas Propag. 32 (1984) 70).

Not included: paths that diffract at edges of different faces or more than twice, paths that diffract and reflect, and
edges that are close to another surface.
"""

import logging
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import numpy as np
import scipy  # its submodules are slow to import and load themselves when first used
from numpy.typing import ArrayLike
from scipy.fft import irfft, next_fast_len, rfft

from roomeq.acoustics.filterbank import SPREAD_S, octave_filterbank
from roomeq.core.arrays import Array, BoolArray, FloatArray, IntArray, Number
from roomeq.core.constants import FS_HZ
from roomeq.core.jit import compiled
from roomeq.sim.adjacency import FACET_RAD, joined_faces
from roomeq.sim.double_diffraction import (
    IN_PLANE_RAD,
    Pieces,
    arc,
    departures_and_arrivals,
    deposit_double_diffraction,
    find_double_paths,
)
from roomeq.sim.mesh import KEPT_POINTS, MeshRoom
from roomeq.sim.room import Room
from roomeq.sim.scene import Scene
from roomeq.sim.tree import EDGE_M

if TYPE_CHECKING:
    from roomeq.sim.context import Directivity

logger = logging.getLogger(__name__)

MAX_EDGES = 2000
PIECE_M = 0.05  # visibility is tested once per piece of this length
MAX_PIECES, MAX_PIECES_TWICE = 1000, 20  # largest number of pieces of an edge, for first and second order
_OFF_EDGE_M = 1e-3
_CLEAR_M = 0.05
"""Of air before an edge: sound passes the slit below furniture, or behind it, less well than an edge in the free."""
_OVERSAMPLING = 16
_GROWTH = 0.125  # length of a bin of time, relative to the time since the shortest path
_SHORTEST_BIN, _LONGEST_BIN = 2.0 ** -11, 0.5  # samples
_SINC_HALF = 32
_WAY_HALF = 8  # samples over which the directions of sound are averaged, if there is any
_ELSEWHERE = 1e-3  # weight of the sound that is further away
_ON_BOUNDARY = 1e-6


@dataclass(frozen=True)
class Edges:
    """Straight convex edges of a room's bodies and walls.

    Attributes
    ----------
    start_m
        Shape (n_edges, 3).
    along
        Unit vectors, shape (n_edges, 3).
    length_m
        Shape (n_edges,).
    across
        Unit vectors in the first face, away from the edge, where the angle is zero, shape (n_edges, 3).
    normal
        Normals of the first face into the air, where the angle is pi / 2, shape (n_edges, 3).
    wedge_rad
        Open angle, on the side of the air, in (pi, 2 pi], shape (n_edges,).
    surfaces
        Materials of the first face and the second, shape (n_edges, 2).
    faces
        Numbers of these faces, shape (n_edges, 2); triangles in one plane that meet are one face.
    n_left_out
        Number of edges beyond `MAX_EDGES`, the shortest.
    """

    start_m: FloatArray
    along: FloatArray
    length_m: FloatArray
    across: FloatArray
    normal: FloatArray
    wedge_rad: FloatArray
    surfaces: IntArray
    faces: IntArray
    n_left_out: int = 0

    def __len__(self) -> int:
        return len(self.length_m)

    def coordinates(self, point_m: ArrayLike) -> FloatArray:
        """Return cylinder coordinates about each edge, distance [m], angle [rad], position [m], shape (3, n_edges).

        A point in the plane of a face is in front of it, whatever the rounding (`IN_PLANE_RAD`).
        """
        offset = np.asarray(point_m, dtype=float) - self.start_m
        x, y, z = (np.einsum("ij,ij->i", offset, axis) for axis in (self.across, self.normal, self.along))
        angle = np.mod(np.arctan2(y, x), 2.0 * np.pi)
        angle = np.where(np.abs(angle - self.wedge_rad) < IN_PLANE_RAD, self.wedge_rad, angle)
        return np.stack([np.hypot(x, y), np.where(angle > 2.0 * np.pi - IN_PLANE_RAD, 0.0, angle), z])


@dataclass(frozen=True)
class Diffracted:
    """Sound diffracted to one microphone, before the losses of materials and air.

    Attributes
    ----------
    first_sample
        Time of the first sample of `signals`.
    signals
        The continuation of the direct sound, and that of the reflection at faces of each surface, shape
        (1 + n_surfaces, n).
    departure, arrival
        Unit vectors from the source, and from the microphone, to where the sound of each sample is diffracted, in the
        mean, shape (n, 3); None if they were not asked for.
    """

    first_sample: int
    signals: FloatArray
    departure: FloatArray | None = None
    arrival: FloatArray | None = None

    def response(self, absorption: FloatArray, scene: Scene, n_samples: int,
                 source_directivity: "Directivity | None" = None, mic_directivity: "Directivity | None" = None
                 ) -> FloatArray:
        """Apply directivities and the losses of materials and air, and add up.

        Parameters
        ----------
        absorption
            In place of that of the scene, shape (n_surfaces, n_bands).
        scene
            As the sound was diffracted in.
        n_samples
        source_directivity, mic_directivity
            None is omnidirectional. The others need `departure` and `arrival`.

        Returns
        -------
        ndarray, shape (n_samples,)
            Part of a response; sample 0 is the emission.
        """
        fs_hz = scene.fs_hz
        kept = np.sqrt((1.0 - absorption) * (1.0 - scene.scattering))
        time_s = (self.first_sample + np.arange(self.signals.shape[1])) / fs_hz
        loss = np.exp(-0.5 * scene.air.speed_m_s * np.maximum(time_s, 0.0) * scene.attenuation_per_m[:, None])
        for directivity, ways in ((source_directivity, self.departure), (mic_directivity, self.arrival)):
            if directivity is not None:
                assert ways is not None
                loss *= directivity(ways).T
        bands = loss * np.einsum("sb,sn->bn", np.vstack([np.ones(kept.shape[1]), kept]), self.signals)
        guard = int(SPREAD_S * fs_hz)
        n_fft = next_fast_len(bands.shape[1] + 2 * guard, real=True)
        spectrum = np.einsum("bf,bf->f", rfft(np.pad(bands, ((0, 0), (guard, guard))), n_fft),
                             octave_filterbank(n_fft, fs_hz))
        shaped = irfft(spectrum, n_fft)
        result = np.zeros(n_samples)
        start = self.first_sample - guard
        low, high = max(0, start), min(n_samples, start + n_fft)
        result[low:high] = shaped[low - start:high - start]
        return result


def find_edges(room: Room) -> Edges | None:
    """Return the edges of a room whose open angle exceeds pi; None if it has none, as every convex room.

    They are computed once per room.
    """
    if room.convex:
        return None
    mesh = cast(MeshRoom, room)
    return mesh.remember("edges", (), 1, lambda: _find_edges(mesh))


def _find_edges(room: MeshRoom) -> Edges | None:
    (first, second), start, end, opposite = room.meetings.faces.T, *room.meetings[1:]
    along = _unit(end - start)

    def away(which: int) -> FloatArray:
        way = opposite[:, which] - start
        return _unit(way - np.einsum("ij,ij->i", way, along)[:, None] * along)

    across, other, normal = away(0), away(1), room.normals[first]
    wedge = np.mod(np.arctan2(np.einsum("ij,ij->i", other, normal), np.einsum("ij,ij->i", other, across)), 2 * np.pi)
    chosen = np.flatnonzero(wedge > np.pi + FACET_RAD)
    if not len(chosen):
        return None
    faces = np.stack([first, second], axis=1)[chosen]
    return _merged(start[chosen], end[chosen], along[chosen], across[chosen], normal[chosen], wedge[chosen],
                   room.face_surface[faces], joined_faces(room.planes, room.meetings)[faces])


def _merged(start: FloatArray, end: FloatArray, along: FloatArray, across: FloatArray, normal: FloatArray,
            wedge: FloatArray, surfaces: IntArray, faces: IntArray) -> Edges:
    """Join adjacent edges on one line between the same faces."""
    swap = faces[:, 0] > faces[:, 1]
    key = np.where(swap[:, None], np.hstack([faces[:, ::-1], surfaces[:, ::-1]]), np.hstack([faces, surfaces]))
    _, group = np.unique(key, axis=0, return_inverse=True)
    kept = []
    for n in range(group.max() + 1):
        members = np.flatnonzero(np.ravel(group) == n)
        lead = members[0]
        spans = np.sort([[(point[m] - start[lead]) @ along[lead] for point in (start, end)] for m in members], axis=1)
        low, high = None, None
        for a, b in spans[np.argsort(spans[:, 0])]:
            if high is not None and a <= high + 1e-4:
                high = max(high, b)
                continue
            if high is not None:
                kept.append((lead, low, high))
            low, high = a, b
        kept.append((lead, low, high))
    kept.sort(key=lambda edge: (edge[1] - edge[2], edge[0]))
    if len(kept) > MAX_EDGES:
        logger.warning("the mesh has %d edges that diffract: the %d longest do, the others, up to %.3g m, don't",
                       len(kept), MAX_EDGES, kept[MAX_EDGES][2] - kept[MAX_EDGES][1])
    leads = np.array([edge[0] for edge in kept[:MAX_EDGES]])
    lows, highs = np.array([edge[1:] for edge in kept[:MAX_EDGES]]).T
    return Edges(start[leads] + lows[:, None] * along[leads], along[leads], highs - lows, across[leads], normal[leads],
                 wedge[leads], surfaces[leads], faces[leads], max(0, len(kept) - MAX_EDGES))


def _unit(vectors: FloatArray) -> FloatArray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _pieces(room: MeshRoom, edges: Edges, most: int) -> Pieces:
    """Cut all edges into short pieces, each edge into at most `most`."""
    known = room._cache.setdefault("edge_pieces", {})
    if most not in known:
        count = np.clip(np.ceil(edges.length_m / PIECE_M).astype(int), 1, most)
        edge = np.repeat(np.arange(len(edges)), count)
        step = (edges.length_m / count)[edge]
        number = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
        half = 0.5 * edges.wedge_rad[:, None]
        outward = np.cos(half) * edges.across + np.sin(half) * edges.normal
        middle = edges.start_m[edge] + ((number + 0.5) * step)[:, None] * edges.along[edge]
        near, far = (middle + off_m * outward[edge] for off_m in (_OFF_EDGE_M, _CLEAR_M))
        known[most] = Pieces(edge, number * step, (number + 1) * step, near, room.sees(near, far))
    return cast(Pieces, known[most])


def _seen(room: MeshRoom, edges: Edges, most: int, point_m: ArrayLike) -> BoolArray:
    """Tell which pieces with air before them are seen from a point; computed once per point.

    The line of sight starts in the air: a piece may lie behind the floor that furniture stands on.
    """
    key, pieces = (most, *(float(value) for value in np.asarray(point_m))), _pieces(room, edges, most)
    return room.remember("edges_seen", key, KEPT_POINTS,
                         lambda: pieces.clear & room.sees(np.asarray(key[1:]), pieces.point_m))


def diffract(room: Room, source_pos_m: ArrayLike, mic_pos_m: ArrayLike, *, speed_m_s: float, n_samples: int,
             direct_visible: bool, fs_hz: float = FS_HZ, directions: bool = False) -> Diffracted | None:
    """Compute the sound that reaches a microphone over one edge, or over two edges of one face.

    Parameters
    ----------
    room
    source_pos_m, mic_pos_m
        Shape (3,).
    speed_m_s
    n_samples
        Later arrivals are left out.
    direct_visible
        Whether the direct sound is included elsewhere; it decides the sign exactly on its shadow boundary.
    fs_hz
    directions
        Whether to find where the sound comes from and goes to, for directive sources and microphones.

    Returns
    -------
    Diffracted or None
        None if there is no such path.
    """
    edges, mesh = find_edges(room), cast(MeshRoom, room)
    if edges is None:
        return None
    coarse, (edge, low, high, _, _) = (_pieces(mesh, edges, most) for most in (MAX_PIECES_TWICE, MAX_PIECES))
    double_paths = find_double_paths(
        mesh, edges, coarse, source_pos_m, _seen(mesh, edges, MAX_PIECES_TWICE, source_pos_m), mic_pos_m,
        _seen(mesh, edges, MAX_PIECES_TWICE, mic_pos_m))
    both = np.flatnonzero(_seen(mesh, edges, MAX_PIECES, source_pos_m) & _seen(mesh, edges, MAX_PIECES, mic_pos_m))
    if not len(both) and not len(double_paths):
        return None
    opens = np.append(True, (np.diff(both) > 1) | (np.diff(edge[both]) > 0))[:len(both)]
    closes = np.append(opens[1:], True)[:len(both)]
    size_m = np.linalg.norm(np.subtract(*mesh.bounds_m))
    distance_m = np.linalg.norm(np.subtract(source_pos_m, mic_pos_m))
    grid = Grid.between(distance_m, 3.0 * size_m, len(room.surfaces), speed_m_s / fs_hz, n_samples, directions)
    deposit(grid, edges, edge[both[opens]], low[both[opens]], high[both[closes]], source_pos_m, mic_pos_m,
            direct_visible=direct_visible)
    deposit_double_diffraction(grid.fine, grid.ways, grid.first_sample, double_paths, edges, coarse, source_pos_m,
                               mic_pos_m, sample_m=speed_m_s / fs_hz, oversampling=_OVERSAMPLING)
    return grid.sampled()


@dataclass(frozen=True)
class Grid:
    """A fine grid of time that contributions are added to.

    Attributes
    ----------
    fine
        Pressure, see `Diffracted.signals`.
    ways
        Sum of the `departure` and `arrival` of contributions, by their magnitude, shape (6, n); (0, n) if they are not
        asked for.
    first_sample
    sample_m
        Way of sound in one sample.
    """

    fine: FloatArray
    ways: FloatArray
    first_sample: int
    sample_m: float

    @classmethod
    def between(cls, distance_m: Number, longest_m: Number, n_surfaces: int, sample_m: float,
                n_samples: int, directions: bool = False) -> "Grid":
        """Return a grid for paths of `distance_m` to `longest_m`, up to sample `n_samples`."""
        first = int(np.floor(distance_m / sample_m)) - 1
        last = min(int(np.ceil(longest_m / sample_m)) + 1, n_samples)
        n_points = max(0, last - first) * _OVERSAMPLING + 1
        return cls(np.zeros((1 + n_surfaces, n_points)), np.zeros((6 * directions, n_points)), first, sample_m)

    def sampled(self) -> Diffracted | None:
        """Resample the contributions to the sample rate; None if there are none."""
        used = np.flatnonzero(self.fine.any(axis=0))
        if not len(used):
            return None
        signals = scipy.signal.fftconvolve(self.fine[:, :used[-1] + 1], _lowpass()[None], axes=1)[:, ::_OVERSAMPLING]
        if not len(self.ways):
            return Diffracted(self.first_sample - _SINC_HALF, signals)
        # without a transform, whose rounding would point somewhere where there is no sound
        ways = scipy.signal.upfirdn(_average(), self.ways[:, :used[-1] + 1], down=_OVERSAMPLING, axis=1)
        departure, arrival = (way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), np.finfo(float).tiny)
                              for way in (ways[:3].T, ways[3:].T))
        return Diffracted(self.first_sample - _SINC_HALF, signals, departure, arrival)


def deposit(grid: Grid, edges: Edges, edge: IntArray, low_m: FloatArray, high_m: FloatArray, source_pos_m: ArrayLike,
            mic_pos_m: ArrayLike, *, direct_visible: bool) -> None:
    """Add the first-order diffraction at some stretches of edges to a grid.

    Parameters
    ----------
    grid
    edges
    edge
        Index of each stretch's edge, shape (n_stretches,).
    low_m, high_m
        Ends of each stretch along its edge, shape (n_stretches,).
    source_pos_m, mic_pos_m
        Shape (3,).
    direct_visible
        See `diffract`.
    """
    source, mic = edges.coordinates(source_pos_m)[:, edge], edges.coordinates(mic_pos_m)[:, edge]
    wedge = edges.wedge_rad[edge]
    on = (source[1] <= wedge) & (mic[1] <= wedge) & (source[0] > 1e-6) & (mic[0] > 1e-6)
    source, mic = source[:, on], mic[:, on]
    bounds = np.stack([_eta(low_m[on], source, mic), _eta(high_m[on], source, mic)])
    way = np.empty((np.count_nonzero(on), 0))
    if len(grid.ways):  # of a stretch, most sound takes the shortest way
        shortest_m = np.clip((source[0] * mic[2] + mic[0] * source[2]) / (source[0] + mic[0]), low_m[on], high_m[on])
        point_m = edges.start_m[edge[on]] + shortest_m[:, None] * edges.along[edge[on]]
        way = departures_and_arrivals(point_m, point_m, source_pos_m, mic_pos_m)
    _deposit(grid.fine, grid.ways, float(grid.first_sample), bounds, source, mic, wedge[on], edges.surfaces[edge[on]],
             way, 1.0 / grid.sample_m, direct_visible)


def _eta(z: FloatArray, source: FloatArray, mic: FloatArray) -> FloatArray:
    """Return Biot and Tolstoy's coordinate of positions on edges, signed, 0 for the shortest path."""
    return np.arcsinh((z - source[2]) / source[0]) + np.arcsinh((z - mic[2]) / mic[0])


def _lowpass() -> FloatArray:
    """Return the Hann-windowed sinc of the image sources' pulses, on the fine grid."""
    position = np.arange(-_SINC_HALF * _OVERSAMPLING, _SINC_HALF * _OVERSAMPLING + 1) / _OVERSAMPLING
    return np.sinc(position) * np.cos(0.5 * np.pi * position / _SINC_HALF) ** 2


def _average() -> FloatArray:
    """Return the window in which the directions of sound are averaged, on the fine grid."""
    position = np.arange(-_SINC_HALF * _OVERSAMPLING, _SINC_HALF * _OVERSAMPLING + 1) / _OVERSAMPLING
    near, far = (np.cos(0.5 * np.pi * np.clip(position / half, -1.0, 1.0)) ** 2 for half in (_WAY_HALF, _SINC_HALF))
    return near + _ELSEWHERE * far


@compiled
def _deposit(fine: Array, ways: Array, first: Number, bounds: Array, source: Array, mic: Array, wedge: Array,
             surfaces: Array, way: Array, to_samples: Number, direct_visible: bool) -> None:
    """Add all stretches to a fine grid of time: one branch on either side of the shortest path."""
    sine, cosine = np.empty(4), np.empty(4)
    for n in range(len(wedge)):
        nu = np.pi / wedge[n]
        less, more = source[1, n] - mic[1, n], source[1, n] + mic[1, n]
        signals = fine[0], fine[1 + surfaces[n, 0]], fine[1 + surfaces[n, 1]]
        for k, angle in enumerate((less, -less, -more, more)):
            half = 0.5 * nu * (np.pi + angle)
            sine[k], cosine[k] = np.sin(half), np.cos(half)
            if abs(sine[k]) < _ON_BOUNDARY:  # there it makes up for the jump of the direct sound or a reflection
                seen = direct_visible if k < 2 else _meets_face(source, mic, n, wedge[n], k == 3)
                sine[k] = np.copysign(_ON_BOUNDARY, cosine[k] if seen else -cosine[k])
            if sine[k] < 0.0:
                sine[k], cosine[k] = -sine[k], -cosine[k]
        squared = (source[0, n] - mic[0, n]) ** 2 + (source[2, n] - mic[2, n]) ** 2
        product = source[0, n] * mic[0, n]
        low, high = bounds[0, n], bounds[1, n]
        if low < 0.0:
            _branch(signals, ways, way[n], first, max(0.0, -high), -low, nu, sine, cosine, squared, product,
                    to_samples)
        if high > 0.0:
            _branch(signals, ways, way[n], first, max(0.0, low), high, nu, sine, cosine, squared, product,
                    to_samples)


@compiled
def _meets_face(source: Array, mic: Array, n: Number, wedge: Number, far: Number) -> bool:
    """Tell whether the reflection at a face of wedge `n` lies on the face, which reaches `EDGE_M` beyond the edge."""
    from_face, to_face = (wedge - source[1, n], wedge - mic[1, n]) if far else (source[1, n], mic[1, n])
    heights_m = source[0, n] * np.sin(from_face) + mic[0, n] * np.sin(to_face)
    return source[0, n] * mic[0, n] * np.sin(from_face + to_face) >= -EDGE_M * heights_m


@compiled
def _branch(signals: tuple[Array, Array, Array], ways: Array, way: Array, first: Number, low: Number, high: Number,
            nu: Number, sine: Array, cosine: Array, squared: Number, product: Number, to_samples: Number) -> None:
    """Integrate beta from eta = low to high by bins of time, the shorter the closer they are to the shortest path.

    Beta is steepest there, and may be unbounded. What a bin has is spread over it evenly. `signals` are the rows of the
    grid for the direct sound, and for the reflections at the first face and the second.
    """
    of_direct, of_near, of_far = signals
    apex_m = np.sqrt(squared + 4.0 * product)
    here = np.sqrt(squared + 4.0 * product * np.cosh(0.5 * low) ** 2)
    end_m = np.sqrt(squared + 4.0 * product * np.cosh(0.5 * high) ** 2)
    before = np.exp(nu * low)
    turns = np.empty(4)
    while here < end_m:
        width_m = min(max(_GROWTH * (here - apex_m), _SHORTEST_BIN / to_samples), _LONGEST_BIN / to_samples)
        there = min(here + width_m, end_m)
        quotient = np.sqrt(max((there - apex_m) * (there + apex_m) / (4.0 * product), 0.0))  # sinh(eta / 2)
        after = (quotient + np.sqrt(1.0 + quotient * quotient)) ** (2.0 * nu)  # exp(nu eta)
        # one arctangent for the difference of two, of tanh(nu eta / 2) = (exp(nu eta) - 1) / (exp(nu eta) + 1)
        rise, sums, differences = 2.0 * (before - after), (before + 1.0) * (after + 1.0), (before - 1.0) * (after - 1.0)
        for k in range(4):
            turns[k] = arc(rise * sine[k] * cosine[k],
                           sums * sine[k] * sine[k] + differences * cosine[k] * cosine[k])
        place, last = (here * to_samples - first) * _OVERSAMPLING, (there * to_samples - first) * _OVERSAMPLING
        n_parts = 1 + int(last - place)
        step, scale = (last - place) / n_parts, 1.0 / (4.0 * np.pi * np.pi * (here + there) * n_parts)
        direct, near, far = scale * (turns[0] + turns[1]), scale * turns[2], scale * turns[3]
        magnitude = scale * np.sum(np.abs(turns))
        place += 0.5 * step
        for _ in range(n_parts):
            index = int(place)
            if index + 1 >= len(of_direct):
                return
            share = place - index
            of_direct[index] += direct * (1.0 - share)
            of_direct[index + 1] += direct * share
            of_near[index] += near * (1.0 - share)
            of_near[index + 1] += near * share
            of_far[index] += far * (1.0 - share)
            of_far[index + 1] += far * share
            for k in range(len(ways)):
                ways[k, index] += magnitude * way[k]
            place += step
        here, before = there, after
