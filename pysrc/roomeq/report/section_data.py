"""Sections about what went in and what came out: the run itself, Table 1, the measured RIRs."""

from collections import Counter, defaultdict
from pathlib import Path

import numpy as np

from roomeq.core.constants import BAND_1KHZ, BANDS_HZ
from roomeq.core.files import read_json
from roomeq.corpora.characterise import SCREENING_FILE
from roomeq.report.kinds import reverberation_times
from roomeq.report.load import IN_EXP, SETS, Run, corpus_readme, read_numbers, read_pairs
from roomeq.report.page import Html, Missing, hertz, join, number, paragraph, tag
from roomeq.report.page import table as make_table

BOOKKEEPING = ("seed", "ways", "listed")
"""Options in stamps that say nothing to a reader, or have a column of their own."""
PLANNED = ("train.real", "dev.real", "test.real", "train.sim", "dev.sim", "train.sim.EQ", "dev.sim.EQ")
"""The paper's Table 1, without ``.rvb``."""
BESIDES = ("train.sim.loop", "dev.sim.loop")
"""Shown below it, where they are there."""


def duration(hours: float) -> str:
    """Return a duration in hours as a person would say it."""
    if hours >= 1:
        return f"{hours:,.0f} h" if hours >= 10 else f"{hours:.1f} h"
    return f"{60 * hours:.0f} min" if hours >= 0.1 else f"{3600 * hours:.0f} s"


def synthetic_corpora(run: Run) -> list[str]:
    """Name the corpora of a run that say of themselves that they are generated."""
    found = []
    if corpus_readme(run, "measured").startswith("Generated"):
        found.append("measured RIRs")
    if any(corpus_readme(run, f"{x}.clean").startswith("Generated") for x in SETS):
        found.append("speech")
    return found


def synthetic_corpus_warning(run: Run) -> Html:
    """Return the box that says which corpora are not real, or nothing."""
    found = synthetic_corpora(run)
    if not found:
        return Html("")
    return tag("p", tag("strong", "Not real: "), f"the {' and the '.join(found)} of this run are generated "
                                                 "synthetic corpora. ",
               "They show that everything works from end to end; no number below says anything about rooms or "
               "recognisers. Give recordings of your own with ", tag("code", "--measured"), " and ",
               tag("code", "--speech"), ".", class_="warning")


def what_ran(run: Run) -> Html:
    """Return the table of steps with their options, from the stamps of the directories."""
    rows = []
    for name in run.names:
        stamp = run.stamp(name)
        if stamp:
            options = [tag("code", f"{key} = {shown(value)}") for key, value in stamp["options"].items()
                       if key not in BOOKKEEPING and value not in (None, "", [])]
            folder = "exp" if name in IN_EXP else "data"
            rows.append([tag("code", f"{folder}/{name}"), stamp["step"], shown(stamp["options"].get("seed", "–")),
                         join(options, Html(" ")) or "–"])
    if not rows:
        raise Missing("any directory that roomeq made", "./run.sh")
    links = join([tag("a", tag("code", f"exp/{name}"), href=f"../{name}") for name in run.benches], ", ")
    benches = [tag("code", f"python tests/bench/{name}/run.py --out exp/bench")
               for name in ("fidelity", "speed")]
    return join([
        paragraph("How right and how fast the simulator is, on the machine at hand: ", join(benches, " and "), ". ",
                  join(["Results beside this page: ", links, "."]) if links else "They were not run here."),
        paragraph("Every directory of the run with the step and the options that it was made with. ",
                  "The same options, seed and inputs give the same bytes, whatever the number of jobs."),
        make_table("table-run", "Steps and their options", ["Directory", "Step", "Seed", "Options"], rows,
                   (0, 1, 3))])


def shown(value) -> str:
    """Return an option's value in short; of a path only its last part, for pages are given away."""
    if isinstance(value, (list, tuple)):
        return ", ".join(shown(item) for item in value)
    if isinstance(value, dict):
        return ", ".join(f"{key}: {shown(item)}" for key, item in value.items())
    text = f"{value:g}" if isinstance(value, float) else str(value)
    return Path(text).name if "/" in text else text


