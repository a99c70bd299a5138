"""Render templates. Autoescape is on: values cannot become markup, and only templates hold HTML.

The page's Content-Security-Policy also forbids scripts and requests.
"""

import functools
from pathlib import Path
from typing import TYPE_CHECKING, Any

from roomeq.report.formats import duration, hertz, number, percent, with_interval
from roomeq.report.step import TEMPLATES
from roomeq.report.style import COLOUR_VARIABLES

if TYPE_CHECKING:
    from jinja2 import Environment
    from markupsafe import Markup


@functools.cache
def environment(*folders: Path) -> "Environment":
    """Return the environment of the report's templates, and of those of further folders."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    created = Environment(loader=FileSystemLoader([TEMPLATES, *folders]), autoescape=True, undefined=StrictUndefined,
                          trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True)
    created.filters.update(duration=duration, hertz=hertz, number=number, percent=percent, with_interval=with_interval)
    created.globals["colour_variables"] = COLOUR_VARIABLES
    return created


def render(template: str, *folders: Path, **values: Any) -> "Markup":
    """Return a template of the report, or of further folders, filled with values."""
    from markupsafe import Markup

    return Markup(environment(*folders).get_template(f"{template}.html.j2").render(values))
