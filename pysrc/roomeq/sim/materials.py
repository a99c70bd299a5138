"""Tables of materials, finding them by name, and drawing the surfaces of a room from them.

An impulse response of a furnished room with its materials by name:

    from roomeq.core.audio import write_wav
    from roomeq.sim.materials import named_scene
    from roomeq.sim.mesh import load_mesh
    from roomeq.sim.response import simulate_rir

    room = load_mesh("office.obj")  # usemtl carpet, oak, wall, ...
    scene = named_scene(room, {"carpet": "carpet_thin", "oak": {"absorption": "wood_1.6cm", "scattering": "rough"},
                               "default": "brick_plastered"})
    (response,) = simulate_rir(scene, (1.0, 2.0, 1.2), (4.5, 3.0, 1.2), seed=0)
    write_wav("office.wav", response.rir)
"""

import logging
import tomllib
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from roomeq.sim.published import PACKAGE, extend_bands, published_file, read_published
from roomeq.sim.response import eyring_exponent
from roomeq.sim.scene import WALLS, Air, Material, Scene, eyring_time_s
from roomeq.sim.target import scaled_absorption

logger = logging.getLogger(__name__)

DEFAULT_TABLE = Path(__file__).with_name("materials.toml")  # conf/materials.toml links to it
USES = ("wall", "floor", "ceiling")
ANY_SURFACE = "default"  # as a surface: all that are not named
DEFAULT_SCATTERING = "ordinary"
_SAME_WALLS = 0.4  # probability that a wall is of the same material as the first
_PLAUSIBLE_EXPONENT = 2.5  # absorption is scaled by no more, where a few draws allow it
_PLAUSIBLE_RATIO = 2.0  # reverberation time of the most reverberant band over that at 1 kHz
_DRAWS = 24


@dataclass(frozen=True)
class MaterialTable:
    """Materials by use, and classes of scattering.

    Attributes
    ----------
    absorption : dict
        Name to tuple of 8 floats.
    uses : dict
        Name to tuple of uses (`USES`).
    scattering : dict
        Class to tuple of 8 floats.
    own_scattering : dict
        Name to tuple of 8 floats, for the materials that state theirs.
    """

    absorption: dict
    uses: dict
    scattering: dict
    own_scattering: dict

    def names(self, use):
        """Names of the materials that may be drawn for a use, sorted."""
        return sorted(name for name, uses in self.uses.items() if use in uses)


@dataclass(frozen=True)
class Surface:
    """What is given for one surface of a room.

    Attributes
    ----------
    name : str
    absorption : tuple of 8 floats
    scattering : tuple of 8 floats or None
        None: drawn, or the table's ordinary class.
    """

    name: str
    absorption: tuple
    scattering: tuple | None


