"""Measure the word error rates of a recipe's systems and their differences, with confidence intervals."""

from collections.abc import Sequence
from pathlib import Path

from roomeq.core.build import Build
from roomeq.core.files import read_json, write_json
from roomeq.records.rir_dir import ROWS_FILE, read_rirs
from roomeq.records.schema import RirRow
from roomeq.wer.breakdown import Breakdown, gains_by_acoustics
from roomeq.wer.check import WER_FILE
from roomeq.wer.scoring import Weights, read_bootci
from roomeq.wer.statistics import Resampling, Statistic, detectable, ratio_interval
from roomeq.wer.table import table_text
from roomeq.wer.workspace import (
    BASE,
    ORACLE,
    TEST,
    Decodings,
    Scores,
    System,
    choose_all_weights,
    compared,
    find_decodings,
    kaldi_versions,
    read_scores,
)


def measure_wer(workspaces: list[Path], out: Path | str, *, rirs: Sequence[Path],
                train_rirs: Path | None = None) -> Path:
    """Measure the word error rates of Kaldi workspaces, with intervals; write `wer.json` and print the table.

    Language model weight and word insertion penalty are chosen on the development set, for each row, column and
    seed, and applied to the test set.

    Parameters
    ----------
    workspaces
        One per seed, e.g. ``exp/kaldi``: ``ROW/decode_SET_COLUMN/scoring_kaldi`` as Kaldi's scoring leaves it, and
        ``data/SET/utt2rir``.
    out
        Directory to make; it holds `wer.json`.
    rirs
        RIR directories whose `room_id` states the room of each RIR that the sets were made with.
    train_rirs
        RIR directory of the measured RIRs that the recognisers were trained with, for the EQ distance of each test
        room to them.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    ValueError
        A decode directory, a file of its scoring or a hypothesis is missing, references differ between rows, or an
        RIR is unknown.
    """
    workspaces = [Path(path) for path in workspaces]
    rows: dict[str, RirRow] = {}
    for directory in rirs:
        for row in read_rirs(directory):
            if rows.setdefault(row["id"], row)["room_id"] != row["room_id"]:
                raise ValueError(f"{directory}: RIR {row['id']} is of room {row['room_id']} here and of room "
                                 f"{rows[row['id']]['room_id']} in a directory before it: rename one")
    decodings = find_decodings(workspaces)
    directories = [*rirs, *([train_rirs] if train_rirs else ())]
    build = Build(Path(out), step="wer",
                  options=dict(rows=decodings.rows, columns=decodings.columns, dev_of=decodings.dev_of,
                               seeds=len(workspaces), train_rirs=train_rirs is not None),
                  inputs=[*(Path(directory) / ROWS_FILE for directory in directories), *decodings.inputs()])
    if not build.done and build.run({}, lambda name, item: None):
        train = read_rirs(train_rirs) if train_rirs else []
        build.finish(lambda directory, _: write_json(directory / WER_FILE, _measure(decodings, rows, train)))
    print(table_text(read_json(build.out / WER_FILE)), end="")
    return build.out / WER_FILE


def _measure(decodings: Decodings, rirs: dict[str, RirRow], train_rirs: list[RirRow]) -> dict:
    """Return what `wer.json` holds; rates and differences in per cent."""
    room_of_rir = {rir_id: row["room_id"] for rir_id, row in rirs.items()}
    weights = choose_all_weights(decodings)
    scores = {name: read_scores(decodings, name, weights, room_of_rir) for name in decodings.set_names}
    rates = _Rates(decodings, scores)
    results: dict[str, dict[str, dict]] = {row: {} for row in decodings.rows}
    for system in decodings.systems():
        results[system.row][system.column] = _result(rates, system, weights[system])
    parts = Breakdown(decodings, scores[TEST], rirs, train_rirs)
    rooms = parts.by_room()
    others = [row for row in decodings.rows if row != BASE] if BASE in decodings.rows else []
    return dict(kaldi=kaldi_versions(decodings.workspaces), seeds=len(decodings.workspaces), rows=decodings.rows,
                columns=decodings.columns, test=TEST, dev_of=decodings.dev_of,
                sets={name: _set_size(of_set) for name, of_set in scores.items()}, results=results, rooms=rooms,
                strata=parts.by_stratum(), gains=gains_by_acoustics(rooms, others, decodings.columns[0]))


