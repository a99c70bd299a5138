"""Sentences that describe what the loop added and what it left unexplained, for the log and the report."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from roomeq.acoustics.octaves import THIRDS_HZ, nominal_hz
from roomeq.core.arrays import Array, FloatArray
from roomeq.core.constants import BANDS_HZ
from roomeq.effects.response import RESPONSE_HZ
from roomeq.loop.facing_estimate import FacingEstimate
from roomeq.loop.features import JND
from roomeq.loop.unexplained import Unexplained

_Best = dict[str, dict]  # best parameters of each unit
_Values = dict[str, Array]  # values of each parameter over units

_LOUDER, _HIGHER = ("louder", "quieter"), ("higher", "lower")
_LONGER, _LATER = ("longer", "shorter"), ("later", "earlier")
_METRICS = {"direct": ("the direct sound", _LOUDER), "early": ("sound of the first 50 ms", _LOUDER),
            "late": ("sound from 50 to 200 ms", _LOUDER), "spectrum": ("the whole response", _LOUDER),
            "edt": ("the early decay time (EDT)", _LONGER), "t20": ("the decay time (T20)", _LONGER),
            "t30": ("the decay time (T30)", _LONGER), "curvature": ("T30 relative to T20", _LONGER),
            "c50": ("clarity (C50)", _HIGHER),
            "drr": ("the direct-to-reverberant ratio (DRR)", _HIGHER), "arrival": ("the direct sound", _LATER),
            "ahead": ("sound before the direct sound", _LOUDER), "floor": ("noise after the response", _LOUDER)}
"""Name of each metric, and the words for more and less of it."""
_VARIES = {"nothing": "equally in all rooms", "room": "in some rooms",
           "source": "for one source compared with the others", "mic": "for one microphone compared with the others"}
_LABELS = {"source_response": "frequency response of the loudspeakers", "mic_response": "frequency response of the "
           "microphones", "room_eq": "equaliser that all recordings share", "source_directivity": "directivity of the "
           "loudspeakers", "noise_floor": "background noise", "near_reflector": "reflecting surface near source and "
           "microphone", "coupled_volume": "coupled second volume", "occlusion": "obstacle in front of the source",
           "room_modes": "room modes", "air_absorption": "air absorption", "sound_speed": "speed of sound"}
"""Names of the effects of the catalogue in words."""
_ADVICE = {
    "direct": "measure the loudspeaker's response at the angles of the microphones, and state where it faces "
              "(source_dir)",
    "early": "add furniture and surfaces near source and microphone to the room's mesh",
    "late": "check the room's dimensions, and give a mesh where it is no shoebox",
    "spectrum": "measure the response of loudspeaker and microphone in the free field",
    "edt": "check the distance, and add furniture and surfaces near source and microphone to the room's mesh",
    "t20": "check the room's dimensions, and whether doors to other rooms were open",
    "t30": "check the room's dimensions, and whether doors to other rooms were open",
    "curvature": "look for objects that ring, doors to other rooms that were open, and noise in the recordings",
    "c50": "check the distance, and add large objects between and around source and microphone to the room's mesh",
    "drr": "check the distance, and state where the loudspeaker faces (source_dir)",
    "arrival": "check positions and temperature, and that the latency of the sound card is removed (otherwise set "
               "tof_removed)",
    "ahead": "play the sweep at a lower level, since distortion of the loudspeaker lies before the direct sound, and "
             "use no zero-phase filter",
    "floor": "record the background noise of each room before the sweep"}
"""What explains a residual of each metric, or makes it smaller."""
_ADVICE_BY_UNIT = {"source": "record another loudspeaker at the same place to tell it from the room",
                   "mic": "exchange two microphones to tell them from their positions",
                   "room": "look at the rooms one by one, since their stated geometry or their state may differ"}
_VISIBLE_DB = -45.0  # a second decay of a lower level does not reach the range of T30
_MIN_DETOUR_M = 0.01  # positions are known to centimetres, so that a shorter detour may be none


def describe_scored(counts: Mapping[str, Any]) -> str:
    """Return of how many RIRs and rooms the errors are, from a ledger or its test set; empty if they are of all."""
    if all(counts[f"scored_{key}"] == counts[key] for key in ("rirs", "rooms")):
        return ""
    return (f"{counts['scored_rirs']} of {counts['rirs']} RIRs in {counts['scored_rooms']} of {counts['rooms']} rooms: "
            "the RIRs of each other room are of a single place")


def effect_names(entry: dict) -> str:
    """Return the name of an accepted effect, or the names of all effects that cannot be distinguished from it."""
    return " or ".join(entry.get("cannot_tell", [entry["effect"]]))


def effect_label(effect: str) -> str:
    """Return the name of an effect in words."""
    return _LABELS[effect]


def advise_on_residual(unexplained: Unexplained) -> str:
    """Return what to do about an unexplained residual."""
    by_unit = _ADVICE_BY_UNIT.get(unexplained.varies_with)
    return _ADVICE[unexplained.metric] + (f"; {by_unit}" if by_unit else "")


def describe_residual(unexplained: Unexplained) -> str:
    """Describe an unexplained residual: metric, bands, size in its own unit, and what it varies with."""
    name, words = _METRICS[unexplained.metric]
    size = abs(unexplained.size_jnd) * JND[unexplained.metric]
    sign = 1.0 if unexplained.size_jnd > 0.0 else -1.0
    amount = {_LONGER: f"{100.0 * abs(np.expm1(sign * size)):.0f} %", _LATER: f"{1e3 * size:.1f} ms"}.get(
        words, f"{size:.1f} dB")
    return (f"{name}{_bands(unexplained.bands_hz)} is {amount} {words[sign < 0.0]} than simulated, "
            f"{_VARIES[unexplained.varies_with]} ({unexplained.size_jnd:+.1f} JND)")


def describe_facing(facing: FacingEstimate) -> str:
    """Describe where a source faces in the RIRs that do not state it."""
    direction = {"towards the microphone": "it faces the microphone", "fixed": "it has one direction at each position",
                 "free": "it has another direction in each RIR"}[facing.hypothesis]
    angle = "" if facing.hypothesis == "towards the microphone" else (
        f", {facing.angle_deg:.0f} degrees from the microphone in the mean")
    return (f"source {facing.source}: {facing.rirs} RIRs do not state where it faces; {direction}{angle} (log Bayes "
            f"factor against facing the microphone: fixed {facing.evidence['fixed']:.1f}, free "
            f"{facing.evidence['free']:.1f})")


def _bands(bands_hz: list[float]) -> str:
    """Return octaves as text, neighbours as a range."""
    numbers = sorted(BANDS_HZ.index(band_hz) for band_hz in bands_hz)
    if not numbers:
        return ""
    runs = np.split(np.array(numbers), np.flatnonzero(np.diff(numbers) > 1) + 1)
    ranges = [f"{BANDS_HZ[run[0]]:g}" + (f" to {BANDS_HZ[run[-1]]:g}" if len(run) > 1 else "") for run in runs]
    return f" at {', '.join(ranges)} Hz"


def describe_effect(effect: str, parameters: dict, sum_with: str | None = None) -> str:
    """Describe the parameters of an accepted effect, by unit, and what is uncertain of them, as in the ledger."""
    best = {unit: entry["best"] for unit, entry in parameters.items()}
    text = _EFFECTS[effect](best, {name: np.array([of_unit[name] for of_unit in best.values()])
                                   for name in next(iter(best.values()))})
    if sum_with is None:
        return text
    return (f"{text}; recordings determine its sum with the {effect_label(sum_with)}, and not how a filter that all "
            "share is divided between both")


def _over(values: FloatArray, form: str, unit: str) -> str:
    """Return a single value as text, or the median of several and their range."""
    if len(values) == 1:
        return f"{values[0]:{form}} {unit}"
    return f"{np.median(values):{form}} {unit} ({np.min(values):{form}} to {np.max(values):{form}})"


def _response(best: _Best, values: _Values) -> str:
    gains_db = values["gains_db"]
    widest = int(np.argmax(np.ptp(gains_db, axis=1)))
    low, high = int(np.argmin(gains_db[widest])), int(np.argmax(gains_db[widest]))
    name = f"the least flat response, that of {list(best)[widest]}," if len(best) > 1 else "the response"
    return (f"{name} ranges from {gains_db[widest, low]:+.1f} dB at {nominal_hz(RESPONSE_HZ[low]):g} Hz to "
            f"{gains_db[widest, high]:+.1f} dB at {nominal_hz(RESPONSE_HZ[high]):g} Hz")


def _coupled_volume(best: _Best, values: _Values) -> str:
    visible = values["level_db"] > _VISIBLE_DB
    if not visible.any():
        return "the second decay lies below the measured part of the decay in all rooms"
    time, level = _over(values["time_s"][visible], ".1f", "s"), _over(-values["level_db"][visible], ".0f", "dB")
    return (f"{visible.sum()} of {len(best)} rooms have a second decay of {time}, {level} below the energy of all "
            "reflections in octaves that decay in 0.5 s, as of a volume that is coupled through an opening")


def _noise_floor(best: _Best, values: _Values) -> str:
    levels_db = np.median(values["levels_db"], axis=0)
    return f"noise is strongest at {nominal_hz(THIRDS_HZ[int(np.argmax(levels_db))]):g} Hz"


def _occlusion(best: _Best, values: _Values) -> str:
    obstructed = values["detour_m"] > _MIN_DETOUR_M
    text = f"an obstacle delays the direct sound of {obstructed.sum()} of {len(best)} recordings"
    if not obstructed.any():
        return text
    return f"{text} by a detour of {_over(100.0 * values['detour_m'][obstructed], '.0f', 'cm')}"


_EFFECTS: dict[str, Callable[[_Best, _Values], str]] = {
    "air_absorption": lambda best, values: (
        f"the air absorbs like air of {values['temperature_c'][0]:.0f} \N{DEGREE SIGN}C and "
        f"{values['humidity_pct'][0]:.0f} % humidity"),
    "sound_speed": lambda best, values: (
        f"sound travels as fast as at {values['temperature_c'][0]:.0f} \N{DEGREE SIGN}C"),
    "source_directivity": lambda best, values: (
        "radiates like a membrane of radius "
        f"{_over(100.0 * values['radius_m'] * np.sin(values['cap_rad']), '.0f', 'cm')} in a cabinet of radius "
        f"{_over(100.0 * values['radius_m'], '.0f', 'cm')}"),
    "room_modes": lambda best, values: (
        f"up to {values['up_to_hz'][0]:.0f} Hz the response consists of the modes of the room"),
    "near_reflector": lambda best, values: (
        f"a surface {_over(values['depth_m'], '.2f', 'm')} below source and microphone reflects "
        f"{_over(100.0 * values['reflection'], '.0f', '%')} of the pressure"),
    "coupled_volume": _coupled_volume, "noise_floor": _noise_floor, "occlusion": _occlusion,
    "source_response": _response, "mic_response": _response, "room_eq": _response}
