#!/usr/bin/env python3
"""Turn what a bench wrote into a file of docs/results, from which the manual makes a page.

Usage: tests/bench/publish.py [--commit HASH] [--date YYYY-MM-DD] PAGE FILE
e.g.:  tests/bench/publish.py simulator exp/bench/fidelity.json
       tests/bench/publish.py loop tests/bench/loop/results/results.jsonl
PAGE is one of simulator, measured_room, drawn_rooms, many_rooms, speed, waiting, compensation, loop, loop_scale,
laboratories, effects, augmentation, wer, wer_real_rooms, wer_digits, wer_by_reverberation, faults, labels; of the word
error rates, FILE is the directory that `tests/bench/wer.sh` or `tests/bench/wer_by_reverberation.sh` made, and the
errors of each seed are written to docs/results/counts/PAGE. The commit is that of the working tree, unless the results
are of an earlier one.
"""

import argparse
import datetime
import json
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

PROJECT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(PROJECT / name) for name in ("pysrc", "tests")]

from bench import kit  # noqa: E402
from bench.loop.table import KIND_COLUMNS, OWN_BASE, by_base, by_kind, rates  # noqa: E402
from roomeq.core.files import write_text  # noqa: E402
from roomeq.wer.check import WER_FILE, read_wer  # noqa: E402
from roomeq.wer.counts import COUNTS_FILE  # noqa: E402
from roomeq.wer.table import (  # noqa: E402
    EQ_NOTE,
    ROOM_ACOUSTICS,
    brackets,
    caption,
    gains_caption,
    p_text,
    room_cells,
    strata_notes,
    stratum_label,
)
from roomeq.wer.workspace import BASE  # noqa: E402

Table = dict[str, Any]


def sections(result: dict[str, Any]) -> list[Table]:
    """Return the tables and the checks of a bench that `kit.run_sections` wrote."""
    tables: list[Table] = []
    checks = []
    for section in result["sections"].values():
        if section["rows"]:
            tables.append(dict(title=section["title"], columns=section["columns"], rows=section["rows"],
                               notes=section["notes"]))
        for check in section["checks"]:
            low, high = check["low"], check["high"]
            limits = [f"≥ {low:g}" if low is not None else "", f"≤ {high:g}" if high is not None else ""]
            checks.append([check["what"], check["value"], check["unit"], " and ".join(filter(None, limits)) or None,
                           check["held"]])
    return [dict(title="Checks", columns=["quantity", "value", "unit", "limit", "held"], rows=checks), *tables]


def loop(rows: list[dict[str, Any]]) -> list[Table]:
    """Return the rates of the loop over its generated rooms, with Wilson intervals, and what it added.

    Rooms of each simulator have tables of their own.
    """
    tables = []
    for base, these in by_base(rows).items():
        where = "" if base == OWN_BASE else f", rooms simulated by {base}"
        tables += [dict(title=f"Rates{where}", columns=["rate", "sets of rooms", "95 % interval", "goal"],
                        rows=[[rate.name, f"{rate.hits} of {rate.count}",
                               f"{max(0.0, 100 * rate.low):.0f} to {100 * rate.high:.0f} %", rate.goal]
                              for rate in rates(these)]),
                   dict(title=f"What was added{where}", columns=list(KIND_COLUMNS), rows=by_kind(these),
                        notes=["JND: change of the features that was requested; error: of held-out positions [JND]; "
                               "s: wall time. Where physics limits an effect, several strengths are the same rooms."])]
    return tables


def loop_scale(result: dict[str, Any]) -> list[Table]:
    """Return time and memory of the loop over the number of RIRs."""
    rows = [[*row[:4], row[3] / row[0], *row[4:]] for row in sorted(result["rows"])]
    return [dict(title=f"Close the loop with {result['nj']} processes",
                 columns=["RIRs", "rooms", "s", "CPU s", "CPU s an RIR", "peak GiB", "added"], rows=rows)]


def augmentation(result: dict[str, Any]) -> list[Table]:
    """Return rates and differences of the augmentation bench."""
    return [dict(title="Rate on one core, times real time", columns=["tool", "median", "best"],
                 rows=[[name, rate["median"], rate["best"]] for name, rate in result["times_real_time"].items()]),
            dict(title="Difference of the audio [dB]", columns=["pair", "utterances", "median", "worst"],
                 rows=[[name, *(difference[key] for key in ("utterances", "median", "worst"))]
                       for name, difference in result["difference_db"].items()]),
            dict(title="Peak memory [MiB]", columns=["run", "MiB"],
                 rows=[list(item) for item in result["peak_memory_mib"].items()])]


