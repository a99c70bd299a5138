"""Read the output of Kaldi's `steps/scoring/score_kaldi_wer.sh` in a decode directory, and count errors.

``scoring_kaldi/test_filt.txt`` in the decode directory holds the reference, ``scoring_kaldi/penalty_P/LMWT.txt`` the
hypotheses at word insertion penalty P and language model weight LMWT.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rapidfuzz.distance import Levenshtein

from roomeq.core.arrays import IntArray
from roomeq.core.files import read_text

REFERENCE_FILE = "test_filt.txt"
BOOTCI_FILE = "bootci"
_PENALTY = re.compile(r"penalty_(\d+(?:\.\d+)?)", re.ASCII)
_WEIGHT = re.compile(r"(\d+)\.txt", re.ASCII)
_BOOTCI = re.compile(r"Set1: %WER ([\d.]+) 95% Conf Interval \[ (-?[\d.]+), (-?[\d.]+) \]", re.ASCII)
_RUN_DECODING = "run stages 8 to 10 again"

Texts = dict[str, tuple[str, ...]]
"""Words by utterance."""


@dataclass(frozen=True)
class Weights:
    """Word insertion penalty and language model weight, which scoring chooses."""

    penalty: str
    """As Kaldi writes it, ``"0.5"``."""
    lmwt: int

    def path(self, decode: Path) -> Path:
        """Return the file of a decode directory with the hypotheses at these weights."""
        return scoring_dir(decode) / f"penalty_{self.penalty}" / f"{self.lmwt}.txt"


def scoring_dir(decode: Path) -> Path:
    """Return the directory in which Kaldi scored a decode directory."""
    return decode / "scoring_kaldi"


def read_texts(path: Path) -> Texts:
    """Read ``utterance words...`` lines; an utterance may have no words.

    Raises
    ------
    ValueError
        The file is missing, empty or cut off, or holds an utterance twice.
    """
    if not path.is_file():
        raise ValueError(f"{path}: no such file: {_RUN_DECODING}")
    *lines, rest = read_text(path).split("\n")
    if rest:
        raise ValueError(f"{path}:{len(lines) + 1}: last line must end in a line break: the file may be cut off, "
                         f"{_RUN_DECODING}")
    if not lines:
        raise ValueError(f"{path}: file is empty: {_RUN_DECODING}")
    texts: Texts = {}
    for number, line in enumerate(lines, start=1):
        utterance, *words = line.split() or [""]
        if not utterance:
            raise ValueError(f"{path}:{number}: line {line!r} must start with an utterance: {_RUN_DECODING}")
        if utterance in texts:
            raise ValueError(f"{path}:{number}: utterance {utterance!r} occurs twice: {_RUN_DECODING}")
        texts[utterance] = tuple(words)
    return texts


def read_reference(decode: Path) -> Texts:
    """Read the reference of a decode directory; every utterance must have words.

    Raises
    ------
    ValueError
        See `read_texts`; also when a reference is empty.
    """
    path = scoring_dir(decode) / REFERENCE_FILE
    reference = read_texts(path)
    for utterance, words in reference.items():
        if not words:
            raise ValueError(f"{path}: reference of {utterance!r} is empty: write it, or leave the utterance out of "
                             "the data directory")
    return reference


def read_hypotheses(path: Path, reference: Texts) -> list[tuple[str, ...]]:
    """Read hypotheses, in the order of the reference.

    Raises
    ------
    ValueError
        See `read_texts`; also when the utterances are not those of the reference.
    """
    hypotheses = read_texts(path)
    for utterance in reference:
        if utterance not in hypotheses:
            raise ValueError(f"{path}: utterance {utterance!r} of {REFERENCE_FILE} is missing: it was not decoded, "
                             f"{_RUN_DECODING}")
    for utterance in hypotheses:
        if utterance not in reference:
            raise ValueError(f"{path}: utterance {utterance!r} is not in {REFERENCE_FILE}: {_RUN_DECODING}")
    return [hypotheses[utterance] for utterance in reference]


def read_weights(decode: Path) -> list[Weights]:
    """Return the weights that a set was scored with: every penalty with every LM weight.

    Raises
    ------
    ValueError
        No hypotheses were scored, or a file is missing.
    """
    scored = scoring_dir(decode)
    lmwts_of = {penalty[1]: {int(lmwt[1]) for file in path.iterdir() if (lmwt := _WEIGHT.fullmatch(file.name))}
                for path in sorted(scored.iterdir()) if (penalty := _PENALTY.fullmatch(path.name))}
    lmwts = sorted(set().union(*lmwts_of.values()))
    if not lmwts:
        raise ValueError(f"{scored}: no penalty_P/LMWT.txt in it: {_RUN_DECODING}")
    grid = [Weights(penalty, lmwt) for penalty in sorted(lmwts_of, key=float) for lmwt in lmwts]
    for weights in grid:
        if weights.lmwt not in lmwts_of[weights.penalty]:
            raise ValueError(f"{weights.path(decode)}: no such file, but other penalties have it: {_RUN_DECODING}")
    return grid


def choose_weights(decode: Path) -> Weights:
    """Return the weights with the fewest errors in the decode directory of a development set.

    Ties go to the smallest penalty, then to the smallest LM weight.
    """
    reference = read_reference(decode)
    known: dict[tuple[tuple[str, ...], tuple[str, ...]], int] = {}  # hypotheses differ little between weights

    def errors(weights: Weights) -> int:
        pairs = list(zip(reference.values(), read_hypotheses(weights.path(decode), reference), strict=True))
        known.update({pair: Levenshtein.distance(*pair) for pair in set(pairs) - known.keys()})
        return sum(known[pair] for pair in pairs)

    return min(read_weights(decode), key=errors)


def count_errors(reference: list[tuple[str, ...]], hypotheses: list[tuple[str, ...]]) -> IntArray:
    """Return substitutions, deletions and insertions, shape (n_utterances, 3).

    Their sum is the smallest number of edits from the reference to the hypothesis, as in Kaldi. If several alignments
    have that number, their kinds may differ from Kaldi's: two substitutions for a deletion and an insertion.
    """
    counts = np.zeros((len(reference), 3), dtype=np.int64)
    kinds = dict(replace=0, delete=1, insert=2)
    for n, (spoken, heard) in enumerate(zip(reference, hypotheses, strict=True)):
        for edit in Levenshtein.editops(spoken, heard):
            counts[n, kinds[edit.tag]] += 1
    return counts


def read_bootci(decode: Path) -> dict | None:
    """Return the output of Kaldi's `compute-wer-bootci` in the decode directory; None if it was not run.

    Returns
    -------
    dict
        `wer` and `interval`, in per cent.

    Raises
    ------
    ValueError
        The file holds something else.
    """
    path = decode / BOOTCI_FILE
    if not path.is_file():
        return None
    text = read_text(path)
    match = _BOOTCI.search(text)
    if not match:
        raise ValueError(f"{path}: {text[:60]!r} is not what compute-wer-bootci prints ('Set1: %WER ...'): remove "
                         "the file, or run it again")
    wer, low, high = map(float, match.groups())
    return dict(wer=wer, interval=[low, high])
