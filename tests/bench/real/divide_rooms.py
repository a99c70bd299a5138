#!/usr/bin/env python3
"""Divide real RIRs into laboratories for training and rooms for test, for word error rates in real rooms.

Usage: tests/bench/real/divide_rooms.py [--data DIR] OUT_DIR
e.g.:  tests/bench/real/divide_rooms.py corpora/real_rooms

The RIRs are those in the folders of DIR (default ../shared/data). Writes OUT_DIR/train.csv, dev.csv and test.csv for
--measured, --dev-rirs and --test-rirs of run.sh, and prints the rooms. The division follows from metadata:

- Training: the laboratories that measured several positions in rooms of known size, without a dummy head, since the
  simulation and the loop need these.
- Development: one state of the room of each laboratory that measured in several states.
- Test: every other room. Each counts once: a room that two folders hold has one name, and if both hold the same
  recording, the first is taken. Rooms of one house, which open into each other, and of one university are all in the
  test set, where they count as rooms of their own.
- Left out: FRL's room, which has a single RIR. In a first experiment it was a training room: since rooms are drawn
  equally, a seventh of the training speech had that RIR.

The division was fixed before any recogniser was trained, but for the room that is left out. A first experiment was
scored in the same test rooms. After it, this room was left out, the T60 of simulated RIRs was taken from the paper's
range, and the generated training speech was doubled. The reasons are in the training sets.
"""

import argparse
import csv
import os
import sys
from collections import defaultdict
from fnmatch import fnmatch
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[3]

TRAIN = ("R3VIVAL_*", "c4dm_*", "dechorate_*")
DEV = ("R3VIVAL_lab_absorptive_RB", "dechorate_011100")
LEFT_OUT = ("FRL_*",)
SAME_ROOM = {"room-conferrence01": "gtu_conferrence01", "room-z02": "gtu_z02", "room-z23": "gtu_z23"}
"""Rooms of `gtu_but_six` by their names in `gtu_11rooms_dims_only`."""
SAME_RECORDING = ("Hotel_SkalskyDvur_*", "VUT_FIT_*")
"""Rooms of `gtu_but_six` that `measured` holds with ``BUT_`` ahead of their names."""


def role_of(room: str) -> str:
    """Return the set that a room belongs to."""
    if any(fnmatch(room, pattern) for pattern in LEFT_OUT):
        return "left out"
    if any(fnmatch(room, pattern) for pattern in DEV):
        return "dev"
    return "train" if any(fnmatch(room, pattern) for pattern in TRAIN) else "test"


def read_rows(manifest: Path, out: Path) -> list[dict[str, str]]:
    """Return the rows of a manifest, with paths relative to `out`."""
    with manifest.open(newline="") as file:
        rows = [row for row in csv.DictReader(file)
                if not any(fnmatch(row["room"], pattern) for pattern in SAME_RECORDING)]
    return [row | dict(file=os.path.relpath(manifest.parent / row["file"], out),
                       room=SAME_ROOM.get(row["room"], row["room"])) for row in rows]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, metavar="OUT_DIR")
    parser.add_argument("--data", type=Path, default=PROJECT.parent / "shared" / "data")
    args = parser.parse_args()
    out = args.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    by_role = defaultdict(list)
    manifests = [args.data / "measured" / "manifest.csv", *sorted(args.data.glob("rooms/*/manifest.csv"))]
    if len(manifests) < 2 or not manifests[0].is_file():
        sys.exit(f"{args.data}: has no measured/manifest.csv and rooms/*/manifest.csv: check --data")
    for manifest in manifests:
        for row in read_rows(manifest, out):
            by_role[role_of(row["room"])].append(row)
    for role in ("train", "dev", "test", "left out"):
        rows = by_role[role]
        if role != "left out":
            columns = list(dict.fromkeys(column for row in rows for column in row))
            with (out / f"{role}.csv").open("w", newline="") as file:
                writer = csv.DictWriter(file, columns, restval="?")
                writer.writeheader()
                writer.writerows(rows)
        rooms = defaultdict(int)
        for row in rows:
            rooms[row["room"]] += 1
        print(f"{role}: {len(rows)} RIRs, {len(rooms)} rooms: "
              + ", ".join(f"{room} {count}" for room, count in rooms.items()))


if __name__ == "__main__":
    main()
