"""The one rule that says for what the geometry of an RIR row may be used, and why not.

A coordinate is *unknown* where it is null or absent. A row is *marked* where its reader or its author said that the
positions cannot be relied on: `unreliable_geometry` is true, or `geometry_problem` says what contradicts what.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

MIN_DISTANCE_M = 0.05
"""Least distance of source and microphone that the simulator allows [m]."""
SAME_SIZE_M = 0.01
"""By which the dimensions of one room may differ between its rows [m]."""
_PLACE_DIGITS = 3  # of a coordinate in metres: channels of an array are some millimetres apart
DISTANCE_SLACK_M, DISTANCE_SLACK = 0.15, 0.05
"""Tolerance of a stated distance, taken by tape measure: the larger of these [m, share of the distance]."""

DEVICES = {"source_pos_m": ("source", "source_id"), "mic_pos_m": ("microphone", "mic_id")}
"""Of the position of each end: what stands there, and the key of its name."""

Need = Literal["consistency", "simulation", "stated distance", "same position", "loop"]
Coordinates = Sequence[float | None] | None


class _Requirement(NamedTuple):
    """What one use of the geometry requires."""

    unmarked_by: tuple[str, ...]
    known: tuple[str, ...] = ()  # positions of which x and y are required
    consistent: bool = False


BINAURAL = "binaural, where an omnidirectional microphone is needed"
MARKED = "the positions are marked unreliable"
CONTRADICTORY = "the positions are marked as contradictory"
OUTSIDE = "a position lies outside the room"
TOO_CLOSE = "source and microphone are closer than the simulator allows"
ONE_ABOVE_THE_OTHER = "source and microphone are one above the other, and their heights are not known"
UNKNOWN = " are unknown"
"""Fixed reasons why the closed loop cannot use an RIR; `find_contradiction` gives others, and those of `_unknown_of`
end in `UNKNOWN`."""

_MARKS = ("unreliable_geometry", "geometry_problem")
_REQUIREMENTS: dict[Need, _Requirement] = {
    "consistency": _Requirement(_MARKS, consistent=True),
    "simulation": _Requirement(_MARKS),
    "stated distance": _Requirement(("geometry_problem",)),
    "same position": _Requirement(("unreliable_geometry",), known=("source_pos_m", "mic_pos_m")),
}


class Contradiction(NamedTuple):
    """What cannot be right about a geometry: in a fixed phrase, and with its values."""

    phrase: str
    detail: str


class Usability(NamedTuple):
    """Whether the geometry of a row may be used, and if not, why."""

    usable: bool
    reason: str | None = None


def geometry_usability(row: Mapping[str, Any], needs: Need) -> Usability:
    """Tell whether the geometry of a row may be used for a purpose.

    Parameters
    ----------
    row : mapping
        Row of an RIR directory (`roomeq.records.schema.RirRow`).
    needs : str
        ``"consistency"``
            The coordinates that are known may be right: the row is unmarked, and nothing in it contradicts itself.
        ``"simulation"``
            The simulator may take the positions that are known: the row is unmarked. What is unknown it draws.
        ``"stated distance"``
            The simulator may keep the stated distance of source and microphone: nothing contradicts the geometry.
        ``"same position"``
            Two recordings may be recognised as of one position: the row is not marked unreliable, and x and y of source
            and microphone are known.
        ``"loop"``
            The closed loop may use the RIR: it is not binaural, the row is unmarked, nothing in it contradicts itself,
            and the three dimensions of the room and x and y of source and microphone are known. Heights of source and
            microphone may be unknown, except where a mesh stands for the dimensions. The reason is one of a few fixed
            phrases, to be counted.
    """
    if needs == "loop":
        reason = _refused_by_loop(row)
        return Usability(reason is None, reason)
    requirement = _REQUIREMENTS[needs]
    for mark in requirement.unmarked_by:
        if row.get(mark):
            return Usability(False, row[mark] if mark == "geometry_problem" else MARKED)
    for key in requirement.known:
        if not is_known((row.get(key) or [None])[:2]):
            return Usability(False, f"{key}={row.get(key)}: x and y must be known")
    if requirement.consistent and (problem := find_contradiction(row)):
        return Usability(False, problem.detail)
    return Usability(True)


def _refused_by_loop(row: Mapping[str, Any]) -> str | None:
    """Return why the closed loop cannot use a row, or None; a contradiction says more than the mark that it left."""
    if row.get("binaural"):
        return BINAURAL
    if problem := find_contradiction(row):
        return problem.phrase
    if row.get("unreliable_geometry"):
        return MARKED
    if row.get("geometry_problem"):
        return CONTRADICTORY
    return _unknown_of(row) or (ONE_ABOVE_THE_OTHER if _is_one_above_the_other(row) else None)


def _is_one_above_the_other(row: Mapping[str, Any]) -> bool:
    """Tell whether heights that are not known decide if source and microphone are too close."""
    source_m, mic_m = row["source_pos_m"], row["mic_pos_m"]
    plan_m = distance_between(source_m[:2], mic_m[:2])
    return distance_between(source_m, mic_m) is None and plan_m is not None and is_too_close(plan_m)


def _unknown_of(row: Mapping[str, Any]) -> str | None:
    """Return what is unknown of the room's dimensions and of the coordinates that the loop cannot estimate, or None."""
    mesh = bool(row.get("mesh"))
    unknown = [] if mesh or is_known(row.get("room_dims_m")) else ["the room's dimensions"]
    ends = [end for key, end in (("source_pos_m", "source"), ("mic_pos_m", "microphone"))
            if not is_known((row.get(key) or [None])[:3 if mesh else 2])]
    if ends:
        unknown.append(f"{'x, y and z' if mesh else 'x and y'} of {' and '.join(ends)}")
    return f"{' and '.join(unknown)}{UNKNOWN}" if unknown else None


