#!/usr/bin/env python3
"""Estimate four language models of a text: interpolated Kneser-Ney, in ARPA format.

Usage: make_lms.py TEXT OUT_DIR
e.g.:  python local/kaldi/make_lms.py lines-of-words.txt exp/kaldi/data/local/lm

Writes lm_fglarge.arpa.gz (4-grams), lm_tglarge (3-grams), and lm_tgmed and lm_tgsmall, which leave out what was seen
less often. The vocabulary is that of the text: for small closed tasks.

References
----------
S. F. Chen, J. Goodman, An empirical study of smoothing techniques for language modeling, 1998: (20)-(24), one discount
an order, n1 / (n1 + 2 n2).
"""

import argparse
import gzip
import math
import sys
from collections import Counter, defaultdict
from pathlib import Path

from roomeq.core.files import read_text

START, END = "<s>", "</s>"
MODELS = {"fglarge": (4, 1, 1), "tglarge": (3, 1, 1), "tgmed": (3, 1, 2), "tgsmall": (3, 3, 10)}
"""Order; how often a bigram, and a longer n-gram, must have been seen to be listed."""


def ngram_counts(sentences, order):
    """Return how often each n-gram occurs, a Counter for each n of 1 to `order`."""
    counts = [Counter() for _ in range(order)]
    for words in sentences:
        line = (START, *words, END)
        for n in range(order):
            counts[n].update(zip(*(line[k:] for k in range(n + 1)), strict=False))
    del counts[0][START,]
    return counts


def continuations(counts):
    """Return Kneser-Ney's counts: below the highest order, how many words an n-gram follows.

    What starts a sentence follows none and keeps its count.
    """
    found = [Counter(ngram[1:] for ngram in longer) for longer in counts[1:]]
    for kept, seen in zip(found, counts, strict=False):
        kept.update({ngram: count for ngram, count in seen.items() if ngram[0] == START})
    return [*found, counts[-1]]


def probabilities(counts):
    """Return the probability of each n-gram's last word after the others, a dict for each n.

    Every word of the vocabulary is also given a share of the lowest order's discount.
    """
    shorter = defaultdict(lambda: 1 / len(counts[0]))
    found = []
    for counted in continuations(counts):
        by_count = Counter(counted.values())
        discount = by_count[1] / (by_count[1] + 2 * by_count[2]) if by_count[1] else 0.5
        total, kinds = Counter(), Counter()
        for ngram, count in counted.items():
            total[ngram[:-1]] += count
            kinds[ngram[:-1]] += 1
        found.append({ngram: (count - discount + discount * kinds[ngram[:-1]] * shorter[ngram[1:]]) / total[ngram[:-1]]
                      for ngram, count in counted.items()})
        shorter = found[-1]
    return found


def backoffs(listed):
    """Return the weight of what is not listed after each history, a dict for each n below the highest.

    A history after which every word is listed has nothing to give away: its weight is 1, and is never used.
    """
    found = []
    for histories, ngrams, shorter in zip(listed, listed[1:], listed, strict=False):
        here, below = Counter(), Counter()
        for ngram, probability in ngrams.items():
            here[ngram[:-1]] += probability
            below[ngram[:-1]] += shorter[ngram[1:]]
        weights = {}
        for history in [*histories, *([(START,)] if len(found) == 0 else [])]:
            left, left_below = 1 - here[history], 1 - below[history]
            weights[history] = left / left_below if left > 1e-6 and left_below > 1e-6 else 1.0
        found.append(weights)
    return found


def listed_ngrams(sentences, order, min_bigrams, min_longer):
    """Return the n-grams that a model lists, with their probabilities, a dict for each n.

    Those are the ones seen often enough, and their beginnings and ends, without which none can be reached.
    """
    counts = ngram_counts(sentences, order)
    listed, needed = [], set()
    for n, found in reversed(list(enumerate(probabilities(counts)))):
        least = (1, min_bigrams, min_longer)[min(n, 2)]
        kept = {ngram: p for ngram, p in found.items() if counts[n][ngram] >= least or ngram in needed}
        needed = {part for ngram in kept for part in (ngram[:-1], ngram[1:])}
        listed.insert(0, kept)
    return listed


def arpa(listed):
    """Return a model in ARPA format."""
    weights = [*backoffs(listed), {}]
    lines = ["\\data\\"]
    sections = [{(START,): None} | listed[0], *listed[1:]]
    lines += [f"ngram {n}={len(section)}" for n, section in enumerate(sections, 1)]
    for n, section in enumerate(sections):
        lines += ["", f"\\{n + 1}-grams:"]
        for ngram, probability in sorted(section.items()):
            log10 = -99 if probability is None else math.log10(probability)
            weight = weights[n].get(ngram)
            lines.append(f"{log10:.6f}\t{' '.join(ngram)}" + (f"\t{math.log10(weight):.6f}" if weight else ""))
    return "\n".join([*lines, "", "\\end\\", ""])


def main(argv=None):
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
        for name, (order, *least) in MODELS.items():
            text = arpa(listed_ngrams(sentences, order, *least))
            (args.out_dir / f"lm_{name}.arpa.gz").write_bytes(gzip.compress(text.encode(), mtime=0))
    except (ValueError, OSError) as error:
        print(f"make_lms.py: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