def effects(result: dict[str, Any]) -> list[Table]:
    """Return how far the predicted change of each effect is from the rendered change, by metric."""
    deviations = result["deviations"]
    metrics = list(dict.fromkeys(metric for by_metric in deviations.values() for metric in by_metric))
    rows = [[effect, *(f"{by_metric[metric]['median']:.2f} / {by_metric[metric]['worst']:.1f}"
                       if metric in by_metric else None for metric in metrics)]
            for effect, by_metric in deviations.items()]
    return [dict(title="Deviation of the predicted from the rendered change [JND]", columns=["effect", *metrics],
                 rows=rows, notes=["Largest median over RIRs of a band / worst single deviation."])]


def word_errors(results: dict[str, dict[str, Any]]) -> list[Table]:
    """Return what `tests/bench/wer.sh` measured, with and without normalised features."""
    tables = []
    for addition, wer in results.items():
        tables += [table | dict(title=f"{table['title']}{addition}") for table in _word_error_tables(wer)]
    return tables


def without_rooms(results: dict[str, dict[str, Any]]) -> list[Table]:
    """Return what `word_errors` returns, without what it tells of single rooms, of which there are hundreds."""
    return [table for table in word_errors(results)
            if not table["title"].startswith("Rooms") and "without the room" not in table["title"]]


def _word_error_tables(wer: dict[str, Any]) -> list[Table]:
    """Return rates, differences between training sets, the rooms, and how gains depend on them."""
    columns, first, results = wer["columns"], wer["columns"][0], wer["results"]

    def rate(system: dict[str, Any]) -> str:
        return f"{system['test']['wer']:.1f}{brackets(system['test']['interval'], 1)}"

    def change(row: str, column: str) -> list[Any]:
        found = results[row][column]["change"]
        relative = None if found["relative"] is None else (
            f"{found['relative']:.1f}{brackets(found['relative_interval'], 1)}")
        mean = found["geometric_mean"]
        return [row, column, f"{found['points']:.2f}{brackets(found['interval'])}", relative,
                found["detectable"] and found["detectable"]["difference"],
                f"{mean['relative']:.1f}{brackets(mean['interval'], 1)}", mean["detectable"]]

    changes = [change(row, column) for row in wer["rows"] for column in columns if "change" in results[row][column]]
    influential = [[row, found["room"], f"{found['points']:.2f}{brackets(found['interval'])}", found["detectable"]]
                   for row in wer["rows"] if (found := results[row][first].get("change", {}).get("influential"))]
    by_seed = [[row, *results[row][first]["test"]["by_seed"]] for row in wer["rows"]]
    rooms = [[room["room"], room["words"], *room_cells(room), *(room["wer"][first][row] for row in wer["rows"])]
             for room in wer["rooms"]]
    strata = [[stratum_label(stratum), stratum["words"], *(stratum["wer"][first][row] for row in wer["rows"])]
              for stratum in wer["strata"]]
    gains = [[*(gain[key] for key in ("row", "what", "rooms", "rho")), p_text(gain["p"])] for gain in wer["gains"]]
    headings = [heading for heading, _ in ROOM_ACOUSTICS.values()]
    return [dict(title="Test error [%], 95 % intervals over rooms and seeds", columns=["trained on", *columns],
                 rows=[[row, *(rate(results[row][column]) for column in columns)] for row in wer["rows"]],
                 notes=caption(wer)),
            dict(title=f"Difference to {BASE}, paired over rooms and seeds", rows=changes,
                 columns=["trained on", "decoding", "points", "relative [%]", "detectable [points]",
                          "geometric mean over rooms [%]", "detectable [%]"],
                 notes=["Relative: of the rates over all rooms. Geometric mean over rooms: of the ratios of a room's "
                        "two rates; a room with many errors counts as much as one with few."]),
            *([dict(title=f"Difference to {BASE} without the room that changes it most, {first}", rows=influential,
                    columns=["trained on", "without", "points", "detectable [points]"],
                    notes=["A room chosen after its result: how much rests on a single room, not a test."])]
              if influential else []),
            dict(title=f"Test error by seed [%], {first}",
                 columns=["trained on", *(f"seed {number}" for number in wer["seeds"])], rows=by_seed),
            dict(title=f"Rooms, test error [%], {first}", columns=["room", "words", *headings, *wer["rows"]],
                 rows=rooms, notes=[EQ_NOTE]),
            dict(title=f"Parts of the test set, test error [%], {first}", columns=["part", "words", *wer["rows"]],
                 rows=strata, notes=strata_notes(wer)),
            *([dict(title="Gains and acoustics", columns=["trained on", "acoustics", "rooms", "rank correlation", "p"],
                    rows=gains, notes=[gains_caption(wer)])] if gains else [])]


