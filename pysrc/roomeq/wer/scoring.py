"""Reading what stock `steps/scoring/score_kaldi_wer.sh` left in a decode directory, and counting its errors.

A workspace holds ``ROW/decode_SET_COLUMN/scoring_kaldi`` with `test_filt.txt`, the reference, and
``penalty_P/LMWT.txt``, the hypotheses at word insertion penalty P and language model weight LMWT.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rapidfuzz.distance import Levenshtein

from roomeq.core.files import read_text

REFERENCE_FILE = "test_filt.txt"
BOOTCI_FILE = "bootci"
_PENALTY = re.compile(r"penalty_(\d+(?:\.\d+)?)", re.ASCII)
_WEIGHT = re.compile(r"(\d+)\.txt", re.ASCII)
_BOOTCI = re.compile(r"Set1: %WER ([\d.]+) 95% Conf Interval \[ (-?[\d.]+), (-?[\d.]+) \]", re.ASCII)
_RUN_DECODING = "run stages 8 to 10 again"


@dataclass(frozen=True)
class Weights:
    """What the decoding of a set leaves open: word insertion penalty and language model weight."""

    penalty: str
    """As Kaldi writes it, ``"0.5"``."""
    lmwt: int

    def path(self, decode: Path) -> Path:
        """Return where a decode directory holds these hypotheses."""
        return scoring_dir(decode) / f"penalty_{self.penalty}" / f"{self.lmwt}.txt"


def scoring_dir(decode: Path) -> Path:
    """Return where a decode directory's scoring lies."""
    return decode / "scoring_kaldi"


def read_texts(path: Path) -> dict[str, tuple[str, ...]]:
    """Read ``utterance words...`` lines; an utterance may have no words.

    Raises
    ------
    ValueError
        The file is missing, empty or cut off, or an utterance stands twice.
    """
    if not path.is_file():
        raise ValueError(f"{path}: no such file: {_RUN_DECODING}")
    *lines, rest = read_text(path).split("\n")
    if rest:
        raise ValueError(f"{path}:{len(lines) + 1}: last line must end in a line break: the file may be cut off, "
                         f"{_RUN_DECODING}")
    if not lines:
        raise ValueError(f"{path}: file is empty: {_RUN_DECODING}")
    texts = {}
    for number, line in enumerate(lines, start=1):
        utterance, *words = line.split() or [""]
        if not utterance:
            raise ValueError(f"{path}:{number}: line {line!r} must start with an utterance: {_RUN_DECODING}")
        if utterance in texts:
            raise ValueError(f"{path}:{number}: utterance {utterance!r} stands twice: {_RUN_DECODING}")
        texts[utterance] = tuple(words)
    return texts


def read_reference(decode: Path) -> dict[str, tuple[str, ...]]:
    """Read the reference of a decode directory, whose utterances must have words.

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


def read_hypotheses(path: Path, reference: dict) -> list[tuple[str, ...]]:
    """Read hypotheses, in the order of the reference.

    Raises
    ------
    ValueError
        See `read_texts`; also when an utterance of the reference has no line, or one is not in it.
    """
    found = read_texts(path)
    for utterance in reference:
        if utterance not in found:
            raise ValueError(f"{path}: utterance {utterance!r} of {REFERENCE_FILE} is missing: it was not decoded, "
                             f"{_RUN_DECODING}")
    for utterance in found:
        if utterance not in reference:
            raise ValueError(f"{path}: utterance {utterance!r} is not in {REFERENCE_FILE}: {_RUN_DECODING}")
    return [found[utterance] for utterance in reference]


def weights_of(decode: Path) -> list[Weights]:
    """Return the weights that a set was scored with, every penalty with every LM weight.

    Raises
    ------
    ValueError
        There are none, or some are missing.
    """
    scored = scoring_dir(decode)
    by_penalty = {found[1]: {int(weight[1]) for one in path.iterdir() if (weight := _WEIGHT.fullmatch(one.name))}
                  for path in sorted(scored.iterdir()) if (found := _PENALTY.fullmatch(path.name))}
    every = sorted(set().union(*by_penalty.values()))
    if not every:
        raise ValueError(f"{scored}: no penalty_P/LMWT.txt in it: {_RUN_DECODING}")
    result = [Weights(penalty, lmwt) for penalty in sorted(by_penalty, key=float) for lmwt in every]
    for one in result:
        if one.lmwt not in by_penalty[one.penalty]:
            raise ValueError(f"{one.path(decode)}: no such file, but other penalties have it: {_RUN_DECODING}")
    return result


def choose_weights(decode: Path, reference: dict) -> Weights:
    """Return the weights with the fewest errors; of equals those with the smallest penalty, then LM weight.

    Parameters
    ----------
    decode : Path
        Decode directory of a development set.
    reference : dict
        Its `read_reference`.
    """
    references, seen = list(reference.values()), {}

    def distance(n: int, hypothesis: tuple[str, ...]) -> int:
        if (n, hypothesis) not in seen:  # most hypotheses are the same at most weights
            seen[n, hypothesis] = Levenshtein.distance(references[n], hypothesis)
        return seen[n, hypothesis]

    def errors(one: Weights) -> int:
        return sum(distance(n, words) for n, words in enumerate(read_hypotheses(one.path(decode), reference)))

    return min(weights_of(decode), key=errors)


def count_errors(reference: list[tuple[str, ...]], hypotheses: list[tuple[str, ...]]) -> np.ndarray:
    """Return substitutions, deletions and insertions, shape (n_utterances, 3).

    Their sum is the least that turns the reference into the hypothesis, which is what Kaldi counts. Where several
    alignments need as few, two substitutions of Kaldi's may be a deletion and an insertion here, or the reverse.
    """
    counts = np.zeros((len(reference), 3), dtype=np.int64)
    kinds = dict(replace=0, delete=1, insert=2)
    for n, (spoken, heard) in enumerate(zip(reference, hypotheses, strict=True)):
        for edit in Levenshtein.editops(spoken, heard):
            counts[n, kinds[edit.tag]] += 1
    return counts


def read_bootci(decode: Path) -> dict | None:
    """Return what Kaldi's `compute-wer-bootci` printed into the decode directory, or None where nobody ran it.

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
    found = _BOOTCI.search(text)
    if not found:
        raise ValueError(f"{path}: {text[:60]!r} is not what compute-wer-bootci prints ('Set1: %WER ...'): remove "
                         "the file, or run it again")
    wer, low, high = map(float, found.groups())
    return dict(wer=wer, interval=[low, high])
