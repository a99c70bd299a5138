"""The rates of the loop's bench, with Wilson intervals."""

import numpy as np

from bench.kit import number, table

Z = 1.96
OUTSIDE_WHERE = {"clock_drift": ("direct", "early"), "harmonic_distortion": ("ahead",), "ringing_object": ("late",
                                                                                                      "whole")}
"""Time regions in which an effect outside the catalogue is at home."""


def wilson(hits, count):
    """Interval of 95 % of a rate (Wilson, J. Am. Stat. Assoc. 22 (1927) 209)."""
    if count == 0:
        return 0.0, 1.0
    rate, spread = hits / count, Z ** 2 / count
    middle = (rate + 0.5 * spread) / (1.0 + spread)
    half = Z * np.sqrt(rate * (1.0 - rate) / count + 0.25 * spread / count) / (1.0 + spread)
    return float(middle - half), float(middle + half)


def _rate(name, hits, asked):
    hits = list(hits)
    low, high = wilson(sum(hits), len(hits))
    return dict(what=name, hits=int(sum(hits)), worlds=len(hits), rate=float(np.mean(hits)) if hits else None,
                low=low, high=high, asked=asked)


def _first_right(one):
    """Whether the effect that was found first is the true one."""
    return bool(one["found"]) and one["found"][0] == one["kind"]


def _located(one):
    """Whether a residual was found where it is; one of the whole band, such as an arrival, has no band to be right."""
    return any(left["time_region"] in OUTSIDE_WHERE[one["kind"]]
               and (not one["rings_hz"] or set(left["bands_hz"]) & set(one["rings_hz"])) for left in one["unexplained"])


def _distinct(done):
    """Each world once: where physics allows no more, another strength asked for is the same world again."""
    return list({(one["kind"], one["seed"], tuple(sorted(one["achieved_jnd"].items()))): one for one in done}.values())


def rates(done):
    """All rates that are asked for, each world counted once.

    Returns
    -------
    list of dict
    """
    done = _distinct(done)
    single = [one for one in done if one["kind"] not in OUTSIDE_WHERE and "+" not in one["kind"]
              and one["kind"] != "clean"]
    strong = [one for one in single if max(one["achieved_jnd"].values()) >= 1.8]
    weak = [one for one in single if max(one["achieved_jnd"].values()) < 1.8]
    clean = {one["seed"]: one for one in done if one["kind"] == "clean"}
    removed = [(one["before"] - one["after"]) / (one["before"] - clean[one["seed"]]["before"]) for one in strong
               if one["seed"] in clean and one["before"] - clean[one["seed"]]["before"] > 0.02]
    ratio = [one["after"] / clean[one["seed"]]["before"] for one in strong if one["seed"] in clean]
    pairs = [one for one in done if "+" in one["kind"]]
    outside = [one for one in done if one["kind"] in OUTSIDE_WHERE]
    return [
        _rate("right effect first, achieved 2 JND and more", map(_first_right, strong), ">= 95 %"),
        _rate("right effect first, achieved less", map(_first_right, weak), ">= 75 %"),
        _rate("false finds in clean worlds", [bool(one["found"]) for one in clean.values()], "<= 5 %"),
        _rate("half of the added error removed", [share >= 0.5 for share in removed], "all"),
        _rate("error after <= 1.2 x that of the same world without the effect", [one <= 1.2 for one in ratio], "all"),
        _rate("both of two effects", [set(one["found"]) >= set(one["kind"].split("+")) for one in pairs], ">= 80 %"),
        _rate("outside the catalogue: unexplained, in its region and band", map(_located, outside), ">= 90 %"),
        _rate("outside the catalogue: misnamed", [bool(one["found"]) for one in outside], "<= 5 %"),
        _rate("a world within 60 s of wall time", [one["seconds"] <= 60.0 for one in done if one["seconds"]], "all")]


def show(done):
    """Print confusion matrix and rates."""
    kinds = sorted({(one["kind"], one["strength"]) for one in done})
    rows = []
    for kind, strength in kinds:
        these = [one for one in done if (one["kind"], one["strength"]) == (kind, strength)]
        first = [(one["found"] or ["nothing"])[0] for one in these]
        seconds = [one["seconds"] for one in these if one["seconds"]]
        named = ", ".join(f"{first.count(name)} {name}" for name in sorted(set(first), key=lambda n: -first.count(n)))
        rows.append([kind, strength, len(these), named, float(np.mean([one["before"] for one in these])),
                     float(np.mean([one["after"] for one in these])),
                     float(np.mean([one["test_after"] for one in these])),
                     float(np.median(seconds)) if seconds else None])
    print("\n" + table(["world", "JND", "worlds", "first found", "error before", "after", "test after", "s"], rows))
    print()
    for one in rates(done):
        rate = "-" if one["rate"] is None else f"{100 * one['rate']:.0f} %"
        print(f"  {one['what']}: {one['hits']} of {one['worlds']}, {rate} "
              f"[{number(100 * one['low'])}, {number(100 * one['high'])}] (asked {one['asked']})")
