"""BUT ReverbDB as released: `<Room>/MicID01/SpkIDnn_DATE_{S,T}/NN/RIR/*.wav`, meta files, background noises.

Positions are in metres from one corner along depth, width and height of the room, which are our x, y and z. Sessions
named `_S` were made for RIRs; sessions named `_T` retransmit speech (`english/`, not read) and repeat RIRs.
Source: I. Szoke et al., doi 10.1109/JSTSP.2019.2917582, and the release itself.
"""

import logging
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from roomeq.corpora.record import (
    Corpus,
    Recording,
    excitation_of,
    is_uncommon_name,
    parse_amount,
    parse_number,
    rir_row,
)
from roomeq.records.geometry import is_known
from roomeq.records.schema import make_id

logger = logging.getLogger(__name__)

UNRELIABLE_ROOMS = ("Hotel_SkalskyDvur_ConferenceRoom2", "VUT_FIT_L227")
"""Rooms whose positions the release's own notes call unreliable."""
UNCOMMON_ROOMS = ("VUT_FIT_L227",)
"""Spaces that the paper leaves out: stairs."""

_SESSION = re.compile(r"(SpkID\d+)_(.+)_([A-Z])")
_DIGITS = re.compile("[0-9]{1,9}")
_AXES = ("Depth", "Width", "Height")


def is_unreliable(room: str) -> bool:
    """Tell whether the positions of a room of ReverbDB are known to be wrong."""
    return any(re.search(rf"(^|[_-]){name}$", room) for name in UNRELIABLE_ROOMS)


def is_uncommon(room: str, room_type: str | None) -> bool:
    """Tell whether a room is one that one would not simulate (stairs), by its name or its described type."""
    listed = any(re.search(rf"(^|[_-]){name}$", room) for name in UNCOMMON_ROOMS)
    return listed or is_uncommon_name(room_type or "")


def find_rooms(source: Path) -> list[Path]:
    """Return the room folders of a ReverbDB tree, which may be one folder deeper or a single room."""
    for folders in ([source], source.glob("*"), source.glob("*/*")):
        rooms = sorted(path for path in folders if path.is_dir() and any(path.glob("MicID*/SpkID*")))
        if rooms:
            return rooms
    return []


def list_reverbdb(source: Path) -> Corpus:
    """List the RIRs and background noises of a ReverbDB tree; repeats and `_T` sessions are included and marked.

    `repeat_of` of a row is the id of the first RIR of the same source and microphone position (`_S` sessions come
    first, then by date and version).

    Raises
    ------
    ValueError
        There is no RIR below `source`.
    """
    corpus = Corpus(name=source.resolve().name, kind="reverbdb")
    for room in find_rooms(source):
        env = read_meta(room / "env_full_meta.txt") | read_meta(room / "env_meta.txt")
        if not env:
            corpus.notes["rooms without env_meta.txt"] += 1
        recordings: list[Recording] = []
        for session in sorted(room.glob("MicID*/SpkID*"), key=_session_order):
            if session.is_dir():
                recordings += _list_session(session, room.resolve().name, env, corpus)
        corpus.rirs += _mark_repeats(recordings)
    if not corpus.rirs:
        raise ValueError(f"{source}: no RIRs (<Room>/MicID01/SpkIDnn_DATE_S/NN/RIR/*.wav): check that the release "
                         "was unpacked whole")
    return corpus


def read_meta(path: Path) -> dict[str, str]:
    """Read lines ``$Key<TAB>value`` of a meta file as {key without $: value}; {} if there is no such file.

    Other lines are banners.
    """
    if not path.is_file():
        return {}
    meta = {}
    for line in path.read_text(encoding="utf-8", errors="replace").lstrip("\ufeff").splitlines():
        key, tab, value = line.strip(" \r").partition("\t")
        if tab and key.startswith("$"):
            meta[key[1:].strip()] = value.strip()
    return meta


def _session_order(session: Path) -> tuple[str, bool, str, str]:
    match = _SESSION.fullmatch(session.name)
    sorting = (match[3] != "S", match[2], match[1]) if match else (True, "", session.name)
    return (session.parent.name, *sorting)


