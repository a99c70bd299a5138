#!/usr/bin/env python3
"""Stop before far-field speech, a report or recognisers are made of directories that do not belong together.

Usage: check_origin.py [--seed N] [--kinds real,sim,...] [--speech] DATA_DIR EXP_DIR
e.g.:  python local/check_origin.py --seed 1 data exp

Each must have been made of the others as they are now, and with the seed. Several seeds may share the split of the
measured RIRs. RIRs with the effects of the closed loop must have been simulated with the options of those without, and
the far-field speech of all kinds of RIRs made with the same. A directory without a stamp, which somebody has made
himself, is taken as it is.
"""

import argparse
import sys
from functools import cache
from pathlib import Path

from roomeq.core.digests import digest
from roomeq.core.stamps import DONE_FILE, Stamp, read_stamp, was_made

STAGES = {"characterise": 1, "split": 1, "simulate": 2, "fit-eq": 3, "compensate": 4, "close-loop": 5, "augment": 6}
"""The stage of run.sh that calls each step; for RIRs with the effects of the closed loop it is 5."""
OF_MODELS = {"draw_devices"}
"""Options that act only with the effects of the closed loop."""

digest_of = cache(digest)


def directories(data: Path, exp: Path, kinds: list[str], speech: bool) -> list[Path]:
    """Return what stages 1 to 5 made, and with `speech` stage 6."""
    made = [data / "rirs.real", exp / "eq", *([exp / "loop"] if "sim.loop" in kinds else [])]
    for kind in kinds:
        made += [data / f"rirs.{kind}.{x}" for x in ("train", "dev", "test")]
        made += [data / f"{x}.{kind}.rvb" for x in ("train", "dev", "test") if speech]
    return made


def problem(directory: Path, stamp: Stamp, seed: int | None) -> str | None:
    """Return why a directory does not belong to the others, or None."""
    made_with = stamp.options.get("seed", seed)
    if seed not in (None, made_with) and stamp.step != "split":
        return f"was made with seed {made_with}, not {seed}"
    for name, content in stamp.made_of.items():
        path = directory / name
        try:
            if was_made(path) and digest_of(path) != content:
                return f"was made of another {path.name} than the present one"
        except (ValueError, OSError):  # some of it is not there any more; a step that needs it says so
            continue
    return other_options(directory, stamp)


def other_options(directory: Path, stamp: Stamp) -> str | None:
    """Return with which other options a directory was made than the one that it is compared with, or None."""
    name = directory.name
    compared = directory.with_name({"simulate": name.replace(".sim.loop.", ".sim."),
                                    "augment": f"{name.split('.')[0]}.real.rvb"}.get(stamp.step, name))
    base = read_stamp(compared)
    if not base or base.step != stamp.step:
        return None
    differing = [f"{name} {stamp.options.get(name)}, not {base.options.get(name)}"
                 for name in sorted((stamp.options.keys() | base.options.keys()) - OF_MODELS)
                 if stamp.options.get(name) != base.options.get(name)]
    return f"was made with other options than {compared.name} ({'; '.join(differing)})" if differing else None


def check(made: list[Path], seed: int | None) -> None:
    """Raise a `ValueError` where directories do not belong together; it names the first stage to run again."""
    problems = []
    digest_of.cache_clear()  # it holds for one look at the directories
    for directory in made:
        stamp = read_stamp(directory)
        if stamp and (found := problem(directory, stamp, seed)):
            stage = 5 if ".loop." in directory.name else STAGES.get(stamp.step, 1)
            problems.append((stage, f"{directory}: {found}: start with --stage {stage}, or remove "
                                    f"{directory / DONE_FILE} to use it as it is"))
    if problems:
        raise ValueError(min(problems, key=lambda found: found[0])[1])


def main(argv: list[str] | None = None) -> int:
    """Parse the command line and check; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, help="seed of simulation, EQs and closed loop; default: any")
    parser.add_argument("--kinds", default="real,sim,sim.EQ,sim.loop", help="kinds of RIRs, with commas between")
    parser.add_argument("--speech", action="store_true", help="also check far-field speech")
    parser.add_argument("data", type=Path, metavar="DATA_DIR")
    parser.add_argument("exp", type=Path, metavar="EXP_DIR")
    args = parser.parse_args(argv)
    try:
        check(directories(args.data, args.exp, args.kinds.split(","), args.speech), args.seed)
    except (ValueError, OSError) as error:
        print(f"check_origin.py: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
