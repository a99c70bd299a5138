"""The bench behind tests/nightly/faults/attacks.sh: see there."""

import argparse
import contextlib
import json
import logging
import os
import random
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import runs
from generated_damage import RECIPE, Example, World
from pipeline import SYNTHETIC, Step
from power_losses import AUDIO_STEPS, Losses

from bench import kit
from roomeq.core.files import read_json, write_json

PROJECT = Path(__file__).resolve().parents[3]
Row = dict[str, Any]
"""An attack: its `kind`, the `step` that ran, the `case`, the `outcome`, and whether it was handled (`ok`)."""

SUITES = {
    "test_cases": "bad input", "test_conf": "bad configuration", "test_untrusted": "hostile names and files",
    "test_no_room": "no room on the disk", "test_corruptions": "corrupted output, checked",
    "test_properties": "any text (hypothesis)", "test_crash_points": "killed at each call",
    "test_power_loss": "killed, unsynced files damaged", "test_changed_inputs": "changed input",
    "test_races": "several runs at once", "test_signals": "signal", "test_suspicious": "recording that is no RIR",
}
"""Kind of attack by the file of tests."""
NO_ATTACKS = ("test_nothing_is_evaluated_or_unpickled", "test_case_names_are_unique")
"""Tests of these files that only read the sources."""
KEPT = {"nothing": "power lost, nothing unsynced kept", "names": "power lost, names without content kept",
        "some": "power lost, some of it kept"}
ALL_STEPS = "all steps"


def step_of(text: str) -> str:
    """Return the step that a text names, or all."""
    plain = text.replace("_", "-")
    names = dict.fromkeys(step.name.split()[0] for step in (*SYNTHETIC, *RECIPE))
    return next((name for name in names if re.search(rf"(?<![a-z]){name}(?![a-z])", plain)), ALL_STEPS)


def row_of(example: Example, kind: str) -> Row:
    """Return the row of an example."""
    step = ALL_STEPS if example.step == ALL_STEPS else step_of(example.step)
    return dict(kind=kind, step=step, case=f"{example.step}: {example.place}: {example.file}", outcome=example.outcome,
                ok=example.ok)


