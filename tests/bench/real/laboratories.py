#!/usr/bin/env python3
"""Close the loop on real rooms, and judge it by laboratories that took no part in it.

Usage: tests/bench/real/laboratories.py [--out DIR] [--data DIR] [--rirs-per-room N] [--only LABORATORY,...]
                                        [--hide-facings]
e.g.:  tests/bench/real/laboratories.py --out exp/bench
       tests/bench/real/laboratories.py --only c4dm --rirs-per-room 12
       tests/bench/real/laboratories.py --only all --hide-facings --out exp/hidden

All measured RIRs in the folders of DIR (default ../shared/data) whose geometry the loop can use take part; a room that
two folders hold is taken from the first. Each laboratory with a room of two RIRs or more is left out once: the loop is
closed on the others, and the laboratory is scored with the base model and with the final model. "all" closes the loop
on all of them. A laboratory whose result the output folder holds is not run again. With --hide-facings, no row states
where a loudspeaker faces, and "all" tells how the estimated angles to the microphones compare with the documented ones.
"""

import argparse
import json
import logging
import os
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path

for variable in ("OMP", "OPENBLAS", "MKL", "NUMBA"):  # as in path.sh: the loop has processes
    os.environ.setdefault(f"{variable}_NUM_THREADS", "1")
PROJECT = Path(__file__).resolve().parents[3]
sys.path[:0] = [str(PROJECT / name) for name in ("pysrc", "tests")]

import numpy as np  # noqa: E402

from bench import kit  # noqa: E402
from bench.memory import PeakMemory  # noqa: E402
from roomeq.core.digests import source_digest  # noqa: E402
from roomeq.core.files import write_json  # noqa: E402
from roomeq.corpora.measured import read_measured  # noqa: E402
from roomeq.loop.descriptions import effect_names  # noqa: E402
from roomeq.loop.ledger import added_effects  # noqa: E402
from roomeq.loop.step import close_loop  # noqa: E402
from roomeq.loop.usable import usable_rirs  # noqa: E402
from roomeq.records.geometry import is_known  # noqa: E402
from roomeq.records.rir_dir import read_rirs, write_rirs  # noqa: E402

SPLITS = {"leave_positions_out": ("unseen positions", 2.3), "leave_room_out": ("unseen rooms", 3.0)}
"""Label of each split, and the error to reach in laboratories that took no part [JND]."""
MIN_EXPLAINED = 0.7
BOX_IS_WRONG = ("bras_cr2",)
"""Folders whose rooms are no shoeboxes, though a box around them is given."""


def read_laboratories(folders, work, rirs_per_room):
    """Write an RIR directory for each laboratory below `work`; return them by name.

    A laboratory is what stands ahead of the first underscore of its rooms' names. Two folders hold rooms of BUT
    ReverbDB, one of them with the corpus ahead of their names.
    """
    rooms = {}
    for folder in folders:
        measured = read_measured(folder / "manifest.csv", work / "measured" / folder.name, skip_bad=True)
        by_room = defaultdict(list)
        for directory, row in usable_rirs([measured]).rirs:
            by_room[row["room_id"]].append({**row, "wav": str((directory / row["wav"]).resolve())})
        for name, rows in by_room.items():
            rooms.setdefault(name.removeprefix("BUT_"), rows)
    laboratories = defaultdict(list)
    for name, rows in rooms.items():
        chosen = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), rirs_per_room)).round().astype(int))
        laboratories[name.split("_")[0]] += [rows[n] for n in chosen]
    for name, rows in laboratories.items():
        directory = work / "laboratories" / name
        directory.mkdir(parents=True)
        write_rirs(directory, [{**row, "wav": os.path.relpath(row["wav"], directory)} for row in rows])
    return {name: work / "laboratories" / name for name in sorted(laboratories)}


def has_scored_room(directory):
    """Tell whether a laboratory has a room with two RIRs: one calibrates it, the other is scored."""
    count = defaultdict(int)
    for _, row in usable_rirs([directory]).rirs:
        count[row["room_id"]] += 1
    return max(count.values()) > 1


def hide_facings(directories):
    """Take the facings of loudspeakers out of some RIR directories; return the rows that stated one."""
    stated = []
    for directory in directories:
        rows = read_rirs(directory)
        write_rirs(directory, [{**row, "source_dir": None} for row in rows])
        stated += [row for row in rows if all(is_known(row.get(key))
                                              for key in ("source_dir", "source_pos_m", "mic_pos_m"))]
    return stated


def compared_facings(stated, model):
    """Compare documented facings with those of a model: RIRs, mean angles to the microphone and error, by source.

    A source that the model does not name faces the microphone.
    """
    angles_deg = defaultdict(list)
    for row in stated:
        towards = np.subtract(row["mic_pos_m"], row["source_pos_m"]).astype(float)
        facings = np.array([row["source_dir"], model["facings"].get(row["id"], towards)])
        cosines = facings @ towards / np.linalg.norm(facings, axis=1) / np.linalg.norm(towards)
        angles_deg[row["source_id"]].append(np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0))))
    return [[source, len(angles), *np.mean(angles, axis=0), np.abs(np.diff(angles)).mean()]
            for source, angles in sorted(angles_deg.items())]


