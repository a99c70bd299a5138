"""The page on the output of the closed loop: what was found, what it is worth, and what to do next."""

from pathlib import Path
from typing import Any

import numpy as np

from roomeq.acoustics.octaves import THIRDS_HZ
from roomeq.core.constants import FS_HZ
from roomeq.effects.catalogue import CATALOGUE
from roomeq.effects.noise_floor import NoiseFloor
from roomeq.effects.response import RESPONSE_HZ, Response
from roomeq.loop.descriptions import advise_on_residual, describe_effect, describe_residual, effect_label
from roomeq.loop.examples import EXAMPLES_FILE, Examples, read_examples
from roomeq.loop.heldout_errors import SPLITS
from roomeq.loop.ledger import LEDGER_FILE, added_effects, read_ledger
from roomeq.loop.unexplained import Unexplained
from roomeq.report import figures, figures_loop, section_loop
from roomeq.report.figures import Draw, Panel, panel
from roomeq.report.formats import number, percent
from roomeq.report.load import Context, Run
from roomeq.show.clips import Clip, clips
from roomeq.show.pages import SEE, Part, make_page
from roomeq.show.sheet import png
from roomeq.show.step import PICTURE

SCOPES = {"all": "all recordings", "source": "each loudspeaker", "mic": "each microphone", "room": "each room",
          "rir": "each recording"}
_MARGIN_DB = 3.0
_MAX_UNITS = 6  # curves in a panel


class LoopRun(Run):
    """A run of which only the output of the closed loop is known, whatever its directory is called."""

    def path(self, name: str) -> Path:
        """Return the loop's directory, or one that does not exist."""
        return self.exp_dir if name == "loop" else self.exp_dir / "absent" / name


def loop_context(directory: Path, speech: Path | None) -> Context:
    """Return what the template of a loop shows.

    Parameters
    ----------
    directory : Path
        Output of ``roomeq close-loop``.
    speech : Path, optional
        Recording of dry speech to listen to.
    """
    ledger = read_ledger(directory / LEDGER_FILE)
    examples = read_examples(directory / EXAMPLES_FILE)
    run = LoopRun(directory, directory)
    return {"ledger": ledger, "left_out": section_loop.left_out(ledger), "scored": section_loop.scored(ledger),
            "effects": found(ledger), "error_rows": section_loop.error_rows(ledger),
            "explained_rows": section_loop.explained_rows(ledger), "at_ceiling": section_loop.at_ceiling(ledger),
            "splits": section_loop.splits(ledger), "maps": section_loop.residual_maps(run, ledger),
            "gains": gain_panels(ledger), "geometry_rows": section_loop.geometry_rows(ledger),
            "facings": section_loop.facings(ledger),
            "power_rows": [[effect_label(effect), *rest] for effect, *rest in section_loop.power_rows(ledger)],
            "places": places(examples, speech), "residuals": residuals(ledger)}


def loop_facts(ledger: dict[str, Any]) -> list[tuple[str, str]]:
    """Return value and label of the cards at the top of the page."""
    before, after, ceiling = (ledger[when][SPLITS[0]]["error"] for when in ("baseline", "final", "ceiling"))
    cards = [(str(len(added_effects(ledger))), "effects that the simulation lacked"),
             (f"{number(before, 2)} → {number(after, 2)}", "JND error on held-out positions, before and after"),
             (number(ceiling, 2), "JND is the smallest error that is possible (ceiling)")]
    share = ledger["explained"][SPLITS[0]]["share"]
    if share is not None:
        cards.append((percent(share), "of the explainable error is explained"))
    return cards


def found(ledger: dict[str, Any]) -> list[Context]:
    """Return each added effect in words: name, what it applies to, its parameters, errors and rivals."""
    effects = []
    for entry in added_effects(ledger):
        rivals = [effect_label(name) for name in entry.get("cannot_tell", []) if name != entry["effect"]]
        described = section_loop.sentence(describe_effect(entry["effect"], entry["parameters"], entry.get("sum_with")))
        low, high = entry["heldout_error_ci"]
        effects.append({"label": effect_label(entry["effect"]), "code": entry["effect"], "rivals": rivals,
                        "applies_to": SCOPES[entry["scope"]], "parameters": described,
                        "size_jnd": entry["size_jnd"], "before": entry["heldout_error_before"],
                        "after": entry["heldout_error_after"], "low": low, "high": high,
                        "scored_on": section_loop.SPLIT_LABELS[entry["scored_on"]],
                        "would_tell": entry.get("would_tell", [])})
    return effects


