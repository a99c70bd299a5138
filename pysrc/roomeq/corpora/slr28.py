"""OpenSLR 28 (`RIRS_NOISES`): its measured part `real_rirs_isotropic_noises`, and `pointsource_noises`.

The lists have Kaldi's format, one line of options per file: ``--rir-id 1 --room-id R FILE`` and ``--noise-id 1
--noise-type isotropic --room-linkage R FILE``; `FILE` is relative to the folder above `RIRS_NOISES`. Without lists,
file names distinguish RIRs and noises. Rooms are read from file names:
``RWCP_type2_rir_cirline_ofc_imp050.wav``, ``RVB2014_type1_noise_largeroom1_1.wav``,
``air_type1_air_binaural_lecture_1_2.wav`` (room, dummy head 0/1, position). Simulated RIRs are not read.
"""

import re
import shlex
from pathlib import Path

from roomeq.core.files import read_text
from roomeq.corpora.folder import noises_of
from roomeq.corpora.record import Corpus, Recording, audio_files, is_uncommon_name, rir_row
from roomeq.records.schema import make_id

MEASURED_FOLDER, POINT_SOURCE_FOLDER = "real_rirs_isotropic_noises", "pointsource_noises"
_AIR = re.compile(r"air_type\d+_air_(?P<setup>binaural|phone(?:_bt)?)_(?P<room>[a-z0-9_]*?[a-z]\d?)"
                  r"(?:_(?P<head>[01]))?_(?P<position>\d+(?:_\d+)*|hfrp|hhp).*", re.IGNORECASE)
_RWCP_OR_REVERB = re.compile(r"(?P<db>[A-Za-z0-9]+)_(?P<type>type\d+)_(?:rir|noise)_(?:(?P<room>.+)_)?[^_]+")


def find_measured_part(source: Path) -> Path | None:
    """Return the folder of the measured part, `source` or one below it, or None."""
    for candidate in (source, source / MEASURED_FOLDER, source / "RIRS_NOISES" / MEASURED_FOLDER):
        if candidate.name == MEASURED_FOLDER and candidate.is_dir():
            return candidate
    return None


def list_slr28(source: Path) -> Corpus:
    """List the measured RIRs and noises of RIRS_NOISES.

    Raises
    ------
    ValueError
        The measured part is missing, or a line of a list is malformed.
    """
    measured = find_measured_part(source)
    if measured is None:
        raise ValueError(f"{source}: no folder {MEASURED_FOLDER} in it: unpack all of RIRS_NOISES")
    corpus = Corpus(name="SLR28", kind="slr28")
    for path, options in _list_files(measured, "rir_list", "rir"):
        binaural, uncommon = _is_dummy_head(path.stem), is_uncommon_name(path.stem)
        corpus.rirs.append(Recording(path, make_id(path.stem), rir_row(
            corpus=path.stem.split("_")[0], room_id=room_of(path.stem) or options.get("--room-id"),
            excitation="sweep" if path.stem.startswith("air") else None, binaural=binaural, uncommon=uncommon)))
    for path, options in _list_files(measured, "noise_list", "noise"):
        room = room_of(path.stem) or options.get("--room-linkage")
        noise = dict(room_id=make_id(room) if room else None, kind="ambient")
        corpus.noises.append(Recording(path, make_id(path.stem), noise))
    if (point := measured.parent / POINT_SOURCE_FOLDER).is_dir():
        corpus.noises += noises_of(audio_files(point), point, kind="point")
    if not corpus.rirs:
        raise ValueError(f"{measured}: no RIRs (*_rir_*.wav, air_*.wav): unpack all of RIRS_NOISES")
    return corpus


def room_of(stem: str) -> str | None:
    """Return the room of a file by its name; the lists give one room different ids for its RIRs and its noises."""
    if match := _AIR.fullmatch(stem):
        return f"AIR_{match['room']}"
    if match := _RWCP_OR_REVERB.fullmatch(stem):
        # the near and far positions of REVERB are in the same room
        return re.sub(r"_(near|far)$", "", f"{match['db']}_{match['room'] or match['type']}")
    return None


def _is_dummy_head(stem: str) -> bool:
    match = _AIR.fullmatch(stem)
    return match is not None and match["setup"].lower() == "binaural" and match["head"] != "0"


def _list_files(measured: Path, list_name: str, kind: str) -> list[tuple[Path, dict[str, str]]]:
    """Return the RIRs or noises with their options: the files of Kaldi's list or, without a list, by file name."""
    path = measured / list_name
    if not path.is_file():
        return [(file, {}) for file in audio_files(measured) if ("_noise_" in file.stem) == (kind == "noise")]
    listed = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        try:
            cells = shlex.split(line)
        except ValueError as error:
            raise ValueError(f"{path}:{number}: {error}: correct the line") from None
        if not cells:
            continue
        if len(cells) % 2 == 0 or any(not name.startswith("--") for name in cells[:-1:2]):
            raise ValueError(f"{path}:{number}: {line[:60]!r} must be options with a value each, then one file: "
                             "replace pipes by files")
        listed.append((_locate(measured, cells[-1]), dict(zip(cells[:-1:2], cells[1:-1:2], strict=True))))
    return listed


def _locate(measured: Path, name: str) -> Path:
    in_folder = measured / Path(name).name
    return in_folder if in_folder.exists() else measured.parent.parent / name
