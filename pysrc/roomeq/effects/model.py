"""A model: the simulator plus a list of effects, in a file that a person can read and edit.

    {"format": 3,
     "effects": [{"effect": "source_response", "of": {"spk1": {"gains_db": [...]}}, "typical": [...], "spread": [...]}]}

`of` holds the parameters of each unit (loudspeaker, microphone, room or all) that was measured. Other units get
parameters drawn from the spread of those. A model with a directivity may also have

     "facings": {"rir1": [1.0, 0.0, 0.0]}

the directions in which sources face, by RIR, where neither its row states one nor it is that of the microphone. And

     "heights_m": {"office": {"source spk1": 1.42, "microphone m1": 1.1}}

the heights of devices that no row states, by room.
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from functools import reduce
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from roomeq.core.arrays import Array, FloatArray
from roomeq.core.constants import is_number
from roomeq.core.files import read_json, write_json
from roomeq.core.rng import rng_for
from roomeq.effects.base import Effect, Rendering
from roomeq.effects.catalogue import CATALOGUE
from roomeq.effects.source_directivity import unit_facing
from roomeq.records.geometry import DEVICES, find_contradiction, is_known
from roomeq.records.schema import RirRow, unit_name
from roomeq.sim.scene import Scene, eyring_time_s

MODEL_FILE = "model.json"
MODEL_FORMAT = 3
MAX_COMPONENT = 100.0
"""Largest component of a vector: spreads are about 1, or some dB."""
_ROUNDING = 1e-9
_KEYS, _ENTRY_KEYS = ("format", "effects", "facings", "heights_m"), ("effect", "of", "typical", "spread")

Directivity = Callable[[FloatArray], FloatArray]


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

    effect: type[Effect]
    of: Mapping[str, Effect]
    typical: FloatArray
    spread: FloatArray

    def for_row(self, row: Mapping[str, Any], seed: int) -> Effect:
        """Return the effect with the parameters of a row's unit, drawn where that was not measured."""
        unit = unit_name(row, self.effect.SCOPE)
        if unit in self.of:
            return self.of[unit]
        drawn = rng_for(seed, f"effect {self.effect.NAME}", unit).standard_normal(len(self.typical))
        # components correlate as in the prior: responses of real loudspeakers are smooth
        covariance = self.effect.prior_covariance()
        deviation = np.sqrt(np.diag(covariance))
        root = np.linalg.cholesky(covariance / np.outer(deviation, deviation) + 1e-9 * np.eye(len(deviation)))
        return self.effect.from_vector(self.typical + self.spread * (root @ drawn))


@dataclass(frozen=True)
class Model:
    """The simulator's extensions, in the catalogue's order.

    Attributes
    ----------
    extensions : tuple of Extension
    facings : dict
        {id of an RIR: direction that its source faces}, of RIRs whose rows may not state it.
    heights_m : dict
        {room: {source or microphone, as in "source spk1": its height}}, of devices whose rows may not state it.
    """

    extensions: tuple[Extension, ...] = ()
    facings: Mapping[str, Sequence[float]] = field(default_factory=dict)
    heights_m: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @property
    def names(self) -> list[str]:
        return [extension.effect.NAME for extension in self.extensions]

    @property
    def is_directive(self) -> bool:
        """Whether an effect acts on paths over their angle of departure."""
        return any(is_directive(extension.effect) for extension in self.extensions)

    def for_row(self, row: Mapping[str, Any], seed: int) -> list[Effect]:
        """Return the effects of a row."""
        return [extension.for_row(row, seed) for extension in self.extensions]

    def with_heights(self, row: RirRow) -> RirRow:
        """Return a row with the model's heights where it states x and y alone, if they do not contradict it."""
        of_room, known = self.heights_m.get(row["room_id"], {}), cast(dict[str, Any], dict(row))
        for key, (kind, id_key) in DEVICES.items():
            position_m, device = known.get(key), f"{kind} {known[id_key]}"
            if device in of_room and position_m and position_m[2] is None and is_known(position_m[:2]):
                known[key] = [*position_m[:2], of_room[device]]
        return row if known == row or find_contradiction(known) else cast(RirRow, known)


def extend_scene(effects: Sequence[Effect], scene: Scene) -> Scene:
    """Return the scene with the effects that act on it."""
    for effect in effects:
        scene = effect.on_scene(scene)
    return scene


def path_gain(effects: Sequence[Effect], source_dir: Sequence[float | None] | None) -> Directivity | None:
    """Return the energy gain of paths as a function of the direction in which they leave the source.

    Parameters
    ----------
    effects : sequence of Effect
    source_dir : sequence of 3 numbers, or None
        Direction that the source faces, as in a row.

    Returns
    -------
    callable or None
        Takes unit vectors, shape (n, 3), and returns pressure gains, shape (n, 8); None where all are 1.
    """
    directive, facing = [effect for effect in effects if is_directive(type(effect))], unit_facing(source_dir)
    if not directive or facing is None:
        return None

    def gain(directions: FloatArray) -> FloatArray:
        cos_angle = directions @ facing
        return np.sqrt(reduce(np.multiply, [effect.on_paths(cos_angle) for effect in directive]))  # type: ignore[arg-type]

    return gain


