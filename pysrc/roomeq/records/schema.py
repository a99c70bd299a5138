"""The one schema of the rows of `rirs.jsonl` and `noises.jsonl`: their keys, and the values that each key takes.

A row is declared once, as a `TypedDict`. The type of a key carries its limits and, as `description`, the rule in words:
`row_problem` and `noise_problem` check rows against the declaration and quote the rule in their messages. Keys that a
declaration does not name are allowed and kept.
"""

import hashlib
import math
import re
import unicodedata
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, NotRequired, TypedDict, get_args, get_type_hints, is_typeddict

import msgspec
from msgspec import Meta

from roomeq.core.constants import BANDS_HZ, FS_HZ, bands_hz

MAX_ID = 200
"""Longest id [characters]: files are named after ids, with a suffix."""
UNKNOWN = "unknown"
"""Id of a room, source or microphone without a name (ids must not be null)."""
LARGEST = 1e9
"""Largest absolute value of a number: no length, time or level of a room comes near it."""
_ID_OF_SCOPE = {"source": "source_id", "mic": "mic_id", "room": "room_id", "rir": "id"}

_SUFFIX = 50  # room for what follows an id: a channel, "-noise1"
_HASH = 12
_ID_PATTERN = rf"^[A-Za-z0-9_+][A-Za-z0-9._+-]{{0,{MAX_ID - 1}}}\Z"
_ID = re.compile(_ID_PATTERN)
_LARGEST_COMPONENT = 1.001  # of a unit vector, whose components may be rounded
_ROUNDED = 0.1  # deviation of its length where they are rounded to one decimal
_N_POINTS = len(BANDS_HZ)
_FEWEST_BANDS, _MOST_BANDS = 7, 9  # at 8 and 48 kHz

Id = Annotated[str, Meta(pattern=_ID_PATTERN, description=(
    f"1 to {MAX_ID} letters, digits or ._+-, no dash or dot first, no path"))]
RirId = Annotated[str, Meta(pattern=_ID_PATTERN, description="the id of an RIR")]
# JSON's \ud800 decodes to a lone surrogate, which no file system takes
FileName = Annotated[str, Meta(pattern="^[^\0\r\n\ud800-\udfff]+\\Z", description="a file name")]
Text = Annotated[str, Meta(description="a text")]
Flag = Annotated[bool, Meta(description="true or false")]
Count = Annotated[int, Meta(gt=0, le=int(LARGEST), description="a positive whole number")]
Number = Annotated[float, Meta(ge=-LARGEST, le=LARGEST, description="a number")]
Amount = Annotated[float, Meta(ge=0, le=LARGEST, description="a number, not negative")]
DirectSample = Annotated[float, Meta(gt=-1, le=LARGEST, description="a number of samples, not negative")]
Polarity = Annotated[Literal[1, -1], Meta(description="1 or -1")]
Vector = Annotated[list[Number | None], Meta(min_length=3, max_length=3, description=(
    "three numbers (each may be null)"))]
Direction = Annotated[list[Number | None], Meta(min_length=3, max_length=3, description=(
    "a unit vector: three numbers in [-1, 1] (each may be null)"))]
Vectors = Annotated[list[Vector], Meta(min_length=2, description="a list of two or more positions")]
Numbers = Annotated[list[Number], Meta(description="a list of numbers")]
EqLevels = Annotated[list[Number], Meta(min_length=_N_POINTS, max_length=_N_POINTS, description=f"{_N_POINTS} numbers")]
EqFlags = Annotated[list[bool], Meta(min_length=_N_POINTS, max_length=_N_POINTS, description=(
    f"{_N_POINTS} times true or false"))]
EqValues = Annotated[list[Number | None], Meta(min_length=_N_POINTS, max_length=_N_POINTS, description=(
    f"{_N_POINTS} numbers (or null)"))]
_PER_BAND = "one per octave band"
BandFlags = Annotated[list[bool], Meta(min_length=_FEWEST_BANDS, max_length=_MOST_BANDS, description=(
    f"true or false, {_PER_BAND}"))]
