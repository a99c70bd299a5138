"""The RIRs that the closed loop can use, and how many it leaves out for which reason.

`roomeq.records.geometry` has the rule for rows, and `roomeq.loop.mislabelled` for rows that their recordings
contradict. The verb `close-loop` and the recipe's stage 5 both decide here.
"""

import logging
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple, cast

from roomeq.core.constants import require_air
from roomeq.core.groups import numbers_by
from roomeq.corpora.repeats import find_repeats
from roomeq.corpora.suspicious import suspicion
from roomeq.records.geometry import OUTSIDE, UNKNOWN, are_unlike, find_contradiction, geometry_usability, place_key
from roomeq.records.rir_dir import ROWS_FILE, read_rirs, require_16_khz
from roomeq.records.schema import RirRow, stated_air

logger = logging.getLogger(__name__)

MIN_ROOMS = 3
"""Fewest rooms with usable RIRs of two places: rooms are left out, and halves of rooms are scored."""

DRY_PCT = 10.0
"""Relative humidity from which on a room is not suspiciously dry [%]."""
UNLIKE = "rows of the room state different dimensions or meshes"
REPEAT = "the recording is a repeated take: another RIR has the same room, devices and positions"
NO_RIR = "the recording is no RIR by its acoustics (roomeq characterise says why)"


class Located(NamedTuple):
    """A row and the RIR directory that its files are relative to."""

    directory: Path
    row: RirRow


class LeftOut(NamedTuple):
    """How many RIRs, of how many rooms, are left out for one reason."""

    reason: str
    rirs: int
    rooms: int

    def __str__(self) -> str:
        return f"{self.rirs} RIR{'s' * (self.rirs > 1)} of {self.rooms} room{'s' * (self.rooms > 1)}: {self.reason}"


class UsableRirs(NamedTuple):
    """Usable RIRs, and those that are left out.

    Attributes
    ----------
    rirs : list of Located
        Sorted by room and id.
    left_out : list of LeftOut
        By reason, the most frequent first.
    contradictions : tuple of str
        What contradicts what in the first RIR or room of each reason that is an error in the rows: name, value, rule
        and remedy.
    """

    rirs: list[Located]
    left_out: list[LeftOut]
    contradictions: tuple[str, ...] = ()

    @property
    def n_scored(self) -> int:
        """Number of rooms with usable RIRs of two places or more: one calibrates the room, another is scored."""
        places = {(place_key(rir.row), rir.row["room_id"]) for rir in self.rirs}
        return sum(n > 1 for n in Counter(room_id for _, room_id in places).values())


def usable_rirs(directories: Iterable[Path], nj: int = 1) -> UsableRirs:
    """Return the RIRs of some directories that the closed loop can use; RIRs of simulated noise sources are ignored.

    The log names what contradicts what in rows that are left out, and recordings with a latency, of which the returned
    rows do not say that sample 0 is the emission. Recordings are read by `nj` processes.

    Raises
    ------
    ValueError
        A directory, mesh or recording is invalid, no room can have the air of a row, or two directories share an id.
    """
    found = [Located(directory, row) for directory in map(Path, directories) for row in read_rirs(directory)
             if not row.get("noise_for")]
    for rir in found:
        require_16_khz(rir.directory, [rir.row])
    _require_unique(found)
    found.sort(key=lambda rir: (rir.row["room_id"], rir.row["id"]))
    reasons = [_refused(rir) for rir in found]
    _check_air([rir for rir, reason in zip(found, reasons, strict=True) if reason is None])
    contradictions = _log_contradictions(found, reasons) | _leave_out_unlike_rooms(found, reasons)
    _share_dimensions(found, reasons)
    _leave_out_repeats(found, reasons)
    contradictions |= _compare_with_recordings(found, reasons, nj)
    usable = leave_out(UsableRirs(found, []), reasons)
    return usable._replace(contradictions=tuple(contradictions[entry.reason] for entry in usable.left_out
                                                if entry.reason in contradictions))


def leave_out(usable: UsableRirs, reasons: Sequence[str | None]) -> UsableRirs:
    """Return RIRs without those for which there is a reason, which are counted by it."""
    left_out = list(usable.left_out)
    for reason in sorted({reason for reason in reasons if reason}):
        rooms = [rir.row["room_id"] for rir, of_rir in zip(usable.rirs, reasons, strict=True) if of_rir == reason]
        left_out.append(LeftOut(reason, len(rooms), len(set(rooms))))
    return usable._replace(rirs=[rir for rir, reason in zip(usable.rirs, reasons, strict=True) if reason is None],
                           left_out=sorted(left_out, key=lambda entry: -entry.rirs))


