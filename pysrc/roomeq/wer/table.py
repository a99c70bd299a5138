"""The paper's Table 2 as plain text, and a line for each comparison; `wer` is the content of `wer.json`."""

from collections import Counter

from roomeq.wer.breakdown import C50, DRR, EQ_DISTANCE, HIGH_EQ, T20
from roomeq.wer.workspace import BASE, CLEAN, DEV, ORACLE

_NOTES = {CLEAN: "baseline", ORACLE: "oracle"}
_UNEQUAL = 0.8
"""Effective share of the number of rooms below which it is stated."""


def table_text(wer: dict) -> str:
    """Return the text that `roomeq wer` prints."""
    results = [result for of_row in wer["results"].values() for result in of_row.values()]
    lines = [*_rates_lines(wer), "", *caption(wer)]
    if any(any(result[kind]["bootci"]) for result in results for kind in ("dev", "test")):
        lines.append("Kaldi's: output of compute-wer-bootci for each seed, which resamples utterances: on dev at the "
                     "weights that Kaldi's scoring chose there, on test at those that were chosen on dev.")
    lines.append("")
    for column in wer["columns"]:
        lines += [f"{column}:", *(f"  {line}" for row in wer["rows"] for line in _row_lines(wer, row, column)), ""]
    lines += [*_room_lines(wer), *_strata_lines(wer), *_gain_lines(wer)]
    return "\n".join(lines)


def _rates_lines(wer: dict) -> list[str]:
    columns, results = wer["columns"], wer["results"]
    width = max(len(label(row)) for row in wer["rows"])
    cell = max(8, *(len(column) + 1 for column in columns))
    half = cell * len(columns)
    lines = [" " * width + "  " + "dev WER [%]".center(half) + "  " + "test WER [%]".center(half),
             "Training data".ljust(width) + "  " + "  ".join(["".join(column.rjust(cell) for column in columns)] * 2)]
    for row in wer["rows"]:
        halves = ("".join(f"{results[row][column][kind]['wer']:{cell}.2f}" for column in columns)
                  for kind in ("dev", "test"))
        lines.append(label(row).ljust(width) + "  " + "  ".join(halves))
    return lines


def label(row: str) -> str:
    """Return the name of a row with its role in the comparison."""
    return f"{row} ({_NOTES[row]})" if row in _NOTES else row


def caption(wer: dict) -> list[str]:
    """Return the sentences that explain the table."""
    test, seeds = wer["sets"][wer["test"]], len(wer["seeds"])
    own = sorted(set(wer["dev_of"].values()) - {DEV})
    other = f"; else {DEV}" if own and DEV in wer["dev_of"].values() else ""
    drawn = "rooms and seeds, crossed" if seeds > 1 else "rooms"
    lines = [f"{test['utterances']} test utterances ({test['words']} words) in {test['rooms']} rooms, "
             f"{seeds} seed{'s' * (seeds > 1)}.",
             "LM weight and word insertion penalty were chosen on dev for each row, column and seed, and applied to "
             "test. Rates on dev are therefore the lowest of the search, rates on test are not.",
             *_size_lines(wer), *_edge_lines(wer),
             f"dev is of each row's own kind, as in the paper: {', '.join(own)}{other}." if own else
             f"dev is {DEV} for every row.",
             f"Intervals are of 95 %, over {drawn} (Student's t); speakers and sentences stay the same."]
    if wer["kaldi"]:
        lines.append(f"Kaldi {', '.join(wer['kaldi'])}.")
    if seeds == 1:
        lines.append("With one seed the spread over seeds is not known: the intervals hold for these trained models "
                     "only.")
    return lines


def _size_lines(wer: dict) -> list[str]:
    """Return the effective number of rooms (see `roomeq.wer.statistics`) where it is clearly below their number."""
    words = [room["words"] for room in wer["rooms"]]
    effective = sum(words) ** 2 / sum(n ** 2 for n in words)
    return [f"The rooms are unequal in words: effective number of rooms {effective:.1f}."
            ] if effective < _UNEQUAL * len(words) else []