BandTimes = Annotated[list[Amount | None], Meta(min_length=_FEWEST_BANDS, max_length=_MOST_BANDS, description=(
    f"times, not negative (or null), {_PER_BAND}"))]
BandValues = Annotated[list[Number | None], Meta(min_length=_FEWEST_BANDS, max_length=_MOST_BANDS, description=(
    f"numbers (or null), {_PER_BAND}"))]
NumberOrNull = Annotated[Number | None, Meta(description="a number or null")]


def unit_name(row: Mapping[str, Any], scope: str) -> str:
    """Return the name of what a scope (``"source"``, ``"mic"``, ``"room"``, ``"rir"``, ``"all"``) refers to in a row.

    Devices without a name are one within a corpus, and others in another one.
    """
    if scope == "all":
        return "all"
    name = str(row[_ID_OF_SCOPE[scope]])
    unnamed = scope in ("source", "mic") and name == UNKNOWN and row.get("corpus")
    return f"{UNKNOWN} of {row['corpus']}" if unnamed else name


def session_name(row: Mapping[str, Any]) -> str:
    """Return the name of the recording session of a row, empty where the row states none.

    Within a session, no gain of the recording chain changes; between sessions it may.
    """
    return row.get("session") or ""


def stated_air(row: Mapping[str, Any]) -> dict[str, float]:
    """Return temperature and humidity of a row, as far as it states them: arguments of `require_air` and `Air`."""
    return {key: row[key] for key in ("temperature_c", "humidity_pct") if row.get(key) is not None}


def is_timed(row: Mapping[str, Any]) -> bool:
    """Tell whether sample 0 of an RIR is the emission: only if its row says so."""
    return row.get("tof_removed") is False


class AcousticParameters(TypedDict, total=False):
    """What `roomeq.acoustics.parameters.measure` returns.

    Lists hold one value per octave band of the row's sample rate, `roomeq.core.constants.bands_hz`; those of the EQ,
    which is of 16 kHz alone, one for each of its eight points.
    """

    direct_sample: DirectSample | None
    direct_polarity: Polarity | None
    drr_db: NumberOrNull
    noise_intersection_s: NumberOrNull
    noise_floor_db: NumberOrNull
    edt_s: BandTimes | None
    edt_valid: BandFlags | None
    t20_s: BandTimes
    t20_valid: BandFlags
    t30_s: BandTimes | None
    t30_valid: BandFlags | None
    c50_db: BandValues | None
    c50_valid: BandFlags | None
    decay_range_db: BandValues | None
    band_noise_intersection_s: BandValues | None
    band_noise_floor_db: BandValues | None
    eq_db: EqLevels
    eq_valid: EqFlags
    eq_edge_db: NumberOrNull
    eq_snr_db: EqValues | None


_COMPLETE = {"eq_db": ("eq_db", "eq_valid", "eq_edge_db"), "t20_valid": ("t20_s", "t20_valid")}
"""Acoustic parameters that are only used together: where the first is given, none of the others may be missing."""


class Membrane(TypedDict):
    """A source that is a membrane in a rigid sphere (`roomeq.Loudspeaker`)."""

    radius_m: Annotated[float, Meta(ge=0, le=LARGEST, description="a length, not negative")]
    membrane_radius_m: Annotated[float, Meta(ge=0, le=LARGEST, description="a length, not negative")]


_ROUNDED_M = 1e-3

TARGET_AGAIN = "target_t60_s again"
"""Entry of a row's `drawn` where a target that could not be met was replaced by another."""
OF_SIMULATED = ("seed", "model", "measured_id")
"""Keys that rows of simulated RIRs have."""


