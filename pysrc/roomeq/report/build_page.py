"""Build the report of a run: one HTML file that holds all it shows."""

import importlib.metadata
import logging
import platform
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from markupsafe import Markup

from roomeq import __version__
from roomeq.core.build import Build
from roomeq.core.constants import FS_HZ
from roomeq.core.files import write_text
from roomeq.report import section_data, section_eq, section_loop, section_rirs, section_speech, section_wer
from roomeq.report.load import Context, Missing, Run, synthetic_corpora
from roomeq.report.render import TEMPLATES, render

logger = logging.getLogger(__name__)

PAGE_FILE = "index.html"
PACKAGES = ("numpy", "scipy", "scikit-learn", "matplotlib", "soundfile", "embreex")


@dataclass(frozen=True)
class Section:
    """A section of the page.

    Parameters
    ----------
    ident : str
        Id of the element and name of the template.
    title : str
        Heading.
    compute : callable
        Returns the values for the template; raises `Missing` if the run lacks them.
    """

    ident: str
    title: str
    compute: Callable[[Run], Context]


SECTIONS = (
    Section("datasets", "Augmented data sets", section_data.datasets),
    Section("listen", "Audio examples", section_speech.audio_examples),
    Section("responses", "Frequency responses", section_rirs.frequency_responses),
    Section("distributions", "EQ distributions", section_eq.eq_distributions),
    Section("spectrograms", "Spectrograms", section_rirs.spectrograms),
    Section("distance", "Distance to measured RIRs", section_eq.distances),
    Section("accuracy", "Accuracy of the compensation", section_eq.accuracy),
    Section("reverberation", "Reverberation times", section_rirs.reverberation),
    Section("loop", "Closed loop: effects added to the simulation", section_loop.closed_loop),
    Section("wer", "Word error rates", section_wer.word_error_rates),
    Section("measured", "Measured RIRs", section_data.measured),
    Section("noise", "Noise", section_speech.noise),
    Section("limits", "Limitations of this run", section_data.limitations),
    Section("run", "Steps and options", section_data.steps))

FACTS = (section_data.facts, section_eq.facts, section_loop.facts, section_wer.facts)
"""Functions that return the values of the cards at the top of the page."""


def make_report(data_dir: Path, exp_dir: Path, out: Path) -> Path:
    """Make one self-contained HTML page of a run: the paper's figures and tables, and audio examples.

    Sections whose inputs are missing name the stage that makes them. The page makes no external requests. The same
    run gives the same bytes.

    Parameters
    ----------
    data_dir : Path
        Output of stages 0 to 6, e.g. ``data``.
    exp_dir : Path
        Parent of `eq`, `loop` and `wer`, the output of stages 3, 5 and 10, e.g. ``exp``.
    out : Path
        Directory to make; it receives `index.html`.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    ValueError
        `data_dir` is missing or holds no directory of a run, a directory in it violates its format, or `out` holds
        files of other origin.
    """
    data_dir, exp_dir, out = Path(data_dir), Path(exp_dir), Path(out)
    run = Run(data_dir, exp_dir)
    if not run.names:
        raise ValueError(f"{data_dir}: no directory of a run in it: run stages 0 to 6 first, or check the path")
    build = Build(out, step="report", options=dict(parts=run.names, benches=run.benches, versions=versions()),
                  inputs=[*(run.path(name) for name in run.names), TEMPLATES])
    if not build.done and build.run({}, lambda name, item: None):
        build.finish(lambda directory, _: write_text(directory / PAGE_FILE, render_page(run)))
    logger.info("report: %s", out / PAGE_FILE)
    return out / PAGE_FILE


def render_page(run: Run) -> str:
    """Return the page of a run as HTML."""
    # the loop needs measured geometry and word error rates need Kaldi: a run without them has no section on them
    sections = [section for section in SECTIONS if section.ident not in ("loop", "wer") or run.has(section.ident)]
    page = render("page", sections=[(section, render_section(run, section)) for section in sections],
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


def versions() -> dict[str, str]:
    """Return the versions of the software that computed the results."""
    installed = {"roomeq": __version__, "Python": platform.python_version()}
    for name in PACKAGES:
        try:
            installed[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            installed[name] = "absent"
    return installed
