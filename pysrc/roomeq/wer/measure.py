"""The verb: word error rates of a recipe's systems, what separates them, and how sure that is."""

import logging
from pathlib import Path

import numpy as np

from roomeq.core.build import Build
from roomeq.core.files import read_json, write_json
from roomeq.records.rir_dir import ROWS_FILE, read_rirs
from roomeq.records.schema import RirRow
from roomeq.wer.check import WER_FILE
from roomeq.wer.statistics import (
    Resampling,
    Statistic,
    detectable,
    ratio_interval,
    utterance_intervals,
)
from roomeq.wer.strata import by_stratum
from roomeq.wer.table import table_text
from roomeq.wer.workspace import (
    BASE,
    ORACLE,
    TEST,
    Decoded,
    Scores,
    choose_all,
    compared,
    find_decoded,
    read_all_bootci,
    read_scores,
)

logger = logging.getLogger(__name__)



def measure_wer(workspaces: list[Path], out: Path, *, rirs: Path) -> Path:
    """Measure the word error rates of Kaldi workspaces, with intervals; write `wer.json` and print the table.

    Language model weight and word insertion penalty are chosen on the development set, for each row, column and
    seed, and applied to the test set.

    Parameters
    ----------
    workspaces : list of Path
        One a seed, e.g. ``exp/kaldi``: ``ROW/decode_SET_COLUMN/scoring_kaldi`` as Kaldi's scoring leaves it, and
        ``data/SET/utt2rir``.
    out : Path
        Directory to make: `wer.json`.
    rirs : Path
        RIR directory whose `room_id` says which rooms the sets' RIRs are of.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    ValueError
        A decode directory, a file of its scoring or a hypothesis is missing, references differ between rows, or an
        RIR is not known.
    """
    workspaces, out = [Path(one) for one in workspaces], Path(out)
    rows = {row["id"]: row for row in read_rirs(Path(rirs))}
    decoded = find_decoded(workspaces)
    build = Build(out, step="wer", options=dict(rows=decoded.rows, columns=decoded.columns, dev_of=decoded.dev_of,
                                                seeds=len(workspaces)),
                  inputs=[Path(rirs) / ROWS_FILE, *decoded.inputs()])
    if not build.done and build.run({}, lambda name, item: None):
        build.finish(lambda directory, _: write_json(directory / WER_FILE, measured(decoded, rows)))
    print(table_text(read_json(out / WER_FILE)), end="")
    return out / WER_FILE


def measured(decoded: Decoded, rirs: dict[str, RirRow]) -> dict:
    """Return everything that `wer.json` holds, from workspaces and RIRs by id; rates and differences in per cent."""
    room_of = {name: row["room_id"] for name, row in rirs.items()}
    weights = choose_all(decoded)
    names = sorted({name for row in decoded.rows for name in decoded.sets_of(row)})
    scores = {name: read_scores(decoded, name, weights, room_of) for name in names}
    rates = _Rates(decoded, scores)
    results = {row: {column: _result(decoded, rates, row, column, weights[row, column]) for column in decoded.columns}
               for row in decoded.rows}
    return dict(seeds=len(decoded.workspaces), rows=decoded.rows, columns=decoded.columns, test=TEST,
                dev_of=decoded.dev_of, sets={name: _described(one) for name, one in scores.items()}, results=results,
                rooms=_by_room(decoded, scores[TEST]), strata=by_stratum(decoded, scores[TEST], rirs))


class _Rates:
    """Word error rates as statistics, each made once; those of a set share its draws of rooms and seeds."""

    def __init__(self, decoded: Decoded, scores: dict[str, Scores]):
        self.decoded, self.scores = decoded, scores
        self._draws, self._plain = {}, {}

    def of(self, row: str, column: str, name: str, names: tuple[str, ...] = ()) -> Statistic:
        """Return the rate of a row on a set, to be compared with rates on all of `names` (default: the same set)."""
        names = tuple(sorted({name, *names}))
        if names not in self._draws:
            rooms = sorted(set().union(*(self.scores[one].room_names for one in names)))
            draws = Resampling(len(self.decoded.workspaces), len(rooms), " ".join(names))
            self._draws[names] = rooms, draws
        rooms, draws = self._draws[names]
        one = self.scores[name]
        return Statistic.of(one.errors(row, column, rooms), one.table(one.words, rooms), draws)

    def utterances(self, row: str, column: str, name: str) -> list[float]:
        """Return the interval that takes utterances for independent."""
        if name not in self._plain:
            one = self.scores[name]
            pooled = {system: _pooled([counts.sum(axis=1) for counts in found])
                      for system, found in one.counts.items()}
            intervals = utterance_intervals(np.array(list(pooled.values())), _pooled(one.words), name)
            self._plain[name] = dict(zip(pooled, intervals, strict=True))
        return self._plain[name][row, column]


