"""Measure the word error rates of a recipe's systems and their differences, with confidence intervals."""

import math
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from roomeq.core.arrays import FloatArray
from roomeq.core.build import Build
from roomeq.core.files import paths, read_json, write_json, write_text
from roomeq.records.rir_dir import ROWS_FILE, read_rirs
from roomeq.records.schema import RirRow
from roomeq.wer.breakdown import ACOUSTICS, EDGES, Breakdown, gains_by_acoustics, ranges
from roomeq.wer.check import WER_FILE
from roomeq.wer.counts import (
    COUNTS_FILE,
    SeedCounts,
    SetCounts,
    count_seed,
    counts_text,
    read_counts,
    require_comparable,
)
from roomeq.wer.statistics import Statistic, detectable, ratio_interval
from roomeq.wer.table import table_text
from roomeq.wer.workspace import BASE, ORACLE, TEST, System, Workspace, compared, find_workspaces


def measure_wer(workspaces: list[Path], out: Path | str, *, rirs: Sequence[Path],
                train_rirs: Path | None = None, counted: Sequence[Path] = ()) -> Path:
    """Measure the word error rates of Kaldi workspaces, with intervals; write `wer.json` and print the table.

    Language model weight and word insertion penalty are chosen on the development set, for each row, column and
    seed, and applied to the test set.

    Parameters
    ----------
    workspaces
        One per seed, e.g. ``exp/kaldi``: ``ROW/decode_SET_COLUMN/scoring_kaldi`` as Kaldi's scoring leaves it, and
        ``data/SET/utt2rir``.
    out
        Directory to make; it holds `wer.json` and `counts.jsonl`.
    rirs
        RIR directories whose `room_id` states the room of each RIR that the sets were made with.
    train_rirs
        RIR directory of the measured RIRs that the recognisers were trained with, for the EQ distance of each test
        room to them.
    counted
        `counts.jsonl` of further seeds.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    ValueError
        A decode directory, a file of its scoring or a hypothesis is missing, references differ between rows, an RIR is
        unknown, or the seeds are not of one experiment.
    """
    counted = paths(counted)
    rirs = paths(rirs)
    _breakdown(rirs, train_rirs)  # refuses wrong rows before all is hashed
    found = find_workspaces(paths(workspaces))
    directories = [*rirs, *([train_rirs] if train_rirs else ())]
    build = Build(Path(out), step="wer",
                  options=dict(rows=found[0].rows, columns=found[0].columns, dev_of=found[0].dev_of,
                               seeds=len(_earlier(counted)) + len(found), train_rirs=train_rirs is not None),
                  inputs=[*(Path(directory) / ROWS_FILE for directory in directories), *counted,
                          *(path for workspace in found for path in workspace.inputs())])
    if not build.done and build.run({}, lambda name, item: None):
        earlier = _earlier(counted)  # as it is in the key, like the rows
        breakdown = _breakdown(rirs, train_rirs)
        trained = {str(workspace.path): count_seed(workspace, breakdown) for workspace in found}
        require_comparable(earlier | trained)
        seeds = sorted([*earlier.values(), *trained.values()], key=lambda counts: counts.seed)

        def write(directory: Path, _: object) -> None:
            write_json(directory / WER_FILE, dict(_measure(seeds), data=_contents(found)))
            write_text(directory / COUNTS_FILE, counts_text(seeds))

        build.finish(write)
    print(table_text(read_json(build.out / WER_FILE)), end="")
    return build.out / WER_FILE


def _earlier(counted: Sequence[Path]) -> dict[str, SeedCounts]:
    """Return seeds that were counted earlier, by their place."""
    return {f"{path}:{n}": seed for path in counted for n, seed in enumerate(read_counts(path), start=1)}


def _breakdown(rirs: Sequence[Path], train_rirs: Path | None) -> Breakdown:
    rows: dict[str, RirRow] = {}
    ambiguous = set()
    for directory in rirs:
        for row in read_rirs(directory):
            if rows.setdefault(row["id"], row)["room_id"] != row["room_id"]:
                raise ValueError(f"{directory}: RIR {row['id']} is of room {row['room_id']} here and of room "
                                 f"{rows[row['id']]['room_id']} in a directory before it: rename one")
            if rows[row["id"]].get("acoustic_parameters") != row.get("acoustic_parameters"):
                ambiguous.add(row["id"])
    return Breakdown(rows, read_rirs(train_rirs) if train_rirs else [], ambiguous)


def _contents(workspaces: Sequence[Workspace]) -> dict[str, list[str]]:
    """Return the hashes of each set in the workspaces, by its name."""
    of_each = [workspace.contents() for workspace in workspaces]
    return {name: sorted({contents[name] for contents in of_each if name in contents})
            for name in sorted(set().union(*of_each))}


