"""Rooms and their impulse responses in two calls:

    room = Room((6, 4, 3), materials="brick_plastered", t60_s=0.5)
    rirs = simulate_rir(room, source=(2, 1.5, 1.5), mics=[(4, 3, 1.2), (4.1, 3, 1.2)], fs=48000)

What lies below, a scene and responses with all that is known about them, is `roomeq.sim.response.simulate_responses`.
"""

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from roomeq.core.arrays import FloatArray
from roomeq.core.constants import FS_HZ, LARGEST_SEED, bands_hz, exact_bands_hz, is_number, is_whole, require_fs
from roomeq.effects.spherical_cap import cap_gain, cap_series
from roomeq.sim.defaults import NUM_RAYS, TARGET_RANGE_S
from roomeq.sim.directivity import unit
from roomeq.sim.materials import DEFAULT_SCATTERING, named_scene, read_materials
from roomeq.sim.mesh import MeshRoom, load_mesh
from roomeq.sim.ray_limits import FEW_RAYS_DB
from roomeq.sim.response import simulate_responses
from roomeq.sim.scene import Air, Scene, Shoebox

logger = logging.getLogger(__name__)

_NEUTRAL = 0.1
"""Absorption in all bands of a room of which only the reverberation time is known, before it is scaled."""

_LARGEST = dict(num_rays=10 ** 7, seed=LARGEST_SEED)

MaterialLike = str | float | Sequence[float] | Mapping[str, Any]


class Directivity(Protocol):
    """What `simulate_rir` asks of a directivity; see `roomeq.sim.directivity` and `Loudspeaker`."""

    def pressure(self, directions: FloatArray, fs_hz: float) -> FloatArray:
        """Return real gains of pressure per octave band, shape (n, n_bands), for unit vectors, shape (n, 3)."""


@dataclass(frozen=True)
class Loudspeaker:
    """Directivity of a loudspeaker: a membrane in a rigid sphere of the size of its cabinet, relative to its axis.

    Attributes
    ----------
    facing
        Direction of the axis, shape (3,).
    radius_m
        Of the sphere, up to 0.5 m: half the width of the cabinet.
    membrane_radius_m
        At most that of the sphere.

    Raises
    ------
    ValueError
        A radius or the direction is out of range.
    """

    facing: Sequence[float] | FloatArray
    radius_m: float = 0.1
    membrane_radius_m: float = 0.05

    def __post_init__(self) -> None:
        object.__setattr__(self, "facing", tuple(unit(self.facing).tolist()))  # may be compared and hashed
        for name in ("radius_m", "membrane_radius_m"):
            if not is_number(getattr(self, name)):
                raise ValueError(f"{name}={getattr(self, name)!r} must be a number [m]: correct it")
        if not 0.0 < self.membrane_radius_m <= self.radius_m:
            raise ValueError(f"membrane_radius_m={self.membrane_radius_m:g} must lie in (0, radius_m="
                             f"{self.radius_m:g}]: correct it")
        cap_series(self.radius_m, self._cap_rad, [1000.0])

    @property
    def _cap_rad(self) -> float:
        return float(np.arcsin(self.membrane_radius_m / self.radius_m))

    def pressure(self, directions: FloatArray, fs_hz: float) -> FloatArray:
        """Return the gains in some directions, shape (n, n_bands)."""
        return np.sqrt(cap_gain(directions @ np.asarray(self.facing), self.radius_m, self._cap_rad,
                                exact_bands_hz(fs_hz), fs_hz))