def _edge_lines(wer: dict) -> list[str]:
    chosen = [weights for of_row in wer["results"].values() for result in of_row.values()
              for weights in result["weights"]]
    at_edge = sum(weights["at_edge"] for weights in chosen)
    return [f"{at_edge} of {len(chosen)} choices lie at the edge of the search: weights beyond it may be "
            "better."] if at_edge else []


def _row_lines(wer: dict, row: str, column: str) -> list[str]:
    result = wer["results"][row][column]
    lines = [f"{row}: " + ", ".join(f"{kind} {_rate_text(result[kind])}" for kind in ("test", "dev"))
             + f", test less dev {_points_text(result['dev_test_gap'])}"]
    if "change" in result:
        lines.append(f"  against {BASE}: {_change_text(result['change'])}")
        lines.append(f"  geometric mean over rooms: {_geometric_mean_text(result['change']['geometric_mean'])}")
    if "closed" in result:
        lines.append(f"  {_closed_text(result['closed'])}")
    if result.get("change", {}).get("detectable"):
        lines.append(f"  {_detectable_text(result['change']['detectable'], len(wer['seeds']))}")
    if influential := result.get("change", {}).get("influential"):
        detected = influential["detectable"]
        lines.append(f"  without {influential['room']}, which changes it most: {influential['points']:+.2f}"
                     f"{brackets(influential['interval'])}{f'; detectable {detected:.2f} points' if detected else ''}")
    return lines


def _rate_text(rate: dict) -> str:
    kaldi = "; ".join(f"{bootci['wer']:.2f}{brackets(bootci['interval'])}" for bootci in rate["bootci"] if bootci)
    return f"{rate['wer']:.2f}{brackets(rate['interval'])}" + (f" (Kaldi's {kaldi})" if kaldi else "")


def brackets(interval: list[float] | None, digits: int = 2) -> str:
    """Return an interval in brackets after a space; nothing for None."""
    return "" if interval is None else f" [{interval[0]:.{digits}f}, {interval[1]:.{digits}f}]"


def _points_text(difference: dict) -> str:
    chance = "" if difference["p"] is None else f", p {p_text(difference['p'])}"
    return f"{difference['points']:+.2f}{brackets(difference['interval'])}{chance}"


def p_text(p: float) -> str:
    """Return the text of a p value."""
    return f"{p:.2g}" if p >= 0.001 else "< 0.001"


def _change_text(change: dict) -> str:
    """Return a change in points and relative to the base."""
    if change["relative"] is None:
        return _points_text(change)
    return (f"{_points_text(change)}; relative {change['relative']:+.1f} %"
            f"{brackets(change['relative_interval'], 1)}")


def _geometric_mean_text(mean: dict) -> str:
    chance = "" if mean["p"] is None else f", p {p_text(mean['p'])}"
    detected = "" if mean["detectable"] is None else f"; detectable {mean['detectable']:.1f} %"
    return f"relative {mean['relative']:+.1f} %{brackets(mean['interval'], 1)}{chance}{detected}"


def _closed_text(closed: dict) -> str:
    """Return the share of the gap that is closed, or why there is none."""
    gap = f"gap {BASE} - {ORACLE} {_points_text(closed['gap'])}"
    if closed["share"] is None:
        return f"{gap} is not certain: no share of it is stated; gained {_points_text(closed['gained'])}"
    low, high = (100 * end for end in closed["interval"])
    return f"closes {100 * closed['share']:.0f} % [{low:.0f}, {high:.0f}] of the {gap}"


def _detectable_text(detectable: dict, seeds: int) -> str:
    """Return the difference that can be detected, and how to detect half of it."""
    half = detectable["for_half"]
    ways = [f"{half[kind]} {kind}" for kind in ("seeds", "rooms") if half[kind] is not None]
    if seeds > 1:
        ways.append(f"{half['factor']:.1f} times as many of both")
    known = "" if seeds > 1 else ", for these models: the spread over seeds is not known"
    return (f"detectable with 80 % power at 5 %: {detectable['difference']:.2f} points "
            f"({detectable['standard_errors']:.1f} standard errors{known}); half of it with {' or '.join(ways)}")


ROOM_ACOUSTICS = {T20: ("T20 [s]", 2), DRR: ("DRR [dB]", 1), C50: ("C50 [dB]", 1), HIGH_EQ: ("4, 8 kHz [dB]", 1),
                  EQ_DISTANCE: ("EQ [dB]", 1)}