@contextlib.contextmanager
def made_world(made: Sequence[Step] = RECIPE) -> Iterator[World]:
    """Yield a world in a temporary directory, which is the current one."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder, "world")
        root.mkdir()
        with contextlib.chdir(root):
            yield World(root, made)


def damage(args: argparse.Namespace) -> list[Row]:
    """Damage a file between two steps, in as many ways as `args.examples` says."""
    with made_world() as world:
        examples = (world.example(number) for number in range(args.examples))
        return [row_of(example, f"damage: {example.kind}") for example in examples]


def power(args: argparse.Namespace) -> list[Row]:
    """Lose power at each different place of the steps that write audio."""
    steps, rows = {step.name: step for step in RECIPE}, []
    with made_world() as world:
        for name, over_older in [*((name, False) for name in AUDIO_STEPS), ("augment sim", True)]:
            losses, rng = Losses(world, steps[name], over_older), random.Random(name)
            for kept, kind in KEPT.items():
                rows += [row_of(example, kind) for example in losses.examples(kept, None, rng)]
    for step in SYNTHETIC:  # losses at some places: each run takes seconds
        with made_world([step]) as world:
            losses, rng = Losses(world, step), random.Random(step.name)
            for kept, kind in KEPT.items():
                rows += [row_of(example, kind) for example in losses.examples(kept, 10, rng)]
    return rows


def tests(args: argparse.Namespace) -> list[Row]:
    """Run the tests of the gate that attack something."""
    files = [path for path in sorted((PROJECT / "tests/integration").rglob("test_*.py")) if path.stem in SUITES]
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder, "report.xml")
        subprocess.run([sys.executable, "-m", "pytest", "-q", f"--junitxml={report}", "-o", "junit_family=xunit1",
                        *files], cwd=PROJECT, stdout=sys.stderr)
        cases = list(ElementTree.parse(report).iter("testcase"))
    rows = []
    for case in cases:
        if case.find("skipped") is not None or case.get("name", "").startswith(NO_ATTACKS):
            continue
        broken = next((found for tag in ("failure", "error") if (found := case.find(tag)) is not None), None)
        said = {found.get("name"): found.get("value") for found in case.iter("property")}
        rows.append(dict(kind=SUITES[case.get("classname", "").split(".")[-1]], case=case.get("name"),
                         step=step_of(said.get("step") or re.sub(r"^[^\[]*", "", case.get("name", ""))),
                         outcome="passed" if broken is None else broken.get("message", "failed"), ok=broken is None))
    return rows


def recipe(args: argparse.Namespace) -> list[Row]:
    """Kill the recipe, run it twice at once, fill its disk."""
    out = args.out / "recipe"
    runs.main(["--out", str(out), *args.recipe_options.split()])
    rows = [json.loads(path.read_text()) for path in sorted((out / "results").glob("*.json"))]
    kinds = {"kill": "recipe killed", "pair": "recipe run twice at once", "full": "recipe on a full disk",
             "readonly": "recipe on a read-only disk"}
    return [dict(kind=kinds[row["case"].split("-")[0]], step=ALL_STEPS, case=row["what"], outcome=row["restarted"],
                 ok=row["ok"]) for row in rows]


SECTIONS: dict[str, Callable[[argparse.Namespace], list[Row]]] = dict(
    damage=damage, power=power, tests=tests, recipe=recipe)


def matrix(rows: list[Row]) -> tuple[list[str], list[list[str]]]:
    """Return columns and rows of the table: for each kind and step, the handled of the tried attacks."""
    order = [*dict.fromkeys(step.name.split()[0] for step in (*SYNTHETIC, *RECIPE)), ALL_STEPS]
    steps = [step for step in order if any(row["step"] == step for row in rows)]

    def cell(these: list[Row]) -> str:
        return f"{sum(row['ok'] for row in these)}/{len(these)}" if these else ""

    def line(label: str, these: list[Row]) -> list[str]:
        return [label, *(cell([row for row in these if row["step"] == step]) for step in steps), cell(these)]
    kinds = dict.fromkeys(row["kind"] for row in rows)
    lines = [line(kind, [row for row in rows if row["kind"] == kind]) for kind in kinds]
    return ["attack", *steps, "total"], [*lines, line("total", rows)]


def main(argv: list[str] | None = None) -> int:
    """Try the attacks of all sections; return 1 if one was not handled."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--examples", type=int, default=1000, help="generated damages")
    parser.add_argument("--only", default=",".join(SECTIONS), help="sections")
    parser.add_argument("--recipe-options", default="", help="options of run.sh here, for the section recipe")
    args = parser.parse_args(argv)
    args.out = args.out.resolve()
    logging.getLogger().addHandler(logging.NullHandler())  # the command line's own log stays out of the messages
    for name in args.only.split(","):
        part = args.out / "sections" / f"{name}.json"
        if not part.is_file():
            before = os.times()
            rows = SECTIONS[name](args)
            write_json(part, dict(rows=rows, cpu_s=sum(os.times()[:4]) - sum(before[:4])))
    parts = {path.stem: read_json(path) for path in sorted((args.out / "sections").glob("*.json"))}
    rows = [row for name in SECTIONS if name in parts for row in parts[name]["rows"]]
    columns, lines = matrix(rows)
    write_json(args.out / "attacks.json", dict(
        machine=kit.machine(), rows=rows, columns=columns, lines=lines,
        cpu_s={name: part["cpu_s"] for name, part in parts.items()}))
    print(kit.table(columns, lines))
    failed = [row for row in rows if not row["ok"]]
    for row in failed:
        print(f"NOT HANDLED: {row['kind']}: {row['step']}: {row['case']}: {row['outcome']}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
