"""The paper's Table 2 as plain text, and a line for each comparison."""

from roomeq.wer.workspace import BASE, CLEAN, DEV, ORACLE

_NOTES = {CLEAN: "baseline", ORACLE: "oracle"}


def table_text(found: dict) -> str:
    """Return what `roomeq wer` prints of its `wer.json`."""
    lines = [*_rates(found), "", *caption(found)]
    if any(any(one[kind]["bootci"]) for row in found["results"].values() for one in row.values()
           for kind in ("dev", "test")):
        lines.append("Kaldi's: what compute-wer-bootci printed for each seed, at the weights that its own scoring took "
                     "for the best of that set.")
    lines.append("")
    for column in found["columns"]:
        lines += [f"{column}:", *(f"  {line}" for row in found["rows"] for line in _row_lines(found, row, column)), ""]
    lines += strata_lines(found)
    return "\n".join(lines)


def strata_lines(found: dict) -> list[str]:
    """Return the word error rates of parts of the test set, of the first column."""
    if not found["strata"]:
        return []
    column = found["columns"][0]
    width = max(len(stratum_label(one)) for one in found["strata"])
    lines = [f"Parts of the test set, {column}; they are small: differences within them are chance for the most part.",
             "".ljust(width) + "   words" + "".join(f"  {row}" for row in found["rows"])]
    for one in found["strata"]:
        lines.append(stratum_label(one).ljust(width) + f"{one['words']:8d}" + "".join(
            f"  {one['wer'][column][row]:{len(row)}.2f}" for row in found["rows"]))
    return [*lines, ""]


def stratum_label(one: dict) -> str:
    """Return what a part of the test set has in common."""
    name, unit = one["what"].removesuffix("]").split(" [")
    low, high = one["low"], one["high"]
    if low is None:
        return f"{name} below {high:g} {unit}"
    return f"{name} {low:g} {unit} and more" if high is None else f"{name} {low:g} to {high:g} {unit}"


def label(row: str) -> str:
    """Return a row's name with what it stands for."""
    return f"{row} ({_NOTES[row]})" if row in _NOTES else row


def _rates(found: dict) -> list[str]:
    columns, results = found["columns"], found["results"]
    width = max(map(len, (label(row) for row in found["rows"])))
    cell = max(8, *(len(column) + 1 for column in columns))
    half = cell * len(columns)
    lines = [" " * width + "  " + "dev WER [%]".center(half) + "  " + "test WER [%]".center(half),
             "Training data".ljust(width) + "  " + "  ".join(["".join(one.rjust(cell) for one in columns)] * 2)]
    for row in found["rows"]:
        halves = ("".join(f"{results[row][column][kind]['wer']:{cell}.2f}" for column in columns)
                  for kind in ("dev", "test"))
        lines.append(label(row).ljust(width) + "  " + "  ".join(halves))
    return lines


def caption(found: dict) -> list[str]:
    """Return what a reader of the table must know."""
    test, seeds = found["sets"][found["test"]], found["seeds"]
    own = sorted({name for name in found["dev_of"].values() if name != DEV})
    mixed = f"; else {DEV}" if own and DEV in found["dev_of"].values() else ""
    over = "rooms and seeds, crossed" if seeds > 1 else "rooms"
    lines = [f"{test['utterances']} test utterances ({test['words']} words) in {test['rooms']} rooms, "
             f"{seeds} seed{'s' * (seeds > 1)}.",
             "LM weight and word insertion penalty were chosen on dev for each row, column and seed, and applied to "
             "test: dev rates are the best of them, test rates are not.",
             f"dev is of each row's own kind, as in the paper: {', '.join(own)}{mixed}." if own else
             f"dev is {DEV} for every row.",
             f"Intervals are of 95 %, from a bootstrap over {over}; speakers and sentences stay as they are."]
    if seeds == 1:
        lines.append("With one seed the spread over seeds is not known: intervals hold for these trained models, not "
                     "for others trained alike.")
    return lines


def _row_lines(found: dict, row: str, column: str) -> list[str]:
    one = found["results"][row][column]
    lines = [f"{row}: " + ", ".join(f"{kind} {_rate(one[kind])}" for kind in ("test", "dev"))
             + f", test less dev {_points(one['dev_test_gap'])}"]
    if "change" in one:
        lines.append(f"  against {BASE}: {change_text(one['change'])}")
    if "closed" in one:
        lines.append(f"  {closed_text(one['closed'])}")
    if one.get("change", {}).get("detectable"):
        lines.append(f"  {detectable_text(one['change']['detectable'], found['seeds'])}")
    return lines


def _rate(one: dict) -> str:
    over = one["interval_over_utterances"]
    text = f"{one['wer']:.2f}{bracket(one['interval'])} (over utterances{bracket(over)}"
    for kaldi in filter(None, one["bootci"]):
        text += f"; Kaldi's {kaldi['wer']:.2f}{bracket(kaldi['interval'])}"
    return text + ")"


def bracket(interval: list[float] | None, digits: int = 2) -> str:
    """Return an interval in brackets after a blank; nothing where there is none."""
    return "" if interval is None else f" [{interval[0]:.{digits}f}, {interval[1]:.{digits}f}]"


def _points(one: dict) -> str:
    return f"{one['points']:+.2f}{bracket(one['interval'])}" + ("" if one["p"] is None else f", p {_p(one['p'])}")


def _p(p: float) -> str:
    return f"{p:.2g}" if p >= 0.001 else "< 0.001"


def change_text(one: dict) -> str:
    """Return a change in points and relative to the base, in words."""
    relative = "" if one["relative"] is None else (f"; relative {one['relative']:+.1f} %"
                                                   f"{bracket(one['relative_interval'], 1)}")
    return f"{_points(one)}{relative}"


def closed_text(one: dict) -> str:
    """Return the share of the gap that is closed, or why there is none, in words."""
    gap = f"gap {BASE} - {ORACLE} {_points(one['gap'])}"
    if one["share"] is None:
        return (f"{gap}: the gap itself is not certain, no share of it is given; gained {_points(one['gained'])}")
    low, high = (100 * end for end in one["interval"])
    return f"closes {100 * one['share']:.0f} % [{low:.0f}, {high:.0f}] of the {gap}"


def detectable_text(one: dict, seeds: int) -> str:
    """Return what difference can be detected, and what half of it would take, in words."""
    half = one["for_half"]
    ways = [f"{half[kind]} {kind}" for kind in ("seeds", "rooms") if half[kind] is not None]
    ways.append(f"{half['factor']:.1f} times as many of both" if seeds > 1 else "")
    known = "" if seeds > 1 else ", for these models: the spread over seeds is not known"
    return (f"detectable with 80 % power at 5 %: {one['difference']:.2f} points ({one['standard_errors']:.1f} standard "
            f"errors{known}); half of it with " + " or ".join(filter(None, ways)))
