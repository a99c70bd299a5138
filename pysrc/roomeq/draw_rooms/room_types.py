"""Types of rooms: the distributions that their rooms are drawn from, and the strict reader of their TOML file.

``conf/room_types.toml`` holds the types of this package and explains each key.
"""

import math
import tomllib
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from difflib import get_close_matches
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from roomeq.draw_rooms.distributions import Distribution, parse_distribution
from roomeq.records.schema import is_id

if TYPE_CHECKING:
    import numpy as np

DEFAULT_TYPES = Path(__file__).with_name("room_types.toml")
"""File of the package's types; conf/room_types.toml links to it."""
MAX_COUNT = 16
"""Largest number of sources, microphones or pieces of furniture of a kind in a room."""
MAX_CHANNELS = 64
"""Largest number of microphones in an array."""
AS_THEY_ARE = "materials"
"""Instead of a reverberation time: that of the drawn materials."""
DIN_18041 = {"A1": (0.45, 0.07), "A2": (0.37, -0.14), "A3": (0.32, -0.17), "A4": (0.26, -0.14)}
"""Target T60 of DIN 18041:2016 by use (music; speech; teaching; teaching, inclusive): a and b in ``a lg V + b`` [s]."""


class Membrane(NamedTuple):
    """A source that is a membrane in a rigid sphere (`roomeq.Loudspeaker`) [m]."""

    radius_m: float
    membrane_radius_m: float


# a talker: a head of 8.75 cm (Algazi, Avendano and Duda 2001) with the open mouth that speech has at vowels
DIRECTIVITIES: Mapping[str, Membrane | None] = {
    "omnidirectional": None, "talker": Membrane(0.0875, 0.015), "loudspeaker": Membrane(0.1, 0.05)}
"""Kinds of sources; None radiates alike in all directions."""
SURFACES = ("free", "table", "wall")
"""Where a source or microphone may be: on a stand or a person, on a table, on a wall."""


@dataclass(frozen=True)
class DecayTime:
    """Distribution of the reverberation time at 1 kHz.

    Attributes
    ----------
    distribution
        Of the time [s], or of its ratio to the target of DIN 18041; None: that of the materials as they are.
    group
        Use of DIN 18041 (`DIN_18041`); None: the distribution is of the time itself.
    """

    distribution: Distribution | None
    group: str | None = None

    def draw(self, volume_m3: float, rng: "np.random.Generator") -> float | None:
        """Draw the time for a room [s]; None if its materials are not scaled."""
        if self.distribution is None:
            return None
        value = self.distribution.draw(rng)
        if self.group:
            slope_s, offset_s = DIN_18041[self.group]
            value *= max(slope_s * math.log10(volume_m3) + offset_s, 0.2)
        return min(max(value, 0.1), 5.0)


@dataclass(frozen=True)
class Furniture:
    """A kind of furniture: boxes along the walls, or tops of tables, which devices stand on."""

    kind: str
    count: Distribution
    length_m: Distribution
    width_m: Distribution
    height_m: Distribution
    materials: tuple[str, ...]
    at_wall: bool


@dataclass(frozen=True)
class SourcePlace:
    """A kind of source: how often, where, and how it radiates."""

    share: float
    directivity: str
    on: str
    height_m: Distribution
    turned_deg: Distribution


@dataclass(frozen=True)
class MicPlace:
    """A kind of microphone: how often, and where; `array_m` holds the positions of an array relative to the place."""

    share: float
    on: str
    height_m: Distribution
    array_m: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class RoomType:
    """A type of rooms; see ``conf/room_types.toml``."""

    name: str
    share: float
    floor_area_m2: Distribution
    aspect: Distribution
    height_m: Distribution
    l_shaped: float
    furnished: float
    walls: tuple[str, ...]
    floors: tuple[str, ...]
    ceilings: tuple[str, ...]
    t60_s: DecayTime
    temperature_c: Distribution
    humidity_pct: Distribution
    wall_distance_m: float
    source_mic_distance_m: float
    num_sources: Distribution
    num_mics: Distribution
    furniture: tuple[Furniture, ...]
    sources: tuple[SourcePlace, ...]
    microphones: tuple[MicPlace, ...]