def is_directive(effect: type[Effect]) -> bool:
    """Tell whether an effect acts on paths over their angle of departure."""
    return effect.on_paths is not Effect.on_paths


def names_of(effects: Sequence[Effect], gain: Directivity | None) -> list[str]:
    """Return the names of the effects that act; those on paths do not where `path_gain` returned None."""
    return [effect.NAME for effect in effects if gain is not None or not is_directive(type(effect))]


def direct_gain(scene: Scene, source_pos_m: ArrayLike, mic_pos_m: ArrayLike,
                gain: Directivity | None = None) -> FloatArray:
    """Return the pressure of the direct sound on a free path: ``1 / (4 pi r)`` with air absorption, shape (8,).

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
    return pressure if gain is None else pressure * gain((path_m / distance_m)[None])[0]


def apply_to_rir(effects: Sequence[Effect], rir: FloatArray, scene: Scene, source_pos_m: Sequence[float],
                 mic_pos_m: Sequence[float], direct: FloatArray, rng: np.random.Generator,
                 white: ArrayLike = (0.0,) * 8, diffuse_noise: Callable[[int], Array] | None = None) -> FloatArray:
    """Return a rendered RIR with the effects that act on it as a whole.

    Parameters
    ----------
    effects : sequence of Effect
    rir : ndarray, shape (n_samples,)
    scene : roomeq.sim.scene.Scene
        With the absorption that was rendered.
    source_pos_m, mic_pos_m : tuple of 3 floats
    direct : ndarray, shape (8,)
        Pressure of the direct sound; 0 where it is obstructed.
    rng : numpy.random.Generator
    white : array_like, shape (8,)
        White noise of the recording that the RIR is compared with (`Rendering`).
    diffuse_noise : callable, optional
        From a number of samples to noise with the coherence of a diffuse field (`Rendering`); for a microphone of an
        array.

    Returns
    -------
    ndarray
        Longer than `rir` where an effect prolongs the decay.
    """
    rendering = Rendering(scene, source_pos_m, mic_pos_m, direct, eyring_time_s(scene), rng, rir, np.asarray(white),
                          diffuse_noise)
    for effect in effects:
        rir = effect.on_rir(rir, rendering)
    return rir


def write_model(path: Path, model: Model) -> None:
    """Write a model file."""
    of_rows = {name: dict(sorted(values.items())) for name, values in
               (("facings", model.facings), ("heights_m", model.heights_m)) if values}
    write_json(path, dict(format=MODEL_FORMAT, effects=[dict(
        effect=extension.effect.NAME,
        of={unit: asdict(effect) for unit, effect in sorted(extension.of.items())},  # type: ignore[call-overload]
        typical=[float(value) for value in extension.typical], spread=[float(value) for value in extension.spread])
        for extension in model.extensions], **of_rows))


def read_model(path: str | Path) -> Model:
    """Read a model file.

    Raises
    ------
    ValueError
        The file is not a model, or names an effect or a parameter that does not exist; the message names the file.
    """
    path = Path(path)
    content = read_json(path)
    if not isinstance(content, dict) or not isinstance(content.get("effects"), list):
        raise ValueError(f"{path}: must hold an object with a list of 'effects': make it with roomeq close-loop")
    _require_known(str(path), content, _KEYS)
    if content.get("format") != MODEL_FORMAT:
        raise ValueError(f"{path}: format={content.get('format')!r:.60} must be {MODEL_FORMAT}: run roomeq close-loop "
                         "again")
    extensions = tuple(_read_extension(f"{path}: effects[{n}]", entry) for n, entry in enumerate(content["effects"]))
    names = [extension.effect.NAME for extension in extensions]
    for n, name in enumerate(names):
        if name in names[:n]:
            raise ValueError(f"{path}: effects[{n}]: effect={name!r} is there already: leave one out")
    return Model(extensions, _read_facings(path, content.get("facings", {})),
                 _read_heights(path, content.get("heights_m", {})))


def _read_facings(path: Path, facings: Any) -> dict[str, list[float]]:
    if not isinstance(facings, dict):
        raise ValueError(f"{path}: facings={facings!r:.60} must map RIRs to directions: correct or remove it")
    for rir_id, facing in facings.items():
        if not (isinstance(facing, list) and len(facing) == 3 and all(map(_is_number, facing)) and any(facing)):
            raise ValueError(f"{path}: facings[{rir_id!r}]={facing!r:.60} must be a direction, three numbers that are "
                             "not all 0: correct or remove it")
    return facings


def _read_heights(path: Path, heights_m: Any) -> dict[str, dict[str, float]]:
    of_rooms = heights_m.items() if isinstance(heights_m, dict) else [("", None)]
    for room, of_room in of_rooms:
        if not (isinstance(of_room, dict) and all(map(_is_number, of_room.values()))):
            raise ValueError(f"{path}: heights_m={heights_m!r:.60} must map rooms to heights of devices, such as "
                             f"{{'{room or 'office'}': {{'source spk1': 1.4}}}}: correct or remove it")
    return cast(dict[str, dict[str, float]], heights_m)


def _read_extension(place: str, entry: Any) -> Extension:
    """Check and convert an entry of a model file; messages begin with its place."""
    if not isinstance(entry, dict) or entry.get("effect") not in list(CATALOGUE):  # a list is in no dict
        name = entry.get("effect") if isinstance(entry, dict) else entry
        raise ValueError(f"{place}: effect={name!r} must be one of {', '.join(sorted(CATALOGUE))}: correct the name")
    _require_known(place, entry, _ENTRY_KEYS)
    effect = CATALOGUE[entry["effect"]]
    size = len(effect.SPREAD)
    if not isinstance(entry.get("of"), dict):
        raise ValueError(f"{place}: of={entry.get('of')!r} must map each {effect.SCOPE} to its parameters: add them")
    if effect.SCOPE == "all" and (strange := entry["of"].keys() - {"all"}):
        raise ValueError(f"{place}: of[{min(strange)!r:.60}] must be of['all'], since {effect.NAME} is of all RIRs: "
                         "correct the name")
    vectors = {}
    for key, lowest in (("typical", -MAX_COMPONENT), ("spread", 0.0)):
        vector = entry.get(key, [0.0] * size)
        if not (isinstance(vector, list) and len(vector) == size and all(map(_is_number, vector))):
            raise ValueError(f"{place}: {key}={vector!r} must be {size} numbers: correct them")
        if not all(lowest <= value <= MAX_COMPONENT for value in vector):
            raise ValueError(f"{place}: {key}={vector!r} must lie in [{lowest:g}, {MAX_COMPONENT:g}]: correct them")
        vectors[key] = np.array(vector, float)
    units = {unit: read_parameters(f"{place}: of[{unit!r}]", effect, parameters)
             for unit, parameters in entry["of"].items()}
    if "typical" not in entry and not (effect.SCOPE == "all" and units):
        raise ValueError(f"{place}: typical must be {size} numbers, for what 'of' does not name: add them")
    return Extension(effect, units, **vectors)


def _require_known(place: str, entry: Mapping[str, Any], keys: Sequence[str]) -> None:
    """Refuse a key that nothing reads, such as a known one misspelt."""
    for key in entry:
        if key not in keys:
            raise ValueError(f"{place}: key {key!r:.60} must be one of {', '.join(keys)}: correct or remove it")


def read_parameters(label: str, effect: type[Effect], parameters: Any) -> Effect:
    """Construct an effect from its parameters as a file holds them; messages begin with the label.

    Raises
    ------
    ValueError
        They are not those of the effect, or out of range.
    """
    names = [field.name for field in fields(effect)]  # type: ignore[arg-type]
    if not isinstance(parameters, dict) or sorted(parameters) != sorted(names):
        raise ValueError(f"{label} must hold {', '.join(names) or 'nothing'}: correct the names")
    # the limits of `from_vector` are those of the parameters: a fit never ends beyond them
    lowest, highest = (effect.from_vector(np.full(len(effect.SPREAD), sign * MAX_COMPONENT)) for sign in (-1, 1))
    for name, value in parameters.items():
        low, high = np.atleast_1d(getattr(lowest, name)), np.atleast_1d(getattr(highest, name))
        is_sequence = isinstance(getattr(lowest, name), tuple)
        values = value if is_sequence and isinstance(value, list) else [value]
        if is_sequence != isinstance(value, list) or len(values) != len(low) or not all(map(_is_number, values)):
            rule = f"{len(low)} numbers" if is_sequence else "a number"
            raise ValueError(f"{label}: {name}={value!r} must be {rule}: correct it")
        if not all(a - _ROUNDING * abs(a) <= number <= b + _ROUNDING * abs(b)
                   for a, number, b in zip(low, values, high, strict=True)):
            raise ValueError(f"{label}: {name}={value!r} must lie in [{low.min():g}, {high.max():g}]: correct it")
    return effect(**{name: tuple(value) if isinstance(value, list) else value for name, value in parameters.items()})


def _is_number(value: Any) -> bool:
    return is_number(value) and abs(value) <= sys.float_info.max
