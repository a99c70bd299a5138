"""Sections about inputs and outputs: data sets, measured RIRs, limitations, and the steps of the run."""

from collections import Counter, defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from roomeq.core.arrays import FloatArray
from roomeq.core.files import read_json
from roomeq.core.stamps import read_stamp
from roomeq.corpora.characterise import SCREENING_FILE
from roomeq.records.geometry import is_known
from roomeq.records.parameters import value_of
from roomeq.records.schema import TARGET_AGAIN, RirRow
from roomeq.report import figures
from roomeq.report.figures_room import room_view
from roomeq.report.formats import DASH, number
from roomeq.report.load import (
    SETS,
    Context,
    Missing,
    Run,
    is_synthetic,
    read_numbers,
    read_pairs,
    synthetic_corpora,
)
from roomeq.report.rir_sets import acoustic_parameters, reverberation_times
from roomeq.report.room_map import RoomMap, map_room

OMITTED_OPTIONS = ("seed", "ways", "listed")
"""Options of stamps that the table of steps leaves out; the seed has a column of its own."""

UNSTAMPED = "no stamp: made or changed by hand"
"""What the table of steps says of a directory without a stamp."""

PAPER_SETS = ("train.real", "dev.real", "test.real", "train.sim", "dev.sim", "train.sim.EQ", "dev.sim.EQ")
"""Data sets of the paper's Table 1, without ``.rvb``."""

LOOP_SETS = ("train.sim.loop", "dev.sim.loop")
FREE_SETS = ("train.sim.free", "dev.sim.free")
"""Data sets of the closed loop and of drawn rooms, which a run may lack."""

TABLE_BANDS = (0, 1, 6)
"""EQ points in the table of acoustic parameters: 62.5 Hz, 125 Hz and 4 kHz."""


def datasets(run: Run) -> Context:
    """Return the paper's Table 1 with the counts of this run."""
    rows, missing = [], []
    for name in [*PAPER_SETS, *(name for name in LOOP_SETS + FREE_SETS if run.has(f"{name}.rvb"))]:
        directory = f"{name}.rvb"
        if not run.has(directory):
            missing.append(f"data/{directory}")
            continue
        hours, n_utterances = size(run, directory)
        used = set(read_pairs(run.path(directory) / "utt2rir").values())
        split, _, kind = name.partition(".")
        rirs = f"rirs.{kind}.{split}"
        n_rirs = len(run.rirs(rirs)) if run.has(rirs) else len(used)
        rows.append([directory, f"{hours:.3g}" if hours < 100 else f"{hours:,.0f}", f"{n_utterances:,}",
                     f"{n_rirs:,}", f"{len(used):,}" if used else DASH, source(run, split)])
    if not rows:
        raise Missing("any data/*.rvb", "stage 6 (roomeq augment)")
    return {"rows": rows, "missing": missing, "has_loop": any(run.has(f"{name}.rvb") for name in LOOP_SETS),
            "has_free": any(run.has(f"{name}.rvb") for name in FREE_SETS)}


def size(run: Run, name: str) -> tuple[float, int]:
    """Return the duration [h] and the number of utterances of a data directory."""
    seconds = read_numbers(run.path(name) / "utt2dur")
    if not seconds:
        raise Missing(f"data/{name}/utt2dur", "stage 6 (roomeq augment)")
    return sum(seconds.values()) / 3600, len(seconds)


def source(run: Run, split: str) -> str:
    """Name the clean speech of a split."""
    options = run.options(f"{split}.clean")
    corpus, sets = options.get("source"), options.get("sets")
    names = sets.get(split, ()) if isinstance(sets, dict) else ()
    # a corpus without sets of these names was split by speaker
    present = [name for name in names
               if corpus and any(Path(corpus, parent, name).is_dir() for parent in (".", "LibriSpeech"))]
    text = option_text(present) if present else Path(corpus).name if corpus else f"data/{split}.clean"
    return f"{text} (synthetic)" if is_synthetic(run, f"{split}.clean") else text


