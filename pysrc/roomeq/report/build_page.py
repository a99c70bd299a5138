"""Making the report of a run: one HTML file that holds everything it shows."""

import importlib.metadata
import logging
import platform
from collections.abc import Callable
from pathlib import Path

from roomeq import __version__
from roomeq.core.build import Build
from roomeq.core.constants import FS_HZ
from roomeq.core.files import write_text
from roomeq.report import section_data, section_eq, section_loop, section_rirs, section_speech, section_wer
from roomeq.report.load import Run
from roomeq.report.page import Html, Missing, document, join, notice, section, tag

logger = logging.getLogger(__name__)

PAGE_FILE = "index.html"
TITLE = "Far-field training data with compensated room responses"
PACKAGES = ("numpy", "scipy", "scikit-learn", "matplotlib", "soundfile", "embreex")

SECTIONS: tuple[tuple[str, str, Callable[[Run], Html]], ...] = (
    ("datasets", "Augmented data sets", section_data.datasets),
    ("listen", "Listen", section_speech.listen),
    ("responses", "Frequency responses", section_rirs.frequency_responses),
    ("distributions", "EQ distributions", section_eq.eq_distributions),
    ("spectrograms", "Spectrograms", section_rirs.spectrograms),
    ("distance", "Distance to measured rooms", section_eq.distances),
    ("accuracy", "Accuracy of the compensation", section_eq.accuracy),
    ("reverberation", "Reverberation times", section_rirs.reverberation),
    ("loop", "What the simulation lacked", section_loop.closed_loop),
    ("wer", "Word error rates", section_wer.word_error_rates),
    ("measured", "The measured RIRs", section_data.measured),
    ("noise", "Noise", section_speech.noise),
    ("limits", "What this run does not show", section_speech.limits),
    ("run", "What ran", section_data.what_ran),
)


def make_report(data_dir: Path, exp_dir: Path, out: Path) -> Path:
    """Make one self-contained HTML page of a run: the paper's figures and tables, and audio to play.

    Parts of the run that are not there are named with the stage that makes them. The page asks for nothing from
    outside, and the same run gives the same bytes.

    Parameters
    ----------
    data_dir : Path
        Where stages 0-6 wrote, e.g. ``data``.
    exp_dir : Path
        Where stages 3, 5 and 10 wrote `eq`, `loop` and `wer`, e.g. ``exp``.
    out : Path
        Directory to make; it gets `index.html`.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    ValueError
        `data_dir` is not there or holds nothing of a run, a directory in it breaks its contract, or `out` holds
        something else.
    """
    data_dir, exp_dir, out = Path(data_dir), Path(exp_dir), Path(out)
    run = Run(data_dir, exp_dir)
    if not run.names:
        raise ValueError(f"{data_dir}: no directory of a run in it: run stages 0 to 6 first, or check the path")
    build = Build(out, step="report", options=dict(parts=run.names, benches=run.benches, versions=versions()),
                  inputs=[run.path(name) for name in run.names])
    if not build.done and build.run({}, lambda name, item: None):
        build.finish(lambda directory, _: write_text(directory / PAGE_FILE, render_page(run)))
    logger.info("report: %s", out / PAGE_FILE)
    return out / PAGE_FILE


def render_page(run: Run) -> str:
    """Return the page of a run."""
    # corpora without geometry have no loop, runs without Kaldi no word error rates, and their pages no chapter on it
    shown = [one for one in SECTIONS if one[0] not in ("loop", "wer") or run.has(one[0])]
    made = [section(ident, title, body(run, make)) for ident, title, make in shown]
    return document(TITLE, header(run), [(ident, title) for ident, title, _ in shown], made)


def body(run: Run, make: Callable[[Run], Html]) -> Html:
    """Return a section's content, or the box that says what is missing for it."""
    try:
        return make(run)
    except Missing as missing:
        return notice(missing)


def versions() -> dict[str, str]:
    """Return the versions of what made the numbers."""
    found = {"roomeq": __version__, "Python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "absent"
    return found


def header(run: Run) -> Html:
    """Return the top of the page: what this is, what is not real, the numbers that matter."""
    lead = tag("p", "Clean speech was made far-field with measured and with simulated room impulse responses "
               "(RIRs). Simulation by rays misses what rooms and loudspeakers do to low frequencies; the "
               "simulated RIRs were given the sub-band EQ that measured ones have. This page shows what went in, "
               "what came out and how near it comes.", class_="lead")
    used = ", ".join(f"{name} {version}" for name, version in versions().items())
    return join([lead, section_data.synthetic_corpus_warning(run), facts(run),
                 tag("p", tag("small", f"All audio at {FS_HZ // 1000} kHz. Made with {used}."))])


def facts(run: Run) -> Html:
    """Return the run's main numbers as a list of cards."""
    cards = []
    for make in (section_data.amounts, section_eq.main_numbers, section_loop.main_numbers,
                 section_wer.main_numbers):
        try:
            cards += make(run)
        except Missing:
            continue
    return tag("dl", *(tag("div", tag("dt", name), tag("dd", value)) for name, value in cards), class_="facts")
