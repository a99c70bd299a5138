"""Sphinx configuration of the manual. Build: `sphinx-build -W --keep-going -b html docs docs/_build/html`."""

import os
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent / "pysrc"), str(HERE)]
for library in ("OMP", "OPENBLAS", "MKL", "NUMBA"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

from matplotlib.figure import Figure  # noqa: E402
from sphinx_gallery.scrapers import figure_rst  # noqa: E402

import roomeq  # noqa: E402
from results_tables import write_pages  # noqa: E402

write_pages(HERE / "results")

project = "roomeq"
author = "The roomeq developers"
version = release = roomeq.__version__
extensions = ["myst_parser", "numpydoc", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "sphinx.ext.viewcode",
              "sphinx_click", "sphinx_gallery.gen_gallery"]
exclude_patterns = ["_build", "requirements.txt", "gallery/*.ipynb", "gallery/*.py", "gallery/*.json", "gallery/*.zip",
                    "gallery/*.md5", "sg_execution_times.rst", "**/sg_execution_times.rst"]
templates_path = ["_templates"]
myst_enable_extensions = ["dollarmath", "deflist", "fieldlist"]
myst_heading_anchors = 3
html_theme = "furo"
html_title = f"roomeq {release}"
html_show_sourcelink = False
autosummary_generate = True
autodoc_typehints = "description"
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False


def figures_without_pyplot(block: tuple, variables: dict, gallery: dict) -> str:
    """Show the figures that a block of a tutorial has made without pyplot, as `roomeq.plot_rir` does."""
    new = [value for value in variables["example_globals"].values()
           if isinstance(value, Figure) and not hasattr(value, "number") and value not in _shown]
    paths = []
    for figure, path in zip(new, variables["image_path_iterator"], strict=False):
        figure.savefig(path)
        paths.append(path)
        _shown.append(figure)
    return figure_rst(paths, gallery["src_dir"])


_shown: list[Figure] = []
sphinx_gallery_conf = {
    "image_scrapers": ("matplotlib", figures_without_pyplot),
    "examples_dirs": ["tutorials"],
    "gallery_dirs": ["gallery"],
    "filename_pattern": r"/\d\d_",
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "remove_config_comments": True,
    "within_subsection_order": "FileNameSortKey",
}
suppress_warnings = ["config.cache"]