def require_enough_rooms(directories: Sequence[Path], nj: int = 1) -> UsableRirs:
    """Return the usable RIRs of directories as `usable_rirs` does, and refuse too few for the closed loop.

    Raises
    ------
    ValueError
        Fewer than `MIN_ROOMS` rooms have usable RIRs of two places; the message counts the RIRs by reason and says what
        to measure or to correct. Also raised as by `usable_rirs`.
    """
    usable = usable_rirs(directories, nj)
    if problem := too_few_rooms(usable):
        raise ValueError(f"{', '.join(map(str, directories))}: {problem}")
    return usable


def too_few_rooms(usable: UsableRirs) -> str | None:
    """Return why usable RIRs are too few for the closed loop, and what to do about it; None if they are enough."""
    if usable.n_scored >= MIN_ROOMS:
        return None
    problem = f"the closed loop needs {MIN_ROOMS} rooms or conditions (room_id) with two usable RIRs each, and has " \
              f"{usable.n_scored}: "
    of_one_place = sum(n > 1 for n in Counter(rir.row["room_id"] for rir in usable.rirs).values()) - usable.n_scored
    if of_one_place:
        problem += f"the RIRs of {of_one_place} other{'s' * (of_one_place > 1)} have one source and one microphone " \
                   "position, of which one half cannot be held out: "
    remedies = ["give further rooms"]
    if of_one_place:
        remedies.insert(0, "give further positions (state that of each channel of an array)")
    if usable.contradictions:
        remedies.insert(0, f"correct the rows ({'; '.join(usable.contradictions)})")
    if unusable := sum(entry.rirs for entry in usable.left_out):
        reasons = "; ".join(f"{entry.rirs}: {entry.reason}" for entry in usable.left_out)
        problem = f"{unusable} of {unusable + len(usable.rirs)} RIRs cannot be used ({reasons}); {problem}"
    if any(entry.reason.endswith(UNKNOWN) for entry in usable.left_out):
        remedies.insert(0, "measure what is unknown (heights may stay unknown)")
    return problem + ", or ".join(remedies)


def _refused(rir: Located) -> str | None:
    """Return why the closed loop cannot use an RIR, or None."""
    reason = geometry_usability(rir.row, needs="loop").reason
    if reason is None and _outside_mesh(rir):
        return OUTSIDE
    return NO_RIR if reason is None and suspicion(rir.directory, rir.row) else reason


def _check_air(rirs: Iterable[Located]) -> None:
    """Refuse air that no room can have, and warn of each directory with drier air than that of rooms."""
    dry: dict[Path, list[Located]] = {}
    for rir in rirs:
        stated = stated_air(rir.row)
        try:
            require_air(**stated)
        except ValueError as error:
            raise ValueError(f"{rir.directory / ROWS_FILE}: RIR {rir.row['id']} of room {rir.row['room_id']}: {error}"
                             ) from None
        if stated.get("humidity_pct", DRY_PCT) < DRY_PCT:
            dry.setdefault(rir.directory, []).append(rir)
    for directory, (first, *others) in dry.items():
        more = f" and {len(others)} more" if others else ""
        logger.warning("%s: RIR %s of room %s%s: humidity_pct=%g is less than %g, which is drier than the air of "
                       "rooms: give percent if it is a fraction", directory / ROWS_FILE, first.row["id"],
                       first.row["room_id"], more, first.row["humidity_pct"], DRY_PCT)


def _log_contradictions(rirs: Iterable[Located], reasons: Iterable[str | None]) -> dict[str, str]:
    """Log the first RIR of each room that is left out because its geometry contradicts itself, with the values.

    Returns the first of each reason.
    """
    told, first = set(), dict[str, str]()
    for (_, row), reason in zip(rirs, reasons, strict=True):
        problem = find_contradiction(row)
        if reason and problem and problem.phrase == reason and (row["room_id"], reason) not in told:
            told.add((row["room_id"], reason))
            detail = f"RIR {row['id']} of room {row['room_id']}: {problem.detail}: correct it, or state lengths in " \
                     "metres"
            logger.warning("left out: %s", detail)
            first.setdefault(reason, detail)
    return first