def datasets(run: Run) -> Html:
    """Return the paper's Table 1 with this run's numbers."""
    rows, missing = [], []
    for name in [*PLANNED, *(name for name in BESIDES if run.has(f"{name}.rvb"))]:
        directory = f"{name}.rvb"
        if not run.has(directory):
            missing.append(directory)
            continue
        hours, n_utterances = size(run, directory)
        used = set(read_pairs(run.path(directory) / "utt2rir").values())
        split, _, kind = name.partition(".")
        rirs = f"rirs.{kind}.{split}"
        given = len(run.rirs(rirs)) if run.has(rirs) else len(used)
        rows.append([tag("code", directory), f"{hours:.3g}" if hours < 100 else f"{hours:,.0f}",
                     f"{n_utterances:,}", f"{given:,}", f"{len(used):,}" if used else "–", source(run, split)])
    if not rows:
        raise Missing("any data/*.rvb", "stage 6 (roomeq augment)")
    parts = [
        paragraph("Clean speech made far-field with measured RIRs (", tag("code", "real"), "), simulated ones (",
                  tag("code", "sim"), ") and simulated ones with corrected EQ (", tag("code", "sim.EQ"), ")",
                  join([" or with the effects that the closed loop found (", tag("code", "sim.loop"), ")"])
                  if any(run.has(f"{name}.rvb") for name in BESIDES) else "", ". ",
                  "Each data set lasts as long as its clean source, to the sample."),
        make_table("table-datasets", "Paper's Table 1, with the counts of this run",
                   ["Augmented dataset", "Hours", "Utterances", "RIRs", "of them used", "Source"], rows, (0, 5))]
    if missing:
        parts.append(tag("p", tag("strong", "Not in this run: "), ", ".join(f"data/{name}" for name in missing),
                         ". Stage 6 (roomeq augment) makes them.", class_="notice"))
    return join(parts)


def size(run: Run, name: str) -> tuple[float, int]:
    """Return hours and number of utterances of a data directory."""
    seconds = read_numbers(run.path(name) / "utt2dur")
    if not seconds:
        raise Missing(f"data/{name}/utt2dur", "stage 6 (roomeq augment)")
    return sum(seconds.values()) / 3600, len(seconds)


def source(run: Run, split: str) -> Html:
    """Name the clean speech of a split."""
    options = run.stamp(f"{split}.clean").get("options", {})
    corpus, sets = options.get("source"), options.get("sets")
    names = sets.get(split, ()) if isinstance(sets, dict) else ()
    # a corpus without sets of these names was split by speaker
    found = [name for name in names if corpus and any(Path(corpus, top, name).is_dir() for top in (".", "LibriSpeech"))]
    text = shown(found) if found else Path(corpus).name if corpus else f"data/{split}.clean"
    generated = corpus_readme(run, f"{split}.clean").startswith("Generated")
    return join([text, " (synthetic)" if generated else ""])


def measured(run: Run) -> Html:
    """Return what the measured corpus holds: rooms and splits, acoustic parameters, what was left out and why."""
    rows = run.rirs("rirs.real")
    return join([
        paragraph(f"{len(rows)} measured RIRs of {len({row['room_id'] for row in rows})} rooms were kept. ",
                  "Each is measured: what can be measured on it, and whether the recording allows it."),
        rooms_table(run, rows), parameters_table(rows), screening(run)])


def rooms_table(run: Run, rows: list[dict]) -> Html:
    """Return rooms by splits."""
    splits = {row["id"]: x for x in SETS if run.has(f"rirs.real.{x}") for row in run.rirs(f"rirs.real.{x}")}
    count = Counter((row["room_id"], splits.get(row["id"], "none")) for row in rows)
    generated = " (generated)" if corpus_readme(run, "measured").startswith("Generated") else ""
    corpora = {row["room_id"]: (row.get("corpus") or "–") + generated for row in rows}
    columns = [*SETS, *(["none"] if any(split == "none" for _, split in count) else [])]
    body = [[tag("code", room), corpora[room], *(count[room, split] for split in columns),
             sum(count[room, split] for split in columns)] for room in sorted(corpora)]
    body.append(["all", "", *(sum(count[room, split] for room in corpora) for split in columns), len(rows)])
    return make_table("table-rooms", "Measured RIRs by room and split; no RIR is in two splits",
                      ["Room", "Corpus", *columns, "all"], body, (0, 1))


