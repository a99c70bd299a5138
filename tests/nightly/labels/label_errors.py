#!/usr/bin/env python
"""Mislabel measured RIRs, close the loop on them, and print what came of each labelling error.

For each generated set of rooms (`tests/testbed`) and each error of `testbed.labels`, the outcome is one of

refused    the loop says in one line that it cannot use the RIRs
left out   RIRs are left out because of the error, with their count, and the effects are those without the error, or
           those of the loop on the set without these RIRs
fewer      the same, but an effect is no longer found: there are fewer rooms
same       nothing is said, and the effects are those without the error
unstable   nothing is said, and an effect is no longer named that was named by mistake without the error
WRONG      an effect is named that is not named without the error, or nothing is said and a true one is no longer found

Exits with status 1 if anything is WRONG. Finished cases are kept in the output folder.

e.g.: python tests/nightly/labels/label_errors.py --out exp/labels --seeds 2
"""

import argparse
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

from roomeq.core.files import read_json, write_json  # noqa: E402
from roomeq.loop.ledger import added_effects  # noqa: E402
from roomeq.loop.step import close_loop  # noqa: E402
from roomeq.records.rir_dir import read_rirs, write_rirs  # noqa: E402
from testbed import make_room_set  # noqa: E402
from testbed.labels import ERRORS, make_mislabelled  # noqa: E402

SETS = (("clean", 0), ("source_response", 2))
FIRST_SEED = 101


def findings(directory: Path, seed: int) -> dict:
    """Close the loop on an RIR directory, and return the effects (a line if it refuses) and what it left out."""
    with tempfile.TemporaryDirectory() as out:
        try:
            ledger = close_loop([directory], Path(out, "loop"), seed=seed, nj=1)
        except ValueError as error:
            return dict(refused=str(error).replace(str(directory), directory.name))
    effects = [sorted({entry["effect"], *entry.get("cannot_tell", [])}) for entry in added_effects(ledger)]
    return dict(effects=effects, left_out=[entry for entry in ledger["left_out"]])


def without(directory: Path, ids: set[str], out: Path) -> Path:
    """Write an RIR directory that lacks some of the RIRs of another, and return it."""
    shutil.copytree(directory / "audio", out / "audio")
    write_rirs(out, [row for row in read_rirs(directory) if row["id"] not in ids])
    return out


def outcome_of(found: dict, clean: dict, kind: str) -> str:
    """Return the outcome of a labelling error in a set with an effect of this kind."""
    if "refused" in found:
        return "refused"
    said = found["left_out"] != clean["left_out"]
    if sorted(found["effects"]) == sorted(clean["effects"]):
        return "left out" if said else "same"
    if found["effects"] == found.get("control", {}).get("effects"):
        return "left out"
    if any(names not in clean["effects"] for names in found["effects"]):
        return "WRONG"
    if said:
        return "fewer"
    lost = [names for names in clean["effects"] if names not in found["effects"]]
    return "WRONG" if any(kind in names for names in lost) else "unstable"


def main(arguments: list[str] | None = None) -> int:
    """Run the cases that are missing, print the table, and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder of sets and results; results there are kept")
    parser.add_argument("--seeds", type=int, default=2, help="sets of each kind")
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    parser.add_argument("--errors", type=lambda text: text.split(";"), default=list(ERRORS), help="only these")
    args = parser.parse_args(arguments)
    args.out.mkdir(parents=True, exist_ok=True)
    file = args.out / "results.json"
    results = read_json(file) if file.is_file() else {}
    for seed in range(args.first_seed, args.first_seed + args.seeds):
        for kind, strength in SETS:
            made = args.out / f"{kind}_{strength}_{seed}"
            if not (made / "truth.json").exists():
                make_room_set(kind, strength, seed, made, cache=args.out / "cache")
            for error in ("none", *args.errors):
                name = f"{kind} {seed}: {error}"
                if name not in results:
                    start = time.process_time()
                    with tempfile.TemporaryDirectory() as folder:
                        rirs = made / "fit"
                        if error != "none":
                            rirs = Path(folder, "rirs")
                            wrong_ids = make_mislabelled(error, seed, made / "fit", rirs)
                        found = findings(rirs, seed) | dict(cpu_s=round(time.process_time() - start))
                        clean = results.get(f"{kind} {seed}: none", found)
                        if outcome_of(found, clean, kind) == "WRONG" and found["left_out"]:
                            found["control"] = findings(without(made / "fit", wrong_ids, Path(folder, "control")), seed)
                    results[name] = found
                    write_json(file, results)
                clean = results[f"{kind} {seed}: none"]
                results[name]["outcome"] = outcome_of(results[name], clean, kind)
                print(f"{name}: {results[name]['outcome']}: {results[name]}", flush=True)
    write_json(file, results)
    wrong = [name for name, result in results.items() if result["outcome"] == "WRONG"]
    print(f"{len(wrong)} of {len(results)} WRONG")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
