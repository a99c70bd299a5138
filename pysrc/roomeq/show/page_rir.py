"""The sections of a page on one RIR."""

from pathlib import Path

from roomeq.records.parameters import reverberation_time_s, value_of
from roomeq.records.schema import RirRow
from roomeq.report import figures
from roomeq.report.figures import SMALL_IN, TICKS, Draw, Panel, panel
from roomeq.report.figures_room import VIEWS, room_view
from roomeq.report.formats import number
from roomeq.report.load import Context
from roomeq.report.room_map import Reflection, RoomMap, map_room
from roomeq.show import figures_rir, tables
from roomeq.show.analysis import AnalysedRir
from roomeq.show.clips import clips
from roomeq.show.inputs import ShownRir


def rir_draws(rir: AnalysedRir, room: RoomMap | None = None) -> list[Draw]:
    """Return the functions that draw the panels of an RIR, for a sheet."""
    draws = [figures_rir.waveform([rir]), figures_rir.early_reflections([rir], room.reflections if room else ()),
             figures_rir.spectrogram(rir), figures_rir.echogram(rir), figures_rir.response([rir]),
             figures_rir.decay_times([rir]), *(figures_rir.decay([rir], n) for n in range(len(rir.bands_hz)))]
    if room is not None:
        draws += [room_view(room, view) for view in VIEWS if view == "plan" or room.has_heights]
    return draws


def facts(shown: ShownRir) -> list[tuple[str, str]]:
    """Return value and label of the cards at the top of the page."""
    parameters = shown.rir.parameters
    cards = [(tables.with_unit(reverberation_time_s(parameters), 2, "s"), "reverberation time (T30 or T20) at 1 kHz"),
             (tables.with_unit(parameters.get("drr_db"), 1, "dB"), "direct-to-reverberant ratio (DRR)"),
             (tables.with_unit(value_of(parameters, "c50"), 1, "dB"), "clarity (C50) at 1 kHz")]
    distance_m = tables.distance_of(shown.row or {})
    if distance_m is not None:
        cards.append((tables.with_unit(distance_m, 2, "m"), "from source to microphone"))
    return cards


def rir_context(shown: ShownRir, rows: list[RirRow], speech: Path | None) -> Context:
    """Return what the template of an RIR shows.

    Parameters
    ----------
    shown : ShownRir
    rows : list of dict
        RIRs of the same directory, whose positions the map shows too.
    speech : Path, optional
        Recording of dry speech to listen to.
    """
    rir = shown.rir
    room = map_room(shown.row, rows, shown.directory) if shown.row and shown.directory else None
    return {"room": room, "room_id": shown.row["room_id"] if shown.row else "",
            "reflections": room.reflections if room else [], "maps": map_panels(room) if room else [],
            "clips": clips([("through the RIR", "measured", rir.samples, rir.fs_hz)], speech),
            "summary": tables.summary_rows(shown), "bands": tables.band_rows(rir),
            "band_columns": [(heading, "text" if n == 0 else "number")
                             for n, heading in enumerate(tables.BAND_COLUMNS)],
            "time_panels": time_panels(rir, room.reflections if room else []),
            "frequency_panels": frequency_panels([rir], "rir"), "decay_panels": decay_panels([rir], "rir"),
            "picture_panels": [panel("figure-spectrogram", figures_rir.spectrogram(rir), f"Spectrogram of {rir.name}"),
                               panel("figure-echogram", figures_rir.echogram(rir),
                                     f"Energy of {rir.name} over time and octave bands")]}


def time_panels(rir: AnalysedRir, reflections: list[Reflection]) -> list[Panel]:
    """Draw the waveform and the early reflections."""
    arrivals = "; ".join(f"{reflection.surface} {number(1e3 * reflection.delay_s)} ms" for reflection in reflections)
    return [panel("figure-waveform", figures_rir.waveform([rir]), f"Waveform of {rir.name}"),
            panel("figure-early", figures_rir.early_reflections([rir], reflections),
                  f"Level of the first 60 ms of {rir.name}" + (f"; reflections by geometry: {arrivals}" if arrivals
                                                              else ""))]


def frequency_panels(rirs: list[AnalysedRir], ident: str) -> list[Panel]:
    """Draw the frequency response and the decay times over frequency."""
    names = " and ".join(rir.name for rir in rirs)
    return [panel(f"figure-response-{ident}", figures_rir.response(rirs), f"Frequency response of {names}"),
            panel(f"figure-times-{ident}", figures_rir.decay_times(rirs), f"Decay times of {names} over frequency")]


def decay_panels(rirs: list[AnalysedRir], ident: str) -> list[Panel]:
    """Draw the decay of each octave band."""
    n_bands = min(len(rir.bands_hz) for rir in rirs)
    alt = "; ".join(figures_rir.describe_decays(rir) for rir in rirs)
    return [panel(f"figure-decay-{ident}-{TICKS[rirs[0].bands_hz[n]]}", figures_rir.decay(rirs, n),
                  alt if n == 0 else f"Decay at {TICKS[rirs[0].bands_hz[n]]} Hz", SMALL_IN) for n in range(n_bands)]


def map_panels(room: RoomMap) -> list[figures.Panel]:
    """Draw plan and section of a room."""
    alt = {"plan": "Plan of the room with source and microphones", "section": "Section of the room"}
    return [panel(f"figure-{view}", room_view(room, view), alt[view]) for view in VIEWS
            if view == "plan" or room.has_heights]
