#!/usr/bin/env python
"""Does the loop find what it was not told of: undeclared worlds, their true effects against those that it names.

Every world is made, closed and forgotten; what came of it is a line of results.jsonl in the output folder. Stopped and
started again, the bench goes on with the worlds that are missing; results of other code (`CODE`) do not count. Prints
the confusion matrix and the rates with their Wilson intervals, and writes loop.json.

e.g.: python tests/bench/loop/run.py --out tests/bench/loop/results            # all: hours; goes on from what is there
      python tests/bench/loop/run.py --out exp/bench/loop --seeds 1 --strengths 2 --kinds clean,source_response
      python tests/bench/loop/run.py --out exp/bench/loop --minutes 30         # as much as fits, then the table
"""

import argparse
import json
import os
import shutil
import sys
import tempfile
import time
from pathlib import Path

for variable in ("OMP", "OPENBLAS", "MKL", "NUMBA"):  # as in path.sh: the loop has processes
    os.environ.setdefault(f"{variable}_NUM_THREADS", "1")
ROOT = Path(__file__).resolve().parents[3]
sys.path[:1] = [str(ROOT / name) for name in ("pysrc", "tests")]

import numpy as np  # noqa: E402

from bench import kit  # noqa: E402
from bench.loop.table import rates, show  # noqa: E402
from roomeq.core.constants import BANDS_HZ  # noqa: E402
from roomeq.core.digests import source_digest  # noqa: E402
from roomeq.loop.close import close_loop  # noqa: E402
from testbed import KINDS, make_world  # noqa: E402

OUTSIDE = ("clock_drift", "harmonic_distortion", "ringing_object")
PAIRS = ("source_response+air_absorption", "source_response+room_modes", "mic_response+near_reflector",
         "coupled_volume+source_directivity", "noise_floor+source_response", "sound_speed+mic_response")
CODE = [*(ROOT / "pysrc/roomeq" / part for part in ("acoustics", "core", "effects", "loop", "records", "sim")),
        ROOT / "tests/testbed"]
"""What makes the results: they count for the same bytes of it."""
CLEAN_SEEDS = 60
FIRST_SEED = 101  # those below were looked at while the loop was made


def worlds(kinds, strengths, seeds):
    """What to make, in an order in which early results already say something: (kind, strength, seed)."""
    single = [kind for kind in KINDS if kind not in OUTSIDE]
    for n in range(max(CLEAN_SEEDS, seeds)):
        seed = FIRST_SEED + n
        some = [("clean", 0)] if n < CLEAN_SEEDS else []
        if n < seeds:
            some += [(kind, strength) for strength in sorted(strengths, key=lambda s: s != 2) for kind in single]
            some += [(kind, 2) for kind in (*OUTSIDE, *PAIRS)]
        for kind, strength in some:
            if not kinds or kind in kinds:
                yield kind, strength, seed


def one_world(kind, strength, seed, cache, done):
    """Make a world, close the loop, and return what came of it.

    Where physics allows no more, it is the same world again: what came of it is known then.
    """
    with tempfile.TemporaryDirectory() as directory:
        truth = make_world(kind, strength, seed, directory, cache=cache)
        for one in done:
            if (one["kind"], one["seed"], one["achieved_jnd"]) == (kind, seed, truth["achieved_jnd"]):
                return one | dict(strength=strength)
        start, cpu = time.perf_counter(), sum(os.times()[:4])
        ledger = close_loop([Path(directory, "fit")], Path(directory, "loop"), seed=seed,
                            test=[Path(directory, "test")], nj=2)
        seconds, cpu = time.perf_counter() - start, sum(os.times()[:4]) - cpu
    return dict(kind=kind, strength=strength, seed=seed, achieved_jnd=truth["achieved_jnd"], rings_hz=_rings_hz(truth),
                found=[one["effect"] for one in ledger["iterations"]],
                cannot_tell=[one.get("cannot_tell", []) for one in ledger["iterations"]],
                before=ledger["baseline"]["positions"]["error"], after=ledger["final"]["positions"]["error"],
                test_before=ledger["test"]["before"]["positions"]["error"],
                test_after=ledger["test"]["after"]["positions"]["error"],
                unexplained=ledger["unexplained_all"][:3], ranking=(ledger["iterations"] or [ledger])[0]["ranking"][:3],
                seconds=seconds, cpu_seconds=cpu)


def _rings_hz(truth):
    """Octaves in which objects of the world ring."""
    objects = truth["effects"].get("ringing_object", dict(parameters={}))["parameters"].values()
    return sorted({min(BANDS_HZ, key=lambda band_hz: abs(np.log(band_hz / one["frequency_hz"]))) for one in objects})


def main():
    """Run what is missing, then show all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder of the results, kept over calls")
    parser.add_argument("--kinds", type=lambda text: text.split(","), help="only these worlds")
    parser.add_argument("--strengths", type=lambda text: [int(one) for one in text.split(",")], default=[1, 2, 4])
    parser.add_argument("--seeds", type=int, default=5, help=f"of each effect; clean worlds have {CLEAN_SEEDS}")
    parser.add_argument("--minutes", type=float, default=1e9, help="begin no world after so many")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    results = args.out / "results.jsonl"
    done = [json.loads(line) for line in results.read_text().splitlines()] if results.is_file() else []
    code = source_digest(*CODE)[:12]
    kept, done = done, [one for one in done if one.get("code") == code]
    if len(done) < len(kept):
        print(f"{results}: {len(kept) - len(done)} of {len(kept)} results are of other code and do not count")
    known = {(one["kind"], one["strength"], one["seed"]) for one in done}
    start, cache = time.monotonic(), args.out / "cache"
    for world in worlds(args.kinds, args.strengths, args.seeds):
        if world in known or time.monotonic() - start > 60.0 * args.minutes:
            continue
        done.append(one_world(*world, cache, done) | dict(code=code))
        with results.open("a") as file:
            file.write(json.dumps(kit.plain(done[-1])) + "\n")
        print(f"{world[0]} {world[1]} JND, seed {world[2]}: found {', '.join(done[-1]['found']) or 'nothing'} "
              f"({done[-1]['seconds']:.0f} s)", flush=True)
    shutil.rmtree(cache, ignore_errors=True)
    show(done)
    (args.out / "loop.json").write_text(json.dumps(kit.plain(rates(done)), indent=1) + "\n")


if __name__ == "__main__":
    main()