def _measure(seeds: Sequence[SeedCounts]) -> dict:
    """Return what `wer.json` holds; rates and differences in per cent."""
    first, rates = seeds[0], _Rates(seeds)
    results = {row: {column: _result(rates, System(row, column)) for column in first.columns} for row in first.rows}
    rooms = _rooms(seeds)
    others = [row for row in first.rows if row != BASE] if BASE in first.rows else []
    return dict(kaldi=sorted({version for seed in seeds for version in seed.kaldi}),
                seeds=[seed.seed for seed in seeds], rows=first.rows,
                columns=first.columns, test=TEST, dev_of=first.dev_of,
                sets={name: _set_size([seed.sets[name] for seed in seeds]) for name in sorted(first.sets)},
                results=results, rooms=rooms, strata=_strata(seeds),
                gains=gains_by_acoustics(rooms, others, first.columns[0]))


class _Rates:
    """Word error rates as statistics."""

    def __init__(self, seeds: Sequence[SeedCounts]) -> None:
        self.seeds = seeds

    def rooms(self, *names: str) -> list[str]:
        """Return the rooms of sets, sorted."""
        return sorted(set().union(*(seed.sets[name].rooms for seed in self.seeds for name in names)))

    def counts(self, system: System, set_name: str, rooms: list[str]) -> tuple[FloatArray, FloatArray]:
        """Return the errors of a system on a set, and the words, shape (n_seeds, n_rooms) each."""
        of_seeds = [seed.sets[set_name] for seed in self.seeds]
        return (np.array([of_set.of_system(system, rooms).sum(axis=1) for of_set in of_seeds], dtype=float),
                np.array([of_set.words_of(rooms) for of_set in of_seeds], dtype=float))

    def rate(self, system: System, set_name: str, compared_with: tuple[str, ...] = ()) -> Statistic:
        """Return the rate of a system on a set, comparable with rates on the sets `compared_with`."""
        return Statistic.of(*self.counts(system, set_name, self.rooms(set_name, *compared_with)))

    def log_ratio(self, system: System, base: System) -> Statistic:
        """Return the mean over the test rooms of the logarithm of the ratio of two rates."""
        rooms = self.rooms(TEST)
        errors, words = self.counts(system, TEST, rooms)
        return Statistic.of_log_ratio(errors, self.counts(base, TEST, rooms)[0], words)


def _set_size(of_seeds: Sequence[SetCounts]) -> dict:
    rooms = set().union(*(of_set.rooms for of_set in of_seeds))
    return dict(utterances=sum(of_set.utterances for of_set in of_seeds),
                words=sum(sum(of_set.words) for of_set in of_seeds),
                rooms=len(rooms) if of_seeds[0].has_rooms else None)


def _result(rates: _Rates, system: System) -> dict:
    """Return the figures of one row and column."""
    first = rates.seeds[0]
    rows, dev, test = first.rows, first.dev_of[system.row], TEST
    chosen = [seed.weights[system.row][system.column] for seed in rates.seeds]
    result = dict(weights=[msgspec.to_builtins(weights) for weights in chosen],
                  dev=_rate(rates, system, dev), test=_rate(rates, system, test))
    test_rate, dev_rate = (rates.rate(system, name, (dev, test)) for name in (test, dev))
    result["dev_test_gap"] = _difference(test_rate.minus(dev_rate))
    if BASE in rows and system.row != BASE:
        row_rate, base_rate = (rates.rate(System(row, system.column), TEST) for row in (system.row, BASE))
        result["change"] = _change(row_rate, base_rate) | dict(
            geometric_mean=_geometric_mean(rates.log_ratio(system, System(BASE, system.column))),
            influential=_most_influential(rates, system))
        if ORACLE in rows and system.row in compared(rows):
            result["closed"] = _closed(row_rate, base_rate, rates.rate(System(ORACLE, system.column), TEST))
    return result


def _rate(rates: _Rates, system: System, set_name: str) -> dict:
    """Return a word error rate with its counts and its interval, which cannot reach below 0."""
    rate, of_seeds = rates.rate(system, set_name), [seed.sets[set_name] for seed in rates.seeds]
    interval = rate.interval()
    by_kind = np.array([of_set.of_system(system) for of_set in of_seeds])
    substitutions, deletions, insertions = by_kind.sum(axis=0).tolist()
    bootci = [of_set.errors[system.row][system.column].bootci for of_set in of_seeds]
    return dict(set=set_name, wer=rate.value, interval=interval and [max(0.0, end) for end in interval],
                substitutions=substitutions, deletions=deletions, insertions=insertions,
                by_seed=[float(100 * errors.sum() / sum(of_set.words))
                         for errors, of_set in zip(by_kind, of_seeds, strict=True)],
                bootci=[msgspec.to_builtins(printed) for printed in bootci])