def position_key(row: Mapping[str, Any]) -> str | None:
    """Return what all recordings of one source and microphone position share, or None where x or y is unknown.

    An unknown height is equal to another unknown height only.
    """
    if not geometry_usability(row, needs="same position").usable:
        return None
    positions, directions = (row["source_pos_m"], row["mic_pos_m"]), (row.get("source_dir"), row.get("mic_dir"))
    return repr((row["room_id"], row["source_id"], row["mic_id"], positions, directions))


def place_key(row: Mapping[str, Any]) -> str:
    """Return what all RIRs of one place share: room and position of source and microphone, whatever the devices.

    An unknown height is equal to another unknown height only. Where x or y is unknown, each RIR has a place of its own.
    """
    positions = [row.get(key) or [None] for key in ("source_pos_m", "mic_pos_m")]
    if not all(is_known(position[:2]) for position in positions):
        return repr((row["room_id"], row["id"]))
    return repr((row["room_id"], [[None if at_m is None else round(float(at_m), _PLACE_DIGITS) for at_m in position]
                                  for position in positions]))


def is_known(coordinates: Coordinates) -> bool:
    """Tell whether all coordinates of a point or of a room's dimensions are known."""
    return coordinates is not None and None not in coordinates


def distance_between(a_m: Coordinates, b_m: Coordinates) -> float | None:
    """Return the distance of two points [m], or None where a coordinate is unknown."""
    if a_m is None or b_m is None or None in (*a_m, *b_m):
        return None
    return math.dist(a_m, b_m)  # type: ignore[arg-type]


def least_distance_between(a_m: Coordinates, b_m: Coordinates) -> float:
    """Return the distance of two points by the coordinates that are known of both, such as that in plan [m].

    Where a coordinate is unknown, it is the least that the distance can be.
    """
    known = [(a, b) for a, b in zip(a_m or (), b_m or (), strict=False) if a is not None and b is not None]
    return math.hypot(*(a - b for a, b in known))


def is_too_close(distance_m: float) -> bool:
    """Tell whether source and microphone are closer than `MIN_DISTANCE_M`; coordinates are rounded."""
    return distance_m < MIN_DISTANCE_M - 1e-9


def find_contradiction(row: Mapping[str, Any]) -> Contradiction | None:
    """Return what cannot be right about the geometry of a row, or simulated, or None; coordinates may be unknown."""
    for axis, size_m in enumerate(row.get("room_dims_m") or ()):
        if size_m is not None and size_m <= 0:
            return Contradiction("the room has a dimension of 0 or less",
                                 f"room_dims_m[{axis}]={size_m:g} must be positive")
    return _outside(row) or _wrong_distance(row)


def are_unlike(one_m: Coordinates, other_m: Coordinates) -> bool:
    """Tell whether the dimensions of two rooms differ by more than `SAME_SIZE_M`, as far as both are known."""
    return any(a_m is not None and b_m is not None and abs(a_m - b_m) > SAME_SIZE_M
               for a_m, b_m in zip(one_m or (), other_m or (), strict=False))


def _wrong_distance(row: Mapping[str, Any]) -> Contradiction | None:
    """Return a distance of source and microphone that cannot be."""
    distance_m, stated_m = distance_between(row.get("source_pos_m"), row.get("mic_pos_m")), row.get("distance_m")
    for apart_m in (distance_m, stated_m):
        if apart_m is not None and is_too_close(apart_m):
            return Contradiction(TOO_CLOSE, f"source and microphone are {apart_m:.3g} m apart and must be at least "
                                            f"{MIN_DISTANCE_M:g} m, which the simulator needs")
    least_m = least_distance_between(row.get("source_pos_m"), row.get("mic_pos_m"))
    slack_m = max(DISTANCE_SLACK_M, DISTANCE_SLACK * least_m)
    if stated_m is not None and (stated_m < least_m - slack_m or (distance_m is not None
                                                                  and stated_m > distance_m + slack_m)):
        at_least = "" if distance_m is not None else "at least "
        return Contradiction("the stated distance is not that of the positions",
                             f"distance_m={stated_m:g} but the positions are {at_least}{least_m:.3g} m apart")
    return None


def _outside(row: Mapping[str, Any]) -> Contradiction | None:
    """Return the first coordinate that lies outside the room, as far as both are known and no mesh gives its walls."""
    if row.get("mesh"):
        return None
    for key in ("source_pos_m", "mic_pos_m"):
        coordinates = zip(row.get(key) or [None] * 3, row.get("room_dims_m") or [None] * 3, strict=True)
        for axis, (at_m, size_m) in enumerate(coordinates):
            if at_m is not None and size_m is not None and not 0 <= at_m <= size_m:
                return Contradiction(OUTSIDE, f"{key}[{axis}]={at_m:g} lies outside the room (0 to {size_m:g} m)")
    return None
