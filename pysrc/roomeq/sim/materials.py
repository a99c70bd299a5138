"""Tables of materials, look-up by name, and random materials for the surfaces of a room.

An impulse response of a furnished room with its materials by name:

    from roomeq.core.audio import write_wav
    from roomeq.sim.materials import named_scene
    from roomeq.sim.mesh import load_mesh
    from roomeq.sim.response import simulate_responses

    room = load_mesh("office.obj")  # usemtl carpet, oak, wall, ...
    scene = named_scene(room, {"carpet": "carpet_thin", "oak": {"absorption": "parquet", "scattering": "ordinary"},
                               "default": "brick_plastered"})
    (response,) = simulate_responses(scene, (1.0, 2.0, 1.2), (4.5, 3.0, 1.2), seed=0)
    write_wav("office.wav", response.rir)
"""

import logging
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np

from roomeq.core.arrays import FloatArray
from roomeq.sim.defaults import DEFAULT_TABLE
from roomeq.sim.published import PACKAGE, extend_bands, published_file, read_published
from roomeq.sim.response import eyring_exponent
from roomeq.sim.room import Room
from roomeq.sim.scene import WALLS, Air, Material, Scene, eyring_time_s
from roomeq.sim.target import scaled_absorption

logger = logging.getLogger(__name__)

USES = ("wall", "floor", "ceiling")
ANY_SURFACE = "default"  # as a surface: all that are not named
DEFAULT_SCATTERING = "ordinary"
_KEYS = ("material", "absorption", "scattering")
_SAME_WALLS = 0.4  # probability that a wall is of the same material as the first
_PLAUSIBLE_EXPONENT = 2.5  # absorption is scaled by no more, where a few draws allow it
_PLAUSIBLE_RATIO = 2.0  # reverberation time of the most reverberant band over that at 1 kHz
_DRAWS = 24

Coefficients = Mapping[str, tuple[float, ...]]
"""Name to eight coefficients."""


@dataclass(frozen=True)
class MaterialTable:
    """Materials by use, and classes of scattering.

    Attributes
    ----------
    absorption
        Eight coefficients of each material.
    uses
        Uses (`USES`) of each material.
    scattering
        Eight coefficients of each class of scattering.
    own_scattering
        Eight coefficients of each material that states its scattering.
    """

    absorption: Coefficients
    uses: Mapping[str, tuple[str, ...]]
    scattering: Coefficients
    own_scattering: Coefficients

    def names(self, use: str) -> list[str]:
        """Return the names of the materials that may be drawn for a use, sorted."""
        return sorted(name for name, uses in self.uses.items() if use in uses)


@dataclass(frozen=True)
class Surface:
    """The material of one surface of a room.

    Attributes
    ----------
    name
    absorption
        Eight coefficients.
    scattering
        Eight coefficients; None: to be drawn, or the table's ordinary class.
    """

    name: str
    absorption: tuple[float, ...]
    scattering: tuple[float, ...] | None


def read_materials(path: str | Path | None = None) -> MaterialTable:
    """Read a table of materials.

    Parameters
    ----------
    path
        TOML as in ``conf/materials.toml``, which is the default. A material may state its `scattering`, as
        coefficients or as the name of a class. Seven, six or five coefficients are those from 125 Hz on; missing
        outer bands take the value of their neighbour, which is logged.

    Raises
    ------
    ValueError
        The file is missing, no TOML, or a coefficient is out of range; the message names file and material.
    """
    path = Path(path or DEFAULT_TABLE)
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ValueError(f"{path}: cannot be read as a table of materials ({error}): see conf/materials.toml "
                         "for the form") from None
    absorption: dict[str, tuple[float, ...]] = {}
    uses: dict[str, tuple[str, ...]] = {}
    own: dict[str, tuple[float, ...]] = {}
    short: list[str] = []
    try:
        scattering = {name: _coefficients("scattering", name, values, short)
                      for name, values in table.get("scattering", {"default": 0.2}).items()}
        for name, entry in table.get("materials", {}).items():
            absorption[name] = _coefficients("absorption", name, entry["absorption"], short)
            uses[name] = tuple(entry.get("use", USES))
            if "scattering" in entry:
                own[name] = _scattering(entry["scattering"], name, scattering, short)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        reason = f"key {error} is missing" if isinstance(error, KeyError) else error
        raise ValueError(f"{path}: {reason}") from None
    if short:
        logger.info("%s: %s: fewer than 8 bands; 62.5 Hz takes the value at 125 Hz, high bands that of the highest",
                    path, ", ".join(sorted(set(short))))
    if drawn := sorted(name for name in own if uses[name]):
        logger.info("%s: %s: their scattering counts where a row or room type names the material for a surface; "
                    "surfaces whose material is drawn take a class of scattering", path, ", ".join(drawn))
    result = MaterialTable(absorption, uses, scattering, own)
    for use in USES:
        if not result.names(use):
            raise ValueError(f"{path}: no material with use {use!r}: add one")
    return result


