"""The chapter about the closed loop: what the simulation lacked, what adding it was worth, what stays unexplained."""

import re
import sys

import numpy as np

from roomeq.core.constants import BANDS_HZ
from roomeq.effects.catalogue import CATALOGUE
from roomeq.effects.response import RESPONSE_HZ, Response
from roomeq.loop.descriptions import describe_effect, describe_residual, effect_names
from roomeq.loop.examples import DECAY_BANDS, EXAMPLES_FILE, KINDS, STEP_S, Examples, read_examples
from roomeq.loop.features import BAND_OF_FEATURE, METRIC, REGION, THIRDS_HZ
from roomeq.loop.ledger import LEDGER_FILE, RESIDUALS_FILE, read_ledger, read_residuals
from roomeq.loop.selection import SPLITS
from roomeq.loop.unexplained import Unexplained
from roomeq.report import figures, figures_loop
from roomeq.report.load import Run
from roomeq.report.page import Html, figure, hertz, join, number, paragraph, tag
from roomeq.report.page import table as make_table

REGIONS = ("ahead", "direct", "early", "late", "whole", "floor")
"""In the order of time; what is measured over all of it comes before the noise."""

NAMES = {"direct": "level, direct sound", "early": "level, up to 50 ms", "late": "level, 50 to 200 ms",
         "spectrum": "level, whole", "edt": "EDT", "t20": "T20", "t30": "T30", "c50": "C50", "drr": "DRR",
         "arrival": "arrival", "ahead": "sound ahead of it", "floor": "noise"}
"""Of metrics, for people."""

SPLIT_NAMES = {split: split.replace("_", "-") for split in SPLITS}
COLOURS = dict(zip(KINDS, ("measured", "simulated", "compensated"), strict=True))
LABELS = dict(zip(KINDS, ("measured", "simulated, before", "simulated, after"), strict=True))


def ledger_of(run: Run) -> dict:
    """Return the run's ledger, read once."""
    return run.once("ledger", lambda: read_ledger(run.need("loop", LEDGER_FILE)))


def closed_loop(run: Run) -> Html:
    """Return the chapter."""
    ledger = ledger_of(run)
    parts = [paragraph(
        f"Each of {ledger['rirs']} measured RIRs of {ledger['rooms']} rooms was simulated at its own place. Only what "
        "nobody declared was fitted: absorption of each room, and the gain of its recordings. Every effect of the "
        "catalogue was then tried as the cause of what is left, and judged by rooms that its fit had not seen. The "
        "best was switched on, everything was simulated again, and it stayed if the error on rooms left out fell. "
        "Errors are in just noticeable differences (JND): 1 dB of level, 5 % of a decay time, 1.1 dB of C50, 2 dB of "
        "DRR."), already(ledger), findings(ledger), errors_table(ledger)]
    if ledger["iterations"]:
        parts.append(effects_table(ledger))
    parts += [residual_maps(run, ledger), rankings(ledger), splits(ledger), responses(ledger)]
    if (run.path("loop") / EXAMPLES_FILE).is_file():
        parts.append(examples_figure(read_examples(run.path("loop") / EXAMPLES_FILE)))
    return join([*parts, unexplained(ledger), cautions(ledger, run.has("wer"))])


def main_numbers(run: Run) -> list[tuple[str, str]]:
    """Return the result that the top of the page shows."""
    if not run.has("loop"):
        return []
    ledger = ledger_of(run)
    before, after = (ledger[when]["leave_positions_out"]["error"] for when in ("baseline", "final"))
    return [(f"JND off at places left out, before and after the loop added {len(ledger['iterations'])} effects",
             f"{before:.1f} \u2192 {after:.1f}")]


def about(effect: str) -> str:
    """Return what an effect is, as its own file says it."""
    return sys.modules[CATALOGUE[effect].__module__].__doc__.splitlines()[0].rstrip(".:").split(" (`")[0]


def sentence(words: str) -> str:
    """Return words as a sentence, with real minus signs."""
    return re.sub(r"(?<!\w)-(?=\d)", "\u2212", f"{words[:1].upper()}{words[1:]}.")


