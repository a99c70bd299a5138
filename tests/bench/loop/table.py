"""Rates of the loop's bench, with Wilson intervals."""

from collections import Counter
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from bench.kit import number, table

Z = 1.96
LARGE_JND = 1.8
"""Achieved change from which the effect of a set counts as large: nearly the 2 JND that were requested."""
OUTSIDE_REGIONS = {"clock_drift": ("direct", "early"), "harmonic_distortion": ("ahead",),
                   "ringing_object": ("late", "whole")}
"""Time regions of the residual of each effect outside the catalogue."""

OWN_BASE, FIRST_GOAL = "testbed", {"testbed": ">= 95 %", "pyroomacoustics": ">= 85 %"}
"""The testbed's own base, and the goal for the true effect coming first."""

KIND_COLUMNS = ("effect", "JND", "sets", "added first", "added, not there", "error before", "after", "test after", "s")

Result = dict[str, Any]


class Interval(NamedTuple):
    """Confidence interval of 95 %."""

    low: float
    high: float


class Rate(NamedTuple):
    """A rate over sets of rooms, None where there are none, and the goal that it is held against."""

    name: str
    hits: int
    count: int
    rate: float | None
    low: float
    high: float
    goal: str


def wilson(hits: int, count: int) -> Interval:
    """Return the interval of a rate (Wilson, J. Am. Stat. Assoc. 22 (1927) 209)."""
    if count == 0:
        return Interval(0.0, 1.0)
    rate, spread = hits / count, Z ** 2 / count
    middle = (rate + 0.5 * spread) / (1.0 + spread)
    half = Z * np.sqrt(rate * (1.0 - rate) / count + 0.25 * spread / count) / (1.0 + spread)
    return Interval(max(0.0, float(middle - half)), float(middle + half))


def _rate(name: str, hits: Iterable[bool], goal: str) -> Rate:
    hits = list(hits)
    return Rate(name, int(sum(hits)), len(hits), float(np.mean(hits)) if hits else None,
                *wilson(sum(hits), len(hits)), goal)


def _first_is_true(result: Result) -> bool:
    """Tell whether the effect that was added first is the true one."""
    return bool(result["added"]) and result["added"][0] == result["kind"]


def _is_among_first(result: Result) -> bool:
    """Tell whether the first find says that it cannot tell the true effect from others."""
    return result["kind"] in (result["cannot_tell"] or [[]])[0]


def _is_misnamed(result: Result) -> bool:
    """Tell whether the first find neither is the true effect nor cannot be told from it."""
    return bool(result["added"]) and not _first_is_true(result) and not _is_among_first(result)


def _is_stated(result: Result) -> bool:
    """Tell whether each effect was added, or is smaller than what the ledger says that the data would have shown."""
    def undetectable(name: str) -> bool:
        detectable_jnd = result.get("detectable_jnd", {}).get(name, 0.0)
        return detectable_jnd is None or result["achieved_jnd"][name] < detectable_jnd

    return all(name in result["added"] or undetectable(name) for name in result["kind"].split("+"))


def _is_located(result: Result) -> bool:
    """Tell whether an unexplained residual lies in the true time region and, for objects that ring, the true band."""
    return any(residual["time_region"] in OUTSIDE_REGIONS[result["kind"]]
               and (not result["rings_hz"] or set(residual["bands_hz"]) & set(result["rings_hz"]))
               for residual in result["unexplained"])


def _distinct(results: list[Result]) -> list[Result]:
    """Drop repeated sets: two strengths give the same rooms where physics limits the effect."""
    return list({(result["kind"], result["seed"], tuple(sorted(result["achieved_jnd"].items()))): result
                 for result in results}.values())


def by_base(results: list[Result]) -> dict[str, list[Result]]:
    """Return the results of each base; those of before there was a second one are of the testbed's own.

    Results of rows that do not state facings are apart.
    """
    bases = [result.get("base", OWN_BASE) + ("" if result.get("facings_stated", True) else ", facings not stated")
             for result in results]
    return {base: [result for result, its in zip(results, bases, strict=True) if its == base]
            for base in sorted(set(bases), key=lambda base: (base != OWN_BASE, base))}


