"""Write the pages of docs/results from the JSON files there.

`tests/bench/publish.py` makes those files from the output of the benches.
"""

import json
from pathlib import Path
from typing import Any

PAGES = {
    "simulator": "Simulator: accuracy", "measured_room": "Simulator: a measured room",
    "drawn_rooms": "Simulator: drawn rooms", "many_rooms": "Simulator: many rooms", "speed": "Simulator: speed",
    "waiting": "Waiting times",
    "compensation": "EQ compensation",
    "loop": "Closed loop: generated rooms", "loop_scale": "Closed loop: time and memory",
    "laboratories": "Closed loop: real rooms",
    "effects": "Effects: predicted and rendered",
    "augmentation": "Augmentation", "wer": "Word error rates: generated rooms",
    "wer_real_rooms": "Word error rates: generated speech in real rooms",
    "wer_digits": "Word error rates: real digits in real rooms",
    "wer_by_reverberation": "Word error rates: reverberation of the training RIRs", "faults": "Faults and bad inputs",
    "labels": "Labelling errors",
}


def write_pages(directory: Path) -> None:
    """Write one Markdown page for each of `PAGES`, and an index of them."""
    for name, title in PAGES.items():
        source = directory / f"{name}.json"
        text = page(title, json.loads(source.read_text())) if source.is_file() else f"# {title}\n\nNot measured yet.\n"
        (directory / f"{name}.md").write_text(text)
    names = "\n".join(PAGES)
    (directory / "index.md").write_text(
        "# Results\n\nThe tables on these pages are generated from the output of the benches in `tests/bench`; nothing "
        "is typed by hand. Each page names the command, the commit, the machine and the date.\n\n"
        f"```{{toctree}}\n:maxdepth: 1\n\n{names}\n```\n")


def page(title: str, result: dict[str, Any]) -> str:
    """Return the page of one result: what was found, its tables, then where they come from."""
    parts = [f"# {title}", result["summary"], *([bullets(result["findings"])] if result["findings"] else [])]
    for table in result["tables"]:
        parts += [f"## {table['title']}", markdown(table["columns"], table["rows"])]
        parts += table.get("notes", [])
    machine = ", ".join(f"{key} {value}" for key, value in result["machine"].items()) or "not recorded"
    parts += ["## How this was measured",
              bullets([f"command: `{result['command']}`", f"commit: `{result['commit']}`", f"date: {result['date']}",
                       f"machine: {machine}", *result["notes"]])]
    return "\n\n".join(parts) + "\n"


def bullets(texts: list[str]) -> str:
    """Return a Markdown list."""
    return "\n".join(f"- {text}" for text in texts)


def markdown(columns: list[str], rows: list[list[Any]]) -> str:
    """Return a Markdown table; numbers to four significant digits, '-' for what was not measured."""
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join("| " + " | ".join(cell(value) for value in line) + " |" for line in lines)


def cell(value: Any) -> str:
    """Return the text of a table cell."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.4g}" if isinstance(value, float) else str(value).replace("|", "\\|")