def already(ledger: dict) -> Html:
    """Say which effects the loop began with."""
    return paragraph("The model had from the beginning: ", ", ".join(ledger["given"]), ".") if ledger["given"] else ""


def findings(ledger: dict) -> Html:
    """Return a sentence for each effect found."""
    if not ledger["iterations"]:
        return paragraph(tag("strong", "No effect helps on rooms left out; nothing was added."))
    return tag("ul", *(tag(
        "li", tag("strong", effect_names(entry)), f": {about(entry['effect'])}. "
        f"{sentence(describe_effect(entry['effect'], entry['parameters']))} Held-out error "
        f"{entry['heldout_error_before']:.2f} \u2192 {entry['heldout_error_after']:.2f} JND (95 % interval "
        f"{entry['heldout_error_ci'][0]:.2f} to {entry['heldout_error_ci'][1]:.2f})",
        join(["; the data cannot tell which of them. It would take ", " or ".join(entry["would_tell"])])
        if "would_tell" in entry else "", ".") for entry in ledger["iterations"]))


def errors_table(ledger: dict) -> Html:
    """Return the held-out errors before and after, those of the judge included."""
    def row(name: str, n_rirs: int, n_rooms: int, before: dict, after: dict) -> list:
        return [name, n_rirs, n_rooms, with_interval(before), with_interval(after),
                f"{100 * (1 - after['error'] / max(before['error'], 1e-9)):.0f} %".replace("-", "\u2212")]

    rows = [row(SPLIT_NAMES[split].capitalize(), ledger["rirs"], ledger["rooms"], ledger["baseline"][split],
                ledger["final"][split]) for split in SPLITS]
    if test := ledger.get("test"):
        rows += [row(f"Test set, {SPLIT_NAMES[split]}", test["rirs"], test["rooms"], test["before"][split],
                     test["after"][split]) for split in SPLITS]
    return make_table(
        "table-loop-errors", "Mean error in JND with 95 % intervals over rooms. Leave-positions-out: half of the "
        "room's RIRs calibrate its surfaces, the others are scored. Leave-room-out: only the reverberation time at "
        "1 kHz and the gains are known of the room, the rest comes from other rooms",
        ["Scored on", "RIRs", "Rooms", "Before", "After", "Less by"], rows)


def with_interval(entry: dict) -> Html:
    """Return an error with its interval, which a single room has not."""
    around = "" if entry["ci"] is None else f" ({entry['ci'][0]:.2f}\u2013{entry['ci'][1]:.2f})"
    return tag("span", f"{entry['error']:.2f}{around}", class_="nw")


def effects_table(ledger: dict) -> Html:
    """Return what was added, with parameters in short."""
    rows = [[effect_names(entry), entry["scope"], in_short(entry["parameters"]), number(entry["size_jnd"]),
             f"{entry['heldout_error_before']:.2f} \u2192 {entry['heldout_error_after']:.2f}",
             SPLIT_NAMES[entry["scored_on"]], f"{entry['p']:.1g}"] for entry in ledger["iterations"]]
    return make_table(
        "table-loop", "What the loop added, in its order. Size: mean change of the values that the effect touches; p: "
        "that the error falls by so much by chance (paired; leave-positions-out: randomisation of the signs of halves "
        "of rooms, leave-room-out: t test over rooms)",
        ["Effect", "Of each", "Parameters", "Size (JND)", "Held-out error (JND)", "Scored on", "p"], rows, (0, 1, 2, 5))


def in_short(parameters: dict) -> str:
    """Return an effect's parameters in a line: each unit's where there are few, else their range."""
    best = {unit: one["best"] for unit, one in parameters.items()}
    fields = list(next(iter(best.values()), {}))
    if not fields:
        return "none"
    said = []
    for name in fields:
        values = {unit: np.atleast_1d(one[name]) for unit, one in best.items()}
        if max(map(len, values.values())) > 1:
            said.append(f"{name} {number(min(map(np.min, values.values())))} to "
                        f"{number(max(map(np.max, values.values())))}")
        elif len(values) <= 2:
            said.append(f"{name} " + ", ".join(f"{value[0]:.3g}" + (f" ({unit})" if unit != "all" else "")
                                               for unit, value in values.items()))
        else:
            every = np.concatenate(list(values.values()))
            said.append(f"{name} {np.median(every):.3g} ({every.min():.3g} to {every.max():.3g})")
    return "; ".join(said).replace("-", "\u2212")


