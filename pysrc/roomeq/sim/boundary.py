"""Gain of late sound at microphones and sources near surfaces.

Direct and reflected sound are in phase within a small part of a wavelength from a wall. In a diffuse field, the mean
squared pressure there is twice that in the middle of a room, at an edge four times, in a corner eight times
(Waterhouse, J. Acoust. Soc. Am. 27 (1955) 247). By reciprocity, a source radiates that much more power. Pressures of
image sources add in phase, but rays add energies, so that theirs is multiplied by

    1 + sum a_n sin(k d_n) / (k d_n)

over the images of the microphone or source at distances d_n from itself. Rays bring the energy of incident and of
reflected sound, 1 + R where a surface reflects the share R; of that, 2 sqrt(R (1 - s)) is in phase if it scatters the
share s. The ratio of both is a_n; for an image in several surfaces, the product of theirs. A surface that is small
against the wavelength, as a table at low frequencies, reflects little: its images do not count there. Directivities
weight each term with how alike they are ahead and in the mirror, ``<D(u) D(R u)> / <D(u)^2>`` over all directions u and
with the mirror image R u.
"""

from dataclasses import dataclass
from functools import cache
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import sici

from roomeq.core.arrays import FloatArray, IntArray
from roomeq.core.constants import BANDS_HZ, exact_bands_hz
from roomeq.sim.adjacency import joined_faces
from roomeq.sim.room import Room
from roomeq.sim.scene import Scene, Shoebox
from roomeq.sim.trace import sphere_directions
from roomeq.sim.walls import Walls

if TYPE_CHECKING:
    from roomeq.sim.context import Directivity
    from roomeq.sim.mesh import MeshRoom

_REACH = 0.3  # of the largest wavelength: the mean of sin(kd) / (kd) over an octave is negative from here on
_ACROSS = 0.7  # largest cosine between the normals of surfaces that form an edge or a corner


class _Surfaces(NamedTuple):
    """Surfaces next to a point: its height [m] above each, their normals into the air, numbers, and roots of areas."""

    height_m: FloatArray
    normals: FloatArray
    surface: IntArray
    extent_m: FloatArray


@dataclass(frozen=True)
class NearImages:
    """Images of a point in the nearest surfaces: the nearest one, and up to two that stand across it.

    Attributes
    ----------
    surface_counts
        Number of reflections at each surface, shape (n_images, n_surfaces).
    in_phase
        Share of the pressure of each image in rigid surfaces that is in phase with the point's own, shape
        (n_images, n_bands).
    """

    surface_counts: IntArray
    in_phase: FloatArray

    def gain(self, scene: Scene, absorption: FloatArray) -> FloatArray:
        """Return the gain of energy in each band, for absorption of shape (n_surfaces, n_bands), shape (n_bands,)."""
        reflected = 1.0 - absorption
        share = 2.0 * np.sqrt(reflected * (1.0 - scene.scattering)) / (1.0 + reflected)
        of_images = np.exp(self.surface_counts @ np.log(np.maximum(share, 1e-100)))
        return np.maximum(1.0 + np.sum(of_images * self.in_phase, axis=0), 0.0)


def near_images(scene: Scene, point_m: ArrayLike, directivity: "Directivity | None" = None) -> NearImages:
    """Find the images of a source or microphone at a point, shape (3,), in the surfaces next to it.

    An image counts where half a wavelength is less than the extent of its surfaces. Negative means over an octave, from
    about a quarter of a wavelength from the surface on, count as 0: further away, other surfaces are as near. At
    wavelengths above ``8 V / S``, where the room has more modes by its surface than by its volume (Kuttruff, Room
    Acoustics, ch. 3), there is no diffuse field, and no image counts.
    """
    beside = _beside(scene.room, np.asarray(point_m, dtype=float), _REACH * scene.air.speed_m_s / BANDS_HZ[0])
    nearest: list[int] = []
    for n in np.argsort(beside.height_m, kind="stable"):
        if len(nearest) < 3 and np.all(np.abs(beside.normals[nearest] @ beside.normals[n]) < _ACROSS):
            nearest.append(int(n))
    wavelength_m = scene.air.speed_m_s / np.array(exact_bands_hz(scene.fs_hz))
    diffuse = scene.room.surface_area_m2.sum() * wavelength_m < 8.0 * scene.room.volume_m3
    groups = [list(group) for size in (1, 2, 3) for group in combinations(nearest, size)]
    to_image_m = np.array([np.linalg.norm(2.0 * beside.height_m[group] @ beside.normals[group]) for group in groups])
    extent_m = np.array([beside.extent_m[group].min() for group in groups])
    low, high = (2.0 * np.pi * edge * to_image_m[:, None] / wavelength_m for edge in (0.5 ** 0.5, 2.0 ** 0.5))
    mean = np.maximum((sici(high)[0] - sici(low)[0]) / (high - low), 0.0)
    in_phase = mean * (diffuse & (0.5 * wavelength_m < extent_m[:, None]))
    heard = np.flatnonzero(in_phase.any(axis=1))
    groups, in_phase = [groups[n] for n in heard], in_phase[heard]
    if directivity is not None and groups:
        in_phase = in_phase * _likeness(directivity, [beside.normals[group] for group in groups])
    counts = [np.bincount(beside.surface[group], minlength=len(scene.room.surfaces)) for group in groups]
    return NearImages(np.reshape(counts, (len(groups), len(scene.room.surfaces))).astype(int), in_phase)


def _likeness(directivity: "Directivity", mirrors: list[FloatArray]) -> FloatArray:
    """Return how alike a directivity and its images are, shape (n_images, n_bands).

    Each image is of some mirrors, which have normals of shape (n, 3).
    """
    directions = [_directions()]
    for normals in mirrors:
        mirrored = directions[0]
        for normal in normals:
            mirrored = mirrored - 2.0 * (mirrored @ normal)[:, None] * normal
        directions.append(mirrored)
    ahead, *behind = np.split(directivity(np.concatenate(directions)), len(directions))
    power = np.sqrt(np.sum(ahead ** 2, axis=0) * np.sum(np.square(behind), axis=1))
    return np.sum(ahead * behind, axis=1) / np.maximum(power, np.finfo(float).tiny)


@cache
def _directions() -> FloatArray:
    return sphere_directions(200, np.random.default_rng(0))


def _beside(room: Room, point_m: FloatArray, reach_m: float) -> _Surfaces:
    """Find the surfaces whose mirrors show a point to itself, up to a distance."""
    if isinstance(room, Shoebox):
        walls = cast(Walls, room.walls)
        height_m = walls.normals @ point_m - walls.offsets
        at = np.flatnonzero(height_m < reach_m)
        return _Surfaces(height_m[at], walls.normals[at], walls.face_surface[at], np.sqrt(room.surface_area_m2[at]))
    mesh = cast("MeshRoom", room)
    region = mesh.remember("regions", None, 1, lambda: joined_faces(mesh.planes, mesh.meetings))
    height_m = mesh.planes.mirrors[:, :3] @ point_m - mesh.planes.mirrors[:, 3]
    plane = np.flatnonzero((height_m > 0.0) & (height_m < reach_m))
    face, _ = mesh.first_hits(np.tile(point_m, (len(plane), 1)), -mesh.planes.mirrors[plane, :3])
    shown = (face >= 0) & (mesh.planes.of_face[face] == plane)
    plane, face = plane[shown], face[shown]
    return _Surfaces(height_m[plane], mesh.planes.mirrors[plane, :3], mesh.face_surface[face],
                     np.sqrt(np.bincount(region, mesh.face_area_m2)[region[face]]))
