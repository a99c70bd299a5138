"""A model: the simulator plus a list of effects, in a file that a person can read and edit.

    {"effects": [{"effect": "source_response", "of": {"spk1": {"gains_db": [...]}}, "typical": {...}, ...}]}

`of` holds the parameters of each unit (loudspeaker, microphone, room or all) that was measured. Others get parameters
drawn from the spread of those.
"""

from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np

from roomeq.core.files import read_json, write_json
from roomeq.core.rng import rng_for
from roomeq.effects.base import Rendering
from roomeq.effects.catalogue import CATALOGUE
from roomeq.sim.scene import eyring_time_s

MODEL_FILE = "model.json"
LARGEST = 100.0
"""Component of a vector: spreads are about 1, or some dB."""
_ROUNDING = 1e-9
_KEY = {"source": "source_id", "mic": "mic_id", "room": "room_id", "rir": "id"}


@dataclass(frozen=True)
class Extension:
    """One effect of a model.

    Attributes
    ----------
    effect : type
        From the catalogue.
    of : dict
        {unit: effect with its parameters}.
    typical, spread : ndarray, shape (n,)
        Mean and standard deviation of the vectors of units that were not measured.
    """

    effect: type
    of: dict
    typical: np.ndarray
    spread: np.ndarray

    def for_row(self, row, seed):
        """The effect with the parameters of a row's unit; drawn where that was not measured."""
        unit = "all" if self.effect.SCOPE == "all" else row[_KEY[self.effect.SCOPE]]
        if unit in self.of:
            return self.of[unit]
        rng = rng_for(seed, f"effect {self.effect.NAME}", unit)
        return self.effect.from_vector(self.typical + self.spread * rng.standard_normal(len(self.typical)))


@dataclass(frozen=True)
class Model:
    """The simulator's extensions, in the catalogue's order.

    Attributes
    ----------
    extensions : tuple of Extension
    """

    extensions: tuple = ()

    @property
    def names(self):
        return [extension.effect.NAME for extension in self.extensions]

    def for_row(self, row, seed):
        """Effects of a row, as a list."""
        return [extension.for_row(row, seed) for extension in self.extensions]


def extend_scene(effects, scene):
    """The scene as effects change it."""
    for effect in effects:
        scene = effect.on_scene(scene)
    return scene


def path_gain(effects, facing):
    """Energy gain of paths by the direction in which they leave the source.

    Parameters
    ----------
    effects : list of Effect
    facing : array_like, shape (3,), or None
        Where the source faces.

    Returns
    -------
    callable or None
        Takes unit vectors, shape (n, 3), and gives gains, shape (n, 8); None where all are 1.
    """
    turned = [effect for effect in effects if effect.on_paths(np.ones(1)) is not None]
    if not turned or facing is None or None in facing:
        return None
    facing = np.asarray(facing, dtype=float) / np.linalg.norm(facing)
    return lambda directions: np.prod([effect.on_paths(directions @ facing) for effect in turned], axis=0)


def names_of(effects, gain):
    """Names of the effects that act; those on paths do not where `path_gain` is None."""
    return [effect.NAME for effect in effects if gain is not None or effect.on_paths(np.ones(1)) is None]


def direct_gain(scene, source_pos_m, mic_pos_m, gain=None):
    """Pressure of the direct sound of a free path, ``1 / (4 pi r)`` less air, shape (8,).

    Parameters
    ----------
    scene : roomeq.sim.scene.Scene
    source_pos_m, mic_pos_m : array_like, shape (3,)
    gain : callable, optional
        From `path_gain`.
    """
    path_m = np.subtract(mic_pos_m, source_pos_m)
    distance_m = np.linalg.norm(path_m)
    pressure = np.exp(-0.5 * distance_m * np.asarray(scene.air.attenuation_per_m)) / (4.0 * np.pi * distance_m)
    return pressure if gain is None else pressure * np.sqrt(gain((path_m / distance_m)[None])[0])


def behind_rendering(effects, rir, scene, source_pos_m, mic_pos_m, direct, rng, white=(0.0,) * 8):
    """A rendered RIR with the effects that act on it as a whole.

    Parameters
    ----------
    effects : list of Effect
    rir : ndarray, shape (n_samples,)
    scene : roomeq.sim.scene.Scene
        With the absorption that was rendered.
    source_pos_m, mic_pos_m : tuple of 3 floats
    direct : ndarray, shape (8,)
        Pressure of the direct sound; 0 where it is obstructed.
    rng : numpy.random.Generator
    white : array_like, shape (8,)
        White noise of the recording that it is compared with (`Rendering`).

    Returns
    -------
    ndarray
        Effects that ring on make it longer.
    """
    rendering = Rendering(scene, source_pos_m, mic_pos_m, direct, eyring_time_s(scene), rng, np.asarray(white))
    for effect in effects:
        rir = effect.on_rir(rir, rendering)
    return rir