class RirRow(TypedDict):
    """A line of `rirs.jsonl`: one RIR. Every optional key but `fs_hz` and `n_samples` may be null."""

    id: Id
    wav: FileName
    room_id: Id
    source_id: Id
    mic_id: Id
    fs_hz: NotRequired[Count]
    n_samples: NotRequired[Count]
    # geometry; a coordinate that nobody measured is null
    room_dims_m: NotRequired[Vector | None]
    mesh: NotRequired[FileName | None]
    source_pos_m: NotRequired[Vector | None]
    mic_pos_m: NotRequired[Vector | None]
    source_dir: NotRequired[Direction | None]
    mic_dir: NotRequired[Direction | None]
    distance_m: NotRequired[Amount | None]
    unreliable_geometry: NotRequired[Flag | None]
    geometry_problem: NotRequired[Text | None]
    geometry_ok: NotRequired[Flag | None]
    channel_pos_m: NotRequired[Vectors | None]
    source_directivity: NotRequired[Annotated[Membrane, Meta(description="an object")] | None]
    drawn: NotRequired[Annotated[list[str], Meta(description="a list of texts")] | None]
    # the measurement
    recording: NotRequired[Text | None]
    corpus: NotRequired[Text | None]
    room_type: NotRequired[Text | None]
    excitation: NotRequired[Text | None]
    session: NotRequired[Text | None]
    temperature_c: NotRequired[Number | None]
    humidity_pct: NotRequired[Number | None]
    documented_t60_s: NotRequired[Amount | None]
    binaural: NotRequired[Flag | None]
    uncommon: NotRequired[Flag | None]
    tof_removed: NotRequired[Flag | None]
    repeat_of: NotRequired[RirId | None]
    suspicious: NotRequired[Text | None]
    # what the toolkit measured
    acoustic_parameters: NotRequired[Annotated[AcousticParameters, Meta(description="an object")] | None]
    screen: NotRequired[Text | None]
    # what the simulation was told and what it did
    materials: NotRequired[Annotated[dict[str, Any], Meta(description="an object")] | None]
    target_t60_s: NotRequired[Amount | None]
    t30_s: NotRequired[Amount | None]
    model: NotRequired[Annotated[list[Any], Meta(description="a list of effects")] | None]
    seed: NotRequired[Annotated[int, Meta(description="a whole number")] | None]
    leaked_share: NotRequired[Number | None]
    few_rays_db: NotRequired[Number | None]
    direct_sample: NotRequired[DirectSample | None]
    direct_polarity: NotRequired[Polarity | None]
    direct_visible: NotRequired[Flag | None]
    noise_for: NotRequired[RirId | None]
    measured_id: NotRequired[RirId | None]
    # the compensation of the EQ
    eq_target_db: NotRequired[Numbers | None]
    eq_achieved_db: NotRequired[Numbers | None]
    eq_error_db: NotRequired[Numbers | None]
    eq_gain_db: NotRequired[Numbers | None]


class NoiseRow(TypedDict):
    """A line of `noises.jsonl`: one noise recording. Every optional key may be null."""

    id: Id
    wav: FileName
    kind: Annotated[Literal["ambient", "point"], Meta(description="'ambient' or 'point'")]
    room_id: NotRequired[Id | None]
    fs_hz: NotRequired[Count | None]
    duration_s: NotRequired[Amount | None]


def is_id(text: object) -> bool:
    """Tell whether a text may be an id: letters, digits and ``._+-``, no path, no leading dash or dot."""
    return isinstance(text, str) and _ID.match(text) is not None


def make_id(text: str) -> str:
    """Return the text with everything that an id may not hold turned into ``-``.

    A hash is appended where the result would not tell two texts apart: to a long one, and to one in another script.
    Letters with an accent may be composed or decomposed, as systems and archives change the names of files.
    """
    text = unicodedata.normalize("NFC", text)
    cleaned = re.sub(r"[^A-Za-z0-9._+-]+", "-", text).lstrip(".-") or "x"
    if len(cleaned) <= MAX_ID - _SUFFIX and text.isascii():
        return cleaned
    digest = hashlib.sha256(text.encode(errors="surrogatepass")).hexdigest()[:_HASH]
    return f"{cleaned[:MAX_ID - _SUFFIX - _HASH - 1].rstrip('-')}-{digest}"


