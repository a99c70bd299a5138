"""Read `wer.json` and check it."""

import math
from pathlib import Path
from typing import Any

from roomeq.core.files import read_json
from roomeq.wer.breakdown import ACOUSTICS

WER_FILE = "wer.json"


def validate_wer(directory: Path) -> int:
    """Check a directory that `roomeq wer` made, and return the number of its systems.

    Raises
    ------
    ValueError
        See `read_wer`.
    """
    wer = read_wer(Path(directory) / WER_FILE)
    return len(wer["rows"]) * len(wer["columns"])


def read_wer(path: Path) -> dict:
    """Read word error rates.

    Raises
    ------
    ValueError
        The file breaks the contract; the message names the first place that does.
    """
    wer = read_json(path)
    try:
        _check(wer)
    except (KeyError, TypeError, IndexError, AttributeError) as error:
        raise ValueError(f"{path}: is not what roomeq wer writes ({type(error).__name__}: {error}): "
                         "measure again") from None
    except _BrokenRule as broken:
        raise ValueError(f"{path}: {broken}: measure again") from None
    return wer


class _BrokenRule(Exception):  # noqa: N818 - becomes the ValueError of `read_wer`
    """The name and value that break a rule, and the rule."""


def _require(fits: bool, name: str, rule: str) -> None:
    if not fits:
        raise _BrokenRule(f"{name} must {rule}")


def _number(value: Any, name: str, low: float = -math.inf) -> None:
    fits = isinstance(value, (int, float)) and not isinstance(value, bool) and value >= low
    _require(fits, f"{name}={value!r:.60}", f"be a number of {low:g} or more")


def _interval(value: Any, name: str, estimate: float) -> None:
    if value is None:  # of a single room
        return
    _require(isinstance(value, list) and len(value) == 2, f"{name}={value!r:.60}", "be two numbers")
    for end in value:
        _number(end, name)
    slack = 1e-9 * (1 + abs(estimate))
    _require(value[0] - slack <= estimate <= value[1] + slack, f"{name}={value}", f"lie around {estimate:g}")


def _check(wer: dict) -> None:
    for key in ("rows", "columns"):
        _require(bool(wer[key]) and all(isinstance(name, str) for name in wer[key]), key, "be names")
    _require(isinstance(wer["seeds"], list) and bool(wer["seeds"]), "seeds", "be numbers")
    for seed in wer["seeds"]:
        _number(seed, "seeds", 0)
    for count in ("utterances", "words", "rooms"):
        _number(wer["sets"][wer["test"]][count], count, 1)
    for name, hashes in wer.get("data", {}).items():  # earlier versions did not state them
        _require(isinstance(hashes, list), f"data of {name!r:.60}", "be hashes")
    for row in wer["rows"]:
        _require(isinstance(wer["dev_of"][row], str), f"dev_of {row}", "be a name")
        for column in wer["columns"]:
            _check_system(wer["results"][row][column], f"{row} {column}")
    _require(bool(wer["rooms"]), "rooms", "not be empty")
    for room in wer["rooms"]:
        name = f"room {room['room']!r:.60}"
        _number(room["words"], f"words of {name}", 1)
        _check_rates(wer, room["wer"], f"in {name}")
        for what in ACOUSTICS:
            if (value := room["acoustics"].setdefault(what)) is not None:  # earlier versions had fewer
                _number(value, f"{what} of {name}")
    for stratum in wer["strata"]:
        name = f"{stratum['what']} from {stratum['low']} to {stratum['high']}"
        _number(stratum["words"], name, 1)
        _check_rates(wer, stratum["wer"], f"at {name}")
    for gain in wer["gains"]:
        name = f"{gain['row']!r:.60} and {gain['what']!r:.60}"
        _require(gain["row"] in wer["rows"] and gain["what"] in ACOUSTICS, f"gain of {name}",
                 "be of a row and of the acoustics")
        _number(gain["rooms"], f"rooms of {name}", 1)
        for key, low in (("rho", -1.0), ("p", 0.0)):
            _number(gain[key], f"{key} of {name}", low)
            _require(gain[key] <= 1.0, f"{key} of {name}", "be 1 or less")
    _require(isinstance(wer["kaldi"], list) and all(isinstance(version, str) for version in wer["kaldi"]), "kaldi",
             "be versions")


def _check_rates(wer: dict, rates: dict, where: str) -> None:
    for column in wer["columns"]:
        for row in wer["rows"]:
            _number(rates[column][row], f"{row} {column} {where}", 0.0)


def _check_system(result: dict, name: str) -> None:
    for kind in ("dev", "test"):
        _number(result[kind]["wer"], f"{name} {kind}", 0.0)
        _interval(result[kind]["interval"], f"{name} {kind} interval", result[kind]["wer"])
    differences = {"dev_test_gap": result["dev_test_gap"]}
    if "change" in result:
        change = differences["change"] = result["change"]
        if change["relative"] is not None:
            _interval(change["relative_interval"], f"{name} relative change", change["relative"])
        if detectable := change["detectable"]:
            _number(detectable["difference"], f"{name} detectable", 0.0)
            _number(detectable["for_half"]["factor"], f"{name} detectable", 0.0)
            _require({"seeds", "rooms"} <= set(detectable["for_half"]), f"{name} detectable", "state seeds and rooms")
        mean = change["geometric_mean"]
        _number(mean["relative"], f"{name} geometric mean", -100.0)
        _interval(mean["interval"], f"{name} geometric mean", mean["relative"])
        for key in ("p", "detectable"):
            if mean[key] is not None:
                _number(mean[key], f"{name} geometric mean {key}", 0.0)
        if influential := change["influential"]:
            differences["change without a room"] = influential
            _require(isinstance(influential["room"], str), f"{name} influential", "state its room")
            if influential["detectable"] is not None:
                _number(influential["detectable"], f"{name} influential", 0.0)
    if "closed" in result:
        closed = result["closed"]
        differences |= dict(gap=closed["gap"], gained=closed["gained"])
        if closed["share"] is not None:
            _require(closed["interval"] is not None, f"{name} share", "have an interval")
            _interval(closed["interval"], f"{name} share", closed["share"])
    for key, difference in differences.items():
        _number(difference["points"], f"{name} {key}")
        _interval(difference["interval"], f"{name} {key}", difference["points"])
        if difference["p"] is not None:
            _number(difference["p"], f"{name} {key} p", 0.0)