def drawn_rooms(result: dict[str, Any]) -> list[Table]:
    """Return the quantiles over measured and over drawn rooms, and the speed."""
    shares = [f"{100 * share:g} %" for share in result["quantiles"]]
    rows = [[quantity["title"], name, quantity[name]["rooms"], *quantity[name]["quantiles"]]
            for quantity in result["quantities"].values() for name in ("measured", "drawn") if name in quantity]
    speed = [[name.replace("_", " "), value] for name, value in result.get("speed", {}).items()]
    return [dict(title="Quantiles over rooms", columns=["quantity", "rooms are", "rooms", *shares], rows=rows),
            dict(title="Speed: one source, one microphone and one noise source per room", columns=["", "value"],
                 rows=speed)]


def many_rooms(result: dict[str, Any]) -> list[Table]:
    """Return rate, processor time and memory of both simulators: `many_rooms.json`."""
    rows = [[who, rooms, rooms / spent["wall_s"], spent["cpu_s"] / rooms, spent["peak_gib"]]
            for who, rooms, spent in (("roomeq", result["rooms"], result["ours"]),
                                      ("pyroomacoustics", result["peer_rooms"], result["peer"]))]
    share = f"{100 * result['within_5_percent']:.1f} %"
    return [dict(title="Shoeboxes: one source, an array of 8 microphones and a target T60; two processes",
                 columns=["simulator", "rooms", "rooms/s", "CPU s a room", "peak GiB"], rows=rows,
                 notes=[f"{result['times_faster']:.1f} times as many rooms a second. Ours write WAV files "
                        "and rows, with image sources to order 6 and 10,000 rays, and meet the target T60 in the mean "
                        f"over the array; at the first microphone T30 is within 5 % of it in {share} of the rooms. "
                        "pyroomacoustics gets the absorption that ours ended with, order 3 and 20,000 rays, which give "
                        "its T20, EDT and C50 the same scatter over seeds."])]


def labels(results: dict[str, Any]) -> list[Table]:
    """Return what came of each labelling error in each set: `results.json` of `label_errors.py`."""
    by_error: dict[str, dict[str, str]] = {}
    for name, result in results.items():
        set_name, error = name.split(": ", 1)
        named = ", ".join("/".join(names) for names in result.get("effects", []))
        by_error.setdefault(error, {})[set_name] = f"{result['outcome']}{f' ({named})' if named else ''}"
    sets = list(dict.fromkeys(name.split(": ", 1)[0] for name in results))
    counts = Counter(result["outcome"] for name, result in results.items() if not name.endswith(": none"))
    return [dict(title="Outcome, and the effects that are named in spite of the error", columns=["error", *sets],
                 rows=[[error, *(of_error.get(one, "") for one in sets)] for error, of_error in by_error.items()],
                 notes=["Sets of 64 RIRs of 8 generated rooms, without and with an undeclared loudspeaker response."]),
            dict(title="Outcomes", columns=["outcome", "errors"], rows=[[name, n] for name, n in counts.items()])]


def faults(result: dict[str, Any]) -> list[Table]:
    """Return which attacks on which step were handled, and what came of generated damage and losses of power."""
    outcomes: dict[str, list[int]] = {}
    for row in result["rows"]:
        if row["kind"].startswith(("damage", "power")):
            counts = outcomes.setdefault(row["kind"], [0, 0, 0])
            refused = row["outcome"] not in ("same bytes", "said in the report")
            counts[int(refused) if row["ok"] else 2] += 1
    seconds = [[name, seconds] for name, seconds in result["cpu_s"].items()]
    return [dict(title="Handled of tried", columns=result["columns"], rows=result["lines"],
                 notes=["Attacks on the recipe as a whole, or on no one step, are in the column of all steps."]),
            dict(title="Generated damage and losses of power",
                 columns=["attack", "same bytes", "refused in one line", "not handled"],
                 rows=[[kind, *counts] for kind, counts in outcomes.items()]),
            dict(title="CPU time", columns=["section", "s"], rows=seconds)]


