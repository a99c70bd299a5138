"""What every reader of measured RIRs returns, and the parsing that readers share."""

import contextlib
import logging
import os
import re
import unicodedata
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from roomeq.core.digests import files_below
from roomeq.core.files import read_json
from roomeq.core.stamps import DONE_FILE, read_stamp
from roomeq.records.geometry import find_contradiction
from roomeq.records.schema import LARGEST, UNKNOWN, make_id

logger = logging.getLogger(__name__)

AUDIO_SUFFIXES = (".wav", ".wave", ".flac", ".ogg", ".oga", ".opus", ".aiff", ".aif", ".aifc", ".au", ".caf", ".w64",
                  ".rf64", ".sph", ".nist", ".mp3")
_OTHER_AUDIO_SUFFIXES = (".3gp", ".aac", ".ac3", ".amr", ".ape", ".m4a", ".m4b", ".mka", ".mp2", ".mp4", ".pcm", ".raw",
                         ".shn", ".snd", ".voc", ".webm", ".wma", ".wv", ".wv1", ".wv2")
"""Of files that are left out of folders: libsndfile does not read them, or not without being told how."""

_UNKNOWN_CELLS = {"", "?", "-", "na", "n/a", "nan", "none", "null", "unknown"}
_AMBIENT_WORDS = {"ambient", "ambience", "background", "isotropic", "silence", "roomtone"}


@dataclass(frozen=True)
class Recording:
    """One audio (or SOFA) file of a corpus.

    Parameters
    ----------
    path : Path
    id : str
        Id of the RIR or noise; ``_ch0``, ``_ch1``, ... is appended for the channels of a file with several.
    row : dict
        What the corpus states: keys of the RIR row (see `rir_row`; of a SOFA file only those that the corpus states
        beside it), or `kind` and `room_id` of a noise.
    where : str
        Line of the manifest that lists the file (``file:line``); empty where no manifest does.
    """

    path: Path
    id: str
    row: dict[str, Any] = field(default_factory=dict)
    where: str = ""


@dataclass
class Corpus:
    """A corpus as its reader lists it; `notes` counts irregularities for the report."""

    name: str
    kind: str
    rirs: list[Recording] = field(default_factory=list)
    noises: list[Recording] = field(default_factory=list)
    notes: Counter[str] = field(default_factory=Counter)


