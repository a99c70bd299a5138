"""The simulated scene: materials, rooms, air, and positions of source and microphone.

Conventions: metres, seconds, degrees Celsius. A room has *surfaces*, named parts of its surface that hold one
material each: the six walls of a shoebox, the materials of a mesh.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from roomeq.acoustics.air import band_attenuation_per_m, speed_of_sound_m_s
from roomeq.core.arrays import FloatArray
from roomeq.core.constants import BANDS_HZ, FS_HZ, MAX_ROOM_M, MIN_ROOM_M, bands_hz, is_number, require_fs
from roomeq.records.geometry import MIN_DISTANCE_M, is_too_close
from roomeq.sim.room import Room
from roomeq.sim.walls import Walls

N_BANDS = len(BANDS_HZ)
WALLS = ("west", "east", "south", "north", "floor", "ceiling")
"""Surfaces of a shoebox: x = 0, x = length, y = 0, y = width, z = 0, z = height."""

MIN_WALL_DISTANCE_M = 0.01


@dataclass(frozen=True)
class Material:
    """Absorption and scattering of a surface in octave bands from 62.5 Hz on.

    Attributes
    ----------
    name
    absorption
        Random-incidence absorption coefficients in [0, 1]: eight, 62.5 Hz to 8 kHz, or nine, to 16 kHz.
    scattering
        Scattering coefficients in [0, 1], likewise: shares of the reflected energy that do not leave in the specular
        direction (ISO 17497-1).

    Raises
    ------
    ValueError
        A coefficient lies outside [0, 1], or there are neither eight nor nine nor one, which applies to all bands.
    """

    name: str
    absorption: tuple[float, ...]
    scattering: tuple[float, ...]

    def __post_init__(self) -> None:
        for kind in ("absorption", "scattering"):
            object.__setattr__(self, kind, self._checked(kind, getattr(self, kind)))

    def _checked(self, kind: str, values: ArrayLike) -> tuple[float, ...]:
        if (type(values) is tuple and len(values) in (N_BANDS, N_BANDS + 1)
                and all(type(value) is float and 0.0 <= value <= 1.0 for value in values)):
            return values  # as those of another material are, whose copies are made by the thousand
        try:
            given = np.asarray(values)
            if given.dtype.kind not in "iuf":  # True and "0.1" would be converted
                raise TypeError
            bands = tuple(float(value) for value in (
                given if given.shape == (N_BANDS + 1,) else np.broadcast_to(given, N_BANDS)))
        except (ValueError, TypeError):
            raise ValueError(f"{kind}={values!r} of material {self.name!r} must be {N_BANDS} numbers "
                             f"(62.5 Hz to 8 kHz), {N_BANDS + 1} (to 16 kHz) or one: correct the material") from None
        for band, value in enumerate(bands):
            if not 0.0 <= value <= 1.0:
                raise ValueError(f"{kind}[{band}]={value:g} of material {self.name!r} must lie in [0, 1]: "
                                 "correct the material")
        return bands


@dataclass(frozen=True)
class Air:
    """The air in a room.

    Attributes
    ----------
    temperature_c
    humidity_pct
        Relative humidity.
    """

    temperature_c: float = 20.0
    humidity_pct: float = 50.0

    def __post_init__(self) -> None:
        band_attenuation_per_m(self.temperature_c, self.humidity_pct)

    @property
    def speed_m_s(self) -> float:
        return speed_of_sound_m_s(self.temperature_c)

    @property
    def attenuation_per_m(self) -> FloatArray:
        """Energy attenuation of the eight bands to 8 kHz at the sample rate of 16 kHz, shape (8,)."""
        return np.array(band_attenuation_per_m(self.temperature_c, self.humidity_pct))


@cache
def _gauss_legendre() -> tuple[FloatArray, FloatArray]:
    return np.polynomial.legendre.leggauss(64)


@dataclass(frozen=True)
class Shoebox:
    """A rectangular room with one corner at the origin.

    Attributes
    ----------
    dims_m
        Length, width, height (x, y, z).
    surfaces
        Their names: west at x = 0, east, south at y = 0, north, floor at z = 0, ceiling.

    Raises
    ------
    ValueError
        A dimension is not in (0.1, 200] m.
    """

    dims_m: tuple[float, ...]
    convex = True
    surfaces: ClassVar[tuple[str, ...]] = WALLS

    def __post_init__(self) -> None:
        dims_m = tuple(float(value) if is_number(value) else value for value in self.dims_m)
        object.__setattr__(self, "dims_m", dims_m)
        if len(dims_m) != 3 or not all(is_number(value) and MIN_ROOM_M <= value <= MAX_ROOM_M for value in dims_m):
            raise ValueError(f"room_dims_m={list(dims_m)} must be three lengths in [{MIN_ROOM_M:g}, {MAX_ROOM_M:g}] m: "
                             "correct the room")

    @property
    def volume_m3(self) -> float:
        return float(np.prod(self.dims_m))

    @property
    def surface_area_m2(self) -> FloatArray:
        length, width, height = self.dims_m
        return np.repeat([width * height, length * height, length * width], 2)

    @cached_property
    def walls(self) -> Walls | None:
        normals = np.repeat(np.eye(3), 2, axis=0) * np.array([1.0, -1.0] * 3)[:, None]
        offsets = np.where(np.arange(6) % 2 == 0, 0.0, -np.repeat(self.dims_m, 2))
        return Walls(normals, offsets, np.arange(6), np.zeros(6, np.bool_), np.array(self.dims_m))

    def sphere_radius_m(self, center_m: ArrayLike, radius_m: float) -> float:
        """Radius of a receiver sphere: as wanted, since walls only cut it."""
        return radius_m

    def require_inside(self, name: str, position_m: Sequence[float] | FloatArray) -> None:
        """Raise ValueError unless a position lies in the room and keeps a minimum distance from the walls."""
        for axis, (value, size_m) in enumerate(zip(position_m, self.dims_m, strict=True)):
            if not MIN_WALL_DISTANCE_M <= value <= size_m - MIN_WALL_DISTANCE_M:
                raise ValueError(
                    f"{name}[{axis}]={value:g} must lie in [{MIN_WALL_DISTANCE_M:g}, "
                    f"{size_m - MIN_WALL_DISTANCE_M:g}] m of a room of {list(self.dims_m)} m: correct it")

    def sphere_volume_m3(self, center_m: ArrayLike, radius_m: float) -> float:
        """Volume of the part of a sphere that lies in the room."""
        node, weight = _gauss_legendre()
        low, high = (np.clip([-radius_m, radius_m], -np.asarray(center_m)[:, None],
                             np.asarray(self.dims_m)[:, None] - np.asarray(center_m)[:, None])).T
        y, z = (0.5 * (high[axis] - low[axis]) * node + 0.5 * (high[axis] + low[axis]) for axis in (1, 2))
        if np.all(low == -radius_m) and np.all(high == radius_m):
            return 4.0 / 3.0 * np.pi * radius_m ** 3
        half = np.sqrt(np.maximum(radius_m ** 2 - y[:, None] ** 2 - z[None, :] ** 2, 0.0))
        depth = np.minimum(half, high[0]) - np.maximum(-half, low[0])
        area = 0.25 * (high[1] - low[1]) * (high[2] - low[2])
        return float(area * weight @ depth @ weight)


@dataclass(frozen=True)
class Scene:
    """A room with its materials and air, and the sample rate of its responses.

    Attributes
    ----------
    room
    materials
        One per surface of the room. A band above those of a material takes the value of the highest one.
    air
    fs_hz
        From 8 to 48 kHz. The octave bands are those below half of it (`roomeq.core.constants.bands_hz`).

    Raises
    ------
    ValueError
        The number of materials is not the number of surfaces, or the sample rate is out of range.
    """

    room: Room
    materials: Sequence[Material]
    air: Air = Air()
    fs_hz: int = FS_HZ

    def __post_init__(self) -> None:
        object.__setattr__(self, "fs_hz", require_fs(self.fs_hz))
        object.__setattr__(self, "materials", tuple(self.materials))
        if len(self.materials) != len(self.room.surfaces):
            raise ValueError(f"{len(self.materials)} materials must be one for each of the room's "
                             f"{len(self.room.surfaces)} surfaces ({', '.join(self.room.surfaces)}): give that many")

    @property
    def n_bands(self) -> int:
        """Number of octave bands below half the sample rate."""
        return len(bands_hz(self.fs_hz))

    @property
    def absorption(self) -> FloatArray:
        """Absorption coefficients, shape (n_surfaces, n_bands)."""
        return np.array([self._in_bands(material.absorption) for material in self.materials])

    @property
    def scattering(self) -> FloatArray:
        """Scattering coefficients, shape (n_surfaces, n_bands)."""
        return np.array([self._in_bands(material.scattering) for material in self.materials])

    @property
    def attenuation_per_m(self) -> FloatArray:
        """Energy attenuation of the air, shape (n_bands,)."""
        if self.fs_hz == FS_HZ:  # the air of a model has no temperature
            return self.air.attenuation_per_m
        return np.array(band_attenuation_per_m(self.air.temperature_c, self.air.humidity_pct, self.fs_hz))

    def _in_bands(self, values: tuple[float, ...]) -> tuple[float, ...]:
        return (*values, values[-1])[:self.n_bands]


def with_absorption(scene: Scene, absorption: ArrayLike) -> Scene:
    """Return the scene with other absorption coefficients, shape (n_surfaces, n_bands)."""
    rows = np.asarray(absorption, dtype=float).tolist()
    materials = [Material(material.name, (*row, *row[-1:] * (N_BANDS - len(row))), material.scattering)  # 7 at 8 kHz
                 for material, row in zip(scene.materials, rows, strict=True)]
    return replace(scene, materials=materials)


def check_positions(room: Room, source_pos_m: ArrayLike, mic_pos_m: ArrayLike) -> None:
    """Raise ValueError unless source and microphone, shape (3,) each, lie in the room and apart."""
    for name, position_m in (("source_pos_m", source_pos_m), ("mic_pos_m", mic_pos_m)):
        if np.shape(position_m) != (3,) or not np.all(np.isfinite(np.asarray(position_m, dtype=float))):
            raise ValueError(f"{name}={position_m!r} must be three finite numbers: correct the position")
        room.require_inside(name, np.asarray(position_m))
    require_apart(source_pos_m, mic_pos_m)


def require_apart(source_pos_m: ArrayLike, mic_pos_m: ArrayLike) -> None:
    """Raise ValueError unless source and microphone, shape (3,) each, keep a minimum distance from each other."""
    distance_m = float(np.linalg.norm(np.subtract(source_pos_m, mic_pos_m)))
    if is_too_close(distance_m):
        raise ValueError(f"source and microphone are {distance_m:g} m apart and must be at least "
                         f"{MIN_DISTANCE_M:g} m: correct the positions, or leave them out")


def eyring_absorption_area_m2(scene: Scene, absorption: FloatArray | None = None) -> FloatArray:
    """Return Eyring's absorption area per band, ``-ln(1 - alpha_mean) S + 4 m V`` (J. Acoust. Soc. Am. 1 (1930) 217).

    `absorption`, shape (n_surfaces, n_bands), replaces that of the scene.
    """
    area_m2 = scene.room.surface_area_m2
    mean = area_m2 @ (scene.absorption if absorption is None else absorption) / area_m2.sum()
    return eyring_area_of_mean(mean, area_m2.sum(), scene.attenuation_per_m, scene.room.volume_m3)


def eyring_area_of_mean(mean: FloatArray, surface_m2: float | FloatArray, attenuation_per_m: FloatArray,
                        volume_m3: float) -> FloatArray:
    """Return the absorption area of mean absorption coefficients, ``-S ln(1 - alpha) + 4 m V`` [m2].

    For a volume of 1 and the surface per volume, it is the area per volume.
    """
    return -np.log(1.0 - np.minimum(mean, 1.0 - 1e-6)) * surface_m2 + 4.0 * attenuation_per_m * volume_m3


def needed_area_m2(volume_m3: float, time_s: float, speed_m_s: float) -> float:
    """Return the absorption area that gives a reverberation time, ``24 ln(10) V / (c T)`` (Sabine, Eyring)."""
    return float(24.0 * np.log(10.0) * volume_m3 / (speed_m_s * time_s))


def uniform_absorption(room: Room, time_s: float, speed_m_s: float) -> float:
    """Return the absorption coefficient with which all surfaces give a reverberation time by Eyring, without air."""
    return 1.0 - float(np.exp(-needed_area_m2(room.volume_m3, time_s, speed_m_s) / room.surface_area_m2.sum()))


def eyring_time_s(scene: Scene, absorption: FloatArray | None = None) -> FloatArray:
    """Return the reverberation time per band by Eyring, ``24 ln(10) V / (c A)`` with `eyring_absorption_area_m2`."""
    return time_of_area_s(eyring_absorption_area_m2(scene, absorption), scene.room.volume_m3, scene.air.speed_m_s)


def time_of_area_s(area_m2: FloatArray, volume_m3: float, speed_m_s: float | FloatArray) -> FloatArray:
    """Return the reverberation time that an absorption area gives, ``24 ln(10) V / (c A)``."""
    return 24.0 * np.log(10.0) * volume_m3 / (speed_m_s * np.maximum(area_m2, 1e-9))
