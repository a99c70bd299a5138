"""The step that makes the report. What it draws with is imported where there is work to do."""

import importlib.metadata
import logging
import platform
from collections.abc import Sequence
from pathlib import Path

from roomeq import __version__
from roomeq.core.build import Build
from roomeq.core.files import write_text
from roomeq.report.kinds import KIND_NAMES
from roomeq.report.load import OTHER_WER, Run

logger = logging.getLogger(__name__)

PAGE_FILE = "index.html"
PACKAGES = ("numpy", "scipy", "scikit-learn", "matplotlib", "soundfile")
TEMPLATES = Path(__file__).parent / "templates"


def make_report(data_dir: Path, exp_dir: Path, out: Path, *, kinds: Sequence[str] = KIND_NAMES) -> Path:
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
    kinds : sequence of str
        Kinds of RIRs to report, where they are there; others may be left of an earlier run in the same directories.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    ValueError
        `data_dir` is missing or holds no directory of a run, a directory in it violates its format, a kind is unknown,
        or `out` holds files of other origin.
    """
    data_dir, exp_dir, out = Path(data_dir), Path(exp_dir), Path(out)
    for kind in kinds:
        if kind not in KIND_NAMES:
            raise ValueError(f"kinds: {kind!r} must be one of {', '.join(KIND_NAMES)}")
    run = Run(data_dir, exp_dir, tuple(kinds))
    if not run.names:
        raise ValueError(f"{data_dir}: no directory of a run in it: run stages 0 to 6 first, or check the path")
    build = Build(out, step="report", options=dict(parts=run.names, benches=run.benches, versions=versions()),
                  inputs=[*(run.path(name) for name in run.names), TEMPLATES])
    if not build.done and build.run({}, lambda name, item: None):
        from roomeq.report.build_page import render_page

        build.finish(lambda directory, _: write_text(directory / PAGE_FILE, render_page(run)))
    if run.other_wer:
        logger.warning("%s", OTHER_WER.format(exp_dir / "wer"))
    logger.info("report: %s", out / PAGE_FILE)
    return out / PAGE_FILE


def versions() -> dict[str, str]:
    """Return the versions of the software that computed the results."""
    installed = {"roomeq": __version__, "Python": platform.python_version()}
    for name in PACKAGES:
        try:
            installed[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            installed[name] = "absent"
    return installed