def write_model(path, model):
    """Write a model file."""
    write_json(path, dict(effects=[dict(
        effect=one.effect.NAME, of={unit: asdict(effect) for unit, effect in sorted(one.of.items())},
        typical=[float(value) for value in one.typical], spread=[float(value) for value in one.spread])
        for one in model.extensions]))


def read_model(path):
    """Read a model file.

    Raises
    ------
    ValueError
        It is not one, or names an effect or a parameter that does not exist; the message names the file.
    """
    path = Path(path)
    content = read_json(path)
    if not isinstance(content, dict) or not isinstance(content.get("effects"), list):
        raise ValueError(f"{path}: must hold an object with a list of 'effects': make it with roomeq close-loop")
    extensions = tuple(_extension(path, n, one) for n, one in enumerate(content["effects"]))
    names = [one.effect.NAME for one in extensions]
    for n, name in enumerate(names):
        if name in names[:n]:
            raise ValueError(f"{path}: effects[{n}]: effect={name!r} is there already: leave one out")
    return Model(extensions)


def _extension(path, n, one):
    what = f"{path}: effects[{n}]"
    if not isinstance(one, dict) or one.get("effect") not in list(CATALOGUE):  # a list is in no dict
        name = one.get("effect") if isinstance(one, dict) else one
        raise ValueError(f"{what}: effect={name!r} must be one of {', '.join(sorted(CATALOGUE))}: correct the name")
    effect = CATALOGUE[one["effect"]]
    size = len(effect.SPREAD)
    if not isinstance(one.get("of"), dict):
        raise ValueError(f"{what}: of={one.get('of')!r} must map each {effect.SCOPE} to its parameters: add them")
    vectors = {}
    for key, lowest in (("typical", -LARGEST), ("spread", 0.0)):
        vectors[key] = one.get(key, [0.0] * size)
        if not (isinstance(vectors[key], list) and len(vectors[key]) == size and all(map(_is_number, vectors[key]))):
            raise ValueError(f"{what}: {key}={vectors[key]!r} must be {size} numbers: correct them")
        if not all(lowest <= value <= LARGEST for value in vectors[key]):
            raise ValueError(f"{what}: {key}={vectors[key]!r} must lie in [{lowest:g}, {LARGEST:g}]: correct them")
    units = {unit: read_parameters(f"{what}: of[{unit!r}]", effect, given) for unit, given in one["of"].items()}
    return Extension(effect, units, np.array(vectors["typical"], float), np.array(vectors["spread"], float))


def read_parameters(what, effect, given):
    """Make an effect of its parameters as a file gives them; `what` is what a message calls them.

    Raises
    ------
    ValueError
        They are not those of the effect, or out of range.
    """
    names = [field.name for field in fields(effect)]
    if not isinstance(given, dict) or sorted(given) != sorted(names):
        raise ValueError(f"{what} must hold {', '.join(names) or 'nothing'}: correct the names")
    # what a vector can say is what there is: a fit never ends elsewhere
    lowest, highest = (effect.from_vector(np.full(len(effect.SPREAD), sign * LARGEST)) for sign in (-1, 1))
    for name, value in given.items():
        low, high = np.atleast_1d(getattr(lowest, name)), np.atleast_1d(getattr(highest, name))
        sequence = isinstance(getattr(lowest, name), tuple)
        values = value if sequence and isinstance(value, list) else [value]
        if sequence != isinstance(value, list) or len(values) != len(low) or not all(map(_is_number, values)):
            rule = f"{len(low)} numbers" if sequence else "a number"
            raise ValueError(f"{what}: {name}={value!r} must be {rule}: correct it")
        if not all(a - _ROUNDING * abs(a) <= one <= b + _ROUNDING * abs(b)
                   for a, one, b in zip(low, values, high, strict=True)):
            raise ValueError(f"{what}: {name}={value!r} must lie in [{low.min():g}, {high.max():g}]: correct it")
    return effect(**{name: tuple(value) if isinstance(value, list) else value for name, value in given.items()})


def _is_number(value):
    return isinstance(value, (int, float)) and not isinstance(value, bool) and np.isfinite(value)