def _coefficients(kind: str, name: str, values: Any, short: list[str] | None = None) -> tuple[float, ...]:
    """Return eight checked coefficients; fewer are extended, and the material is noted in `short`."""
    if isinstance(values, list | tuple):
        if short is not None and len(values) < 8:
            short.append(name)
        try:
            values = extend_bands(values)
        except ValueError as error:
            raise ValueError(f"{kind} of material {name!r}: {error}") from None
    material = Material(name, **(dict(absorption=0.0, scattering=0.0) | {kind: values}))
    return material.absorption if kind == "absorption" else material.scattering


def _scattering(value: Any, name: str, classes: Coefficients, short: list[str] | None = None) -> tuple[float, ...]:
    if not isinstance(value, str):
        return _coefficients("scattering", name, value, short)
    return _look_up("scattering", value, classes)


def _look_up(kind: str, name: str, table: Coefficients) -> tuple[float, ...]:
    """Return coefficients by name from the table, else from the published one."""
    published = read_published()[kind]
    if name in table or name in published:
        return table[name] if name in table else published[name]
    close = get_close_matches(name, {**table, **published}, n=4, cutoff=0.4)
    hint = f"closest: {', '.join(close)}" if close else "nothing there is called like it"
    absent = "" if published_file() else f"; {PACKAGE}, whose table would be searched too, is not installed"
    raise ValueError(f"{kind}={name!r} is in no table of materials ({hint}{absent}): correct the name")


def find_surface(table: MaterialTable, given: str | Mapping[str, Any]) -> Surface:
    """Find a material.

    Parameters
    ----------
    table
    given
        A name from the table or else from pyroomacoustics' published one (`roomeq.sim.published`); or
        ``{"absorption": name or coefficients, "scattering": name, coefficients or nothing}``.

    Raises
    ------
    ValueError
        No table has the name (the message lists the closest), or a coefficient is out of range.
    """
    if isinstance(given, str):
        given = {"material": given, "absorption": given, "scattering": table.own_scattering.get(given)}
    for key in given if isinstance(given, dict) else ():
        if key not in _KEYS:
            raise ValueError(f"material {given!r}: key {key!r} must be one of {', '.join(_KEYS)}: correct or remove it")
    if not isinstance(given, dict) or given.get("absorption") is None:
        raise ValueError(f"material {given!r} must be a name or an object with absorption and scattering: correct it")
    absorption, scattering = given["absorption"], given.get("scattering")
    name = given.get("material") or (absorption if isinstance(absorption, str) else "own")
    if isinstance(absorption, str):
        absorption = _look_up("absorption", absorption, table.absorption)
    else:
        absorption = _coefficients("absorption", name, absorption)
    return Surface(name, absorption, None if scattering is None else _scattering(scattering, name, table.scattering))


def given_surfaces(table: MaterialTable, room: Room, materials: Mapping[str, Any] | None) -> dict[str, Surface]:
    """Find the materials that are stated for the surfaces of a room.

    Parameters
    ----------
    table
    room
    materials
        From a surface, or ``"default"`` for all others, to what `find_surface` takes. A surface with the name of a
        material in the table is of that material.

    Returns
    -------
    dict of str to Surface
        Surfaces without a stated material are not in it.

    Raises
    ------
    ValueError
        A material is unknown, the room has no such surface, or `materials` is no mapping.
    """
    if not isinstance(materials, Mapping | None):
        raise ValueError(f"materials={materials!r:.80} must be a mapping from surfaces to materials: give "
                         f"{{{ANY_SURFACE!r}: ...}} for all surfaces")
    materials = dict(materials or {})
    rest = materials.pop(ANY_SURFACE, None)
    for surface in materials:
        if surface not in room.surfaces:
            raise ValueError(f"materials: {surface!r} must be one of the room's ({', '.join(room.surfaces)}) or "
                             f"{ANY_SURFACE!r}: correct the name")
    stated = {surface: materials.get(surface, surface if surface in table.absorption else rest)
              for surface in room.surfaces}
    return {surface: find_surface(table, material) for surface, material in stated.items() if material is not None}


