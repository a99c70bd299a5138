"""The rules of a ledger (`roomeq.loop.ledger`): keys, types and ranges of its entries, and what must agree."""

import math
import sys
from collections.abc import Callable, Sequence
from typing import Any

from roomeq.core.constants import BANDS_HZ
from roomeq.effects.base import Effect
from roomeq.effects.catalogue import CATALOGUE
from roomeq.effects.model import read_parameters
from roomeq.loop.acceptance import REASONS
from roomeq.loop.facing_estimate import HYPOTHESES
from roomeq.loop.features import LARGEST, METRIC, REGION
from roomeq.loop.heldout_errors import SPLITS
from roomeq.loop.usable import LeftOut

LEDGER_FORMAT = 9
_VARIES = ("nothing", "room", "source", "mic")


class InvalidEntryError(Exception):
    """An entry that breaks a rule; becomes the ValueError of `read_ledger`."""


def _require(fits: bool, where: str, rule: str) -> None:
    if not fits:
        raise InvalidEntryError(f"{where} must {rule}")


def _keys(value: Any, where: str, names: Sequence[str]) -> None:
    _require(isinstance(value, dict), where, "be an object")
    for name in names:
        _require(name in value, where, f"hold {name!r}")


def _number(value: Any, where: str, low: float = -math.inf, high: float = math.inf) -> None:
    fits = isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= sys.float_info.max
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


def _facing(value: Any, where: str) -> None:
    _keys(value, where, ("source", "rirs", "positions", "hypothesis", "evidence", "angle_deg"))
    _require(isinstance(value["source"], str), f"{where}.source={value['source']!r:.60}", "be a source_id")
    for key in ("rirs", "positions"):
        _count(value[key], f"{where}.{key}")
    _require(value["hypothesis"] in HYPOTHESES, f"{where}.hypothesis={value['hypothesis']!r:.60}",
             f"be one of {', '.join(HYPOTHESES)}")
    _keys(value["evidence"], f"{where}.evidence", HYPOTHESES[1:])
    for key in HYPOTHESES[1:]:
        _number(value["evidence"][key], f"{where}.evidence.{key}")
    _number(value["angle_deg"], f"{where}.angle_deg", 0.0, 180.0)


def _errors(value: Any, where: str) -> None:
    _keys(value, where, SPLITS)
    for split in SPLITS:
        entry, at = value[split], f"{where}.{split}"
        _keys(entry, at, ("error", "ci", "by_metric", "by_band"))
        if entry["error"] is not None or not where.endswith("ceiling"):  # in which no feature may be valid
            _number(entry["error"], f"{at}.error", 0.0, LARGEST)
        if entry["ci"] is not None:  # of a single room
            _interval(entry["ci"], f"{at}.ci", entry["error"])
        _breakdown(entry["by_metric"], entry["by_band"], at)


def _explained(value: Any, where: str) -> None:
    _keys(value, where, SPLITS)
    for split in SPLITS:
        entry, at = value[split], f"{where}.{split}"
        _keys(entry, at, ("share", "ci", "by_metric", "by_band", "at_ceiling"))
        _require(isinstance(entry["by_metric"], dict) and set(entry["by_metric"]) <= set(METRIC), f"{at}.by_metric",
                 "name metrics")
        _require(isinstance(entry["by_band"], list) and len(entry["by_band"]) == len(BANDS_HZ), f"{at}.by_band",
                 f"hold {len(BANDS_HZ)} octaves")
        _share(entry, at)
        for metric, share in entry["by_metric"].items():
            _share(share, f"{at}.by_metric.{metric}")
        for share in entry["by_band"]:
            _share(share, f"{at}.by_band")
        _require(isinstance(entry["at_ceiling"], list)
                 and all(metric in list(entry["by_metric"]) for metric in entry["at_ceiling"]),
                 f"{at}.at_ceiling", "name metrics of by_metric")


def _share(entry: Any, where: str) -> None:
    _keys(entry, where, ("share", "ci"))
    if entry["share"] is not None:  # nothing was left to explain
        _number(entry["share"], f"{where}.share")
    if entry["ci"] is not None:
        _interval(entry["ci"], f"{where}.ci", entry["share"])


def _effect(value: Any, where: str) -> None:
    _require(isinstance(value, str) and value in CATALOGUE, f"{where}={value!r:.60}", "be an effect of the catalogue")


def _candidate(value: Any, where: str) -> None:
    _keys(value, where, ("effect", "gain", "ci", "p", "size_jnd"))
    _effect(value["effect"], f"{where}.effect")
    _number(value["gain"], f"{where}.gain")
    _interval(value["ci"], f"{where}.ci")
    _number(value["p"], f"{where}.p", 0.0, 1.0)
    _number(value["size_jnd"], f"{where}.size_jnd", 0.0)
    if "rejected" in value:
        _trial(value["rejected"], f"{where}.rejected")
        rendered = value["rejected"].get("rendered")
        _require(isinstance(rendered, bool), f"{where}.rejected.rendered={rendered!r:.60}", "be true or false")
        reason = value["rejected"].get("reason")
        _require(reason in REASONS, f"{where}.rejected.reason={reason!r:.60}", f"be one of {', '.join(REASONS)}")