def rates(results: list[Result]) -> list[Rate]:
    """Return all rates that have a goal, for results of one base; each set of rooms counts once."""
    results = _distinct(results)
    first_goal = FIRST_GOAL[results[0].get("base", OWN_BASE) if results else OWN_BASE]
    single = [result for result in results if result["kind"] not in OUTSIDE_REGIONS and "+" not in result["kind"]
              and result["kind"] != "clean"]
    strong = [result for result in single if max(result["achieved_jnd"].values()) >= LARGE_JND]
    weak = [result for result in single if max(result["achieved_jnd"].values()) < LARGE_JND]
    clean = {result["seed"]: result for result in results if result["kind"] == "clean"}
    with_clean = [(result, clean[result["seed"]]["before"]) for result in strong if result["seed"] in clean]
    removed = [(result["before"] - result["after"]) / (result["before"] - error_jnd) for result, error_jnd in with_clean
               if result["before"] - error_jnd > 0.02]
    ratio = [result["after"] / error_jnd for result, error_jnd in with_clean]
    pairs = [result for result in results if "+" in result["kind"]]
    outside = [result for result in results if result["kind"] in OUTSIDE_REGIONS]
    return [
        _rate("true effect added first, achieved 1.8 JND or more", map(_first_is_true, strong), first_goal),
        _rate("true effect added first, achieved less than 1.8 JND", map(_first_is_true, weak), ">= 75 %"),
        _rate("the same, or too small to be found by the ledger's statement", map(_is_stated, weak), ">= 75 %"),
        _rate("first find cannot be told from others, true effect among them", map(_is_among_first, single), "-"),
        _rate("another effect added first", map(_is_misnamed, single), "<= 5 %"),
        _rate("second effect added that is not there", [len(result["added"]) > 1 for result in single
                                                        if _first_is_true(result)], "<= 5 %"),
        _rate("effect added to clean rooms", [bool(result["added"]) for result in clean.values()], "none"),
        _rate("half of the effect's error removed", [share >= 0.5 for share in removed], ">= 95 %"),
        _rate("error after at most 1.2 times that of the same rooms without the effect",
              [value <= 1.2 for value in ratio], "all"),
        _rate("both of two effects added", [set(result["added"]) >= set(result["kind"].split("+"))
                                            for result in pairs], ">= 80 %"),
        _rate("both added, or too small to be found by the ledger's statement", map(_is_stated, pairs), "-"),
        _rate("effect outside the catalogue: unexplained, in its region and band", map(_is_located, outside),
              ">= 95 %"),
        _rate("effect outside the catalogue: another one added", [bool(result["added"]) for result in outside],
              "<= 5 %"),
        _rate("within 60 s of wall time, two jobs", [result["seconds"] <= 60.0 for result in results
                                                     if result["seconds"] and result.get("nj", 2) == 2], "all")]


def show(results: list[Result]) -> None:
    """Print which effect was added first by kind and strength, and the rates, for each base."""
    for base, these in by_base(results).items():
        print(f"\nRooms simulated by: {base}")
        _show_base(these)


def by_kind(results: list[Result]) -> list[list[Any]]:
    """Return what was added and the errors for each kind of effect and strength, with `KIND_COLUMNS`."""
    rows = []
    for kind, strength in sorted({(result["kind"], result["strength"]) for result in results}):
        these = [result for result in results if (result["kind"], result["strength"]) == (kind, strength)]
        seconds = [result["seconds"] for result in these if result["seconds"]]
        rows.append([kind, strength, len(these), _counts([(result["added"] or ["none"])[0] for result in these]),
                     _counts([name for result in these for name in result["added"] if name not in kind.split("+")]),
                     *(float(np.mean([result[key] for result in these])) for key in ("before", "after", "test_after")),
                     float(np.median(seconds)) if seconds else None])
    return rows


def _counts(names: list[str]) -> str:
    return ", ".join(f"{count} {name}" for name, count in Counter(names).most_common())


def _show_base(results: list[Result]) -> None:
    print("\n" + table(list(KIND_COLUMNS), by_kind(results)))
    print()
    for rate in rates(results):
        percent = "-" if rate.rate is None else f"{100 * rate.rate:.0f} %"
        print(f"  {rate.name}: {rate.hits} of {rate.count}, {percent} "
              f"[{number(100 * rate.low)}, {number(100 * rate.high)}] (goal {rate.goal})")