def row_problem(row: Mapping[str, Any]) -> str | None:
    """Return what is wrong with a row of `rirs.jsonl` (key, value and rule), or None."""
    if problem := _problem(row, RirRow):
        return problem
    for key in ("source_dir", "mic_dir"):
        if not may_be_unit_vector(row.get(key)):
            return f"{key}={_brief(row[key])} must be {_rule(Direction)}, no angles"
    parameters = row.get("acoustic_parameters") or {}
    for first, keys in _COMPLETE.items():
        for key in keys if first in parameters else ():
            if key not in parameters:
                return f"acoustic_parameters: key {key!r} is missing"
    fs_hz = row.get("fs_hz", FS_HZ)
    n_bands = len(bands_hz(fs_hz))
    for key, values in parameters.items():
        if isinstance(values, list) and not key.startswith("eq_") and len(values) != n_bands:
            return (f"acoustic_parameters: {key} holds {len(values)} values and must hold {n_bands}, one per octave "
                    f"band at {fs_hz} Hz")
    first_m, mic_m = (row.get("channel_pos_m") or [[]])[0], row.get("mic_pos_m") or []
    if any(None not in pair and abs(pair[0] - pair[1]) > _ROUNDED_M for pair in zip(first_m, mic_m, strict=False)):
        return (f"channel_pos_m[0]={first_m} and mic_pos_m={mic_m} must be the same place, that of an array's first "
                "microphone")
    return None


def may_be_unit_vector(vector: Sequence[float | None] | None) -> bool:
    """Tell whether a vector has the length 1, or may have it with what is unknown of it; 0 is an unknown direction."""
    known = [component for component in vector or () if component is not None]
    length = math.hypot(*known)
    if any(abs(component) > _LARGEST_COMPONENT for component in known):
        return False
    return length <= 1.0 + _ROUNDED and (length >= 1.0 - _ROUNDED or len(known) < 3 or length == 0.0)


def noise_problem(row: Mapping[str, Any]) -> str | None:
    """Return what is wrong with a row of `noises.jsonl` (key, value and rule), or None."""
    return _problem(row, NoiseRow)


def _problem(row: Mapping[str, Any], schema: type) -> str | None:
    try:
        try:
            msgspec.convert(row, schema)
        except UnicodeEncodeError:  # msgspec looks for keys and numbers in UTF-8, where surrogates have no place
            msgspec.convert(_without_surrogates(row), schema)
    except msgspec.ValidationError as error:
        return _explain(str(error), row, schema)
    return None


def _without_surrogates(value: Any) -> Any:
    """Return a value with surrogates turned into null characters, which file names and ids may not hold either."""
    if isinstance(value, str):
        return re.sub("[\ud800-\udfff]", "\0", value)
    if isinstance(value, dict):
        return {_without_surrogates(key): _without_surrogates(entry) for key, entry in value.items()}
    return [_without_surrogates(entry) for entry in value] if isinstance(value, list) else value


def _explain(message: str, row: Mapping[str, Any], schema: type) -> str:
    """Return an error of msgspec, such as "Expected `int`, got `str` - at `$.fs_hz`", as key, value and rule."""
    missing = re.match("Object missing required field `([^`]*)`", message)
    place = re.search(r" - at `\$([^`]*)`$", message)
    keys = re.findall(r"\.(\w+)", place[1].partition("[")[0]) if place else []
    objects, value, declared = [], row, schema
    for key in keys:
        value, declared = value[key], get_type_hints(_typed_dict(declared), include_extras=True)[key]
        objects.append(key)
    if missing:
        return "".join(f"{key}: " for key in objects) + f"key {missing[1]!r} is missing"
    path = "".join(f"{key}: " for key in objects[:-1])
    return f"{path}{objects[-1]}={_brief(value)} must be {_rule(declared)}"


def _rule(declared: Any) -> str | None:
    """Return the outermost description of a declared type."""
    for metadata in getattr(declared, "__metadata__", ()):
        if metadata.description:
            return metadata.description
    return next(filter(None, map(_rule, get_args(declared))), None)


def _typed_dict(declared: Any) -> Any:
    """Return the `TypedDict` in a declared type."""
    if is_typeddict(declared):
        return declared
    return next(filter(None, map(_typed_dict, get_args(declared))), None)


def _brief(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:60]}..."