def rir_row(**known: Any) -> dict[str, Any]:
    """Return the keys of an RIR row that describe the measurement; those that are not known are null (or false).

    Room, source and microphone get valid ids, ``"unknown"`` where they are not known. Geometry that contradicts itself
    is marked (`roomeq.records.geometry.find_contradiction`).

    Raises
    ------
    TypeError
        A key is not one of a measurement.
    """
    row: dict[str, Any] = dict(
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
        row.update(geometry_problem=problem.detail, unreliable_geometry=True)
    return row


class DistinctIds:
    """The texts of one corpus that ids were made from; with the same id, two would be taken for one room or person."""

    def __init__(self) -> None:
        self._texts: dict[tuple[str, str], str] = {}

    def add(self, key: str, made: str, text: str) -> None:
        """Add a text and the id that was made from it.

        Raises
        ------
        ValueError
            Another text under the same key has this id.
        """
        first = self._texts.setdefault((key, made), text)
        if unicodedata.normalize("NFC", text) != unicodedata.normalize("NFC", first):
            raise ValueError(f"{key}={text!r} and {first!r} would both have the id {made!r}: rename one")


def is_unknown(text: str) -> bool:
    """Tell whether a cell says that something is unknown: ``?``, ``NA``, or nothing."""
    return text.lower() in _UNKNOWN_CELLS


def parse_number(text: str | None) -> float | None:
    """Parse a number, with a point or comma as decimal mark; unknown (``?``, empty, ``NA``) is None.

    Raises
    ------
    ValueError
        The text is no number, or its absolute value exceeds `roomeq.records.schema.LARGEST`.
    """
    text = (text or "").strip()
    if is_unknown(text):
        return None
    if re.fullmatch(r"[+-]?\d+,\d+", text):
        text = text.replace(",", ".")
    value = float(text)
    if not abs(value) <= LARGEST:
        raise ValueError(f"{text!r} must be finite and within {LARGEST:g}")
    return value


def parse_amount(text: str | None) -> float | None:
    """Parse a number that cannot be negative, such as a distance or a time, as `parse_number` does."""
    value = parse_number(text)
    if value is not None and value < 0:
        raise ValueError(f"{text!r} must be 0 or more")
    return value


def parse_vector(text: str | None) -> list[float | None] | None:
    """Parse three coordinates ``"4.71 2.75 ?"`` (also separated by ``,``, ``;`` or ``x``); None if all are unknown.

    Where blanks, ``;`` or ``x`` separate them, a comma within one is a decimal mark.

    Raises
    ------
    ValueError
        The text does not hold three coordinates, or one is not a number.
    """
    text = (text or "").strip().strip("[]()")
    if is_unknown(text):
        return None
    parts = [part.strip(",") for part in re.split(r"[;x\u00d7\s]+", text) if part.strip(",")]
    if len(parts) == 1:
        parts = text.split(",")
    if len(parts) != 3:
        raise ValueError(f"{text!r} must be three numbers such as '4.7 2.75 ?'")
    vector = [parse_number(part) for part in parts]
    return None if vector == [None] * 3 else vector


def words_of(text: str) -> set[str]:
    """Return the words of a name in lower case; anything but a letter separates words."""
    return set(re.findall(r"[a-z]+", text.lower()))


def excitation_of(name: str) -> str | None:
    """Recognise the excitation by the words of a file name: ``"clap"``, ``"sweep"`` or None."""
    words = words_of(name)
    if words & {"clap", "claps", "clapper", "handclap"}:
        return "clap"
    return "sweep" if words & {"sweep", "ess", "swept"} else None


def is_binaural_name(name: str) -> bool:
    """Recognise a recording with a dummy head by the words of its name."""
    return bool(words_of(name) & {"brir", "brirs", "hrir", "binaural", "dummyhead"})


def is_uncommon_name(text: str) -> bool:
    """Recognise a space that one would not simulate (stairs) by the words of its name."""
    return bool(words_of(text) & {"stairs", "stair", "staircase", "stairway", "stairwell"})


def noise_kind_of(name: str) -> str:
    """Recognise by the words of a name whether a noise is ``"ambient"`` or comes from a ``"point"``."""
    words = words_of(name)
    return "ambient" if words & _AMBIENT_WORDS or {"room", "tone"} <= words else "point"


def audio_files(directory: Path, *, warn: bool = True) -> list[Path]:
    """Return the audio files below a directory in a fixed order, also those in linked folders, without hidden ones.

    Files in a folder below it that a step of roomeq made are left out: an output that lies in the folder of its source
    would otherwise be read as a part of the source when the step runs again. Warnings count them, and files with the
    suffix of audio that is not read, unless `warn` is false.
    """
    files = files_below(directory)
    folders = {path.parent for path in files}
    below = {above for folder in folders for above in (folder, *folder.parents)
             if above != directory and above.is_relative_to(directory)}
    outputs = {folder for folder in below if _is_output(folder)}
    of_others = [path for path in files if outputs.isdisjoint(path.parents)]
    kept, made = (sorted(path for path in some if path.suffix.lower() in AUDIO_SUFFIXES) for some in (of_others, files))
    unread = sorted(path for path in of_others if path.suffix.lower() in _OTHER_AUDIO_SUFFIXES)
    if warn and len(kept) < len(made):
        logger.warning("%s: %d audio files in folders below it that roomeq made (%s) are left out", directory,
                       len(made) - len(kept), ", ".join(map(str, sorted(outputs))))
    if warn and unread:
        logger.warning("%s: %d files are left out, as audio of their format is not read (the first: %s): convert them "
                       "to WAV or FLAC", directory, len(unread), unread[0].relative_to(directory))
    return kept


def _is_output(folder: Path) -> bool:
    """Tell whether a step of roomeq made a folder; other programs write files called `.done` too."""
    with contextlib.suppress(ValueError, OSError):
        stamp = read_json(folder / DONE_FILE)
        return isinstance(stamp, dict) and "step" in stamp
    return False


def is_sofa(path: Path) -> bool:
    """Tell by its name whether a file is a SOFA file."""
    return path.suffix.lower() == ".sofa"


def folder_name(directory: Path) -> str:
    """Return the name of a folder, also of the working directory; that of a link is its own."""
    return Path(os.path.abspath(directory)).name


class Stamped(NamedTuple):
    """Files of a corpus, by what makes an output depend on them.

    Attributes
    ----------
    inputs : list of Path
        The corpus, if a `roomeq.core.build.Build` made it: its stamp holds the hashes of its own files. Else empty.
    others : list of Path
        Files that no stamp covers, such as those that somebody put beside a step's: their own content counts.
    """

    inputs: list[Path]
    others: list[Path]


def by_stamp(source: Path, files: Iterable[Path]) -> Stamped:
    """Return which files of a corpus its stamp, if it has one, covers.

    Raises
    ------
    ValueError
        The stamp is damaged or of another version of roomeq.
    """
    stamp = read_stamp(source)
    if stamp is None:
        return Stamped([], list(files))
    return Stamped([source], [path for path in files if os.path.relpath(path, source) not in stamp.files])


def id_of_path(path: Path, root: Path) -> str:
    """Return an id made from a file's path below a root, without the suffix."""
    return make_id("-".join(path.relative_to(root).with_suffix("").parts))