def _trial(value: Any, where: str) -> None:
    _keys(value, where, ("p", "p_by_split", "touched_fall", "p_other_devices"))
    _number(value["p"], f"{where}.p", 0.0, 1.0)
    if value["p_other_devices"] is not None:
        _number(value["p_other_devices"], f"{where}.p_other_devices", 0.0, 1.0)
    for key, low in (("p_by_split", 0.0), ("touched_fall", -LARGEST)):
        _keys(value[key], f"{where}.{key}", SPLITS)
        for split in SPLITS:
            _number(value[key][split], f"{where}.{key}.{split}", low, 1.0)


def _undetected(value: Any, where: str) -> None:
    _candidate(value, where)
    _keys(value, where, ("detectable_jnd", "would_show"))
    if value["detectable_jnd"] is not None:
        _number(value["detectable_jnd"], f"{where}.detectable_jnd", 0.0)
    _require(isinstance(value["would_show"], str), f"{where}.would_show", "be text")


def _iteration(value: Any, where: str) -> None:
    _keys(value, where, ("effect", "scope", "size_jnd", "parameters", "scored_on", "heldout_error_before",
                        "heldout_error_after", "heldout_error_ci", "fall_ci", "by_metric", "by_band", "ranking"))
    _trial(value, where)
    _effect(value["effect"], f"{where}.effect")
    scope = CATALOGUE[value["effect"]].SCOPE
    _require(value["scope"] == scope, f"{where}.scope={value['scope']!r:.60}", f"be {scope!r}")
    _require(value["scored_on"] in SPLITS, f"{where}.scored_on={value['scored_on']!r:.60}",
             f"be {' or '.join(SPLITS)}")
    for key in ("heldout_error_before", "heldout_error_after"):
        _number(value[key], f"{where}.{key}", 0.0, LARGEST)
    _interval(value["heldout_error_ci"], f"{where}.heldout_error_ci", value["heldout_error_after"])
    _interval(value["fall_ci"], f"{where}.fall_ci", value["heldout_error_before"] - value["heldout_error_after"])
    _number(value["size_jnd"], f"{where}.size_jnd", 0.0)
    _parameters(value["parameters"], CATALOGUE[value["effect"]], f"{where}.parameters")
    for key in ("by_metric", "by_band"):
        _keys(value[key], f"{where}.{key}", ("before", "after"))
    for when in ("before", "after"):
        _breakdown(value["by_metric"][when], value["by_band"][when], f"{where} {when}")
    _list(value["ranking"], f"{where}.ranking", _candidate)
    _list(value.get("cannot_tell", []), f"{where}.cannot_tell", _effect)
    if "sum_with" in value:
        _effect(value["sum_with"], f"{where}.sum_with")
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
            raise InvalidEntryError(str(error).rpartition(": ")[0]) from None


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


def _counts(value: Any, where: str) -> None:
    """Check the numbers of RIRs and rooms, and of those that are scored; `where` ends in a point, or is empty."""
    for key in ("rirs", "rooms", "scored_rirs", "scored_rooms"):
        _count(value[key], f"{where}{key}")
    for key in ("rirs", "rooms"):
        _require(value[f"scored_{key}"] <= value[key], f"{where}scored_{key}={value[f'scored_{key}']}",
                 f"not exceed {where}{key}, {value[key]}")
    _require(2 * value["scored_rooms"] <= value["scored_rirs"], f"{where}scored_rirs={value['scored_rirs']}",
             f"be two or more for each of {where}scored_rooms, {value['scored_rooms']}")


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


def check_ledger(ledger: Any) -> None:
    _require(isinstance(ledger, dict), "ledger", "be an object")
    _require(ledger.get("format") == LEDGER_FORMAT, f"format={ledger.get('format')!r:.60}", f"be {LEDGER_FORMAT}")
    _keys(ledger, "ledger", ("rirs", "rooms", "scored_rirs", "scored_rooms", "left_out", "geometry", "facings", "given",
                             "baseline", "iterations", "ranking", "unexplained", "unexplained_all", "final", "ceiling",
                             "explained"))
    _counts(ledger, "")
    _list(ledger["left_out"], "left_out", _left_out)
    _list(ledger["geometry"], "geometry", _estimate)
    _list(ledger["facings"], "facings", _facing)
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
        _keys(ledger["test"], "test", ("rirs", "rooms", "scored_rirs", "scored_rooms", "left_out", "geometry",
                                       "facings", "measured", "before", "after", "ceiling", "explained"))
        _counts(ledger["test"], "test.")
        _list(ledger["test"]["measured"], "test.measured", _effect)
        _list(ledger["test"]["left_out"], "test.left_out", _left_out)
        _list(ledger["test"]["geometry"], "test.geometry", _estimate)
        _list(ledger["test"]["facings"], "test.facings", _facing)
        for key in ("before", "after", "ceiling"):
            _errors(ledger["test"][key], f"test.{key}")
        _explained(ledger["test"]["explained"], "test.explained")