@dataclass(frozen=True)
class Room:
    """A room: a shoebox or a mesh, its materials, its air and, if wanted, its reverberation time.

    Attributes
    ----------
    geometry
        Length, width and height of a shoebox [m]; or the path of a mesh, whose materials name its surfaces; or a room
        of `roomeq.Shoebox` or `roomeq.load_mesh`.
    materials
        Of all surfaces, or from the name of each surface to its own (``"default"``: all others, except that a surface
        of a mesh that has the name of a material is of it). A shoebox has the surfaces west, east, south, north, floor
        and ceiling. A material is a name of ``conf/materials.toml``, an absorption coefficient, coefficients per octave
        band (8 from 62.5 Hz on or 9 with 16 kHz; 5, 6 or 7 begin at 125 Hz), or ``{"absorption": ..., "scattering":
        ...}``. Where only `t60_s` is given, all bands and surfaces absorb alike.
    t60_s
        Scale the absorption of all surfaces until T30 at 1 kHz has this value, in the mean over the microphones.
    temperature_c
    humidity_pct

    Raises
    ------
    ValueError
        Geometry, materials or air are out of range, or there are neither materials nor a reverberation time.
    """

    geometry: Sequence[float] | str | PathLike[str] | Shoebox | MeshRoom
    materials: MaterialLike | None = field(default=None, hash=False)  # a mapping has no hash
    t60_s: float | None = None
    temperature_c: float = Air.temperature_c
    humidity_pct: float = Air.humidity_pct

    def __post_init__(self) -> None:
        if self.materials is None and self.t60_s is None:
            raise ValueError("a room needs materials or t60_s: give one of them")
        if self.t60_s is not None and not (
                is_number(self.t60_s) and TARGET_RANGE_S[0] <= self.t60_s <= TARGET_RANGE_S[1]):
            raise ValueError(f"t60_s={self.t60_s!r} must be a number in [0.05, 10] s: correct it")
        shape = self.scene().room
        if isinstance(shape, Shoebox) and not isinstance(self.geometry, Shoebox):
            object.__setattr__(self, "geometry", shape.dims_m)
        object.__setattr__(self, "materials", _without_arrays(self.materials))

    def scene(self, fs_hz: int = FS_HZ) -> Scene:
        """Return the scene, before its absorption is scaled."""
        if isinstance(self.geometry, str | PathLike):
            shape: Shoebox | MeshRoom = load_mesh(Path(self.geometry))
        elif isinstance(self.geometry, Shoebox | MeshRoom):
            shape = self.geometry
        elif np.ndim(self.geometry) != 1:
            raise ValueError(f"geometry={self.geometry!r:.80} must be three lengths [m], the path of a mesh, or a "
                             "Shoebox or mesh: correct it")
        else:
            shape = Shoebox(tuple(self.geometry))
        given = _NEUTRAL if self.materials is None else self.materials
        if not isinstance(given, Mapping) or "absorption" in given:
            given = dict.fromkeys(shape.surfaces, given)
        scene = named_scene(shape, {surface: _entry(material) for surface, material in given.items()},
                            table=read_materials(), air=Air(self.temperature_c, self.humidity_pct))
        return Scene(scene.room, scene.materials, scene.air, fs_hz)


def _without_arrays(value: Any) -> Any:
    """Return a material, or a mapping to materials, in which sequences are tuples: rooms may be compared."""
    if isinstance(value, Mapping):
        return {key: _without_arrays(of_key) for key, of_key in value.items()}
    return tuple(np.asarray(value, dtype=object).tolist()) if np.ndim(value) else value


def _entry(material: MaterialLike) -> str | Mapping[str, Any]:
    """Return a material as `roomeq.sim.materials.find_surface` takes it."""
    if isinstance(material, str) or (isinstance(material, Mapping) and "absorption" not in material):
        return material
    entry = dict(material) if isinstance(material, Mapping) else dict(absorption=material)
    for key, value in entry.items():
        if key in ("absorption", "scattering") and not isinstance(value, str) and value is not None:
            entry[key] = np.asarray(value, dtype=object).tolist()  # `Material` refuses what is no number
    return {"scattering": DEFAULT_SCATTERING} | entry