def residual_sizes(residual: np.ndarray) -> np.ndarray:
    """Return the mean size of residuals by region of time and band, shape (6, 9) [JND]; the ninth has no band."""
    region = np.array([REGION[metric] for metric in METRIC])
    result = np.full((len(REGIONS), len(BANDS_HZ) + 1), np.nan)
    for r, name in enumerate(REGIONS):
        for column, band in enumerate([*range(len(BANDS_HZ)), -1]):
            features = residual[:, (region == name) & (BAND_OF_FEATURE == band)]
            if np.isfinite(features).any():
                result[r, column] = np.nanmean(np.abs(features))
    return result


def residual_maps(run: Run, ledger: dict) -> Html:
    """Return the residuals before and after by time and frequency."""
    found = read_residuals(run.need("loop", RESIDUALS_FILE), ledger["rirs"])
    maps = {when: residual_sizes(found[when]) for when in ("before", "after")}
    largest = float(np.nanmax(list(maps.values())))
    panels = [figures.panel(f"figure-loop-map-{when}", figures_loop.residual_map(
        {"before": "Before", "after": "After"}[when], sizes, list(REGIONS), largest),
        f"Mean size of what is left {when} the loop: " + "; ".join(
            f"{name} {number(float(np.nanmean(row)))} JND" for name, row in zip(REGIONS, sizes, strict=True)
            if np.isfinite(row).any())) for when, sizes in maps.items()]
    return figure("figure-loop-map", panels, "Where the simulation is off: mean size of measured less simulated, in "
                  "JND, by region of time (ahead of the direct sound; direct, 2.5 ms; early, up to 50 ms; late; the "
                  "whole response; noise behind it) and octave. This map is of all RIRs after calibration, those that "
                  "the calibration saw included; the errors above are of RIRs left out.")


def rankings(ledger: dict) -> Html:
    """Return the candidates of each iteration."""
    rounds = [(f"Round {n}", entry["ranking"], entry["effect"])
              for n, entry in enumerate(ledger["iterations"], start=1)]
    rounds.append(("When it stopped", ledger["ranking"], None))
    panels = []
    for n, (title, candidates, chosen) in enumerate(rounds, start=1):
        if candidates:
            values = [(one["effect"], one["gain"] / ledger["rooms"], *one["ci"]) for one in candidates]
            panels.append(figures.panel(
                f"figure-loop-ranking-{n}", figures_loop.ranking(title, values, chosen),
                f"{title}: " + ", ".join(f"{name} {number(mean)}" for name, mean, *_ in values)))
    return figure("figure-loop-ranking", panels, "Candidates by what they are worth on a room that took no part in "
                  "their fit, mean and 95 % interval over rooms, on a scale that is linear up to 10. Green: added. One "
                  "with a high gain that is not added did not lower the error when it was simulated.")


def splits(ledger: dict) -> Html:
    """Return the errors by metric and by band."""
    before, after = (ledger[when]["leave_positions_out"] for when in ("baseline", "final"))
    metrics = list(before["by_metric"])
    by_metric = [[entry["by_metric"].get(metric, np.nan) for metric in metrics] for entry in (before, after)]
    by_band = [[np.nan if one is None else one for one in entry["by_band"]] for entry in (before, after)]

    def panel(ident: str, names: list[str], values: list[list[float]]) -> Html:
        alt = "; ".join(f"{name} {number(b)} to {number(a)} JND" for name, b, a in zip(names, *values, strict=True))
        return figures.panel(ident, figures_loop.before_and_after(names, *values), alt)

    return figure("figure-loop-split", [
        panel("figure-loop-metrics", [NAMES[metric] for metric in metrics], by_metric),
        panel("figure-loop-bands", [hertz(band_hz) for band_hz in BANDS_HZ], by_band)],
        "Held-out error (leave-positions-out) by metric and by octave band.")