def read_materials(path=None):
    """Read a table of materials.

    Parameters
    ----------
    path : Path, optional
        TOML as in ``conf/materials.toml``, which is the default. A material may state its `scattering`, as
        coefficients or as the name of a class. Seven, six or five coefficients are those from 125 Hz on; missing
        outer bands take the value of their neighbour, which is logged.

    Returns
    -------
    MaterialTable

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
    absorption, uses, own, short = {}, {}, {}, []
    try:
        scattering = {name: _coefficients("scattering", name, values, short)
                      for name, values in table.get("scattering", {"default": 0.2}).items()}
        for name, entry in table.get("materials", {}).items():
            absorption[name] = _coefficients("absorption", name, entry["absorption"], short)
            uses[name] = tuple(entry.get("use", USES))
            if "scattering" in entry:
                own[name] = _scattering(entry["scattering"], name, scattering, short)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        what = f"key {error} is missing" if isinstance(error, KeyError) else error
        raise ValueError(f"{path}: {what}") from None
    if short:
        logger.info("%s: %s: fewer than 8 bands; 62.5 Hz takes the value at 125 Hz, high bands that of the highest",
                    path, ", ".join(sorted(set(short))))
    result = MaterialTable(absorption, uses, scattering, own)
    for use in USES:
        if not result.names(use):
            raise ValueError(f"{path}: no material with use {use!r}: add one")
    return result


def _coefficients(what, name, values, short=None):
    """Eight checked coefficients; those of fewer bands are extended and noted in `short`."""
    if isinstance(values, list | tuple):
        if short is not None and len(values) < 8:
            short.append(name)
        try:
            values = extend_bands(values)
        except ValueError as error:
            raise ValueError(f"{what} of material {name!r}: {error}") from None
    return getattr(Material(name, **(dict(absorption=0.0, scattering=0.0) | {what: values})), what)


def _scattering(value, name, classes, short=None):
    if not isinstance(value, str):
        return _coefficients("scattering", name, value, short)
    return _look_up("scattering", value, classes)


def _look_up(what, name, table):
    """Coefficients by name: of the table, else of the published one."""
    published = read_published()[what]
    if name in table or name in published:
        return table[name] if name in table else published[name]
    close = get_close_matches(name, {**table, **published}, n=4, cutoff=0.4)
    hint = f"closest: {', '.join(close)}" if close else "nothing there is called like it"
    absent = "" if published_file() else f"; {PACKAGE}, whose table would be searched too, is not installed"
    raise ValueError(f"{what}={name!r} is in no table of materials ({hint}{absent}): correct the name")


def find_surface(table, given):
    """Find a material.

    Parameters
    ----------
    table : MaterialTable
    given : str or dict
        A name, of the table or else of pyroomacoustics' published one (`roomeq.sim.published`); or
        ``{"absorption": name or coefficients, "scattering": name, coefficients or nothing}``.

    Returns
    -------
    Surface

    Raises
    ------
    ValueError
        No table has the name (the message lists the closest), or coefficients are wrong.
    """
    if isinstance(given, str):
        given = {"material": given, "absorption": given, "scattering": table.own_scattering.get(given)}
    if not isinstance(given, dict) or given.get("absorption") is None:
        raise ValueError(f"material {given!r} must be a name or an object with absorption and scattering: correct it")
    absorption, scattering = given["absorption"], given.get("scattering")
    name = given.get("material") or (absorption if isinstance(absorption, str) else "own")
    if isinstance(absorption, str):
        absorption = _look_up("absorption", absorption, table.absorption)
    else:
        absorption = _coefficients("absorption", name, absorption)
    return Surface(name, absorption, None if scattering is None else _scattering(scattering, name, table.scattering))


def given_surfaces(table, room, materials):
    """Find the materials that are given for the surfaces of a room.

    Parameters
    ----------
    table : MaterialTable
    room : Shoebox or MeshRoom
    materials : dict or None
        Surface, or ``"default"`` for all others, to what `find_surface` takes. A surface that is itself named like a
        material of the table is that.

    Returns
    -------
    dict of str to Surface
        Surfaces for which nothing is given are not in it.

    Raises
    ------
    ValueError
        A material is unknown, or the room has no such surface.
    """
    materials = dict(materials or {})
    rest = materials.pop(ANY_SURFACE, None)
    for surface in materials:
        if surface not in room.surfaces:
            raise ValueError(f"materials: {surface!r} must be one of the room's ({', '.join(room.surfaces)}) or "
                             f"{ANY_SURFACE!r}: correct the name")
    given = {surface: materials.get(surface, surface if surface in table.absorption else rest) for surface in room.surfaces}
    return {surface: find_surface(table, one) for surface, one in given.items() if one is not None}


def named_scene(room, materials, *, table=None, air=None):
    """Put a scene together from the names of its materials; the module's docstring has an example.

    Parameters
    ----------
    room : Shoebox or MeshRoom
    materials : dict
        As `given_surfaces` takes it.
    table : MaterialTable, optional
        Default: ``conf/materials.toml``.
    air : Air, optional

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
    return Scene(room, [Material(one.name, one.absorption, ordinary if one.scattering is None else one.scattering)
                        for one in (given[surface] for surface in room.surfaces)], air or Air())


def draw_scattering(table, room, rng, given=()):
    """Draw how rough each surface of a room is, shape (n_surfaces, 8); what `given` (surface to Surface) states is kept."""
    classes = sorted(table.scattering)
    drawn = [table.scattering[classes[rng.integers(len(classes))]] for _ in room.surfaces]
    own = [given[surface].scattering if surface in given else None for surface in room.surfaces]
    return np.array([known or row for known, row in zip(own, drawn, strict=True)])


def draw_materials(table, room, scattering, air, target_s, rng, given=None):
    """Draw the materials of a room, of a few draws one that needs little scaling to meet a target.

    Parameters
    ----------
    table : MaterialTable
    room : Shoebox or MeshRoom
    scattering : ndarray, shape (n_surfaces, 8)
    air : Air
    target_s : float
        Reverberation time at 1 kHz that will be asked for [s].
    rng : numpy.random.Generator
    given : dict of str to Surface, optional
        Surfaces that are not drawn; by default those that are named like a material.

    Returns
    -------
    Scene
    """
    given = given_surfaces(table, room, None) if given is None else given
    best, best_misfit = None, np.inf
    for _ in range(_DRAWS):
        drawn = [given.get(surface) or Surface(name, table.absorption[name], None)
                 for surface, name in zip(room.surfaces, _draw_names(table, room, rng), strict=True)]
        scene = Scene(room, [Material(one.name, one.absorption, tuple(row))
                             for one, row in zip(drawn, scattering, strict=True)], air)
        misfit = _misfit(scene, target_s)
        if misfit < best_misfit:
            best, best_misfit = scene, misfit
        if misfit == 0.0 or len(given) == len(room.surfaces):
            break
    return best


def _misfit(scene, target_s):
    """How much stranger than real rooms a scene would be at its target; 0 for a plausible one."""
    exponent = eyring_exponent(scene, target_s)
    longest_s = eyring_time_s(scene, scaled_absorption(scene.absorption, exponent)).max()
    excess = np.array([abs(np.log(exponent)) / np.log(_PLAUSIBLE_EXPONENT),
                       np.log(longest_s / target_s) / np.log(_PLAUSIBLE_RATIO)])
    return float(np.maximum(excess - 1.0, 0.0).sum())


def _draw_names(table, room, rng):
    """A material for each surface: floor and ceiling get theirs, all others walls."""
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
