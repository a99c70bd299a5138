"""What the benches share: sections of results, their tables, checks, JSON and figure, and the command line."""

import argparse
import json
import math
import os
import platform
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path

import matplotlib
import numpy as np


@dataclass(frozen=True)
class Check:
    """One number that is held to a limit.

    Attributes
    ----------
    what : str
    value : float
    low, high : float or None
        The range that is asked for; None: open, and with both open the number is only reported.
    unit : str
    """

    what: str
    value: float
    low: float | None = None
    high: float | None = None
    unit: str = ""

    @property
    def held(self):
        """True, False, or None where nothing is asked for."""
        if self.low is None and self.high is None:
            return None
        above = self.low is None or self.value >= self.low
        return bool(above and (self.high is None or self.value <= self.high))

    def __str__(self):
        verdict = {True: "ok  ", False: "MISS", None: "    "}[self.held]
        low = "" if self.low is None else f">= {self.low:g}"
        high = "" if self.high is None else f"<= {self.high:g}"
        asked = " and ".join(part for part in (low, high) if part)
        line = f"  {verdict} {self.what}: {number(self.value)} {self.unit}".rstrip()
        return f"{line}  ({asked})" if asked else line


@dataclass
class Section:
    """One part of a bench.

    Attributes
    ----------
    name, title : str
    columns : list of str
    rows : list of list
        Strings, numbers or None.
    checks : list of Check
    notes : list of str
    curves : dict
        Numbers that the figure is drawn from.
    """

    name: str
    title: str
    columns: list = field(default_factory=list)
    rows: list = field(default_factory=list)
    checks: list = field(default_factory=list)
    notes: list = field(default_factory=list)
    curves: dict = field(default_factory=dict)
    seconds: float = 0.0
    cpu_seconds: float = 0.0

    def show(self):
        """Print table, checks and notes."""
        print(f"\n== {self.title} ({self.seconds:.0f} s, {self.cpu_seconds:.0f} s of CPU)")
        if self.rows:
            print(table(self.columns, self.rows))
        for check in self.checks:
            print(check)
        for note in self.notes:
            print(f"  note: {note}")


def number(value):
    """Format a table cell: four significant digits, '-' for None."""
    if value is None:
        return "-"
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, int | np.integer):
        return str(int(value))
    if isinstance(value, float | np.floating):
        return "-" if math.isnan(value) else f"{value:.4g}"
    return str(value)


def table(columns, rows):
    """Lay out rows under their columns."""
    cells = [[str(column) for column in columns]] + [[number(value) for value in row] for row in rows]
    widths = [max(len(row[n]) for row in cells) for n in range(len(columns))]
    lines = ["  " + "  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in cells]
    return "\n".join([lines[0], "  " + "  ".join("-" * width for width in widths), *lines[1:]])


def plain(value):
    """Turn numpy values into what JSON knows; NaN becomes null."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain(item) for item in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value


def arguments(description, names):
    """Parse the options that both benches have."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small sizes: a look, not a result")
    parser.add_argument("--out", type=Path, default=Path("exp/bench"), metavar="DIR", help="where JSON and PNG go")
    parser.add_argument("--only", default=",".join(names), metavar="A,B",
                        help=f"sections to run, of {', '.join(names)}")
    parser.add_argument("--resume", action="store_true", help="keep sections that DIR already holds")
    chosen = parser.parse_args()
    unknown = set(chosen.only.split(",")) - set(names)
    if unknown:
        parser.error(f"--only={chosen.only} must name some of {','.join(names)}: correct {','.join(unknown)}")
    return chosen


def run_sections(bench, sections, chosen, figures):
    """Run the chosen sections one after the other, print each, and write ``DIR/<bench>.json`` and ``.png``.

    A finished section is kept in ``DIR/<bench>.parts/``, so that a run that was killed goes on with `--resume`.

    Parameters
    ----------
    bench : str
    sections : dict of str to callable
        ``section(quick) -> Section``.
    chosen : argparse.Namespace
        From `arguments`.
    figures : dict of str to callable
        ``figure(axis, section)`` draws the panel of a section.

    Returns
    -------
    dict of str to Section
    """
    parts = chosen.out / f"{bench}.parts"
    parts.mkdir(parents=True, exist_ok=True)
    results = {}
    for name in chosen.only.split(","):
        path = parts / f"{name}{'.quick' if chosen.quick else ''}.json"
        if chosen.resume and path.exists():
            result = _read_section(path)
        else:
            start, cpu = time.perf_counter(), sum(os.times()[:4])  # of the processes that it starts, too
            result = sections[name](chosen.quick)
            result.seconds, result.cpu_seconds = time.perf_counter() - start, sum(os.times()[:4]) - cpu
            path.write_text(json.dumps(plain(asdict(result)), sort_keys=True))
        result.show()
        results[name] = result
    _write(bench, results, chosen)
    _draw(results, figures, chosen.out / f"{bench}.png")
    missed = [f"{name}: {check.what}" for name, result in results.items() for check in result.checks
              if check.held is False]
    print(f"\n{chosen.out / bench}.json and .png written; {len(missed)} of "
          f"{sum(check.held is not None for result in results.values() for check in result.checks)} checks missed")
    for line in missed:
        print(f"  missed {line}")
    return results


def _read_section(path):
    content = json.loads(path.read_text())
    content["checks"] = [Check(**check) for check in content["checks"]]
    return Section(**content)


def _write(bench, results, chosen):
    content = {"bench": bench, "quick": chosen.quick, "machine": machine(),
               "sections": {name: asdict(result) for name, result in results.items()}}
    for name, result in results.items():
        for check, written in zip(result.checks, content["sections"][name]["checks"], strict=True):
            written["held"] = check.held
    (chosen.out / f"{bench}.json").write_text(json.dumps(plain(content), indent=1, sort_keys=True) + "\n")


def machine():
    """What the numbers were measured on."""
    model = ""
    if Path("/proc/cpuinfo").exists():
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        model = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "")
    return {"cpu": model, "cores": len(os.sched_getaffinity(0)), "python": platform.python_version(),
            "load_1min": os.getloadavg()[0]}


def _draw(results, figures, path):
    """One panel per section that has a figure."""
    matplotlib.use("Agg")
    from matplotlib import pyplot

    names = [name for name in results if name in figures]
    if not names:
        return
    columns = min(3, len(names))
    figure, axes = pyplot.subplots(-(-len(names) // columns), columns, squeeze=False, layout="constrained",
                                   figsize=(5.2 * columns, 3.6 * -(-len(names) // columns)))
    for axis in axes.ravel()[len(names):]:
        axis.remove()
    for axis, name in zip(axes.ravel(), names, strict=False):
        figures[name](axis, results[name])
    figure.savefig(path, dpi=90)
    pyplot.close(figure)