def responses(ledger: dict) -> Html:
    """Return the frequency responses that were found, or nothing."""
    panels = []
    for entry in ledger["iterations"]:
        if issubclass(CATALOGUE[entry["effect"]], Response):
            units = [(unit, *(np.array(one.get(key, one["best"])["gains_db"]) for key in ("best", "low", "high")))
                     for unit, one in entry["parameters"].items()]
            alt = "; ".join(f"{unit}: {number(best.min())} to {number(best.max())} dB" for unit, best, *_ in units)
            draw = figures_loop.response_curves(entry["effect"], RESPONSE_HZ, units)
            panels.append(figures.panel(f"figure-loop-{entry['effect']}", draw, alt))
    if not panels:
        return Html("")
    return figure("figure-loop-responses", panels, "Responses that were found, in third octaves, with 95 % intervals "
                  "(jackknife over rooms) as fitted when the effect was added. A gain that all of them share cannot be "
                  "told from that of the recordings.")


def examples_figure(found: Examples) -> Html:
    """Return decay curves and spectra of a few RIRs, measured and simulated."""
    made = []
    time_s = np.arange(found.decay_db.shape[-1]) * STEP_S
    for n, (ident, room) in enumerate(zip(found.ids, found.rooms, strict=True), start=1):
        spectra = found.spectrum_db[n - 1] - np.nanmean(found.spectrum_db[n - 1][0])
        panels = [example_panel(f"spectrum-{n}", "Spectrum", np.array(THIRDS_HZ), spectra, "Level (dB)", ident,
                                frequency=True, limits=figures.common_limits(spectra))]
        panels += [example_panel(f"decay-{n}-{BANDS_HZ[band]:g}", f"Decay at {BANDS_HZ[band]:g} Hz", time_s,
                                 found.decay_db[n - 1, :, k], "Energy to come (dB)", ident, limits=(-50.0, 2.0))
                   for k, band in enumerate(DECAY_BANDS)]
        made.append(figure(f"figure-loop-example-{n}", panels, join([
            tag("code", ident), " of room ", tag("code", room), ": measured, and simulated at its place with the "
            "surfaces that calibration found."])))
    return join([paragraph("Of a small, a middling and a large room, the RIR at the median distance:"), *made])


def example_panel(ident: str, title: str, x: np.ndarray, values: np.ndarray, label: str, rir: str, **how) -> Html:
    """Return one panel of the examples."""
    lines: list[tuple[str, str, np.ndarray]] = [(LABELS[kind], COLOURS[kind], one)
                                                for kind, one in zip(KINDS, values, strict=True)]
    return figures.panel(f"figure-loop-{ident}", figures_loop.curves(title, x, lines, label, **how),
                         f"{title} of {rir}: measured, simulated before and after", figures.SMALL_IN)


def unexplained(ledger: dict) -> Html:
    """Return what is left, in words."""
    if not ledger["unexplained_all"]:
        return paragraph(tag("strong", "Nothing is left unexplained"),
                         " that is more than chance and could be heard.")
    return join([
        paragraph(tag("strong", "What stays unexplained."), " No effect of the catalogue accounts for it; it is named "
                  "by where it sits, not by a cause:"),
        tag("ul", *(tag("li", sentence(describe_residual(Unexplained(**one)))) for one in ledger["unexplained_all"]))])


def cautions(ledger: dict, trained: bool) -> Html:
    """Return what the loop does not show."""
    points = [
        "An effect that is not found may be there: below half a JND, or where the rooms are too few, it cannot be told "
        "from chance.",
        "A name says which of the catalogue's effects predicts unseen rooms best. Something that acts alike and is not "
        "in the catalogue would bear the same name.",
        f"Rooms are left out of {ledger['rooms']}, all measured by the same people with the same devices. How far "
        "the model holds for others, these data cannot say.",
        "Parameters were fitted to these loudspeakers and microphones. Others get parameters drawn from their spread."]
    if not trained:
        points.append("No recogniser was trained on what the extended model simulates.")
    if "test" in ledger:
        points.insert(3, "The RIRs that took no part may come from rooms that did, unless the split was by room.")
    return join([paragraph(tag("strong", "What this does not show.")), tag("ul", *(tag("li", one) for one in points))])