def _rooms(seeds: Sequence[SeedCounts]) -> list[dict]:
    """Return the word error rates of each test room over all seeds.

    Returns
    -------
    list of dict
        `room`, `words`, `wer` by column and row [%], and `acoustics`: the mean of each of
        `roomeq.wer.breakdown.ACOUSTICS` over the room's utterances, None where it is unknown.
    """
    first, names = seeds[0], sorted(set().union(*(seed.sets[TEST].rooms for seed in seeds)))
    words = np.sum([seed.sets[TEST].words_of(names) for seed in seeds], axis=0)
    wer = {column: {row: 100 * np.sum([seed.sets[TEST].of_system(System(row, column), names).sum(axis=1)
                                       for seed in seeds], axis=0) / words for row in first.rows}
           for column in first.columns}
    stated = []
    for n, name in enumerate(names):
        of_seeds = [seed.acoustics.get(name, {}) for seed in seeds]
        known = {what: [acoustics[what] for acoustics in of_seeds if what in acoustics] for what in ACOUSTICS}
        stated.append(dict(
            room=name, words=int(words[n]),
            wer={column: {row: float(rates[n]) for row, rates in of_rows.items()} for column, of_rows in wer.items()},
            acoustics={what: sum(total for total, _ in sums) / count if (count := sum(n for _, n in sums)) else None
                       for what, sums in known.items()}))
    return stated


def _strata(seeds: Sequence[SeedCounts]) -> list[dict]:
    """Return the word error rates of each part of the test set over all seeds: `what, low, high, words, wer`."""
    stated = []
    for what in EDGES:
        for low, high in ranges(what):
            parts = [part for seed in seeds for part in seed.strata if (part.what, part.low, part.high)
                     == (what, low, high)]
            if words := sum(part.words for part in parts):
                wer = {column: {row: float(100 * sum(part.errors[column][row] for part in parts) / words)
                                for row in seeds[0].rows} for column in seeds[0].columns}
                stated.append(dict(what=what, low=low, high=high, words=words, wer=wer))
    return stated


def _difference(difference: Statistic) -> dict:
    return dict(points=difference.value, interval=difference.interval(), p=difference.p_value())


def _change(row: Statistic, base: Statistic) -> dict:
    """Return the difference of a row from the base, in points and relative to the base [%]."""
    difference, ratio = row.minus(base), ratio_interval(row, base)
    relative = 100 * difference.value / base.value if base.value else None
    return _difference(difference) | dict(
        relative=relative, relative_interval=ratio and [100 * (end - 1) for end in ratio],
        detectable=detectable(difference))


def _geometric_mean(log_ratio: Statistic) -> dict:
    """Return the geometric mean over rooms of the ratio to the base, as a relative change [%].

    `detectable` is the smallest decrease that is detected.
    """
    interval, found = log_ratio.interval(), detectable(log_ratio)
    return dict(relative=100 * math.expm1(log_ratio.value),
                interval=interval and [100 * math.expm1(end) for end in interval], p=log_ratio.p_value(),
                detectable=found and -100 * math.expm1(-found["difference"]))


def _most_influential(rates: _Rates, system: System) -> dict | None:
    """Return the room without which the difference from the base changes most, and the difference without it.

    None of fewer than three rooms. A room that is the only one of a seed is not left out.
    """
    rooms = rates.rooms(TEST)
    of_seeds = [seed.sets[TEST].rooms for seed in rates.seeds]
    candidates = [n for n, room in enumerate(rooms) if [room] not in of_seeds]
    if len(rooms) < 3 or not candidates:
        return None
    of_row, of_base = (rates.counts(System(row, system.column), TEST, rooms) for row in (system.row, BASE))

    def difference(*without: int) -> Statistic:
        row, base = (Statistic.of(*(np.delete(table, without, axis=1) for table in tables))
                     for tables in (of_row, of_base))
        return row.minus(base)

    points, of_each = difference().value, {n: difference(n) for n in candidates}
    most = max(candidates, key=lambda n: abs(of_each[n].value - points))
    found = detectable(of_each[most])
    return _difference(of_each[most]) | dict(room=rooms[most], detectable=found and found["difference"])


def _closed(row: Statistic, base: Statistic, oracle: Statistic) -> dict:
    """Return the share of the gap between base and oracle that a row closes; None unless the gap is certain."""
    gained, gap = base.minus(row), base.minus(oracle)
    ratio = ratio_interval(gained, gap)
    return dict(gap=_difference(gap), gained=_difference(gained), interval=ratio,
                share=gained.value / gap.value if ratio else None)