SUMMARY = {
    "simulator": "Accuracy of the simulator against exact solutions and an independent Monte Carlo simulation, with "
                 "pyroomacoustics beside it.",
    "measured_room": "The simulator in a room whose geometry, materials and measured parameters are documented: the "
                     "seminar room CR2 of BRAS (Aspöck et al., TU Berlin and RWTH Aachen, 2020). No parameter is "
                     "fitted.",
    "drawn_rooms": "RIRs of drawn rooms (`roomeq simulate --rooms`) beside measured ones: a value per room, the median "
                   "over its RIRs. The measured rooms are those of published corpora, many of them laboratories; the "
                   "distributions of the drawn rooms are not fitted to them.",
    "speed": "Time of the simulator beside pyroomacoustics, in one run on one machine.",
    "waiting": "How long one waits for a first RIR in a new process, for the recipe in a new clone and for the closed "
               "loop, on two cores.",
    "compensation": "Distance of the EQ of simulated RIRs to that of held-out measured RIRs, before and after "
                    "compensation. Rooms count equally.",
    "loop": "What the closed loop finds in generated rooms whose extra effect it is not told of. The rooms are made by "
            "code that shares nothing with the effects or the simulator.",
    "loop_scale": "Time and memory of the closed loop over the number of RIRs, in generated rooms with eight RIRs each "
                  "that hold an undeclared loudspeaker response and noise floor. Memory is that of all processes.",
    "laboratories": "The closed loop on measured RIRs of real rooms. Each laboratory is scored by a loop that was "
                    "closed on the others: with the base model before, with the final model after. Ceiling: the error "
                    "that would remain if the final model were right.",
    "effects": "Each effect of the catalogue, switched on at a realistic size in three rooms: the change of the "
               "features that the loop predicts against the change that rendering shows.",
    "augmentation": "Speed and exactness of augmentation, from FLAC to FLAC on one core: several copies of each "
                    "utterance, which roomeq reads and transforms once, and the others each time.",
    "wer": "Word error rates in generated rooms, with intervals over rooms and seeds (`conf/mini.conf`).",
    "wer_real_rooms": "Word error rates of generated speech in real rooms, with intervals over rooms and seeds "
                      "(`conf/real_rooms.conf`). The measured RIRs for training are of three laboratories, the EQ "
                      "mixture is of two of them; every test room is elsewhere.",
    "wer_digits": "Word error rates of real digits in real rooms, with intervals over rooms and seeds "
                  "(`conf/digits.conf`). The measured RIRs for training are of three laboratories, the EQ "
                  "mixture is of two of them; every test room is elsewhere.",
    "wer_by_reverberation": "How recognisers of real digits depend on the reverberation of their training RIRs, "
                            "without the rooms of the test set: those of `conf/digits.conf`, and one that is trained "
                            "on RIRs "
                            "simulated with the T20 of the measured ones (sim.t60), are tested in drawn rooms with T60 "
                            "from 0.2 to 2.0 s.",
    "faults": "Attacks on the recipe and its steps: files that change between two steps, losses of power, bad inputs, "
              "hostile names, kills, several runs at once, full disks. Handled: the bytes of an undisturbed run, or a "
              "refusal in one line that names the cause.",
    "many_rooms": "How many rooms `roomeq simulate --rooms` makes a second, beside pyroomacoustics on some of them.",
    "labels": "The closed loop on RIRs with labelling errors: wrong units, exchanged recordings and devices, a room "
              "twice, wrong dimensions. Refused: the loop says in one line that it cannot use the RIRs. Left out: RIRs "
              "are left out with counts, and the effects are those without the error, or those of the loop on the set "
              "without these RIRs; fewer: one is no longer found. "
              "Same: nothing is said, and the effects are those without the error. Unstable: nothing is said, and an "
              "effect is no longer named that had been named by mistake. WRONG: an effect is named because of the "
              "error, or a true one is lost without a word.",
}
READERS: dict[str, Callable[[Any], list[Table]]] = {
    "simulator": sections, "measured_room": sections, "speed": sections, "waiting": sections,
    "drawn_rooms": drawn_rooms, "many_rooms": many_rooms, "compensation": lambda result: result["tables"], "loop": loop,
    "loop_scale": loop_scale, "laboratories": sections, "augmentation": augmentation, "effects": effects,
    "wer": word_errors, "wer_real_rooms": word_errors, "wer_digits": word_errors,
    "wer_by_reverberation": without_rooms, "faults": faults, "labels": labels,
}
COMMAND = {
    "simulator": "tests/bench/fidelity/run.py", "measured_room": "tests/bench/real/bras_cr2.py",
    "speed": "tests/bench/speed/run.py", "waiting": "tests/bench/waiting.py",
    "drawn_rooms": "tests/bench/real/drawn_rooms.py",
    "compensation": "./run.sh --measured RIRS --stop-stage 4 && tests/bench/compensation.py --out exp/bench data",
    "loop": "tests/bench/loop/run.py", "loop_scale": "tests/bench/loop/scale.py",
    "laboratories": "tests/bench/real/laboratories.py",
    "effects": "tests/bench/effects.py", "augmentation": "tests/bench/augment.py",
    "wer": "tests/bench/wer.sh exp/bench_wer -- --config conf/mini.conf",
    "wer_real_rooms": "tests/bench/wer.sh exp/bench_wer -- --config conf/real_rooms.conf",
    "wer_digits": "tests/bench/wer.sh exp/bench_wer -- --config conf/digits.conf",
    "wer_by_reverberation": "tests/bench/wer_by_reverberation.sh", "faults": "tests/nightly/faults/attacks.sh",
    "many_rooms": "tests/bench/many_rooms.py", "labels": "tests/nightly/labels/label_errors.py",
}