def parameters_table(rows: list[dict]) -> Html:
    """Return the median acoustic parameters of each room."""
    by_room = defaultdict(list)
    for row in rows:
        if row.get("acoustic_parameters"):
            by_room[row["room_id"]].append(row)
    if not by_room:
        raise Missing("the acoustic parameters of data/rirs.real", "stage 1 (roomeq characterise)")
    body = []
    for room, members in sorted(by_room.items()):
        parameters = [row["acoustic_parameters"] for row in members]
        eq_db = np.array([np.where(p["eq_valid"], p["eq_db"], np.nan) for p in parameters], dtype=float)
        spread = np.array([np.nanstd(column) for column in eq_db.T if np.isfinite(column).any()])
        body.append([
            tag("code", room), len(members), middle(reverberation_times(parameters), 2),
            middle([p["c50_db"][BAND_1KHZ] for p in parameters if p["c50_valid"][BAND_1KHZ]], 1),
            middle([p["drr_db"] for p in parameters if p["drr_db"] is not None], 1),
            number(np.sqrt(np.mean(spread ** 2)) if len(members) > 1 and len(spread) else None),
            *(middle(column[np.isfinite(column)], 1) for column in eq_db[:, [0, 1, 6]].T)])
    points = [f"EQ at {hertz(BANDS_HZ[n])} (dB)" for n in (0, 1, 6)]
    head = ["Room", "RIRs", f"T60, {hertz(1000)} (s)", f"C50, {hertz(1000)} (dB)", "DRR (dB)", "EQ spread (dB)"]
    return make_table(
        "table-acoustic-parameters", "Acoustic parameters: the median of each room, over those of its RIRs that allow the measurement. "
        "T60: reverberation time, by T30 where noise leaves enough decay, else by T20; C50: early (50 ms) to late "
        "energy; DRR: direct sound to everything else; EQ spread: standard deviation within the room, mean over "
        "the points", [*head, *points], body)


def middle(values, decimals: int) -> str:
    """Return the median as text, a dash where there is nothing."""
    return number(float(np.median(values)) if len(values) else None, decimals)


def screening(run: Run) -> Html:
    """Return how many RIRs were dropped or left out of the EQ fit, by reason and room."""
    dropped = read_json(run.need("rirs.real", SCREENING_FILE))
    screened = {row["id"]: row["screen"] for row in run.rirs("rirs.real") if row.get("screen")}
    if (run.path("eq") / SCREENING_FILE).is_file():
        screened = read_json(run.path("eq") / SCREENING_FILE)["screened"] | screened
    room_of = {row["id"]: row["room_id"] for name in ("measured", "rirs.real") if run.has(name)
               for row in run.rirs(name)}
    rooms = defaultdict(Counter)
    for what, reasons in (("dropped", dropped["dropped"]), ("not in the EQ fit", screened)):
        for ident, reason in reasons.items():
            rooms[what, reason.split(":")[0]][room_of.get(ident, "–")] += 1
    body = [[reason, what, sum(counts.values()), ", ".join(f"{room} ({n})" for room, n in sorted(counts.items()))]
            for (what, reason), counts in sorted(rooms.items())]
    body.append(["none of these", "kept", dropped["n_given"] - sum(row[2] for row in body), "–"])
    return join([
        paragraph("A hand clap, a dummy head's ears or a dead band says more about the recording than about the "
                  "room and would widen the mixture until compensation hurts. Such RIRs are kept for augmentation "
                  "but do not shape the EQ distribution; repeats and stairwells are dropped altogether."),
        make_table("table-screening", f"Screening of the {dropped['n_given']} measured RIRs given",
                   ["Reason", "What happened", "RIRs", "Rooms"],
                   body, (0, 1, 3))])


def amounts(run: Run) -> list[tuple[str, str]]:
    """Return the counts that the top of the page shows."""
    cards = []
    if run.has("rirs.real"):
        rows = run.rirs("rirs.real")
        cards.append((f"measured RIRs of {len({row['room_id'] for row in rows})} rooms", f"{len(rows):,}"))
    simulated = [len(run.rirs(f"rirs.sim.{x}")) for x in SETS if run.has(f"rirs.sim.{x}")]
    if simulated:
        cards.append(("simulated RIRs", f"{sum(simulated):,}"))
    sizes = [size(run, f"{name}.rvb") for name in (*PLANNED, *BESIDES) if run.has(f"{name}.rvb")]
    if sizes:
        cards.append((f"far-field speech in {len(sizes)} data sets", duration(sum(hours for hours, _ in sizes))))
    return cards
