"""Reading what `roomeq wer` wrote, and checking it."""

import math
from pathlib import Path

from roomeq.core.files import read_json

WER_FILE = "wer.json"


def validate_wer(directory: Path) -> int:
    """Check a directory that `roomeq wer` made, and return the number of its systems.

    Raises
    ------
    ValueError
        The first thing that is wrong.
    """
    found = read_wer(Path(directory) / WER_FILE)
    return len(found["rows"]) * len(found["columns"])


def read_wer(path: Path) -> dict:
    """Read word error rates.

    Raises
    ------
    ValueError
        The file breaks the contract; the message names the first place that does.
    """
    found = read_json(path)
    try:
        _check(found)
    except (KeyError, TypeError, IndexError, AttributeError) as error:
        raise ValueError(f"{path}: is not what roomeq wer writes ({type(error).__name__}: {error}): "
                         "measure again") from None
    except _Wrong as wrong:
        raise ValueError(f"{path}: {wrong}: measure again") from None
    return found


class _Wrong(Exception):  # noqa: N818 - becomes the ValueError of `read_wer`
    """What is wrong, and where."""


def _require(fits: bool, what: str, rule: str) -> None:
    if not fits:
        raise _Wrong(f"{what} must {rule}")


def _number(value, what: str, low: float = -math.inf) -> None:
    fits = isinstance(value, (int, float)) and not isinstance(value, bool) and value >= low
    _require(fits, f"{what}={value!r:.60}", f"be a number of {low:g} or more")


def _interval(value, what: str, around: float) -> None:
    if value is None:  # of a single room
        return
    _require(isinstance(value, list) and len(value) == 2, f"{what}={value!r:.60}", "be two numbers")
    for end in value:
        _number(end, what)
    slack = 1e-9 * (1 + abs(around))
    _require(value[0] - slack <= around <= value[1] + slack, f"{what}={value}", f"lie around {around:g}")


def _check(found: dict) -> None:
    for name in ("rows", "columns"):
        _require(bool(found[name]) and all(isinstance(one, str) for one in found[name]), name, "be names")
    _number(found["seeds"], "seeds", 1)
    for count in ("utterances", "words", "rooms"):
        _number(found["sets"][found["test"]][count], count, 1)
    for row in found["rows"]:
        _require(isinstance(found["dev_of"][row], str), f"dev_of {row}", "be a name")
        for column in found["columns"]:
            _check_system(found["results"][row][column], f"{row} {column}")
    for one in found["rooms"]:
        for column in found["columns"]:
            for row in found["rows"]:
                _number(one["wer"][column][row], f"{row} {column} in room {one['room']!r:.60}", 0.0)
    for one in found["strata"]:
        what = f"{one['what']} from {one['low']} to {one['high']}"
        _number(one["words"], what, 1)
        for column in found["columns"]:
            for row in found["rows"]:
                _number(one["wer"][column][row], f"{row} {column} at {what}", 0.0)


def _check_system(one: dict, what: str) -> None:
    for kind in ("dev", "test"):
        _number(one[kind]["wer"], f"{what} {kind}", 0.0)
        _interval(one[kind]["interval"], f"{what} {kind} interval", one[kind]["wer"])
    differences = [("dev_test_gap", one["dev_test_gap"])]
    if "change" in one:
        differences.append(("change", one["change"]))
        if one["change"]["relative"] is not None:
            _interval(one["change"]["relative_interval"], f"{what} relative change", one["change"]["relative"])
        if half := one["change"]["detectable"]:
            _number(half["difference"], f"{what} detectable", 0.0)
            _number(half["for_half"]["factor"], f"{what} detectable", 0.0)
            _require({"seeds", "rooms"} <= set(half["for_half"]), f"{what} detectable", "say seeds and rooms")
    if "closed" in one:
        differences += [(key, one["closed"][key]) for key in ("gap", "gained")]
        if one["closed"]["share"] is not None:
            _require(one["closed"]["interval"] is not None, f"{what} share", "have an interval")
            _interval(one["closed"]["interval"], f"{what} share", one["closed"]["share"])
    for key, value in differences:
        _number(value["points"], f"{what} {key}")
        _interval(value["interval"], f"{what} {key}", value["points"])
        if value["p"] is not None:
            _number(value["p"], f"{what} {key} p", 0.0)
