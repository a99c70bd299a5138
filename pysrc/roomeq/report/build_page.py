"""Build the report of a run: one HTML file that holds all it shows."""

from collections.abc import Callable
from dataclasses import dataclass

from markupsafe import Markup

from roomeq.core.constants import FS_HZ
from roomeq.core.progress import progress
from roomeq.report import (
    section_data,
    section_eq,
    section_loop,
    section_rirs,
    section_speech,
    section_summary,
    section_wer,
)
from roomeq.report.load import Context, Missing, Run, synthetic_corpora
from roomeq.report.render import render
from roomeq.report.step import versions


@dataclass(frozen=True)
class Section:
    """A section of the page.

    Parameters
    ----------
    ident : str
        Id of the element and name of the template.
    title : str
        Heading.
    group : str
        Part of the table of contents: findings, data or details.
    compute : callable
        Returns the values for the template; raises `Missing` if the run lacks them.
    """

    ident: str
    title: str
    group: str
    compute: Callable[[Run], Context]


FINDINGS, DATA, DETAILS = "Findings", "Data", "Details"

SECTIONS = (
    Section("summary", "What the simulation lacks, and what adding it is worth", FINDINGS, section_summary.summary),
    Section("listen", "Audio examples", FINDINGS, section_speech.audio_examples),
    Section("limits", "Limitations of this run", FINDINGS, section_data.limitations),
    Section("datasets", "Augmented data sets", DATA, section_data.datasets),
    Section("measured", "Measured RIRs", DATA, section_data.measured),
    Section("rooms", "Rooms", DATA, section_data.room_maps),
    Section("noise", "Noise", DATA, section_speech.noise),
    Section("responses", "Frequency responses", DETAILS, section_rirs.frequency_responses),
    Section("distributions", "EQ distributions", DETAILS, section_eq.eq_distributions),
    Section("spectrograms", "Spectrograms and echograms", DETAILS, section_rirs.spectrograms),
    Section("distance", "Distance to measured RIRs", DETAILS, section_eq.distances),
    Section("accuracy", "Accuracy of the compensation", DETAILS, section_eq.accuracy),
    Section("reverberation", "Reverberation times", DETAILS, section_rirs.reverberation),
    Section("loop", "Closed loop: effects added to the simulation", DETAILS, section_loop.closed_loop),
    Section("wer", "Word error rates", DETAILS, section_wer.word_error_rates),
    Section("run", "Steps and options", DETAILS, section_data.steps))

FACTS = (section_data.facts, section_eq.facts, section_loop.facts, section_wer.facts)
"""Functions that return the values of the cards at the top of the page."""


def render_page(run: Run) -> str:
    """Return the page of a run as HTML."""
    # the loop needs measured geometry and word error rates need Kaldi: a run without them has no section on them
    sections = [section for section in SECTIONS if section.ident not in ("loop", "wer") or run.has(section.ident)]
    groups: dict[str, list[Section]] = {}
    for section in sections:
        groups.setdefault(section.group, []).append(section)
    page = render("page", groups=groups, sections=[(section, render_section(run, section))
                                                     for section in progress(sections, len(sections), "report")],
                  synthetic=synthetic_corpora(run), facts=facts(run), versions=versions(), fs_khz=FS_HZ // 1000)
    # a file name that is not UTF-8 arrives with lone surrogates
    return page.encode("utf-8", "replace").decode()


def render_section(run: Run, section: Section) -> Markup:
    """Return a section's content, or a notice that names the missing part of the run."""
    try:
        return render(section.ident, **section.compute(run))
    except Missing as missing:
        return render("missing", part=missing.part, maker=missing.maker)


def facts(run: Run) -> Context:
    """Return the values of the cards at the top of the page, without those that the run lacks."""
    values: Context = {}
    for compute in FACTS:
        try:
            values |= compute(run)
        except Missing:
            continue
    return values