def _leave_out_unlike_rooms(rirs: Sequence[Located], reasons: list[str | None]) -> dict[str, str]:
    """Leave out rooms whose rows state different dimensions or meshes, in `reasons`; return what the first states."""
    first = dict[str, str]()
    of_room = numbers_by(None if reason else rir.row["room_id"] for rir, reason in zip(rirs, reasons, strict=True))
    for room_id, members in of_room.items():
        begin = rirs[members[0]]
        for other in (rirs[n] for n in members[1:]):
            if (unlike := _difference(begin, other)) is None:
                continue
            detail = f"room {room_id}: RIR {begin.row['id']} states {unlike} of RIR {other.row['id']}: correct the " \
                     "row, or give different rooms or states of a room different names (room_id)"
            logger.warning("left out: %s", detail)
            first.setdefault(UNLIKE, detail)
            for n in members:
                reasons[n] = UNLIKE
            break
    return first


def _share_dimensions(rirs: list[Located], reasons: Sequence[str | None]) -> None:
    """Let usable rows of a room have the same dimensions, the largest that they state: these hold all positions.

    They differ little (`roomeq.records.geometry.are_unlike`), and are of one room, which is estimated and traced once.
    """
    of_room = numbers_by(None if reason or rir.row.get("mesh") else rir.row["room_id"]
                         for rir, reason in zip(rirs, reasons, strict=True))
    for members in of_room.values():
        stated_m = [cast(list[float], rirs[n].row["room_dims_m"]) for n in members]
        largest_m = [max(sizes_m) for sizes_m in zip(*stated_m, strict=True)]
        for n, dims_m in zip(members, stated_m, strict=True):
            if dims_m != largest_m:
                row: RirRow = {**rirs[n].row, "room_dims_m": [*largest_m]}
                rirs[n] = rirs[n]._replace(row=row)


def _leave_out_repeats(rirs: Sequence[Located], reasons: list[str | None]) -> None:
    """Leave out all takes of a measurement but the first, in `reasons`: the others are no evidence of their own."""
    left = [n for n, reason in enumerate(reasons) if reason is None]
    for n, repeat in zip(left, find_repeats([rirs[n] for n in left]), strict=True):
        if repeat:
            reasons[n] = REPEAT
            logger.info("left out: RIR %s of room %s: %s", rirs[n].row["id"], rirs[n].row["room_id"], repeat)


def _difference(one: Located, other: Located) -> str | None:
    """Return how the rooms of two rows differ, or None."""
    if bool(one.row.get("mesh")) != bool(other.row.get("mesh")):
        return "a mesh in place of the dimensions" if one.row.get("mesh") else "dimensions in place of the mesh"
    if one.row.get("mesh"):
        files = [(rir.directory / str(rir.row["mesh"])).resolve() for rir in (one, other)]
        return None if files[0] == files[1] else f"the mesh {files[0]}, not {files[1]}"
    sizes_m = [rir.row["room_dims_m"] or [None] * 3 for rir in (one, other)]
    return f"room_dims_m={sizes_m[0]}, not {sizes_m[1]}" if are_unlike(*sizes_m) else None


def _compare_with_recordings(rirs: list[Located], reasons: list[str | None], nj: int) -> dict[str, str]:
    """Leave out RIRs whose rows are contradicted by their recordings, in `reasons`; return the first of each reason.

    In `rirs`, rows of recordings with a latency no longer say that sample 0 is the emission.
    """
    from roomeq.loop.mislabelled import find_mislabelled  # only where there are recordings to listen to

    left, first = [n for n, reason in enumerate(reasons) if reason is None], dict[str, str]()
    for n, doubt, latency_s in zip(left, *find_mislabelled([rirs[n] for n in left], nj), strict=True):
        if doubt:
            reasons[n] = doubt.phrase
            first.setdefault(doubt.phrase, doubt.detail)
        elif latency_s:
            row: RirRow = {**rirs[n].row, "tof_removed": None}
            rirs[n] = rirs[n]._replace(row=row)
    return first


def _outside_mesh(rir: Located) -> bool:
    """Tell whether a position, known to the rule, lies outside the mesh of its room."""
    mesh = rir.row.get("mesh")
    if not mesh:
        return False
    from roomeq.sim.mesh import load_mesh

    room = load_mesh(rir.directory / mesh)
    try:
        for key in ("source_pos_m", "mic_pos_m"):
            room.require_inside(key, cast(list[float], rir.row[key]))
    except ValueError:
        return True
    return False


def _require_unique(rirs: Iterable[Located]) -> None:
    first: dict[str, Path] = {}
    for directory, row in rirs:
        if row["id"] in first:
            raise ValueError(f"RIR {row['id']} is in both {first[row['id']]} and {directory}: give each RIR once")
        first[row["id"]] = directory
