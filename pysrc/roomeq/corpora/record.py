"""What every reader of measured RIRs delivers, and the parsing that they share."""

import re
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from roomeq.core.build import DONE_FILE
from roomeq.records.geometry import find_contradiction
from roomeq.records.schema import LARGEST, make_id

AUDIO_SUFFIXES = (".wav", ".flac", ".ogg", ".aiff", ".aif", ".au", ".caf", ".w64", ".mp3")
UNKNOWN = "unknown"
"""Id of a room, source or microphone that nobody named (the contract has no null there)."""

_UNKNOWN_CELLS = {"", "?", "-", "na", "n/a", "nan", "none", "null", "unknown"}
_AMBIENT_WORDS = {"ambient", "ambience", "background", "isotropic", "silence", "roomtone"}


@dataclass(frozen=True)
class Recording:
    """One audio (or SOFA) file of a corpus.

    Parameters
    ----------
    path : Path
    id : str
        Of the RIR or noise; a file with several channels gets ``_ch0``, ``_ch1``, ... behind it.
    row : dict
        Keys of the RIR row that the corpus tells (see `rir_row`), or `kind` and `room_id` of a noise.
    """

    path: Path
    id: str
    row: dict = field(default_factory=dict)


@dataclass
class Corpus:
    """A corpus as listed by its reader; `notes` counts what was odd, for the report."""

    name: str
    kind: str
    rirs: list[Recording] = field(default_factory=list)
    noises: list[Recording] = field(default_factory=list)
    notes: Counter = field(default_factory=Counter)


def rir_row(**known) -> dict:
    """Return the keys of an RIR row that describe the measurement; what is not given is null (or false).

    Ids are cleaned, so that they hold no path; room, source and microphone are ``"unknown"`` where not given.

    Raises
    ------
    TypeError
        A key that no reader delivers.
    """
    row = dict(
        corpus=None, room_id=None, room_type=None, room_dims_m=None, source_pos_m=None, mic_pos_m=None,
        source_id=None, mic_id=None, source_dir=None, mic_dir=None, temperature_c=None, humidity_pct=None,
        binaural=False, excitation=None, session=None, repeat_of=None, distance_m=None, documented_t60_s=None,
        tof_removed=None, unreliable_geometry=False, geometry_problem=None, uncommon=False)
    if unexpected := set(known) - set(row):
        raise TypeError(f"not a key of an RIR row: {sorted(unexpected)}")
    row.update(known)
    for key in ("room_id", "source_id", "mic_id"):
        row[key] = make_id(str(row[key])) if row[key] is not None else UNKNOWN
    problem = find_contradiction(row)
    if problem:
        row.update(geometry_problem=problem, unreliable_geometry=True)
    return row


def parse_number(text: str | None) -> float | None:
    """Parse a number; a comma may be the decimal mark; unknown (``?``, empty, ``NA``) is None.

    Raises
    ------
    ValueError
        The text is neither, not finite or beyond all measure.
    """
    text = (text or "").strip()
    if text.lower() in _UNKNOWN_CELLS:
        return None
    if re.fullmatch(r"[+-]?\d+,\d+", text):
        text = text.replace(",", ".")
    value = float(text)
    if not abs(value) <= LARGEST:
        raise ValueError(f"{text!r} must be finite and within {LARGEST:g}")
    return value


def parse_amount(text: str | None) -> float | None:
    """`parse_number` for what cannot be negative: a distance, a time."""
    value = parse_number(text)
    if value is not None and value < 0:
        raise ValueError(f"{text!r} must be 0 or more")
    return value


def parse_vector(text: str | None) -> list[float | None] | None:
    """Parse three coordinates ``"4.71 2.75 ?"`` (also with ``,``, ``;`` or ``x`` between); all unknown is None.

    Raises
    ------
    ValueError
        There are not three, or one is no number.
    """
    text = (text or "").strip().strip("[]()")
    if text.lower() in _UNKNOWN_CELLS:
        return None
    parts = [part for part in re.split(r"\s*[,;x\u00d7]\s*|\s+", text) if part]
    if len(parts) != 3:
        raise ValueError(f"{text!r} must be three numbers such as '4.7 2.75 ?'")
    vector = [parse_number(part) for part in parts]
    return None if vector == [None] * 3 else vector


def words_of(text: str) -> set[str]:
    """Return the lower-case words of a name: what lies between anything that is no letter."""
    return set(re.findall(r"[a-z]+", text.lower()))


def excitation_of(name: str) -> str | None:
    """Recognise by the words of a file's name what excited the room: ``"clap"``, ``"sweep"`` or None."""
    words = words_of(name)
    if words & {"clap", "claps", "clapper", "handclap"}:
        return "clap"
    return "sweep" if words & {"sweep", "ess", "swept"} else None


def is_binaural_name(name: str) -> bool:
    """Tell by the words of a name whether a dummy head was listening."""
    return bool(words_of(name) & {"brir", "brirs", "hrir", "binaural", "dummyhead"})


def is_uncommon_name(text: str) -> bool:
    """Tell by its words whether a space is none that one would simulate: stairs."""
    return bool(words_of(text) & {"stairs", "stair", "staircase", "stairway", "stairwell"})


def noise_kind_of(name: str) -> str:
    """Recognise by the words of a name whether a noise surrounds (``"ambient"``) or comes from a ``"point"``."""
    words = words_of(name)
    return "ambient" if words & _AMBIENT_WORDS or {"room", "tone"} <= words else "point"


def audio_files(directory: Path) -> list[Path]:
    """Return the audio files below a directory in a fixed order, hidden ones left out."""
    return sorted(path for path in directory.rglob("*")
                  if path.suffix.lower() in AUDIO_SUFFIXES and path.is_file()
                  and not any(part.startswith(".") for part in path.relative_to(directory).parts))


def is_generated(source: Path) -> bool:
    """Tell whether a corpus was made by a `roomeq.core.build.Build`, which stamps it with hashes of what is in it."""
    return (source / DONE_FILE).is_file()


def id_of_path(path: Path, root: Path) -> str:
    """Return an id made of a file's path below a root, without its suffix."""
    return make_id("-".join(path.relative_to(root).with_suffix("").parts))
