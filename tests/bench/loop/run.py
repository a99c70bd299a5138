#!/usr/bin/env python
"""Tell how often the loop finds the true effect in generated rooms whose effect it is not told of.

For each kind of effect, strength and seed, a set of rooms is generated (`tests/testbed`), the loop is closed on it, and
the result is appended as a line to results.jsonl in the output folder. A later call runs what is missing. Results of
other code (`CODE`) are not counted, unless --any-code asks to print them. Prints which effect was added first, and the
rates with their Wilson intervals, for each base (the simulator of the rooms, --base) by itself; writes the rates to
loop.json. Results do not depend on --jobs, except for the wall time.

e.g.: python tests/bench/loop/run.py --out tests/bench/loop/results            # all: hours
      python tests/bench/loop/run.py --out exp/bench/loop --seeds 1 --strengths 2 --kinds clean,source_response
      python tests/bench/loop/run.py --out exp/bench/loop --minutes 30         # as many as fit, then the table
      python tests/bench/loop/run.py --out tests/bench/loop/results --jobs 2   # two sets at once, in one process each
      python tests/bench/loop/run.py --out exp/bench/loop --base pyroomacoustics --clean 20
      python tests/bench/loop/run.py --out exp/bench/loop --hide-facings --kinds clean,source_directivity
      python tests/bench/loop/run.py --out tests/bench/loop/results --any-code # print what is there, run nothing
"""

import argparse
import json
import multiprocessing
import os
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from pathlib import Path
from typing import NamedTuple

for variable in ("OMP", "OPENBLAS", "MKL", "NUMBA"):  # as in path.sh: the loop has processes
    os.environ.setdefault(f"{variable}_NUM_THREADS", "1")
ROOT = Path(__file__).resolve().parents[3]
sys.path[:1] = [str(ROOT / name) for name in ("pysrc", "tests")]

import numpy as np  # noqa: E402

from bench import kit  # noqa: E402
from bench.loop.table import Result, by_base, rates, show  # noqa: E402
from roomeq.core.constants import BANDS_HZ  # noqa: E402
from roomeq.core.digests import source_digest  # noqa: E402
from roomeq.core.workers import end_with  # noqa: E402
from roomeq.loop.ledger import added_effects  # noqa: E402
from roomeq.loop.step import close_loop  # noqa: E402
from roomeq.records.rir_dir import read_rirs, write_rirs  # noqa: E402
from testbed import BASES, KINDS, make_room_set  # noqa: E402
from testbed.bases import base_named  # noqa: E402

OUTSIDE = ("clock_drift", "harmonic_distortion", "ringing_object")
PAIRS = ("source_response+air_absorption", "source_response+room_modes", "mic_response+near_reflector",
         "coupled_volume+source_directivity", "noise_floor+source_response", "sound_speed+mic_response")
CODE = [*(ROOT / "pysrc/roomeq" / part for part in ("acoustics", "core", "effects", "loop", "records", "sim")),
        ROOT / "tests/testbed"]
"""The code that determines the results: they are counted if its bytes are the same."""
CLEAN_SEEDS = 60
FIRST_SEED = 101  # smaller seeds were used while the loop was developed


class RoomSet(NamedTuple):
    """A set of generated rooms; the strength is the requested change of the features [JND].

    Its rows state where the loudspeakers face, or they do not.
    """

    base: str
    kind: str
    strength: int
    seed: int
    facings_stated: bool = True


def planned_sets(base: str, kinds: list[str] | None, strengths: list[int], seeds: int, clean: int,
                 facings_stated: bool = True) -> Iterator[RoomSet]:
    """Yield the sets to run, in an order in which the first results already cover all kinds."""
    single = [kind for kind in KINDS if kind not in OUTSIDE]
    for n in range(max(clean, seeds)):
        of_seed = [("clean", 0)] if n < clean else []
        if n < seeds:
            of_seed += [(kind, strength) for strength in sorted(strengths, key=lambda s: s != 2) for kind in single]
            of_seed += [(kind, 2) for kind in (*OUTSIDE, *PAIRS)]
        for kind, strength in of_seed:
            if not kinds or kind in kinds:
                yield RoomSet(base, kind, strength, FIRST_SEED + n, facings_stated)


def run_set(rooms: RoomSet, cache: Path, earlier: list[Result], nj: int) -> Result:
    """Generate a set of rooms, close the loop on it, and return the result.

    Where physics limits the effect, two strengths give the same rooms, and the earlier result of the same base, kind
    and seed is returned.
    """
    base, kind, strength, seed, facings_stated = rooms
    with tempfile.TemporaryDirectory() as directory:
        truth = make_room_set(kind, strength, seed, directory, cache=cache, base=base)
        for result in earlier:
            if result["achieved_jnd"] == truth["achieved_jnd"]:
                return result | dict(strength=strength)
        if not facings_stated:
            for part in ("fit", "test"):
                write_rirs(Path(directory, part), [{**row, "source_dir": None}
                                                   for row in read_rirs(Path(directory, part))])
        start, cpu = time.perf_counter(), sum(os.times()[:4])
        ledger = close_loop([Path(directory, "fit")], Path(directory, "loop"), seed=seed,
                            test=[Path(directory, "test")], nj=nj)
        seconds, cpu = time.perf_counter() - start, sum(os.times()[:4]) - cpu
    iterations, test = added_effects(ledger), ledger["test"]
    before, after, test_before, test_after = (errors["leave_positions_out"]["error"] for errors in (
        ledger["baseline"], ledger["final"], test["before"], test["after"]))
    return dict(base=base, kind=kind, strength=strength, seed=seed, facings_stated=facings_stated,
                facings=ledger["facings"], achieved_jnd=truth["achieved_jnd"],
                rings_hz=_rings_hz(truth), added=[entry["effect"] for entry in iterations],
                cannot_tell=[entry.get("cannot_tell", []) for entry in iterations],
                p=[entry["p"] for entry in iterations],
                detectable_jnd={entry["effect"]: entry["detectable_jnd"] for entry in ledger["ranking"]
                                if entry["effect"] in kind.split("+")},
                before=before, after=after, test_before=test_before, test_after=test_after,
                unexplained=ledger["unexplained_all"][:3], ranking=(iterations or [ledger])[0]["ranking"][:3],
                seconds=seconds, cpu_seconds=cpu, nj=nj)