def gain_panels(ledger: dict[str, Any]) -> list[Panel]:
    """Draw every list of gains or levels of an added effect over frequency."""
    panels = []
    for entry in added_effects(ledger):
        effect = CATALOGUE[entry["effect"]]
        if issubclass(effect, (Response, NoiseFloor)):
            is_gain = issubclass(effect, Response)
            key, frequencies_hz = ("gains_db", RESPONSE_HZ) if is_gain else ("levels_db", THIRDS_HZ)
            shown = dict(list(entry["parameters"].items())[:_MAX_UNITS])
            bands, alt = section_loop.response_bands(shown, key)
            label = effect_label(entry["effect"])
            panels.append(panel(f"figure-gains-{entry['effect']}",
                                gain_curves(f"{label[0].upper()}{label[1:]}", frequencies_hz, bands,
                                            "Gain (dB)" if is_gain else "Noise re response (dB)"), alt))
    return panels


def gain_curves(title: str, frequencies_hz: tuple[float, ...], bands: list[figures_loop.ResponseBand],
                label: str) -> Draw:
    """Draw gains or levels over frequency with their intervals."""
    inner = figures_loop.response_curves(title, frequencies_hz, bands)

    def draw(axes: Any, colours: dict[str, str]) -> None:
        inner(axes, colours)
        axes.set_ylabel(label)
        levels_db = np.array([(band.low, band.best, band.high) for band in bands])
        axes.set_ylim(levels_db.min() - _MARGIN_DB, levels_db.max() + _MARGIN_DB)
    return draw


def places(examples: Examples, speech: Path | None) -> list[Context]:
    """Return the players and figures of each example: measured, before and after at the same place."""
    shown = []
    drawn = section_loop.example_figures(examples)
    for number_of_example, (rirs, figure) in enumerate(zip(examples.rirs, drawn, strict=True), start=1):
        labels = section_loop.LABELS.values()
        players = clips([(label, colour, rir.astype(np.float64), FS_HZ) for label, colour, rir in zip(
            labels, section_loop.COLOURS.values(), rirs, strict=True)], speech, with_responses=False)
        renamed = [Clip(f"{clip.ident}-{number_of_example}", clip.label, clip.colour, clip.src) for clip in players]
        shown.append({**figure, "clips": renamed})
    return shown


def residuals(ledger: dict[str, Any]) -> list[Context]:
    """Return each unexplained residual in words, and what to do about it."""
    entries = [Unexplained(**residual) for residual in ledger["unexplained_all"]]
    return [{"text": section_loop.sentence(describe_residual(entry)),
             "advice": section_loop.sentence(advise_on_residual(entry))} for entry in entries]


def loop_draws(directory: Path) -> list[Draw]:
    """Return the functions that draw the panels of a loop, for a sheet."""
    ledger = read_ledger(directory / LEDGER_FILE)
    metrics, by_metric, by_band = section_loop.split_errors(ledger)
    return [figures_loop.before_and_after(metrics, *by_metric),
            figures_loop.before_and_after(list(figures.TICK_LABELS), *by_band)]


def show_loop(directory: Path, suffix: str | None, speech: Path | None) -> bytes | str:
    """Return the page, picture or text of a loop."""
    ledger = read_ledger(directory / LEDGER_FILE)
    if suffix is None:
        lines = [f"{value}: {label}" for value, label in loop_facts(ledger)]
        lines += [f"\nThe simulation lacked: {effect['label']} ({effect['code']}), of {effect['applies_to']}. "
                  f"{effect['parameters']}" for effect in found(ledger)]
        lines += [f"\n{text}" for text in (section_loop.scored(ledger),) if text]
        lines += [f"\n{section_loop.sentence(facing)}" for facing in section_loop.facings(ledger)]
        lines += [f"\nUnexplained: {entry['text']}\nWhat to do: {entry['advice']}" for entry in residuals(ledger)]
        return "\n".join([*lines, "", SEE])
    if suffix == PICTURE:
        return png(loop_draws(directory), "Held-out error before and after the closed loop")
    lead = (f"The closed loop compared a simulation with {ledger['rirs']} measured room impulse responses (RIRs) of "
            f"{ledger['rooms']} rooms, and added what the simulation lacked. Errors are in just noticeable differences "
            "(JND).")
    return make_page("What the simulation lacked", lead, loop_facts(ledger), [], _loop_parts(directory, speech))


def _loop_parts(directory: Path, speech: Path | None) -> list[Part]:
    context = loop_context(directory, speech)
    parts: list[Part] = [("loop_found", "What was found", context), ("loop_errors", "Before and after", context)]
    if context["gains"]:
        parts.append(("loop_gains", "Gains over frequency", context))
    return [*parts, ("loop_listen", "Measured, before and after", context),
            ("loop_unexplained", "What remains, and what to do", context)]
