"""The colours of page and figures, and the page's style sheet.

Colours are Okabe and Ito's, which colour-blind readers can tell apart, lightened for a dark page.
"""

LIGHT = dict(paper="#ffffff", ink="#1d2430", soft="#5b6675", line="#d9dee5", wash="#f4f6f8",
             measured="#0072b2", simulated="#d55e00", compensated="#00815f", drawn="#a8477d", extra="#6b7280")
"""Colours on a light page: what each kind of RIR looks like, everywhere."""

DARK = dict(paper="#161b22", ink="#e6eaf0", soft="#9aa6b5", line="#323b47", wash="#1e252e",
            measured="#56b4e9", simulated="#f08c4a", compensated="#35c795", drawn="#e29ac4", extra="#9aa6b5")
"""Colours on a dark page."""


def _variables(colours: dict[str, str]) -> str:
    return "".join(f"--{name}:{value};" for name, value in colours.items())


COLOURS = f":root{{{_variables(LIGHT)}}}@media (prefers-color-scheme:dark){{:root{{{_variables(DARK)}}}}}"
"""Style sheet of the colours as variables, for the page and for each figure."""

CSS = f"""{COLOURS}
*{{box-sizing:border-box}}
html{{-webkit-text-size-adjust:100%;scroll-behavior:smooth}}
body{{margin:0 auto;padding:0 1rem 4rem;max-width:66rem;background:var(--paper);color:var(--ink);
 font:1rem/1.6 system-ui,-apple-system,"Segoe UI",Roboto,"Noto Sans","DejaVu Sans",sans-serif;
 overflow-wrap:anywhere}}
h1{{font-size:clamp(1.6rem,5vw,2.2rem);line-height:1.2;margin:2.2rem 0 .4rem;letter-spacing:-.01em}}
h2{{font-size:1.35rem;line-height:1.3;margin:0 0 .6rem}}
h3{{font-size:1.05rem;margin:1.8rem 0 .4rem}}
section{{margin-top:2.6rem;padding-top:1.6rem;border-top:1px solid var(--line)}}
p,ul{{max-width:46rem;margin:.6rem 0}} ul{{padding-left:1.2rem}} li{{margin:.3rem 0}}
a{{color:var(--measured)}}
code{{font:.9em ui-monospace,SFMono-Regular,Menlo,"DejaVu Sans Mono",monospace;background:var(--wash);
 padding:.1em .3em;border-radius:.25rem}}
.lead{{font-size:1.08rem;color:var(--soft)}}
nav{{margin-top:1.4rem;padding:.9rem 1.2rem;background:var(--wash);border-radius:.6rem}}
nav h2{{font-size:1rem;margin:0}} nav ol{{margin:.3rem 0 0;padding-left:1.4rem;columns:18rem 2;column-gap:2rem}}
nav li{{margin:0 0 .35rem;break-inside:avoid}}
.facts{{display:grid;grid-template-columns:repeat(auto-fit,minmax(9.5rem,1fr));gap:.7rem;
 margin:1.2rem 0;padding:0}}
.facts div{{background:var(--wash);border-radius:.6rem;padding:.7rem .9rem}}
.facts dt{{font-size:.85rem;line-height:1.35;color:var(--soft)}}
.facts dd{{margin:0 0 .15rem;font-size:1.45rem;font-weight:650;line-height:1.25;font-variant-numeric:tabular-nums}}
.facts div{{display:flex;flex-direction:column-reverse;justify-content:flex-end}}
.notice,.warning{{padding:.7rem 1rem;border-left:.3rem solid var(--soft);background:var(--wash);
 border-radius:0 .5rem .5rem 0}}
.warning{{border-color:var(--simulated);max-width:none}}
figure{{margin:1.2rem 0 1.6rem}}
.panels{{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,24rem),1fr));gap:1rem 1.4rem}}
.panels.of3{{grid-template-columns:repeat(auto-fit,minmax(min(100%,18rem),1fr))}} .panels.of1{{max-width:32rem}}
img{{width:100%;max-width:100%;height:auto;display:block}}
figcaption{{font-size:.92rem;line-height:1.5;color:var(--soft);margin:.5rem 0;max-width:46rem}}
.scroll{{overflow-x:auto;max-width:100%}}
table{{border-collapse:collapse;font-size:.92rem;font-variant-numeric:tabular-nums;min-width:min(100%,30rem)}}
th,td{{padding:.38rem .8rem;text-align:left;vertical-align:top;border-bottom:1px solid var(--line);
 overflow-wrap:normal}}
thead th{{font-weight:600;border-bottom:2px solid var(--line);vertical-align:bottom}}
tbody th{{font-weight:500;padding-left:0}} thead th:first-child{{padding-left:0}}
.t{{min-width:6.5rem}} #table-run .t:last-child,#table-screening .t:last-child{{min-width:18rem}}
.n{{text-align:right}} .nw{{white-space:nowrap}} small{{color:var(--soft)}}
tbody tr:hover{{background:var(--wash)}}
.key{{display:inline-block;width:.75em;height:.75em;border-radius:.2em;margin-right:.45em;vertical-align:-.05em}}
.measured{{background:var(--measured)}} .simulated{{background:var(--simulated)}}
.compensated{{background:var(--compensated)}} .drawn{{background:var(--drawn)}} .clean{{background:var(--extra)}}
.clips{{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,24rem),1fr));gap:.8rem;padding:0;
 max-width:none;list-style:none}}
.clips li{{background:var(--wash);border-radius:.6rem;padding:.7rem .9rem;margin:0}}
audio{{width:100%;margin-top:.4rem;display:block}}
details{{margin:.8rem 0}} summary{{cursor:pointer;color:var(--measured)}}
@media print{{body{{max-width:none}} nav,audio{{display:none}} section{{break-inside:avoid}}}}
"""
