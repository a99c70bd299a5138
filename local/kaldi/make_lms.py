#!/usr/bin/env python3
"""Estimate four language models of a text: interpolated Kneser-Ney, in ARPA format.

Usage: make_lms.py TEXT OUT_DIR
e.g.:  python local/kaldi/make_lms.py lines-of-words.txt exp/kaldi/data/local/lm

Writes lm_fglarge.arpa.gz (4-grams), lm_tglarge (3-grams), and lm_tgmed and lm_tgsmall (3-grams without the rarer ones).
The vocabulary is that of the text, so the models are for small closed tasks.

References
----------
S. F. Chen, J. Goodman, An empirical study of smoothing techniques for language modeling, 1998: (20)-(24), with one
discount per order, n1 / (n1 + 2 n2).
"""

import argparse
import gzip
import math
import sys
from collections import Counter, defaultdict
from collections.abc import Mapping
from pathlib import Path

from roomeq.core.files import read_text

START, END = "<s>", "</s>"
MODELS = {"fglarge": (4, 1, 1), "tglarge": (3, 1, 1), "tgmed": (3, 1, 2), "tgsmall": (3, 3, 10)}
"""Order, and the smallest counts of the bigrams and the longer n-grams that are listed."""

Ngram = tuple[str, ...]


def ngram_counts(sentences: list[list[str]], order: int) -> list[Counter[Ngram]]:
    """Return the counts of all n-grams, one Counter for each n from 1 to `order`."""
    counts: list[Counter[Ngram]] = [Counter() for _ in range(order)]
    for words in sentences:
        line = (START, *words, END)
        for n in range(order):
            counts[n].update(zip(*(line[k:] for k in range(n + 1)), strict=False))
    del counts[0][START,]
    return counts


def continuations(counts: list[Counter[Ngram]]) -> list[Counter[Ngram]]:
    """Return Kneser-Ney's counts: below the highest order, the number of different words before an n-gram.

    N-grams at the start of a sentence keep their count.
    """
    lower = [Counter(ngram[1:] for ngram in longer) for longer in counts[1:]]
    for followed, seen in zip(lower, counts, strict=False):
        followed.update({ngram: count for ngram, count in seen.items() if ngram[0] == START})
    return [*lower, counts[-1]]


def probabilities(counts: list[Counter[Ngram]]) -> list[dict[Ngram, float]]:
    """Return the probability of each n-gram's last word given the others, one dict for each n.

    The discount of the lowest order is shared among all words of the vocabulary.
    """
    shorter: dict[Ngram, float] = defaultdict(lambda: 1 / len(counts[0]))
    by_order = []
    for counted in continuations(counts):
        by_count = Counter(counted.values())
        discount = by_count[1] / (by_count[1] + 2 * by_count[2]) if by_count[1] else 0.5
        total: Counter[Ngram] = Counter()
        kinds: Counter[Ngram] = Counter()
        for ngram, count in counted.items():
            total[ngram[:-1]] += count
            kinds[ngram[:-1]] += 1
        shorter = {ngram: (count - discount + discount * kinds[ngram[:-1]] * shorter[ngram[1:]]) / total[ngram[:-1]]
                   for ngram, count in counted.items()}
        by_order.append(shorter)
    return by_order


def backoffs(listed: list[dict[Ngram, float]]) -> list[dict[Ngram, float]]:
    """Return the backoff weight of each history, one dict for each n below the highest.

    The weight of a history after which every word is listed is never used and is set to 1.
    """
    by_order: list[dict[Ngram, float]] = []
    for histories, ngrams, shorter in zip(listed, listed[1:], listed, strict=False):
        here: dict[Ngram, float] = defaultdict(float)
        below: dict[Ngram, float] = defaultdict(float)
        for ngram, probability in ngrams.items():
            here[ngram[:-1]] += probability
            below[ngram[:-1]] += shorter[ngram[1:]]
        weights = {}
        for history in [*histories, *([(START,)] if not by_order else [])]:
            left, left_below = 1 - here[history], 1 - below[history]
            weights[history] = left / left_below if left > 1e-6 and left_below > 1e-6 else 1.0
        by_order.append(weights)
    return by_order


def listed_ngrams(sentences: list[list[str]], order: int, min_bigrams: int,
                  min_longer: int) -> list[dict[Ngram, float]]:
    """Return the n-grams that a model lists, with their probabilities, one dict for each n.

    These are the n-grams with a sufficient count, and the prefixes and suffixes through which they are reached.
    """
    counts = ngram_counts(sentences, order)
    listed: list[dict[Ngram, float]] = []
    needed: set[Ngram] = set()
    for n, by_ngram in reversed(list(enumerate(probabilities(counts)))):
        min_count = (1, min_bigrams, min_longer)[min(n, 2)]
        kept = {ngram: p for ngram, p in by_ngram.items() if counts[n][ngram] >= min_count or ngram in needed}
        needed = {part for ngram in kept for part in (ngram[:-1], ngram[1:])}
        listed.insert(0, kept)
    return listed


def arpa(listed: list[dict[Ngram, float]]) -> str:
    """Return a model in ARPA format."""
    weights = [*backoffs(listed), {}]
    lines = ["\\data\\"]
    sections: list[Mapping[Ngram, float | None]] = [{(START,): None, **listed[0]}, *listed[1:]]
    lines += [f"ngram {n}={len(section)}" for n, section in enumerate(sections, 1)]
    for n, section in enumerate(sections):
        lines += ["", f"\\{n + 1}-grams:"]
        for ngram, probability in sorted(section.items()):
            log10 = -99 if probability is None else math.log10(probability)
            weight = weights[n].get(ngram)
            lines.append(f"{log10:.6f}\t{' '.join(ngram)}" + (f"\t{math.log10(weight):.6f}" if weight else ""))
    return "\n".join([*lines, "", "\\end\\", ""])


def main(argv: list[str] | None = None) -> int:
    """Parse the command line and write the models; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("text", type=Path, metavar="TEXT")
    parser.add_argument("out_dir", type=Path, metavar="OUT_DIR")
    args = parser.parse_args(argv)
    try:
        sentences = [words for line in read_text(args.text).splitlines() if (words := line.split())]
        if len(sentences) < 2:
            raise ValueError(f"{args.text} must hold sentences, one a line, at least two: give a text")
        args.out_dir.mkdir(parents=True, exist_ok=True)
        for name, (order, *min_counts) in MODELS.items():
            text = arpa(listed_ngrams(sentences, order, *min_counts))
            (args.out_dir / f"lm_{name}.arpa.gz").write_bytes(gzip.compress(text.encode(), mtime=0))
    except (ValueError, OSError) as error:
        print(f"make_lms.py: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
