"""The ledger of a loop, `ledger.json`: what each entry holds, written and validated.

`residuals.npz`, with the residuals before and after the loop, is validated here as well.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from roomeq.core.arrays import FloatArray
from roomeq.core.constants import BANDS_HZ
from roomeq.core.files import read_json
from roomeq.effects.base import Effect
from roomeq.effects.catalogue import CATALOGUE
from roomeq.effects.model import MODEL_FILE, read_model, read_parameters
from roomeq.loop.examples import EXAMPLES_FILE, read_arrays, read_examples
from roomeq.loop.features import LARGEST, METRIC, N_FEATURES, REGION
from roomeq.loop.packing import OWN_SCOPES
from roomeq.loop.selection import SPLITS, Candidate, HeldOutErrors
from roomeq.loop.session import Session
from roomeq.loop.splitters import leave_rooms_out
from roomeq.loop.usable import LeftOut

LEDGER_FILE, RESIDUALS_FILE = "ledger.json", "residuals.npz"
LEDGER_FORMAT = 3
_REMEDY = "run roomeq close-loop again"
_VARIES = ("nothing", "room", "source", "mic")


def error_entry(errors: HeldOutErrors) -> dict:
    """Return the entry of held-out errors, by split."""
    return {split: dict(error=errors.mean(split), ci=errors.interval(split), by_metric=errors.by_metric(split),
                        by_band=errors.by_band(split)) for split in SPLITS}


def left_out_entries(left_out: Sequence[LeftOut]) -> list[dict]:
    """Return the entries of the RIRs that took no part, by reason."""
    return [entry._asdict() for entry in left_out]


def ranking_entry(candidate: Candidate) -> dict:
    """Return the entry of a candidate in a ranking."""
    return dict(effect=candidate.effect.NAME, gain=candidate.total, ci=list(candidate.interval), p=candidate.p,
                size_jnd=candidate.size_jnd)


def undetected_entry(candidate: Candidate, detectable_jnd: float | None) -> dict:
    """Return the entry of a candidate that was not added: with the smallest size that would have been found."""
    return ranking_entry(candidate) | dict(detectable_jnd=detectable_jnd,
                                           would_show=candidate.effect.DISCRIMINATING_MEASUREMENT)


def iteration_entry(winner: Candidate, rivals: list[Candidate], ranking: list[Candidate], session: Session,
                    before: HeldOutErrors, after: HeldOutErrors, p: dict[str, float]) -> dict:
    """Return the entry of an accepted effect.

    Parameters
    ----------
    winner : Candidate
    rivals : list of Candidate
        Those that cannot be distinguished from the winner.
    ranking : list of Candidate
    session : Session
        Of the model with the effect.
    before, after : HeldOutErrors
    p : dict
        p value of the error being lower, by split (`roomeq.loop.selection.p_lower`). The entry's errors are those of
        the split with the lowest p.
    """
    split = min(p, key=lambda name: (p[name], name))
    entry = dict(
        effect=winner.effect.NAME, scope=winner.effect.SCOPE, size_jnd=winner.size_jnd,
        parameters=_parameter_intervals(session, winner.effect), scored_on=split,
        heldout_error_before=before.mean(split), heldout_error_after=after.mean(split),
        heldout_error_ci=after.interval(split), p=p[split],
        by_metric={"before": before.by_metric(split), "after": after.by_metric(split)},
        by_band={"before": before.by_band(split), "after": after.by_band(split)},
        ranking=[ranking_entry(candidate) for candidate in ranking])
    if rivals:
        entry["cannot_tell"] = [winner.effect.NAME, *(candidate.effect.NAME for candidate in rivals)]
        entry["would_tell"] = sorted({candidate.effect.DISCRIMINATING_MEASUREMENT for candidate in (winner, *rivals)})
    return entry


def update_errors(entry: dict, errors: HeldOutErrors, eliminated: list[str]) -> None:
    """Enter the effects that the effect of an iteration made superfluous, and the held-out errors without them."""
    split = entry["scored_on"]
    entry |= dict(eliminated=eliminated, heldout_error_after=errors.mean(split),
                  heldout_error_ci=errors.interval(split),
                  by_metric={**entry["by_metric"], "after": errors.by_metric(split)},
                  by_band={**entry["by_band"], "after": errors.by_band(split)})


def added_effects(ledger: dict) -> list[dict]:
    """Return the iterations whose effects are in the final model: later ones may have made earlier ones superfluous."""
    eliminated = {name for entry in ledger["iterations"] for name in entry.get("eliminated", [])}
    return [entry for entry in ledger["iterations"] if entry["effect"] not in eliminated]


def _parameters_of(effect: type[Effect], vector: FloatArray) -> dict:
    return asdict(effect.from_vector(vector))  # type: ignore[call-overload]


def _parameter_intervals(session: Session, effect: type[Effect]) -> dict:
    """Return the parameters of each unit, those of shared effects with 95 % intervals from a jackknife over rooms."""
    index, k = session.index, session.effects.index(effect)
    best = index.vectors(session.fit.mean, session.fit.local)[k]
    entry = {name: {"best": _parameters_of(effect, vector)}
             for name, vector in zip(session.data.units(effect.SCOPE)[0], best, strict=True)}
    if effect.SCOPE in OWN_SCOPES:
        return entry
    held_out = np.array([index.vectors(room.mean, session.fit.local)[k]
                         for room in leave_rooms_out(session.data, session.fit)])
    half = 1.96 * np.sqrt((len(held_out) - 1) / len(held_out)
                          * np.sum((held_out - held_out.mean(axis=0)) ** 2, axis=0))
    for unit, low, high in zip(entry.values(), best - half, best + half, strict=True):
        unit |= {"low": _parameters_of(effect, low), "high": _parameters_of(effect, high)}
    return entry


def validate_loop(directory: Path) -> int:
    """Validate a loop directory, and return the number of effects that the loop added.

    Raises
    ------
    ValueError
        The first error of the directory.
    """
    directory = Path(directory)
    ledger, model = read_ledger(directory / LEDGER_FILE), read_model(directory / MODEL_FILE)
    added = added_effects(ledger)
    names = sorted([*ledger["given"], *(entry["effect"] for entry in added)])
    if names != sorted(model.names):
        raise ValueError(f"{directory / MODEL_FILE}: effects {', '.join(sorted(model.names)) or 'none'} are not those "
                         f"of {LEDGER_FILE} ({', '.join(names) or 'none'}): {_REMEDY}")
    by_name = {extension.effect.NAME: extension for extension in model.extensions}
    for entry in added:
        units = sorted(by_name[entry["effect"]].of)
        if sorted(entry["parameters"]) != units:
            raise ValueError(f"{directory / LEDGER_FILE}: parameters of {entry['effect']} must be of "
                             f"{', '.join(units)}, as in {MODEL_FILE}: {_REMEDY}")
    read_residuals(directory / RESIDUALS_FILE, ledger["rirs"])
    read_examples(directory / EXAMPLES_FILE)
    return len(added)


def read_residuals(path: Path, n_rirs: int) -> dict[str, FloatArray]:
    """Read the residuals "before" and "after" the loop: ndarray, shape (n_rirs, n_features) each [JND].

    Raises
    ------
    ValueError
        The file is invalid, or holds another number of RIRs.
    """
    arrays = read_arrays(path, ("before", "after"))
    for key, values in arrays.items():
        if values.shape != (n_rirs, N_FEATURES) or values.dtype.kind != "f" or np.any(np.isinf(values)):
            raise ValueError(f"{path}: {key!r} must hold {n_rirs} x {N_FEATURES} finite numbers or gaps, as "
                             f"{LEDGER_FILE} says: {_REMEDY}")
    return arrays


def read_ledger(path: Path) -> dict:
    """Read a ledger and validate it.

    Raises
    ------
    ValueError
        The ledger is invalid or has another format; the message names the file and the first invalid entry.
    """
    ledger = read_json(path)
    try:
        _check_ledger(ledger)
    except _InvalidEntryError as error:
        raise ValueError(f"{path}: {error}: {_REMEDY}") from None
    return ledger


class _InvalidEntryError(Exception):
    """An entry that breaks a rule; becomes the ValueError of `read_ledger`."""


def _require(fits: bool, where: str, rule: str) -> None:
    if not fits:
        raise _InvalidEntryError(f"{where} must {rule}")


def _keys(value: Any, where: str, names: Sequence[str]) -> None:
    _require(isinstance(value, dict), where, "be an object")
    for name in names:
        _require(name in value, where, f"hold {name!r}")


def _number(value: Any, where: str, low: float = -math.inf, high: float = math.inf) -> None:
    fits = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    _require(fits and low <= value <= high, f"{where}={value!r:.60}", f"be a number in [{low:g}, {high:g}]")


def _interval(value: Any, where: str, around: float | None = None) -> None:
    _require(isinstance(value, list) and len(value) == 2, f"{where}={value!r:.60}", "be two numbers")
    for bound in value:
        _number(bound, where)
    _require(value[0] <= value[1], f"{where}={value}", "have its smaller number first")
    if around is not None:
        _require(value[0] <= around <= value[1], f"{where}={value}", f"lie around {around:g}")


def _list(value: Any, where: str, check: Callable[[Any, str], None]) -> None:
    _require(isinstance(value, list), where, "be a list")
    for n, element in enumerate(value):
        check(element, f"{where}[{n}]")


def _breakdown(by_metric: Any, by_band: Any, where: str) -> None:
    """Check errors by metric and by band."""
    _require(isinstance(by_metric, dict) and set(by_metric) <= set(METRIC), f"{where}.by_metric", "name metrics")
    for metric, error in by_metric.items():
        _number(error, f"{where}.by_metric.{metric}", 0.0, LARGEST)
    _require(isinstance(by_band, list) and len(by_band) == len(BANDS_HZ), f"{where}.by_band",
             f"hold {len(BANDS_HZ)} octaves")
    for error in by_band:
        if error is not None:
            _number(error, f"{where}.by_band", 0.0, LARGEST)


def _errors(value: Any, where: str) -> None:
    _keys(value, where, SPLITS)
    for split in SPLITS:
        entry, at = value[split], f"{where}.{split}"
        _keys(entry, at, ("error", "ci", "by_metric", "by_band"))
        _number(entry["error"], f"{at}.error", 0.0, LARGEST)
        if entry["ci"] is not None:  # of a single room
            _interval(entry["ci"], f"{at}.ci", entry["error"])
        _breakdown(entry["by_metric"], entry["by_band"], at)


def _explained(value: Any, where: str) -> None:
    _keys(value, where, SPLITS)
    for split in SPLITS:
        entry, at = value[split], f"{where}.{split}"
        _keys(entry, at, ("share", "ci", "by_metric", "by_band", "at_ceiling"))
        if entry["ci"] is not None:
            _interval(entry["ci"], f"{at}.ci", entry["share"])
        _require(isinstance(entry["by_metric"], dict) and set(entry["by_metric"]) <= set(METRIC), f"{at}.by_metric",
                 "name metrics")
        _require(isinstance(entry["by_band"], list) and len(entry["by_band"]) == len(BANDS_HZ), f"{at}.by_band",
                 f"hold {len(BANDS_HZ)} octaves")
        for key, shares in (("share", [entry["share"]]), ("by_metric", [*entry["by_metric"].values()]),
                            ("by_band", entry["by_band"])):
            for share in shares:
                if share is not None:  # nothing was left to explain
                    _number(share, f"{at}.{key}")
        _require(isinstance(entry["at_ceiling"], list) and set(entry["at_ceiling"]) <= set(entry["by_metric"]),
                 f"{at}.at_ceiling", "name metrics of by_metric")


def _effect(value: Any, where: str) -> None:
    _require(isinstance(value, str) and value in CATALOGUE, f"{where}={value!r:.60}", "be an effect of the catalogue")


def _candidate(value: Any, where: str) -> None:
    _keys(value, where, ("effect", "gain", "ci", "p", "size_jnd"))
    _effect(value["effect"], f"{where}.effect")
    _number(value["gain"], f"{where}.gain")
    _interval(value["ci"], f"{where}.ci")
    _number(value["p"], f"{where}.p", 0.0, 1.0)
    _number(value["size_jnd"], f"{where}.size_jnd", 0.0)


def _undetected(value: Any, where: str) -> None:
    _candidate(value, where)
    _keys(value, where, ("detectable_jnd", "would_show"))
    if value["detectable_jnd"] is not None:
        _number(value["detectable_jnd"], f"{where}.detectable_jnd", 0.0)
    _require(isinstance(value["would_show"], str), f"{where}.would_show", "be text")


def _iteration(value: Any, where: str) -> None:
    _keys(value, where, ("effect", "scope", "size_jnd", "parameters", "scored_on", "heldout_error_before",
                        "heldout_error_after", "heldout_error_ci", "p", "by_metric", "by_band", "ranking"))
    _effect(value["effect"], f"{where}.effect")
    scope = CATALOGUE[value["effect"]].SCOPE
    _require(value["scope"] == scope, f"{where}.scope={value['scope']!r:.60}", f"be {scope!r}")
    _require(value["scored_on"] in SPLITS, f"{where}.scored_on={value['scored_on']!r:.60}",
             f"be {' or '.join(SPLITS)}")
    for key in ("heldout_error_before", "heldout_error_after"):
        _number(value[key], f"{where}.{key}", 0.0, LARGEST)
    _interval(value["heldout_error_ci"], f"{where}.heldout_error_ci", value["heldout_error_after"])
    _number(value["p"], f"{where}.p", 0.0, 1.0)
    _number(value["size_jnd"], f"{where}.size_jnd", 0.0)
    _parameters(value["parameters"], CATALOGUE[value["effect"]], f"{where}.parameters")
    for key in ("by_metric", "by_band"):
        _keys(value[key], f"{where}.{key}", ("before", "after"))
    for when in ("before", "after"):
        _breakdown(value["by_metric"][when], value["by_band"][when], f"{where} {when}")
    _list(value["ranking"], f"{where}.ranking", _candidate)
    _list(value.get("cannot_tell", []), f"{where}.cannot_tell", _effect)
    _list(value.get("eliminated", []), f"{where}.eliminated", _effect)
    _require(value.get("cannot_tell", [value["effect"]])[:1] == [value["effect"]], f"{where}.cannot_tell",
             "begin with its effect")


def _parameters(value: Any, effect: type[Effect], where: str) -> None:
    _require(isinstance(value, dict) and bool(value) and all(isinstance(unit, dict) for unit in value.values()), where,
             "give the best of each unit")
    for name, unit in value.items():
        try:
            read_parameters(f"{where}[{name!r}].best", effect, unit.get("best"))
        except ValueError as error:
            raise _InvalidEntryError(str(error).rpartition(": ")[0]) from None


def _unexplained(value: Any, where: str) -> None:
    _keys(value, where, ("metric", "time_region", "bands_hz", "varies_with", "size_jnd", "p"))
    _require(value["metric"] in list(REGION), f"{where}.metric={value['metric']!r:.60}", "be a metric")
    region = REGION[value["metric"]]
    _require(value["time_region"] == region, f"{where}.time_region={value['time_region']!r:.60}", f"be {region!r}")
    _require(isinstance(value["bands_hz"], list) and all(band_hz in BANDS_HZ for band_hz in value["bands_hz"]),
             f"{where}.bands_hz={value['bands_hz']!r:.60}", "hold octaves")
    _require(value["varies_with"] in _VARIES, f"{where}.varies_with={value['varies_with']!r:.60}",
             f"be one of {', '.join(_VARIES)}")
    _number(value["size_jnd"], f"{where}.size_jnd")
    _number(value["p"], f"{where}.p", 0.0, 1.0)


def _count(value: Any, where: str) -> None:
    _require(isinstance(value, int) and not isinstance(value, bool) and value > 0, f"{where}={value!r:.60}",
             "be a positive whole number")


def _left_out(value: Any, where: str) -> None:
    _keys(value, where, LeftOut._fields)
    _require(isinstance(value["reason"], str) and bool(value["reason"]), f"{where}.reason={value['reason']!r:.60}",
             "be a text")
    for key in ("rirs", "rooms"):
        _count(value[key], f"{where}.{key}")
    _require(value["rooms"] <= value["rirs"], f"{where}.rooms={value['rooms']}", "not exceed the number of RIRs")


def _estimate(value: Any, where: str) -> None:
    _keys(value, where, ("room", "quantity", "unit", "prior", "posterior", "documented", "evidence", "used"))
    for key in ("room", "quantity", "unit"):
        _require(isinstance(value[key], str) and bool(value[key]), f"{where}.{key}={value[key]!r:.60}", "be a text")
    for key in ("prior", "posterior"):
        _require(isinstance(value[key], list) and len(value[key]) == 2, f"{where}.{key}={value[key]!r:.60}",
                 "be mean and spread")
        _number(value[key][0], f"{where}.{key}")
        _number(value[key][1], f"{where}.{key}", 0.0)
    if value["documented"] is not None:
        _number(value["documented"], f"{where}.documented")
    _number(value["evidence"], f"{where}.evidence")
    _require(isinstance(value["used"], bool), f"{where}.used={value['used']!r:.60}", "be true or false")


def _check_ledger(ledger: Any) -> None:
    _require(isinstance(ledger, dict), "ledger", "be an object")
    _require(ledger.get("format") == LEDGER_FORMAT, f"format={ledger.get('format')!r:.60}", f"be {LEDGER_FORMAT}")
    _keys(ledger, "ledger", ("rirs", "rooms", "left_out", "geometry", "given", "baseline", "iterations", "ranking",
                             "unexplained", "unexplained_all", "final", "ceiling", "explained"))
    for key in ("rirs", "rooms"):
        _count(ledger[key], key)
    _list(ledger["left_out"], "left_out", _left_out)
    _list(ledger["geometry"], "geometry", _estimate)
    for key in ("baseline", "final", "ceiling"):
        _errors(ledger[key], key)
    _explained(ledger["explained"], "explained")
    _list(ledger["iterations"], "iterations", _iteration)
    _list(ledger["ranking"], "ranking", _undetected)
    _list(ledger["unexplained_all"], "unexplained_all", _unexplained)
    _require(ledger["unexplained"] == (ledger["unexplained_all"] or [None])[0], "unexplained",
             "be the first of unexplained_all")
    iterations = ledger["iterations"]
    _list(ledger["given"], "given", _effect)
    names = [*ledger["given"], *(entry["effect"] for entry in iterations)]
    _require(len(set(names)) == len(names), "given and iterations", "name each effect once")
    if not iterations:
        _require(ledger["final"] == ledger["baseline"], "final", "be the baseline where nothing was added")
    else:
        for key, iteration, when in (("baseline", iterations[0], "before"), ("final", iterations[-1], "after")):
            split, error = iteration["scored_on"], iteration[f"heldout_error_{when}"]
            _require(ledger[key][split]["error"] == error, f"{key}.{split}.error={ledger[key][split]['error']:g}",
                     f"be the heldout_error_{when} of its iteration, {error:g}")
    if "test" in ledger:
        _keys(ledger["test"], "test", ("rirs", "rooms", "left_out", "geometry", "before", "after", "ceiling",
                                       "explained"))
        _list(ledger["test"]["left_out"], "test.left_out", _left_out)
        _list(ledger["test"]["geometry"], "test.geometry", _estimate)
        for key in ("before", "after", "ceiling"):
            _errors(ledger["test"][key], f"test.{key}")
        _explained(ledger["test"]["explained"], "test.explained")