"""Properties in the table of rooms: heading and digits."""
EQ_NOTE = ("4, 8 kHz: mean of the EQ there, the level relative to 1 kHz. EQ: mean distance of the room's EQs to those "
           "of the measured training RIRs; also a room like those of training has one.")


def room_cells(room: dict) -> list[str]:
    """Return the acoustics of a room as text; a dash where they are unknown."""
    values = [(room["acoustics"][what], digits) for what, (_, digits) in ROOM_ACOUSTICS.items()]
    return ["-" if value is None else f"{value:.{digits}f}" for value, digits in values]


def _room_lines(wer: dict) -> list[str]:
    """Return the acoustics and the word error rates of each room, in the first column."""
    column, width = wer["columns"][0], max(len("room"), *(len(room["room"]) for room in wer["rooms"]))
    headings = [heading for heading, _ in ROOM_ACOUSTICS.values()]
    lines = [f"Rooms, {column}. {EQ_NOTE}",
             "room".ljust(width) + "   words" + "".join(f"  {text}" for text in [*headings, *wer["rows"]])]
    for room in wer["rooms"]:
        cells = [text.rjust(len(heading)) for text, heading in zip(room_cells(room), headings, strict=True)]
        cells += [f"{room['wer'][column][row]:{len(row)}.2f}" for row in wer["rows"]]
        lines.append(room["room"].ljust(width) + f"{room['words']:8d}" + "".join(f"  {cell}" for cell in cells))
    return [*lines, ""]


def _gain_lines(wer: dict) -> list[str]:
    """Return how the gains depend on the acoustics of the rooms."""
    if not wer["gains"]:
        return []
    names = {gain["what"]: gain["what"].partition(" [")[0] for gain in wer["gains"]}
    lines = [gains_caption(wer)]
    for row in dict.fromkeys(gain["row"] for gain in wer["gains"]):
        lines.append(f"  {row}: " + ", ".join(
            f"{names[gain['what']]} {gain['rho']:+.2f} (p {p_text(gain['p'])}, {gain['rooms']} rooms)"
            for gain in wer["gains"] if gain["row"] == row))
    return [*lines, ""]


def gains_caption(wer: dict) -> str:
    """Return the sentences that explain the rank correlations."""
    return (f"Spearman's rank correlation over rooms of the change against {BASE} with the acoustics, "
            f"{wer['columns'][0]}. Negative: the row gains most where the value is large. {len(wer['gains'])} "
            "correlations are stated: by chance, one in 20 has p below 0.05.")


def _strata_lines(wer: dict) -> list[str]:
    """Return the word error rates of parts of the test set, in the first column."""
    if not wer["strata"]:
        return []
    column = wer["columns"][0]
    width = max(len(stratum_label(stratum)) for stratum in wer["strata"])
    lines = [f"Parts of the test set, {column}. They are small: most differences within them are chance.",
             "".ljust(width) + "   words" + "".join(f"  {row}" for row in wer["rows"])]
    for stratum in wer["strata"]:
        lines.append(stratum_label(stratum).ljust(width) + f"{stratum['words']:8d}" + "".join(
            f"  {stratum['wer'][column][row]:{len(row)}.2f}" for row in wer["rows"]))
    return [*lines, *strata_notes(wer), ""]


def strata_notes(wer: dict) -> list[str]:
    """Return which properties are not known of all words, as seeds of earlier versions of roomeq do not state all."""
    total, words = sum(room["words"] for room in wer["rooms"]), Counter[str]()
    for stratum in wer["strata"]:
        words[stratum["what"]] += stratum["words"]
    return [f"{what.split(' [')[0]} is known of {count} of {total} words: not all seeds or rooms state it."
            for what, count in words.items() if count < total]


def stratum_label(stratum: dict) -> str:
    """Return the range of values that a stratum covers, with the name of the property."""
    name, unit = stratum["what"].removesuffix("]").split(" [")
    low, high = stratum["low"], stratum["high"]
    if low is None:
        return f"{name} below {high:g} {unit}"
    return f"{name} {low:g} {unit} and more" if high is None else f"{name} {low:g} to {high:g} {unit}"
