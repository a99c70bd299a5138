#!/usr/bin/env python
"""Tell how often the loop finds the true effect in generated rooms whose effect it is not told of.

For each kind of effect, strength and seed, a set of rooms is generated (`tests/testbed`), the loop is closed on it, and
the result is appended as a line to results.jsonl in the output folder. A later call runs what is missing. Results of
other code (`CODE`) are not counted, unless --any-code asks to print them. Prints which effect was added first, and the
rates with their Wilson intervals; writes the rates to loop.json.

e.g.: python tests/bench/loop/run.py --out tests/bench/loop/results            # all: hours
      python tests/bench/loop/run.py --out exp/bench/loop --seeds 1 --strengths 2 --kinds clean,source_response
      python tests/bench/loop/run.py --out exp/bench/loop --minutes 30         # as many as fit, then the table
      python tests/bench/loop/run.py --out tests/bench/loop/results --any-code # print what is there, run nothing
"""

import argparse
import json
import os
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

for variable in ("OMP", "OPENBLAS", "MKL", "NUMBA"):  # as in path.sh: the loop has processes
    os.environ.setdefault(f"{variable}_NUM_THREADS", "1")
ROOT = Path(__file__).resolve().parents[3]
sys.path[:1] = [str(ROOT / name) for name in ("pysrc", "tests")]

import numpy as np  # noqa: E402

from bench import kit  # noqa: E402
from bench.loop.table import Result, rates, show  # noqa: E402
from roomeq.core.constants import BANDS_HZ  # noqa: E402
from roomeq.core.digests import source_digest  # noqa: E402
from roomeq.loop.close import close_loop  # noqa: E402
from testbed import KINDS, make_room_set  # noqa: E402

OUTSIDE = ("clock_drift", "harmonic_distortion", "ringing_object")
PAIRS = ("source_response+air_absorption", "source_response+room_modes", "mic_response+near_reflector",
         "coupled_volume+source_directivity", "noise_floor+source_response", "sound_speed+mic_response")
CODE = [*(ROOT / "pysrc/roomeq" / part for part in ("acoustics", "core", "effects", "loop", "records", "sim")),
        ROOT / "tests/testbed"]
"""The code that determines the results: they are counted if its bytes are the same."""
CLEAN_SEEDS = 60
FIRST_SEED = 101  # smaller seeds were used while the loop was developed


class RoomSet(NamedTuple):
    """A set of generated rooms; the strength is the requested change of the features [JND]."""

    kind: str
    strength: int
    seed: int


def planned_sets(kinds: list[str] | None, strengths: list[int], seeds: int) -> Iterator[RoomSet]:
    """Yield the sets to run, in an order in which the first results already cover all kinds."""
    single = [kind for kind in KINDS if kind not in OUTSIDE]
    for n in range(max(CLEAN_SEEDS, seeds)):
        of_seed = [("clean", 0)] if n < CLEAN_SEEDS else []
        if n < seeds:
            of_seed += [(kind, strength) for strength in sorted(strengths, key=lambda s: s != 2) for kind in single]
            of_seed += [(kind, 2) for kind in (*OUTSIDE, *PAIRS)]
        for kind, strength in of_seed:
            if not kinds or kind in kinds:
                yield RoomSet(kind, strength, FIRST_SEED + n)


def run_set(rooms: RoomSet, cache: Path, results: list[Result]) -> Result:
    """Generate a set of rooms, close the loop on it, and return the result.

    Where physics limits the effect, two strengths give the same rooms, and the earlier result is returned.
    """
    kind, strength, seed = rooms
    with tempfile.TemporaryDirectory() as directory:
        truth = make_room_set(kind, strength, seed, directory, cache=cache)
        for result in results:
            if (result["kind"], result["seed"], result["achieved_jnd"]) == (kind, seed, truth["achieved_jnd"]):
                return result | dict(strength=strength)
        start, cpu = time.perf_counter(), sum(os.times()[:4])
        ledger = close_loop([Path(directory, "fit")], Path(directory, "loop"), seed=seed,
                            test=[Path(directory, "test")], nj=2)
        seconds, cpu = time.perf_counter() - start, sum(os.times()[:4]) - cpu
    iterations, test = ledger["iterations"], ledger["test"]
    before, after, test_before, test_after = (errors["leave_positions_out"]["error"] for errors in (
        ledger["baseline"], ledger["final"], test["before"], test["after"]))
    return dict(kind=kind, strength=strength, seed=seed, achieved_jnd=truth["achieved_jnd"], rings_hz=_rings_hz(truth),
                added=[entry["effect"] for entry in iterations],
                cannot_tell=[entry.get("cannot_tell", []) for entry in iterations],
                before=before, after=after, test_before=test_before, test_after=test_after,
                unexplained=ledger["unexplained_all"][:3], ranking=(iterations or [ledger])[0]["ranking"][:3],
                seconds=seconds, cpu_seconds=cpu)


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
    parser.add_argument("--seeds", type=int, default=5, help=f"of each effect; clean rooms have {CLEAN_SEEDS}")
    parser.add_argument("--minutes", type=float, default=1e9, help="start no set of rooms after this time")
    parser.add_argument("--any-code", action="store_true",
                        help="print the results of any code with the digests of that code; run nothing")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    file = args.out / "results.jsonl"
    kept = [json.loads(line) for line in file.read_text().splitlines()] if file.is_file() else []
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
    known = {(result["kind"], result["strength"], result["seed"]) for result in results}
    start, cache = time.monotonic(), args.out / "cache"
    for rooms in planned_sets(args.kinds, args.strengths, args.seeds):
        if rooms in known or time.monotonic() - start > 60.0 * args.minutes:
            continue
        results.append(run_set(rooms, cache, results) | dict(code=code))
        with file.open("a") as stream:
            stream.write(json.dumps(kit.plain(results[-1])) + "\n")
        added = ", ".join(results[-1]["added"]) or "none"
        print(f"{rooms.kind} {rooms.strength} JND, seed {rooms.seed}: added {added} ({results[-1]['seconds']:.0f} s)",
              flush=True)
    shutil.rmtree(cache, ignore_errors=True)
    show(results)
    (args.out / "loop.json").write_text(json.dumps(kit.plain([rate._asdict() for rate in rates(results)]), indent=1)
                                        + "\n")


if __name__ == "__main__":
    main()
