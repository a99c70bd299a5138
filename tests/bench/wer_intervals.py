#!/usr/bin/env python3
"""Measure how often intervals of word error rates contain the truth when effects of seeds and rooms are known.

Usage: tests/bench/wer_intervals.py [--times 1000] --out DIR
e.g.:  tests/bench/wer_intervals.py --out exp/wer_intervals

A recogniser makes 20 % errors. Seeds, rooms and each room at each seed add random deviations [points], and the errors
are drawn with the resulting rates. Rooms have 200 words, some of them 20 times as many, or a random number from a
skewed distribution. The intervals of `roomeq wer` are compared with the percentiles of the plain bootstrap over rooms
and seeds, and with the bootstrap over utterances of Kaldi's `compute-wer-bootci` (utterances of ten words). Prints a
table and writes wer_intervals.json.
"""

import argparse
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

PROJECT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(PROJECT / "pysrc"))

from roomeq.core.files import write_json  # noqa: E402
from roomeq.core.rng import rng_for  # noqa: E402
from roomeq.wer.statistics import Statistic  # noqa: E402

TRUTH = 20.0  # per cent
WORDS, UTTERANCE = 200, 10  # in a room, in an utterance
LARGE = 20  # times as many words
REPLICATES = 2000


class Scenario(NamedTuple):
    """Standard deviations [points].

    `skewed`: exponential effects of rooms; their sizes vary by 60 %. `large`: number of rooms of `LARGE` size.
    """

    n_seeds: int
    n_rooms: int
    seed: float
    room: float
    residual: float
    skewed: bool = False
    large: int = 0


SCENARIOS = [
    Scenario(1, 2, 0, 4, 0), Scenario(1, 10, 0, 4, 0), Scenario(1, 40, 0, 4, 0), Scenario(2, 40, 1, 4, 2),
    Scenario(2, 40, 2, 0, 0),
    Scenario(2, 27, 0.5, 0.5, 1.4), Scenario(3, 27, 0.5, 0.5, 1.4), Scenario(5, 27, 0.5, 0.5, 1.4),
    Scenario(3, 40, 1, 4, 2), Scenario(3, 40, 2, 0, 0), Scenario(5, 10, 1, 4, 2), Scenario(5, 40, 1, 4, 2),
    Scenario(5, 40, 2, 0, 0), Scenario(5, 40, 0, 0, 0), Scenario(5, 40, 1, 6, 2, skewed=True),
    Scenario(5, 10, 1, 6, 2, skewed=True), Scenario(1, 27, 0, 3, 0, large=5), Scenario(5, 27, 0.3, 3, 1, large=2)]


def draw(scenario: Scenario, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return errors and words of every seed and room."""
    shape = scenario.n_seeds, scenario.n_rooms
    room, words = rng.standard_normal(scenario.n_rooms), np.full(shape, WORDS)
    if scenario.skewed:
        room = rng.exponential(size=scenario.n_rooms) - 1
        words[:] = np.maximum(UTTERANCE, rng.gamma(1 / 0.36, 0.36 * WORDS, size=scenario.n_rooms))
    words[:, :scenario.large] *= LARGE
    rate = (TRUTH + scenario.seed * rng.standard_normal((scenario.n_seeds, 1)) + scenario.room * room
            + scenario.residual * rng.standard_normal(shape))
    return rng.binomial(words, np.clip(rate / 100, 0.0, 1.0)), words


def intervals(errors: np.ndarray, words: np.ndarray, weights: tuple[np.ndarray, np.ndarray]
              ) -> dict[str, tuple[float, float]]:
    """Return the interval of each method; `weights` are those of seeds and rooms in the replicates of the bootstrap."""
    rate = Statistic.of(errors, words)
    deviations = np.einsum("bs,bs->b", weights[0], weights[1] @ rate.z.T)
    bootstrap = rate.value + np.quantile(deviations, (0.025, 0.975))
    share = errors / words  # of a resampling of utterances, the variance is known: within rooms and between rooms
    variance = (words * (share * (1 - share) + UTTERANCE * (share - rate.value / 100) ** 2)).sum()
    half = 196 * np.sqrt(variance) / words.sum()
    return dict(ours=tuple(rate.interval()), bootstrap=tuple(bootstrap),
                utterances=(rate.value - half, rate.value + half))


def resampled(n: int, rng: np.random.Generator) -> np.ndarray:
    """Return the weights of so many seeds or rooms in each replicate."""
    return rng.multinomial(n, [1 / n] * n, size=REPLICATES) / n


def measure(scenario: Scenario, times: int) -> dict:
    """Return the share of intervals that contain the truth, and their mean width [points], by method."""
    rng, held, width = rng_for(0, "bench", "weights"), {}, {}
    weights = resampled(scenario.n_seeds, rng), resampled(scenario.n_rooms, rng)
    for n in range(times):
        errors, words = draw(scenario, rng_for(n, "bench", str(tuple(scenario))))
        for method, (low, high) in intervals(errors, words, weights).items():
            held[method] = held.get(method, 0) + bool(low <= TRUTH <= high)
            width[method] = width.get(method, 0.0) + (high - low)
    return scenario._asdict() | dict(held={method: count / times for method, count in held.items()},
                                     width={method: float(total / times) for method, total in width.items()})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=1000, help="tables drawn of each scenario")
    parser.add_argument("--out", required=True, type=Path)
    args = parser.parse_args()
    results = [measure(scenario, args.times) for scenario in SCENARIOS]
    print("methods: ours, bootstrap over rooms and seeds, bootstrap over utterances")
    print("seeds rooms | seed room residual skewed large | held [%]          | width [points]")
    for result in results:
        print(f"{result['n_seeds']:5d} {result['n_rooms']:5d} | {result['seed']:4g} {result['room']:4g} "
              f"{result['residual']:8g} {'skewed' if result['skewed'] else '':6} "
              f"{result['large'] or '':>5} | "
              + " ".join(f"{100 * value:5.1f}" for value in result["held"].values()) + " | "
              + " ".join(f"{value:6.2f}" for value in result["width"].values()))
    write_json(args.out / "wer_intervals.json", dict(times=args.times, scenarios=results))


if __name__ == "__main__":
    main()