def _pooled(of_seeds: list[np.ndarray]) -> np.ndarray:
    return np.concatenate(of_seeds)


def _described(scores: Scores) -> dict:
    return dict(utterances=sum(map(len, scores.words)), words=sum(int(one.sum()) for one in scores.words),
                rooms=len(scores.room_names) if scores.has_rooms else None)


def _result(decoded: Decoded, rates: _Rates, row: str, column: str, weights: list) -> dict:
    """Return the figures of one row and column."""
    dev, test = decoded.sets_of(row)
    result = dict(weights=[dict(lmwt=one.lmwt, penalty=one.penalty) for one in weights],
                  dev=_rate(decoded, rates, row, column, dev), test=_rate(decoded, rates, row, column, test))
    both = [rates.of(row, column, name, (dev, test)) for name in (test, dev)]
    result["dev_test_gap"] = _difference(both[0].less(both[1]))
    if BASE in decoded.rows and row != BASE:
        result["change"] = _change(rates.of(row, column, TEST), rates.of(BASE, column, TEST))
        if ORACLE in decoded.rows and row in compared(decoded.rows):
            result["closed"] = _closed(*(rates.of(one, column, TEST) for one in (row, BASE, ORACLE)))
    return result


def _rate(decoded: Decoded, rates: _Rates, row: str, column: str, name: str) -> dict:
    """Return a word error rate with its counts and intervals."""
    scores, found = rates.scores[name], rates.of(row, column, name)
    interval = found.interval()
    counts = scores.counts[row, column]
    substitutions, deletions, insertions = (int(sum(one[:, k].sum() for one in counts)) for k in range(3))
    return dict(set=name, wer=found.value, interval=interval and [max(0.0, end) for end in interval],
                substitutions=substitutions, deletions=deletions, insertions=insertions,
                by_seed=[float(100 * one.sum() / words.sum())
                         for one, words in zip(counts, scores.words, strict=True)],
                interval_over_utterances=rates.utterances(row, column, name),
                bootci=read_all_bootci(decoded, row, name, column))


def _difference(found: Statistic) -> dict:
    return dict(points=found.value, interval=found.interval(), p=found.p())


def _change(row: Statistic, base: Statistic) -> dict:
    """Return how a row differs from the base, in points and relative to it [%]."""
    difference, ratio = row.less(base), ratio_interval(row, base)
    relative = 100 * difference.value / base.value if base.value else None
    return _difference(difference) | dict(
        relative=relative, relative_interval=ratio and [100 * (one - 1) for one in ratio],
        detectable=detectable(difference))


def _closed(row: Statistic, base: Statistic, oracle: Statistic) -> dict:
    """Return the share of the gap between base and oracle that a row closes; no share where there is no sure gap."""
    gained, gap = base.less(row), base.less(oracle)
    ratio = ratio_interval(gained, gap)
    return dict(gap=_difference(gap), gained=_difference(gained), interval=ratio,
                share=gained.value / gap.value if ratio else None)


def _by_room(decoded: Decoded, scores: Scores) -> list[dict]:
    """Return the test set's word error rates by room, over all seeds."""
    names = scores.room_names
    words = scores.table(scores.words, names).sum(axis=0)
    errors = {system: scores.errors(*system, names).sum(axis=0) for system in scores.counts}
    return [dict(room=name, words=int(words[n]),
                 wer={column: {row: float(100 * errors[row, column][n] / words[n]) for row in decoded.rows}
                      for column in decoded.columns}) for n, name in enumerate(names)]