def _list_session(session: Path, room_id: str, env: dict[str, str], corpus: Corpus) -> list[Recording]:
    match = _SESSION.fullmatch(session.name)
    source_id, kind = (match[1], match[3]) if match else (session.name, None)
    spk = read_meta(session / "spk_meta.txt")
    listed = []
    for mic in sorted(path for path in session.iterdir() if path.is_dir() and _DIGITS.fullmatch(path.name)):
        stem = make_id(f"{room_id}-{session.parent.name}-{session.name}-{mic.name}")
        wavs = sorted((mic / "RIR").glob("*.wav"))
        # the microphone's meta file repeats the loudspeaker's position; the session's file is the fallback
        meta = env | spk | read_meta(mic / "mic_meta.txt")
        if wavs:
            row = _row(meta, mic, room_id, corpus)
            row.update(source_id=source_id, mic_id=f"{session.parent.name}-{mic.name}", session=kind)
            listed += [Recording(wav, f"{stem}-{_version(wav)}", rir_row(
                **row, excitation=excitation_of(wav.stem))) for wav in wavs]
        for wav in sorted((mic / "silence").glob("*.wav")):
            noise = dict(room_id=make_id(room_id), kind="ambient")
            corpus.noises.append(Recording(wav, make_id(f"{stem}-{wav.stem}"), noise))
    return listed


def _version(wav: Path) -> str:
    """Return ``v00`` from the name of a sweep as released, and the whole name of any other file."""
    match = re.fullmatch(r"IR_sweep_15s_45Hzto22kHz_FS16kHz\.(v\d+)", wav.stem)
    return match[1] if match else make_id(wav.stem)


def _row(meta: dict[str, str], mic: Path, room_id: str, corpus: Corpus) -> dict[str, Any]:
    n = int(mic.name)
    stated = meta.get("EnvMicID", "")
    if _DIGITS.fullmatch(stated) and int(stated) != n and f"EnvMic{int(stated)}Depth" in meta:
        corpus.notes["microphone folders whose $EnvMicID is another number (its keys were used)"] += 1
        n = int(stated)

    def number(key: str, parse: Callable[[str], float | None] = parse_number) -> float | None:
        try:
            value = parse(re.sub(r"(\u00b0? ?C|m|s|deg)$", "", meta.get(key, "")))
        except ValueError:
            value = None
        if value is None:
            corpus.notes[f"${re.sub(r'Mic[0-9]+', 'Mic{n}', key)} absent or no number"] += 1
        return value

    def vector(prefix: str) -> list[float | None] | None:
        values = [number(prefix + axis) for axis in _AXES]
        return None if values == [None] * 3 else values

    room_type = " ".join(meta[key] for key in ("EnvType", "EnvSubType") if meta.get(key)) or None
    return dict(
        corpus=corpus.name, room_id=room_id, room_type=room_type, room_dims_m=vector("Env"),
        source_pos_m=vector("EnvSpk1"), mic_pos_m=vector(f"EnvMic{n}"), temperature_c=number("EnvTemp"),
        distance_m=number(f"EnvMic{n}RelDistance", parse_amount),
        documented_t60_s=number(f"EnvMic{n}RelRT60", parse_amount),
        unreliable_geometry=is_unreliable(room_id), uncommon=is_uncommon(room_id, room_type))


def _mark_repeats(recordings: list[Recording]) -> list[Recording]:
    """Set `repeat_of` of all but the first RIR of each pair of positions (or of each folder, if they are unknown)."""
    first: dict[str, str] = {}
    for recording in recordings:
        row = recording.row
        positions = (row["source_pos_m"], row["mic_pos_m"])
        known = all(map(is_known, positions))
        # without positions, only the files of one folder are certain to be of one position
        key = repr((row["mic_id"], positions)) if known else str(recording.path.parent)
        if (earlier := first.setdefault(key, recording.id)) != recording.id:
            row["repeat_of"] = earlier
    return recordings