WER_TABLES = {"wer": "", "wer.without_cmvn": ", features not normalised"}
"""Directories that `tests/bench/wer.sh` makes, and what their tables are called."""


def read(path: Path) -> Any:
    """Read a JSON file, the lines of a JSON-lines file, all JSON files of a directory, or what wer.sh made."""
    if (path / "wer").is_dir():
        return {addition: read_wer(path / name / WER_FILE) for name, addition in WER_TABLES.items()
                if (path / name).is_dir()}
    if path.is_dir():
        return [json.loads(file.read_text()) for file in sorted(path.glob("*.json"))]
    if path.suffix == ".jsonl":
        return [json.loads(line) for line in path.read_text().splitlines()]
    return json.loads(path.read_text())


def main() -> None:
    """Write docs/results/PAGE.json."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("page", choices=sorted(READERS))
    parser.add_argument("file", type=Path)
    parser.add_argument("--commit", help="that the results are of; without it that of the working tree")
    parser.add_argument("--date", default=datetime.date.today().isoformat())
    parser.add_argument("--finding", action="append", default=[], help="what the tables show; may be given repeatedly")
    parser.add_argument("--note", action="append", default=[],
                        help="how the tables came about, besides the command; may be given repeatedly")
    given = parser.parse_args()
    commit = given.commit or subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=PROJECT, check=True, text=True,
                                            capture_output=True).stdout.strip()
    result = read(given.file)
    of_words = given.page.startswith("wer")
    if of_words and not (given.file / "wer").is_dir():
        sys.exit(f"{given.file}: has no wer: give the directory that {COMMAND[given.page]} made")
    machine = result.get("machine", kit.machine()) if isinstance(result, dict) else kit.machine()
    if of_words:
        machine = {}  # seeds may be of several machines, and this may be another one
    machine = {key: value for key, value in machine.items() if key in ("cpu", "cores", "python")}
    content = dict(summary=SUMMARY[given.page], findings=given.finding, command=COMMAND[given.page], commit=commit,
                   date=given.date, machine=machine, notes=given.note, tables=READERS[given.page](result))
    out = PROJECT / "docs/results" / f"{given.page}.json"
    out.write_text(json.dumps(kit.plain(content), indent=1, ensure_ascii=False) + "\n")
    print(f"{out.relative_to(PROJECT)} written")
    if of_words:
        for name in WER_TABLES:
            if (counts := given.file / name / COUNTS_FILE).is_file():
                write_text(out.parent / "counts" / given.page / f"{name}.jsonl", counts.read_text())


if __name__ == "__main__":
    main()