def measured(run: Run) -> Context:
    """Return rooms and splits, acoustic parameters and the screening of the measured corpus."""
    rows = measured_rows(run)
    by_room: dict[str, list[RirRow]] = defaultdict(list)
    for row in rows:
        if row.get("acoustic_parameters"):
            by_room[row["room_id"]].append(row)
    if not by_room:
        raise Missing("the acoustic parameters of data/rirs.real", "stage 1 (roomeq characterise)")
    dropped = read_json(run.need("rirs.real", SCREENING_FILE))
    return {"n_rirs": len(rows), "n_rooms": len({row["room_id"] for row in rows}), **rooms_by_split(run, rows),
            "parameters": [[room, *median_parameters(members)] for room, members in sorted(by_room.items())],
            "n_given": dropped["n_given"], "screening": screening(run, dropped)}


def measured_rows(run: Run) -> list[RirRow]:
    """Return the measured RIRs of a run: those that were split, and others that were given to develop or test on."""
    own = {row["id"]: row for split in SETS if run.has(f"rirs.real.{split}") for row in run.rirs(f"rirs.real.{split}")}
    return list(({row["id"]: row for row in run.rirs("rirs.real")} | own).values())


def room_maps(run: Run) -> Context:
    """Return maps of a small, a medium-sized and a large room of the measured corpus.

    Raises
    ------
    Missing
        The dimensions of no room are known.
    """
    rows = run.rirs("rirs.real")
    maps: dict[str, tuple[float, RirRow, RoomMap]] = {}
    for row in sorted(rows, key=lambda row: (not _has_positions(row), row["id"])):
        if row["room_id"] not in maps and (mapped := map_room(row, rows, run.path("rirs.real"))):
            extent_m = np.ptp(mapped.edges_m.reshape(-1, 3), axis=0)
            maps[row["room_id"]] = float(np.prod(extent_m)), row, mapped
    if not maps:
        raise Missing("a room with known dimensions or a mesh", "stage 0 with --measured and a table of geometry")
    by_size = sorted(maps.values(), key=lambda entry: (entry[0], entry[1]["room_id"]))
    chosen = [by_size[n] for n in sorted({0, (len(by_size) - 1) // 2, len(by_size) - 1})]
    panels = [figures.panel(f"figure-room-{n}", room_view(mapped, "plan", title=row["room_id"]),
                            f"Plan of room {row['room_id']} with source and microphones")
              for n, (_, row, mapped) in enumerate(chosen, start=1)]
    return {"panels": panels, "n_mapped": len(maps), "n_rooms": len({row["room_id"] for row in rows}),
            "notes": [f"{row['room_id']}: {mapped.note}" for _, row, mapped in chosen if mapped.note]}


def _has_positions(row: RirRow) -> bool:
    return is_known(row.get("source_pos_m")) and is_known(row.get("mic_pos_m"))


def rooms_by_split(run: Run, rows: list[RirRow]) -> Context:
    """Return the number of RIRs of each room and split, and their totals."""
    split_of = {row["id"]: split for split in SETS if run.has(f"rirs.real.{split}")
                for row in run.rirs(f"rirs.real.{split}")}
    count = Counter((row["room_id"], split_of.get(row["id"], "none")) for row in rows)
    suffix = " (synthetic)" if is_synthetic(run, "measured") else ""
    corpora = {row["room_id"]: (row.get("corpus") or DASH) + suffix for row in rows}
    splits = [*SETS, *(["none"] if any(split == "none" for _, split in count) else [])]
    rooms = [[room, corpora[room], *(count[room, split] for split in splits),
              sum(count[room, split] for split in splits)] for room in sorted(corpora)]
    totals = ["all", "", *(sum(count[room, split] for room in corpora) for split in splits), len(rows)]
    return {"splits": splits, "rooms": rooms, "totals": totals}


def median_parameters(members: list[RirRow]) -> list[str | int]:
    """Return the number of RIRs of a room and their median acoustic parameters."""
    parameters = acoustic_parameters(members)
    eq_db = np.array([np.where(p["eq_valid"], np.array(p["eq_db"], dtype=float), np.nan) for p in parameters])
    spread = np.array([np.nanstd(column) for column in eq_db.T if np.isfinite(column).any()])
    return [len(members), median(reverberation_times(parameters), 2),
            median([value_of(p, "c50") for p in parameters], 1),
            median([p["drr_db"] for p in parameters], 1),
            number(float(np.sqrt(np.mean(spread ** 2))) if len(members) > 1 and len(spread) else None),
            *(median(column, 1) for column in eq_db[:, TABLE_BANDS].T)]


def median(values: Sequence[float | None] | FloatArray, decimals: int) -> str:
    """Format the median of the values that are not missing; a dash if there are none."""
    array = np.array(values, dtype=np.float64)
    present = array[np.isfinite(array)]
    return number(float(np.median(present)) if len(present) else None, decimals)


def screening(run: Run, dropped: dict[str, Any]) -> list[list[Any]]:
    """Return the number of RIRs that were dropped or excluded from the EQ fit, by reason and room."""
    excluded = {row["id"]: reason for row in run.rirs("rirs.real") if (reason := row.get("screen"))}
    if (run.path("eq") / SCREENING_FILE).is_file():
        excluded = read_json(run.path("eq") / SCREENING_FILE)["screened"] | excluded
    room_of = {row["id"]: row["room_id"] for name in ("measured", "rirs.real") if run.has(name)
               for row in run.rirs(name)}
    rooms: dict[tuple[str, str], Counter[str]] = defaultdict(Counter)
    for outcome, reasons in (("dropped", dropped["dropped"]), ("not in the EQ fit", excluded)):
        for ident, reason in reasons.items():
            rooms[outcome, reason.split(":")[0]][room_of.get(ident, DASH)] += 1
    body = [[reason, outcome, sum(counts.values()), ", ".join(f"{room} ({n})" for room, n in sorted(counts.items()))]
            for (outcome, reason), counts in sorted(rooms.items())]
    n_kept = dropped["n_given"] - sum(counts.total() for counts in rooms.values())
    return [*body, ["none of these", "kept", n_kept, DASH]]


def limitations(run: Run) -> Context:
    """Return the values that decide which conclusions this run does not support."""
    real = measured_rows(run) if run.has("rirs.real") else []
    rooms = [{row["room_id"] for row in run.rirs(name)} if run.has(name) else set()
             for name in ("rirs.real.train", "rirs.real.test")]
    simulated = run.rirs("rirs.sim.train") if run.has("rirs.sim.train") else []
    return {"synthetic": synthetic_corpora(run), "n_measured": len(real),
            "n_rooms": len({row["room_id"] for row in real}), "shares_rooms": not rooms[0].isdisjoint(rooms[1]),
            "n_simulated": len(simulated),
            "n_drawn": sum(any(what != TARGET_AGAIN for what in row.get("drawn") or ()) for row in simulated),
            "has_wer": run.has("wer"), "other_wer": run.other_wer}


def steps(run: Run) -> Context:
    """Return the steps of the run with their options, from the stamps of the directories; one may have none."""
    stamps = {name: read_stamp(run.path(name)) for name in run.names}
    rows: list[list[Any]] = []
    for name, stamp in stamps.items():
        if not stamp:
            rows.append([run.label(name), UNSTAMPED, DASH, []])
        else:
            options = [f"{key} = {option_text(value)}" for key, value in stamp.options.items()
                       if key not in OMITTED_OPTIONS and value not in (None, "", [])]
            rows.append([run.label(name), stamp.step, option_text(stamp.options.get("seed", DASH)), options])
    if not any(stamps.values()):
        raise Missing("any directory that roomeq made", "./run.sh")
    return {"rows": rows, "benches": run.benches}


def option_text(value: object) -> str:
    """Format an option's value; of a path only its last part, so that a published page does not reveal folders."""
    if isinstance(value, (list, tuple)):
        return ", ".join(option_text(item) for item in value)
    if isinstance(value, dict):
        return ", ".join(f"{key}: {option_text(item)}" for key, item in value.items())
    text = f"{value:g}" if isinstance(value, float) else str(value)
    return Path(text).name if "/" in text else text


def facts(run: Run) -> Context:
    """Return the counts for the cards at the top of the page."""
    values: Context = {}
    if run.has("rirs.real"):
        rows = measured_rows(run)
        values |= {"n_measured": len(rows), "n_rooms": len({row["room_id"] for row in rows})}
    if simulated := [len(run.rirs(f"rirs.sim.{split}")) for split in SETS if run.has(f"rirs.sim.{split}")]:
        values["n_simulated"] = sum(simulated)
    if sizes := [size(run, f"{name}.rvb") for name in (*PAPER_SETS, *LOOP_SETS, *FREE_SETS) if run.has(f"{name}.rvb")]:
        values |= {"hours": sum(hours for hours, _ in sizes), "n_sets": len(sizes)}
    return values