def simulate_rir(room: Room, source: ArrayLike, mics: ArrayLike, fs: int = FS_HZ, *,
                 source_directivity: Directivity | None = None,
                 mic_directivity: Directivity | Sequence[Directivity | None] | None = None, num_rays: int = NUM_RAYS,
                 seed: int = 0) -> FloatArray:
    """Simulate the impulse responses from a source to one or more microphones.

    Parameters
    ----------
    room
    source
        Position of the source [m], shape (3,). The late reverberation of separate calls is independent, even a
        centimetre apart. For a source that moves past a microphone, exchange the two: the places of the source are
        `mics` of one call, and its directivity is theirs.
    mics
        Positions of the microphones [m], shape (3,) or (n_mics, 3). The source is traced once for all. Their late
        reverberation is coherent as in a diffuse field, with their directivities (`roomeq.sim.array_noise`).
    fs
        Sample rate, 8 to 48 kHz [Hz].
    source_directivity
        `FirstOrder`, `Loudspeaker`, `DirectivityTable`, or whatever has their method; by default omnidirectional.
    mic_directivity
        Likewise, of all microphones or of each.
    num_rays
        For each distinct column of scattering coefficients.
    seed
        The same arguments give the same samples.

    Returns
    -------
    ndarray, shape (n_samples,) or (n_mics, n_samples)
        Sound pressure. The source emits a unit pulse at sample 0: the direct sound at distance r arrives at sample
        ``fs r / c`` with the pressure ``1 / (4 pi r)``. Shorter responses are continued with zeros.

    Raises
    ------
    ValueError
        A position lies outside the room, source and microphone coincide, the reverberation time cannot be met, or an
        argument is out of range.
    """
    if not isinstance(room, Room):
        raise ValueError(f"room is a {type(room).__name__} and must be a Room: give Room(geometry, materials=...), "
                         "or call simulate_responses with a Scene")
    fs = require_fs(fs)
    for name, value, lowest in (("num_rays", num_rays, 1), ("seed", seed, 0)):
        if not (is_whole(value) and lowest <= value <= _LARGEST[name]):
            raise ValueError(f"{name}={value!r} must be a whole number from {lowest} to {_LARGEST[name]}: correct it")
    source_m, positions_m = _coordinates("source", source), _coordinates("mics", mics)
    if positions_m.shape[-1:] != (3,) or positions_m.ndim > 2 or not positions_m.size:
        raise ValueError(f"mics of shape {positions_m.shape} must have the shape (3,) or (n_mics, 3): give x, y, z of "
                         "each microphone")
    n_mics = len(np.atleast_2d(positions_m))
    of_mics = (list(mic_directivity)
               if isinstance(mic_directivity, Sequence | np.ndarray) and not isinstance(mic_directivity, str)
               else [mic_directivity] * n_mics)
    if len(of_mics) != n_mics:
        raise ValueError(f"{len(of_mics)} directivities of microphones must be one, or one for each of {n_mics}: give "
                         "that many")
    at_rate = {id(one): _at_rate(one, fs) for one in of_mics}
    responses = simulate_responses(
        room.scene(fs), source_m, positions_m, num_rays=num_rays, target_t60_s=room.t60_s,
        source_directivity=_at_rate(source_directivity, fs), mic_directivities=[at_rate[id(one)] for one in of_mics],
        arrays=[0] * n_mics, seed=seed)
    if any((response.few_rays_db or 0.0) > FEW_RAYS_DB for response in responses):
        logger.warning("few of %d rays tell the decay of an octave, whose T30 is uncertain by 10 %%: give more "
                       "num_rays", num_rays)
    result = np.zeros((n_mics, max(len(response.rir) for response in responses)))
    for row, response in zip(result, responses, strict=True):
        row[:len(response.rir)] = response.rir
    return result[0] if positions_m.ndim == 1 else result


def _coordinates(name: str, values: ArrayLike) -> FloatArray:
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name}={values!r:.80} must be coordinates x, y, z [m]: correct them") from None


def _at_rate(directivity: Directivity | None, fs_hz: float) -> Callable[[FloatArray], FloatArray] | None:
    if directivity is None:
        return None
    if isinstance(directivity, type) or not callable(getattr(directivity, "pressure", None)):
        raise ValueError(f"directivity={directivity!r:.80} must be a FirstOrder, Loudspeaker or DirectivityTable, or "
                         "have their method pressure: correct it")
    gains = np.asarray(directivity.pressure(np.array([[1.0, 0.0, 0.0]]), fs_hz=fs_hz))
    if gains.shape != (1, len(bands_hz(fs_hz))) or not np.all(np.isfinite(gains)) or np.iscomplexobj(gains):
        raise ValueError(f"directivity={directivity!r:.80}: pressure returns {gains.dtype} gains of shape "
                         f"{gains.shape} for one direction, and must return finite real ones of shape "
                         f"{(1, len(bands_hz(fs_hz)))}, one for each octave band at fs={fs_hz:g}: correct it")
    return partial(directivity.pressure, fs_hz=fs_hz)