def key(result: Result) -> RoomSet:
    """Return the set that a result is of."""
    return RoomSet(*(result[name] for name in RoomSet._fields[:-1]), result.get("facings_stated", True))


def run_sets(missing: Iterator[RoomSet], cache: Path, results: list[Result], jobs: int) -> Iterator[Result]:
    """Yield the result of each set as it ends: `jobs` sets at once, each in a process of its own.

    One set at a time has two jobs of the loop, more sets one each.
    """
    nj = 2 if jobs == 1 else 1
    with ThreadPoolExecutor(jobs) as pool:
        running: set[Future[Result]] = set()
        while True:
            while len(running) < jobs and (rooms := next(missing, None)):
                earlier = [result for result in results if key(result)._replace(strength=rooms.strength) == rooms]
                running.add(pool.submit(in_own_process, run_set, rooms, cache, earlier, nj))
            if not running:
                return
            ended, running = wait(running, return_when=FIRST_COMPLETED)
            yield from (future.result() for future in ended)


def in_own_process(function: Callable[..., Result], *arguments: object) -> Result:
    """Run a function in a process that ends with it, or with this one: no memory is kept from set to set."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), initializer=end_with,
                             initargs=(os.getpid(),)) as process:
        return process.submit(function, *arguments).result()


def _rings_hz(truth: dict) -> list[float]:
    """Return the octaves in which objects in the rooms ring."""
    objects = truth["effects"].get("ringing_object", dict(parameters={}))["parameters"].values()
    return sorted({min(BANDS_HZ, key=lambda band_hz: abs(np.log(band_hz / ringing["frequency_hz"])))
                   for ringing in objects})


def main() -> None:
    """Run the sets that are missing, then print the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder of the results; results there are kept")
    parser.add_argument("--kinds", type=lambda text: text.split(","), help="only these kinds, such as clean,occlusion")
    parser.add_argument("--strengths", type=lambda text: [int(number) for number in text.split(",")],
                        default=[1, 2, 4])
    parser.add_argument("--seeds", type=int, default=5, help="of each effect")
    parser.add_argument("--clean", type=int, default=CLEAN_SEEDS, help="sets of rooms without an effect")
    parser.add_argument("--hide-facings", action="store_true", help="rows do not state where the loudspeakers face")
    parser.add_argument("--base", choices=BASES, default=BASES[0], help="simulator of all but the effect")
    parser.add_argument("--jobs", type=int, default=1, help="sets at once")
    parser.add_argument("--minutes", type=float, default=1e9, help="start no set of rooms after this time")
    parser.add_argument("--any-code", action="store_true",
                        help="print the results of any code with the digests of that code; run nothing")
    args = parser.parse_args()
    try:
        base_named(args.base)
    except ValueError as error:
        raise SystemExit(f"run.py: {error}") from None
    args.out.mkdir(parents=True, exist_ok=True)
    file = args.out / "results.jsonl"
    kept = [dict(base=BASES[0]) | json.loads(line) for line in file.read_text().splitlines()] if file.is_file() else []
    code = source_digest(*CODE)[:12]
    if args.any_code:
        for digest, count in Counter(result.get("code", "unknown") for result in kept).items():
            print(f"{file}: {count} results of code {digest}" + (", this code" if digest == code else
                                                                 f"; this code is {code}"))
        show(kept)
        return
    results = [result for result in kept if result.get("code") == code]
    if len(results) < len(kept):
        print(f"{file}: {len(kept) - len(results)} of {len(kept)} results are of other code and are not counted "
              "(--any-code prints them)")
    known = {key(result) for result in results}
    start, cache = time.monotonic(), args.out / "cache"
    missing = (rooms for rooms in planned_sets(args.base, args.kinds, args.strengths, args.seeds, args.clean,
                                               not args.hide_facings)
               if rooms not in known and time.monotonic() - start < 60.0 * args.minutes)
    for result in run_sets(missing, cache, results, args.jobs):
        results.append(result | dict(code=code))
        with file.open("a") as stream:
            stream.write(json.dumps(kit.plain(results[-1])) + "\n")
        added = ", ".join(result["added"]) or "none"
        print(f"{result['base']}, {result['kind']} {result['strength']} JND, seed {result['seed']}: added {added} "
              f"({result['seconds']:.0f} s)", flush=True)
    shutil.rmtree(cache, ignore_errors=True)
    show(results)
    found = {base: [rate._asdict() for rate in rates(these)] for base, these in by_base(results).items()}
    (args.out / "loop.json").write_text(json.dumps(kit.plain(found), indent=1) + "\n")


if __name__ == "__main__":
    main()