def types_file(choice: str | Path | None) -> Path:
    """Return the file of a choice of types (`read_room_types`): it is the file, or is of the package's types."""
    is_file = choice is not None and (str(choice).endswith(".toml") or "/" in str(choice))
    return Path(str(choice)) if is_file else DEFAULT_TYPES


def read_room_types(choice: str | Path | None = None) -> list[RoomType]:
    """Read types of rooms.

    Parameters
    ----------
    choice
        A TOML file, or names of types in ``conf/room_types.toml`` with commas between; by default all of these.

    Returns
    -------
    list of RoomType
        In the order of the file.

    Raises
    ------
    ValueError
        The file is missing or no TOML, a key is unknown or missing, or a value is out of range; the message names file,
        key, rule and remedy.
    """
    path = types_file(choice)
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ValueError(f"{path}: cannot be read as types of rooms ({error}): see conf/room_types.toml for the "
                         "form") from None
    if not content:
        raise ValueError(f"{path}: no type of room in it: add a table such as [meeting_room]")
    if choice is None or Path(choice) == path:
        return [_room_type(path, name, table) for name, table in content.items()]
    names = [name for name in str(choice).split(",") if name]
    if not names:
        raise ValueError(f"room_types={str(choice)!r} must be a TOML file or among {', '.join(content)}: give one, or "
                         "leave the option out")
    for name in names:
        if name not in content:
            raise ValueError(f"room_types: {name!r} must be a TOML file or among {', '.join(content)}: correct "
                             "the name")
    return [_room_type(path, name, content[name]) for name in content if name in names]


def draw_type(types: Sequence[RoomType], rng: "np.random.Generator") -> RoomType:
    """Draw a type by its share."""
    return types[draw_index([room_type.share for room_type in types], rng)]


def draw_index(shares: Sequence[float], rng: "np.random.Generator") -> int:
    """Draw an index by its share."""
    return min(bisect_right(list(accumulate(shares)), rng.random() * sum(shares)), len(shares) - 1)


Parser = Callable[[Any], Any]
_REQUIRED = object()


def _room_type(path: Path, name: str, table: Any) -> RoomType:
    if not is_id(name):
        raise ValueError(f"{path}: type {name!r} must be named by letters, digits and ._+-: rename it")
    return _parse(RoomType, f"{path}: {name}", table, {
        "share": (_number(1e-9, 1e9), 1.0),
        "floor_area_m2": (_distribution(2.0, 5000.0), _REQUIRED),
        "aspect": (_distribution(1.0, 5.0), _REQUIRED),
        "height_m": (_distribution(2.0, 20.0), _REQUIRED),
        "l_shaped": (_number(0.0, 1.0), 0.0),
        "furnished": (_number(0.0, 1.0), 0.0),
        "walls": (_names, ()),
        "floors": (_names, ()),
        "ceilings": (_names, ()),
        "t60_s": (_decay_time, _REQUIRED),
        "temperature_c": (_distribution(0.0, 40.0), Distribution(20.0, 20.0)),
        "humidity_pct": (_distribution(5.0, 95.0), Distribution(50.0, 50.0)),
        "wall_distance_m": (_number(0.05, 2.0), 0.5),
        "source_mic_distance_m": (_number(0.1, 5.0), 0.3),
        "num_sources": (_distribution(1, MAX_COUNT), Distribution(1, 1)),
        "num_mics": (_distribution(1, MAX_COUNT), Distribution(1, 1)),
        "furniture": (_tables(Furniture, {
            "kind": (_one_of("box", "table"), _REQUIRED),
            "count": (_distribution(0, MAX_COUNT), Distribution(1, 1)),
            "length_m": (_distribution(0.2, 10.0), _REQUIRED),
            "width_m": (_distribution(0.2, 5.0), _REQUIRED),
            "height_m": (_distribution(0.2, 3.0), _REQUIRED),
            "materials": (_names, _REQUIRED),
            "at_wall": (_flag, False)}), ()),
        "sources": (_tables(SourcePlace, {
            "share": (_number(1e-9, 1e9), 1.0),
            "directivity": (_one_of(*DIRECTIVITIES), "omnidirectional"),
            "on": (_one_of(*SURFACES), "free"),
            "height_m": (_distribution(0.02, 10.0), _REQUIRED),
            "turned_deg": (_distribution(-180.0, 180.0), Distribution(-180.0, 180.0))}), _REQUIRED),
        "microphones": (_tables(MicPlace, {
            "share": (_number(1e-9, 1e9), 1.0),
            "on": (_one_of(*SURFACES), "free"),
            "height_m": (_distribution(0.02, 10.0), _REQUIRED),
            "array_m": (_array, ((0.0, 0.0, 0.0),))}), _REQUIRED),
    }, name=name)


