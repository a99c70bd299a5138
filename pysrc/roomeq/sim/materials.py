"""Tables of materials, and drawing the surfaces of a room from them."""

import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from roomeq.sim.response import eyring_exponent
from roomeq.sim.scene import WALLS, Material, Scene, eyring_time_s, with_absorption
from roomeq.sim.target import scaled_absorption

DEFAULT_TABLE = Path(__file__).with_name("materials.toml")  # conf/materials.toml links to it
USES = ("wall", "floor", "ceiling")
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
    """

    absorption: dict
    uses: dict
    scattering: dict

    def names(self, use):
        """Names of the materials that may be drawn for a use, sorted."""
        return sorted(name for name, uses in self.uses.items() if use in uses)


def read_materials(path=None):
    """Read a table of materials.

    Parameters
    ----------
    path : Path, optional
        TOML as in ``conf/materials.toml``, which is the default.

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
    absorption, uses = {}, {}
    try:
        for name, entry in table.get("materials", {}).items():
            absorption[name] = Material(name, entry["absorption"], 0.0).absorption
            uses[name] = tuple(entry.get("use", USES))
        scattering = {name: Material(name, 0.0, values).scattering
                      for name, values in table.get("scattering", {"default": 0.2}).items()}
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        what = f"key {error} is missing" if isinstance(error, KeyError) else error
        raise ValueError(f"{path}: {what}") from None
    result = MaterialTable(absorption, uses, scattering)
    for use in USES:
        if not result.names(use):
            raise ValueError(f"{path}: no material with use {use!r}: add one")
    return result


def draw_scattering(table, room, rng):
    """Draw how rough each slot of a room is, shape (n_slots, 8)."""
    classes = sorted(table.scattering)
    return np.array([table.scattering[classes[rng.integers(len(classes))]] for _ in room.slots])


def draw_materials(table, room, scattering, air, target_s, rng):
    """Draw the materials of a room, of a few draws one that needs little scaling to meet a target.

    Parameters
    ----------
    table : MaterialTable
    room : Shoebox or MeshRoom
    scattering : ndarray, shape (n_slots, 8)
    air : Air
    target_s : float
        Reverberation time at 1 kHz that will be asked for [s].
    rng : numpy.random.Generator

    Returns
    -------
    Scene
    """
    best, best_misfit = None, np.inf
    for _ in range(_DRAWS):
        names = _draw_names(table, room, rng)
        scene = Scene(room, [Material(name, table.absorption[name], tuple(row))
                             for name, row in zip(names, scattering, strict=True)], air)
        misfit = _misfit(scene, target_s)
        if misfit < best_misfit:
            best, best_misfit = scene, misfit
        if misfit == 0.0:
            break
    return best


def _misfit(scene, target_s):
    """How much stranger than real rooms a scene would be at its target; 0 for a plausible one."""
    exponent = eyring_exponent(scene, target_s)
    longest_s = eyring_time_s(with_absorption(scene, scaled_absorption(scene.absorption, exponent))).max()
    excess = np.array([abs(np.log(exponent)) / np.log(_PLAUSIBLE_EXPONENT),
                       np.log(longest_s / target_s) / np.log(_PLAUSIBLE_RATIO)])
    return float(np.maximum(excess - 1.0, 0.0).sum())


def _draw_names(table, room, rng):
    """A material for each slot: a slot named like one gets it, floor and ceiling get theirs, all others walls."""
    walls = table.names("wall")
    first = walls[rng.integers(len(walls))]
    names = []
    for slot in room.slots:
        use = slot if slot in USES else "wall"
        candidates = table.names(use)
        drawn = candidates[rng.integers(len(candidates))]
        if slot in WALLS[:4] and rng.random() < _SAME_WALLS:
            drawn = first
        names.append(slot if slot in table.absorption else drawn)
    return names