def named_scene(room: Room, materials: Mapping[str, Any], *, table: MaterialTable | None = None,
                air: Air | None = None) -> Scene:
    """Make a scene from the names of its materials; the module docstring has an example.

    Parameters
    ----------
    room
    materials
        See `given_surfaces`.
    table
        Default: ``conf/materials.toml``.
    air

    Returns
    -------
    Scene
        Materials that state no scattering get the table's class "ordinary".

    Raises
    ------
    ValueError
        A surface has no material, or a material is unknown.
    """
    table = read_materials() if table is None else table
    given = given_surfaces(table, room, materials)
    missing = [surface for surface in room.surfaces if surface not in given]
    if missing:
        raise ValueError(f"materials: nothing is given for {', '.join(missing)}: name a material for each, or one "
                         f"for {ANY_SURFACE!r}")
    ordinary = table.scattering.get(DEFAULT_SCATTERING, next(iter(table.scattering.values())))
    return Scene(room, [Material(surface.name, surface.absorption, surface.scattering or ordinary)
                        for surface in (given[name] for name in room.surfaces)], air or Air())


def draw_scattering(table: MaterialTable, room: Room, rng: np.random.Generator,
                    given: Mapping[str, Surface] | None = None) -> FloatArray:
    """Draw the scattering of each surface of a room, unless `given` states it.

    Shape (n_surfaces, 8), or 9 bands where one of them is stated up to 16 kHz.
    """
    given = given or {}
    classes = sorted(table.scattering)
    drawn = [table.scattering[classes[rng.integers(len(classes))]] for _ in room.surfaces]
    own = [given[surface].scattering if surface in given else None for surface in room.surfaces]
    rows = [known or row for known, row in zip(own, drawn, strict=True)]
    n_bands = max(map(len, rows))
    return np.array([(*row, *(row[-1],) * (n_bands - len(row))) for row in rows])


def draw_materials(table: MaterialTable, room: Room, scattering: FloatArray, air: Air, target_s: float | None,
                   rng: np.random.Generator, given: Mapping[str, Surface] | None = None) -> Scene:
    """Draw the materials of a room: the one of a few draws that needs least scaling to meet a target.

    Parameters
    ----------
    table
    room
    scattering
        From `draw_scattering`.
    air
    target_s
        Reverberation time at 1 kHz that the response will be scaled to; None: the first draw is taken.
    rng
    given
        Surfaces that are not drawn; by default those with the name of a material.
    """
    given = given_surfaces(table, room, None) if given is None else given
    best: Scene | None = None
    best_misfit = np.inf
    rows = [tuple(row) for row in scattering.tolist()]
    for _ in range(_DRAWS):
        drawn = [given.get(surface) or Surface(name, table.absorption[name], None)
                 for surface, name in zip(room.surfaces, _draw_names(table, room, rng), strict=True)]
        scene = Scene(room, [Material(surface.name, surface.absorption, row)
                             for surface, row in zip(drawn, rows, strict=True)], air)
        misfit = 0.0 if target_s is None else _misfit(scene, target_s)
        if best is None or misfit < best_misfit:
            best, best_misfit = scene, misfit
        if misfit == 0.0 or len(given) == len(room.surfaces):
            break
    assert best is not None
    return best


def _misfit(scene: Scene, target_s: float) -> float:
    """Return how implausible a scene would be at its target; 0 for a plausible one."""
    exponent = eyring_exponent(scene, target_s)
    longest_s = eyring_time_s(scene, scaled_absorption(scene.absorption, exponent)).max()
    excess = np.array([abs(np.log(exponent)) / np.log(_PLAUSIBLE_EXPONENT),
                       np.log(longest_s / target_s) / np.log(_PLAUSIBLE_RATIO)])
    return float(np.maximum(excess - 1.0, 0.0).sum())


def _draw_names(table: MaterialTable, room: Room, rng: np.random.Generator) -> list[str]:
    """Draw a material for each surface: of its use for floor and ceiling, of walls for all others."""
    walls = table.names("wall")
    first = walls[rng.integers(len(walls))]
    names = []
    for surface in room.surfaces:
        use = surface if surface in USES else "wall"
        candidates = table.names(use)
        drawn = candidates[rng.integers(len(candidates))]
        if surface in WALLS[:4] and rng.random() < _SAME_WALLS:
            drawn = first
        names.append(drawn)
    return names
