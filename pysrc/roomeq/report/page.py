"""The page as HTML: escaping by construction, the parts that sections are made of, the style sheet.

Every text that goes into a tag is escaped unless it is `Html` already, so that an id or a path cannot become
markup. The page's Content-Security-Policy forbids scripts and requests besides, should that ever fail.
"""

import base64
import html
import math

from roomeq.report.style import CSS

POLICY = "default-src 'none'; img-src data:; media-src data:; style-src 'unsafe-inline'"


class Html(str):
    """Text that is HTML already and is not escaped again."""


class Missing(Exception):  # noqa: N818 - not an error: the section says so and the page goes on
    """A part of the run that a section needs is not there.

    Parameters
    ----------
    what : str
        What is missing, e.g. ``"data/rirs.sim.EQ.train"``.
    maker : str
        What makes it, e.g. ``"stage 4 (roomeq compensate)"``.
    """

    def __init__(self, what: str, maker: str):
        super().__init__(f"{what} is not there: {maker} makes it")
        self.what, self.maker = what, maker


def escape(value) -> Html:
    """Return a value as HTML text; `Html` comes back as it is."""
    if isinstance(value, Html):
        return value
    # a file name that is not UTF-8 reaches us with lone surrogates, which no page can hold
    return Html(html.escape(str(value).encode("utf-8", "replace").decode(), quote=True))


def tag(name: str, *children, **attributes) -> Html:
    """Return an element; ``class_`` stands for ``class``, ``_`` for ``-``, None leaves an attribute out."""
    words = "".join(f' {key.rstrip("_").replace("_", "-")}="{escape(value)}"'
                    for key, value in attributes.items() if value is not None)
    if name in ("img", "meta", "br"):
        return Html(f"<{name}{words}>")
    return Html(f"<{name}{words}>{join(children)}</{name}>")


def join(parts, separator: str = "") -> Html:
    """Return the parts one after the other, each escaped where it is not HTML."""
    return Html(escape(separator).join(escape(part) for part in parts))


def paragraph(*children) -> Html:
    """Return a paragraph of text."""
    return tag("p", *children)


def notice(missing: Missing) -> Html:
    """Return the box that stands where a part of the run is missing."""
    return tag("p", tag("strong", "Not in this run: "), missing.what, ". ", "It is made by ", missing.maker, ".",
               class_="notice")


def table(ident: str, caption, head: list, rows: list[list], text: tuple[int, ...] = (0,)) -> Html:
    """Return a table in a box that scrolls by itself.

    Parameters
    ----------
    ident : str
        Id of the table.
    caption : str or Html
    head : list
        Column headings.
    rows : list of list
        Cells; the first of a row is its heading.
    text : tuple of int
        Columns of text, aligned left; all others are numbers, aligned right.
    """
    def cell(kind: str, column: int, value, scope: str | None = None) -> Html:
        return tag(kind, value, scope=scope, class_="t" if column in text else "n")

    head_row = tag("tr", *(cell("th", n, name, "col") for n, name in enumerate(head)))
    body = [tag("tr", cell("th", 0, row[0], "row"), *(cell("td", n, value) for n, value in enumerate(row[1:], 1)))
            for row in rows]
    name = f"{ident}-caption"
    whole = tag("table", tag("thead", head_row), tag("tbody", *body), id=ident, aria_labelledby=name)
    return tag("figure", tag("figcaption", caption, id=name),
               tag("div", whole, class_="scroll", role="region", tabindex="0", aria_labelledby=name))


def picture(ident: str, svg: bytes, alt: str, width: int, height: int) -> Html:
    """Return an image.

    Parameters
    ----------
    ident : str
    svg : bytes
    alt : str
        What the picture shows, for who can't see it.
    width, height : int
        Its size in CSS pixels, so that nothing jumps while the page loads.
    """
    return tag("img", id=ident, src=data_uri("image/svg+xml", svg), alt=alt, width=width, height=height)


def figure(ident: str, pictures: list[Html], caption) -> Html:
    """Return pictures side by side (one below the other on a phone) with one caption."""
    panels = tag("div", *pictures, class_=f"panels of{len(pictures)}")
    return tag("figure", panels, tag("figcaption", caption), id=ident)


def number(value: float | None, decimals: int = 1) -> str:
    """Return a number as text with a real minus sign; a dash for None and for what is not finite."""
    if value is None or not math.isfinite(value):
        return "–"
    return f"{value:.{decimals}f}".replace("-", "−")


def percent(share: float, decimals: int = 0) -> str:
    """Return a share as percent, which do not break from their sign."""
    return f"{number(100 * share, decimals)}\N{NO-BREAK SPACE}%"


def hertz(value: float) -> str:
    """Return a frequency as text that does not break between number and unit."""
    return f"{value:g}\N{NO-BREAK SPACE}Hz"


def data_uri(mime: str, data: bytes) -> Html:
    """Return bytes as a ``data:`` address."""
    return Html(f"data:{mime};base64,{base64.b64encode(data).decode()}")


def section(ident: str, title: str, *children) -> Html:
    """Return a section with its heading."""
    return tag("section", tag("h2", title), *children, id=ident, aria_label=title)


def document(title: str, header: Html, contents: list[tuple[str, str]], sections: list[Html]) -> str:
    """Return the whole page.

    Parameters
    ----------
    title : str
    header : Html
        What comes before the table of contents.
    contents : list of (str, str)
        Id and title of each section.
    sections : list of Html
    """
    toc = tag("nav", tag("h2", "Contents"), tag("ol", *(
        tag("li", tag("a", name, href=f"#{ident}")) for ident, name in contents)), aria_label="Contents")
    head = join([tag("meta", charset="utf-8"), tag("meta", http_equiv="Content-Security-Policy", content=POLICY),
                 tag("meta", name_="viewport", content="width=device-width, initial-scale=1"),
                 tag("meta", name_="color-scheme", content="light dark"), tag("title", title),
                 tag("style", Html(CSS))], Html("\n"))
    body = tag("body", tag("header", tag("h1", title), header), Html("\n"), toc, Html("\n"),
               tag("main", join(sections, Html("\n"))))
    return f'<!DOCTYPE html>\n<html lang="en">\n<head>\n{head}\n</head>\n{body}\n</html>\n'