class _Rates:
    """Word error rates as statistics; those of the same sets share their resampled rooms and seeds."""

    def __init__(self, decodings: Decodings, scores: dict[str, Scores]) -> None:
        self.decodings, self.scores = decodings, scores
        self._resamplings: dict[tuple[str, ...], tuple[list[str], Resampling]] = {}

    def rate(self, system: System, set_name: str, compared_with: tuple[str, ...] = ()) -> Statistic:
        """Return the rate of a system on a set, comparable with rates on the sets `compared_with`."""
        set_names = tuple(sorted({set_name, *compared_with}))
        if set_names not in self._resamplings:
            rooms = sorted(set().union(*(self.scores[name].room_names for name in set_names)))
            self._resamplings[set_names] = rooms, Resampling(len(self.decodings.workspaces), len(rooms),
                                                             " ".join(set_names))
        rooms, resampling = self._resamplings[set_names]
        scores = self.scores[set_name]
        return Statistic.of(scores.error_table(system, rooms), scores.word_table(rooms), resampling)


def _set_size(scores: Scores) -> dict:
    return dict(utterances=sum(map(len, scores.words)), words=sum(int(words.sum()) for words in scores.words),
                rooms=len(scores.room_names) if scores.has_rooms else None)


def _result(rates: _Rates, system: System, weights: list[Weights]) -> dict:
    """Return the figures of one row and column."""
    rows, (dev, test) = rates.decodings.rows, rates.decodings.sets_of(system.row)
    result = dict(weights=[dict(lmwt=chosen.lmwt, penalty=chosen.penalty) for chosen in weights],
                  dev=_rate(rates, system, dev), test=_rate(rates, system, test))
    test_rate, dev_rate = (rates.rate(system, name, (dev, test)) for name in (test, dev))
    result["dev_test_gap"] = _difference(test_rate.minus(dev_rate))
    if BASE in rows and system.row != BASE:
        row_rate, base_rate = (rates.rate(System(row, system.column), TEST) for row in (system.row, BASE))
        result["change"] = _change(row_rate, base_rate)
        if ORACLE in rows and system.row in compared(rows):
            result["closed"] = _closed(row_rate, base_rate, rates.rate(System(ORACLE, system.column), TEST))
    return result


def _rate(rates: _Rates, system: System, set_name: str) -> dict:
    """Return a word error rate with its counts and its interval, which cannot reach below 0."""
    scores, rate = rates.scores[set_name], rates.rate(system, set_name)
    interval = rate.interval()
    counts = scores.counts[system]
    substitutions, deletions, insertions = (int(sum(of_seed[:, kind].sum() for of_seed in counts)) for kind in range(3))
    decode_dirs = [rates.decodings.decode_dir(seed, system, set_name) for seed in range(len(counts))]
    return dict(set=set_name, wer=rate.value, interval=interval and [max(0.0, end) for end in interval],
                substitutions=substitutions, deletions=deletions, insertions=insertions,
                by_seed=[float(100 * of_seed.sum() / words.sum())
                         for of_seed, words in zip(counts, scores.words, strict=True)],
                bootci=[read_bootci(decode) for decode in decode_dirs])


def _difference(difference: Statistic) -> dict:
    return dict(points=difference.value, interval=difference.interval(), p=difference.p_value())


def _change(row: Statistic, base: Statistic) -> dict:
    """Return the difference of a row from the base, in points and relative to the base [%]."""
    difference, ratio = row.minus(base), ratio_interval(row, base)
    relative = 100 * difference.value / base.value if base.value else None
    return _difference(difference) | dict(
        relative=relative, relative_interval=ratio and [100 * (end - 1) for end in ratio],
        detectable=detectable(difference))


def _closed(row: Statistic, base: Statistic, oracle: Statistic) -> dict:
    """Return the share of the gap between base and oracle that a row closes; None unless the gap is certain."""
    gained, gap = base.minus(row), base.minus(oracle)
    ratio = ratio_interval(gained, gap)
    return dict(gap=_difference(gap), gained=_difference(gained), interval=ratio,
                share=gained.value / gap.value if ratio else None)