def _parse(made: type, place: str, table: Any, keys: Mapping[str, tuple[Parser, Any]], **more: Any) -> Any:
    """Make a dataclass from a table; a key that it does not know, a wrong value or a missing key is refused."""
    if not isinstance(table, dict):
        raise ValueError(f"{place}={table!r:.60} must be a table of keys: see conf/room_types.toml for the form")
    for key in table:
        if key not in keys:
            close = get_close_matches(key, keys, n=1)
            raise ValueError(f"{place}: key {key!r:.60} must be one of {', '.join(keys)}: "
                             + (f"did you mean {close[0]}?" if close else "correct or remove it"))
    values = {}
    for key, (parse, default) in keys.items():
        if key not in table:
            if default is _REQUIRED:
                raise ValueError(f"{place}: key {key!r} is missing: add it")
            values[key] = default
            continue
        try:
            values[key] = parse(table[key])
        except _InnerError as error:
            raise ValueError(f"{place}: {key}{error}") from None
        except ValueError as error:
            raise ValueError(f"{place}: {key}={table[key]!r:.60} must be {error}: correct it") from None
    assert {field.name for field in fields(made)} == {*values, *more}
    return made(**values, **more)


class _InnerError(ValueError):
    """A complete message about an entry of a list, which follows its key."""


def _distribution(low: float, high: float) -> Parser:
    return lambda value: parse_distribution(value, low, high)


def _number(low: float, high: float) -> Parser:
    def parse(value: Any) -> float:
        if not isinstance(value, int | float) or isinstance(value, bool) or not low <= value <= high:
            raise ValueError(f"a number in [{low:g}, {high:g}]")
        return float(value)

    return parse


def _one_of(*names: str) -> Parser:
    def parse(value: Any) -> str:
        if value not in list(names):
            raise ValueError(f"one of {', '.join(names)}")
        return value

    return parse


def _flag(value: Any) -> bool:
    if not isinstance(value, bool):
        raise ValueError("true or false")
    return value


def _names(value: Any) -> tuple[str, ...]:
    if not isinstance(value, list) or not value or not all(isinstance(name, str) for name in value):
        raise ValueError("a list of names of materials")
    return tuple(value)


def _decay_time(value: Any) -> DecayTime:
    if value == AS_THEY_ARE:
        return DecayTime(None)
    try:
        if isinstance(value, dict) and set(value) == {"din_18041", "ratio"} and value["din_18041"] in list(DIN_18041):
            return DecayTime(parse_distribution(value["ratio"], 0.2, 5.0), value["din_18041"])
        return DecayTime(parse_distribution(value, 0.1, 5.0))
    except ValueError as error:
        raise ValueError(f'{error}; or "{AS_THEY_ARE}"; or {{din_18041 = "{"|".join(DIN_18041)}", ratio = ...}} with '
                         "ratios in [0.2, 5]") from None


def _array(value: Any) -> tuple[tuple[float, ...], ...]:
    number = _number(-1.0, 1.0)
    if not isinstance(value, list) or not 1 <= len(value) <= MAX_CHANNELS or not all(
            isinstance(point, list) and len(point) == 3 for point in value):
        raise ValueError(f"1 to {MAX_CHANNELS} positions [x, y, z]")
    return tuple(tuple(number(axis) for axis in point) for point in value)


def _tables(made: type, keys: Mapping[str, tuple[Parser, Any]]) -> Parser:
    def parse(value: Any) -> tuple[Any, ...]:
        if not isinstance(value, list) or not value:
            raise ValueError("one or more tables")
        entries = []
        for n, entry in enumerate(value):
            try:
                entries.append(_parse(made, f"[{n}]", entry, keys))
            except ValueError as error:
                raise _InnerError(str(error)) from None
        return tuple(entries)

    return parse
