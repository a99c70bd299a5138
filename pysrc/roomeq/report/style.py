"""Colours of the page and of its figures.

The palette is that of Okabe and Ito, which colour-blind readers can distinguish; the dark page uses lighter shades.
"""

LIGHT = dict(paper="#ffffff", ink="#1d2430", soft="#5b6675", line="#d9dee5", wash="#f4f6f8",
             measured="#0072b2", simulated="#d55e00", compensated="#00815f", drawn="#a8477d", extra="#6b7280")
"""Colours of a light page, by name."""

DARK = dict(paper="#161b22", ink="#e6eaf0", soft="#9aa6b5", line="#323b47", wash="#1e252e",
            measured="#56b4e9", simulated="#f08c4a", compensated="#35c795", drawn="#e29ac4", extra="#9aa6b5")
"""Colours of a dark page, by name."""


def _variables(colours: dict[str, str]) -> str:
    return "".join(f"--{name}:{value};" for name, value in colours.items())


COLOUR_VARIABLES = f":root{{{_variables(LIGHT)}}}@media (prefers-color-scheme:dark){{:root{{{_variables(DARK)}}}}}"
"""Style sheet that defines the colours as CSS variables, for the page and for each figure."""
