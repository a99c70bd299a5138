"""Pages, pictures and texts of everything that can be shown."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from roomeq.core.audio import audio_info
from roomeq.records.schema import RirRow
from roomeq.report.load import Context
from roomeq.report.render import render
from roomeq.report.room_map import map_room
from roomeq.report.step import versions
from roomeq.show import tables
from roomeq.show.figures_sets import QUANTITIES, by_room, distribution, labels_of, over_frequency
from roomeq.show.inputs import RirSet, ShownRir, middle_of, read_rir_file, read_rir_of, read_set
from roomeq.show.page_compare import (
    compared_bands,
    compared_rirs,
    compared_sets,
    compared_summary,
    compared_values,
    pair_rirs,
    typical_pair,
)
from roomeq.show.page_rir import facts, rir_context, rir_draws
from roomeq.show.page_set import set_context, set_facts
from roomeq.show.sheet import png
from roomeq.show.step import PICTURE
from roomeq.show.tables import METRICS, as_text

if TYPE_CHECKING:
    from markupsafe import Markup

Part = tuple[str, str, Context]
"""Template of a section, its title, and what it shows."""

TEMPLATES = Path(__file__).parent / "templates"
SEE = "See and hear it: --out FILE.html (with audio) or --out FILE.png."


@dataclass(frozen=True)
class _Section:
    """A section of a page: its id and its title."""

    ident: str
    title: str


def rir_file(path: Path, suffix: str | None, channel: int | None, speech: Path | None,
             keep_suspicious: bool) -> bytes | str:
    """Return the page, picture or text of an RIR file."""
    return _one_rir(read_rir_file(path, channel, keep_suspicious), suffix, speech)


def rir_set(directory: Path, suffix: str | None, ident: str | None, speech: Path | None,
            keep_suspicious: bool) -> bytes | str:
    """Return the page, picture or text of a set, or of one of its RIRs for a picture or a text with an id."""
    if ident is not None and suffix != ".html":
        return _one_rir(read_rir_of(directory, ident, keep_suspicious), suffix, speech)
    chosen = read_rir_of(directory, ident, keep_suspicious) if ident is not None else None
    of_set = read_set(directory, keep_suspicious)
    if suffix is None:
        return _set_text(of_set)
    if suffix == PICTURE:
        return png([*(distribution([of_set], quantity) for quantity in QUANTITIES),
                    *(by_room(of_set, quantity) for quantity in QUANTITIES),
                    over_frequency([of_set], "t60", "Reverberation time (s)"),
                    over_frequency([of_set], "eq", "EQ (dB, 1 kHz = 0)")], f"RIRs of {of_set.label}")
    chosen = chosen or read_rir_of(directory, middle_of(of_set), keep_suspicious=True)
    if len(of_set.rows) == 1 and not of_set.left_out:
        return _one_rir(chosen, suffix, speech)
    context = set_context(of_set)
    lead = ("Reverberation, clarity and colour of the room impulse responses (RIRs) of a directory, room by room. One "
            "of them is shown in detail.")
    return make_page(f"RIRs of {of_set.label}", lead, set_facts(of_set), [],
                     [("set", "Overview", context), *_rir_parts(chosen, of_set.rows, speech, f"RIR {chosen.rir.name}"),
                      ("list", "All RIRs", context)])


def two_files(first: Path, second: Path, suffix: str | None, channel: int | None, speech: Path | None,
              keep_suspicious: bool) -> bytes | str:
    """Return the page or text that compares two RIR files; a mono file is compared whatever the channel."""
    a, b = (read_rir_file(path, channel if audio_info(path).channels > 1 else None, keep_suspicious)
            for path in (first, second))
    if suffix is None:
        return _pair_text(a, b)
    lead = "Two room impulse responses (RIRs) overlaid, with their differences in just noticeable differences (JND)."
    return make_page(f"{a.rir.name} and {b.rir.name}", lead, [], [], _pair_parts(a, b, speech))


def two_sets(first: Path, second: Path, suffix: str | None, ident: str | None, speech: Path | None,
             keep_suspicious: bool) -> bytes | str:
    """Return the page or text that compares two RIR directories."""
    a, b = read_set(first, keep_suspicious), read_set(second, keep_suspicious)
    pairs = pair_rirs(a, b)
    chosen = None
    if ident is not None:
        chosen = next((n for n, (number_a, _) in enumerate(pairs.numbers) if a.rows[number_a]["id"] == ident), None)
        if chosen is None:
            raise ValueError(f"--id {ident}: no pair of {first} and {second} has this id in {first}: give another of "
                             f"the {len(pairs.numbers)} pairs")
    elif pairs.numbers:
        chosen = typical_pair(pairs)
    if suffix is None:
        return _sets_text(a, b, compared_values(a, b, pairs))
    parts: list[Part] = [("sets", "Both sets", compared_sets(a, b, pairs))]
    if chosen is not None:
        number_a, number_b = pairs.numbers[chosen]
        shown = (read_rir_of(first, a.rows[number_a]["id"], keep_suspicious=True),
                 read_rir_of(second, b.rows[number_b]["id"], keep_suspicious=True))
        parts += _pair_parts(*shown, speech, f"One pair: {shown[0].rir.name}")
    cards = [(f"{len(of_set.rows):,}", f"RIRs of {len(of_set.rooms):,} rooms in {label}")
             for of_set, label in zip((a, b), labels_of([a, b]), strict=True)]
    lead = ("Two sets of room impulse responses (RIRs) side by side, with their differences in just noticeable "
            "differences (JND).")
    return make_page(" and ".join(labels_of([a, b])), lead,
                     [*cards, (f"{len(pairs.numbers):,}", "pairs of RIRs")], [], parts)


def _one_rir(shown: ShownRir, suffix: str | None, speech: Path | None) -> bytes | str:
    if suffix is None:
        bands = as_text(tables.BAND_COLUMNS, tables.band_rows(shown.rir))
        summary = as_text(*_with_heading(tables.summary_rows(shown), shown.rir.name))
        warning = f"No RIR by its acoustics: {shown.problem}\n\n" if shown.problem else ""
        dash = "A dash stands for a value that noise or bandwidth make invalid."
        return f"{warning}{summary}\n\n{bands}\n\n{dash} {SEE}"
    if suffix == PICTURE:
        room = map_room(shown.row, [shown.row], shown.directory) if shown.row and shown.directory else None
        reason = f"; no RIR by its acoustics: {shown.problem}" if shown.problem else ""
        return png(rir_draws(shown.rir, room), f"{shown.rir.name}{reason}")
    warnings = [f"No RIR by its acoustics: {shown.problem}"] if shown.problem else []
    lead = "A room impulse response (RIR): what is heard, measured and seen of it."
    return make_page(shown.rir.name, lead, facts(shown), warnings,
                         _rir_parts(shown, [shown.row] if shown.row else [], speech))


def _rir_parts(shown: ShownRir, rows: list[RirRow], speech: Path | None, first: str = "Sound") -> list[Part]:
    context = rir_context(shown, rows, speech)
    return [("listen", first, context), ("parameters", "Acoustic parameters", context),
            ("time", "Response over time", context), ("frequency", "Response over frequency", context),
            ("decays", "Decay by octave", context), ("room", "Room", context)]


def _pair_parts(a: ShownRir, b: ShownRir, speech: Path | None, first: str = "Differences") -> list[Part]:
    context = compared_rirs(a, b, speech)
    return [("differences", first, context), ("listen", "Sound", context), ("time", "Response over time", context),
            ("frequency", "Response over frequency", context), ("decays", "Decay by octave", context)]


def _with_heading(rows: list[list[str]], heading: str) -> tuple[list[str], list[list[str]]]:
    return [heading, *[""] * (len(rows[0]) - 1)], rows


def _set_text(of_set: RirSet) -> str:
    return (f"{of_set.directory}: {len(of_set.rows)} RIRs of {len(of_set.rooms)} rooms; medians by room."
            f"{_left_out_text(of_set)}\n\n"
            f"{as_text(tables.ROOM_COLUMNS, tables.room_rows(of_set))}\n\n"
            f"One RIR: --id ID, such as {middle_of(of_set)}. {SEE}")


def _left_out_text(of_set: RirSet) -> str:
    return f"\n{len(of_set.left_out)} recordings that are no RIR are left out." if of_set.left_out else ""


def _pair_text(a: ShownRir, b: ShownRir) -> str:
    columns = ["Octave", *(tables.HEADINGS[metric] for metric in METRICS)]
    warnings = "".join(f"{letter}: no RIR by its acoustics: {shown.problem}\n"
                       for letter, shown in (("A", a), ("B", b)) if shown.problem)
    return (f"{warnings}{as_text(['', 'A', 'B', 'B - A (JND)'], compared_summary(a, b))}\n\n"
            f"{as_text(columns, compared_bands(a, b))}\n\nA → B (difference in JND). Overlaid: --out FILE.html.")


def _sets_text(a: RirSet, b: RirSet, context: Context) -> str:
    columns = ["Octave", *(tables.HEADINGS[metric] for metric in METRICS)]
    paired = ""
    if context["n_pairs"]:
        paired = (f"\n\n{context['n_pairs']} pairs: mean absolute difference in JND (mean difference B - A)\n\n"
                  f"{as_text(columns, context['paired'])}")
    return (f"A: {a.directory}, {len(a.rows)} RIRs.{_left_out_text(a)}\n"
            f"B: {b.directory}, {len(b.rows)} RIRs.{_left_out_text(b)}\n\n"
            f"Medians A → B (difference in JND)\n\n{as_text(columns, context['medians'])}\n\n"
            f"DRR: {context['median_drr']}{paired}\n\n"
            "Overlaid: --out FILE.html.")


def make_page(title: str, lead: str, cards: list[tuple[str, str]], warnings: list[str],
          parts: list[Part]) -> str:
    """Return a page with one section for each part: its template, its title, and what it shows."""
    sections: list[tuple[_Section, Markup]] = []
    for template, heading, context in parts:
        content = render(f"show_{template}", TEMPLATES, **context)
        sections.append((_Section(template.replace("_", "-"), heading), content))
    return render("show_page", TEMPLATES, title=title, lead=lead, cards=cards, warnings=warnings, sections=sections,
                  versions=versions())