def run(name, laboratories, work, nj, stated):
    """Close the loop on all laboratories but one, or on "all"; return what the ledger says of it."""
    test = [laboratories[name]] if name in laboratories else []
    start, cpu = time.perf_counter(), sum(os.times()[:4])
    with PeakMemory() as memory:
        ledger = close_loop([path for path in laboratories.values() if path not in test], work / "loop" / name,
                            test=test, nj=nj)
    facings = compared_facings(stated, json.loads((work / "loop" / name / "model.json").read_text()))
    scored = ledger["test"] if test else dict(ledger, before=ledger["baseline"], after=ledger["final"])
    return dict(laboratory=name, rirs=scored["rirs"], rooms=scored["scored_rooms"],
                added=[effect_names(entry) for entry in added_effects(ledger)],
                facings=scored["facings"], hidden_facings=facings, unexplained=ledger["unexplained_all"][:5],
                **{key: scored[key] for key in ("before", "after", "ceiling", "explained")},
                seconds=time.perf_counter() - start, cpu_seconds=sum(os.times()[:4]) - cpu,
                gib=memory.gib)


def section(results, rirs_per_room):
    """Return the table of all laboratories, and its checks."""
    table = kit.Section("laboratories", "Laboratories that took no part in the loop", columns=[
        "laboratory", "RIRs", "rooms", "split", "before [JND]", "after [JND]", "ceiling [JND]", "explained",
        "effects that were added", "minutes"], notes=[f"At most {rirs_per_room} RIRs of a room."])
    for result in results:
        for split, (label, _) in SPLITS.items():
            table.rows.append([result["laboratory"], result["rirs"], result["rooms"], label,
                               *(result[key][split]["error"] for key in ("before", "after", "ceiling")),
                               result["explained"][split]["share"], ", ".join(result["added"]) or "none",
                               result["seconds"] / 60.0])
    unseen = [result for result in results if result["laboratory"] != "all"]
    for split, (label, goal) in SPLITS.items():
        if unseen:
            error, share = (np.average(values, weights=[result["rooms"] for result in unseen]) for values in (
                [result["after"][split]["error"] for result in unseen],
                [result["explained"][split]["share"] or 0.0 for result in unseen]))
            table.checks += [kit.Check(f"error after, {label}, mean over rooms", float(error), high=goal, unit="JND"),
                             kit.Check(f"explained, {label}, mean over rooms", float(share), low=MIN_EXPLAINED)]
    for result in results:
        if result["laboratory"] == "all":
            minutes = result["seconds"] / 60.0
            table.checks += [kit.Check(f"205 RIRs, scaled from {result['rirs']}", minutes * 205 / result["rirs"],
                                       high=3.0, unit="minutes"),
                             kit.Check("memory", result["gib"], high=1.5, unit="GiB")]
    table.seconds, table.cpu_seconds = (sum(result[key] for result in results) for key in ("seconds", "cpu_seconds"))
    return table


def facing_section(rows):
    """Return the table of facings that were hidden from the loop on all laboratories."""
    return kit.Section("facings", "Facings that were hidden from the loop", rows=rows, columns=[
        "loudspeaker", "RIRs", "documented angle to the microphone [deg]", "estimated [deg]", "mean error [deg]"])


def main():
    """Run the laboratories that are missing, print the table, and write laboratories.json."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("exp/bench"), help="where results go (default exp/bench)")
    parser.add_argument("--data", type=Path, default=PROJECT.parent / "shared" / "data")
    parser.add_argument("--rirs-per-room", type=int, default=34, help="more are thinned out evenly")
    parser.add_argument("--only", type=lambda text: text.split(","), help="laboratories to leave out, or all")
    parser.add_argument("--hide-facings", action="store_true", help="no row states where a loudspeaker faces")
    parser.add_argument("--nj", type=int, default=2)
    args = parser.parse_args()
    folders = [args.data / "measured", *sorted((args.data / "rooms").glob("*"))]
    folders = [folder for folder in folders if (folder / "manifest.csv").is_file()
               and folder.name not in BOX_IS_WRONG]
    if not folders:
        sys.exit(f"{args.data}: holds no folder with a manifest.csv: give the recordings with --data")
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s", datefmt="%H:%M:%S")
    code = (f"{source_digest(PROJECT / 'pysrc/roomeq')[:12]}, {args.rirs_per_room} RIRs of a room"
            + ", facings hidden" * args.hide_facings)
    results = []
    with tempfile.TemporaryDirectory() as work:
        laboratories = read_laboratories(folders, Path(work), args.rirs_per_room)
        known = [name for name, path in laboratories.items() if has_scored_room(path)] + ["all"]
        if unknown := set(args.only or ()) - set(known):
            sys.exit(f"--only {','.join(sorted(unknown))}: laboratories with rooms to score are {', '.join(known)}")
        stated = hide_facings(laboratories.values()) if args.hide_facings else []
        names = args.only or known
        for name in names:
            file = args.out / "laboratories.parts" / f"{name}.json"
            if file.is_file() and json.loads(file.read_text())["code"] == code:
                results.append(json.loads(file.read_text()))
                continue
            results.append(run(name, laboratories, Path(work), args.nj, stated) | dict(code=code))
            write_json(file, kit.plain(results[-1]))
    tables = [section(results, args.rirs_per_room)]
    tables += [facing_section(result["hidden_facings"]) for result in results
               if result["laboratory"] == "all" and result["hidden_facings"]]
    for table in tables:
        table.show()
    write_json(args.out / "laboratories.json", kit.plain(dict(
        bench="laboratories", machine=kit.machine(), results=results,
        sections={table.name: dict(vars(table), checks=[dict(vars(check), held=check.held) for check in table.checks])
                  for table in tables})))


if __name__ == "__main__":
    main()
