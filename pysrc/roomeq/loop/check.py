"""Reading what the loop wrote, and checking it: `ledger.json`, `model.json`, `residuals.npz`."""

import math
from pathlib import Path

import numpy as np

from roomeq.core.constants import BANDS_HZ
from roomeq.core.files import read_json
from roomeq.effects.catalogue import CATALOGUE
from roomeq.effects.model import MODEL_FILE, read_model, read_parameters
from roomeq.loop.examples import EXAMPLES_FILE, read_arrays, read_examples
from roomeq.loop.features import LARGEST, METRIC, N_FEATURES, REGION
from roomeq.loop.ledger import LEDGER_FILE

RESIDUALS_FILE = "residuals.npz"
WAYS = ("positions", "rooms")
"""Of meeting what was left out; see `roomeq.loop.heldout`."""
_VARIES = ("nothing", "room", "source", "mic")


def validate_loop(directory):
    """Check a directory that `roomeq close-loop` made whole, and return the number of effects found.

    Raises
    ------
    ValueError
        The first thing that is wrong.
    """
    directory = Path(directory)
    ledger, model = read_ledger(directory / LEDGER_FILE), read_model(directory / MODEL_FILE)
    found = sorted([*ledger["given"], *(entry["effect"] for entry in ledger["iterations"])])
    if found != sorted(model.names):
        raise ValueError(f"{directory / MODEL_FILE}: effects {', '.join(sorted(model.names)) or 'none'} are not those "
                         f"of {LEDGER_FILE} ({', '.join(found) or 'none'}): close the loop again")
    by_name = {one.effect.NAME: one for one in model.extensions}
    for entry in ledger["iterations"]:
        units = sorted(by_name[entry["effect"]].of)
        if sorted(entry["parameters"]) != units:
            raise ValueError(f"{directory / LEDGER_FILE}: parameters of {entry['effect']} must be of "
                             f"{', '.join(units)}, as in {MODEL_FILE}: close the loop again")
    read_residuals(directory / RESIDUALS_FILE, ledger["rirs"])
    read_examples(directory / EXAMPLES_FILE)
    return len(ledger["iterations"])


def read_residuals(path, n_rirs):
    """Read measured less expected features before and after: {"before", "after": ndarray, shape (n_rirs, n_features)}.

    Raises
    ------
    ValueError
        The file is none of ours, or of other RIRs.
    """
    arrays = read_arrays(path, ("before", "after"))
    for key, values in arrays.items():
        if values.shape != (n_rirs, N_FEATURES) or values.dtype.kind != "f" or np.any(np.isinf(values)):
            raise ValueError(f"{path}: {key!r} must hold {n_rirs} x {N_FEATURES} finite numbers or gaps, as {LEDGER_FILE} "
                             "says: close the loop again")
    return arrays


def read_ledger(path):
    """Read a ledger (DESIGN: what was missing, with the error before and after).

    Raises
    ------
    ValueError
        It breaks the contract; the message names the file and the first place that does.
    """
    ledger = read_json(path)
    try:
        _check_ledger(ledger)
    except _Wrong as wrong:
        raise ValueError(f"{path}: {wrong}: close the loop again") from None
    return ledger


class _Wrong(Exception):  # noqa: N818 - becomes the ValueError of `read_ledger`
    """What is wrong, and where."""


def _require(fits, what, rule):
    if not fits:
        raise _Wrong(f"{what} must {rule}")


def _keys(value, what, names):
    _require(isinstance(value, dict), what, "be an object")
    for name in names:
        _require(name in value, what, f"hold {name!r}")


def _number(value, what, low=-math.inf, high=math.inf):
    fits = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    _require(fits and low <= value <= high, f"{what}={value!r:.60}", f"be a number in [{low:g}, {high:g}]")


def _interval(value, what, around=None):
    _require(isinstance(value, list) and len(value) == 2, f"{what}={value!r:.60}", "be two numbers")
    for one in value:
        _number(one, what)
    _require(value[0] <= value[1], f"{what}={value}", "have its smaller number first")
    if around is not None:
        _require(value[0] <= around <= value[1], f"{what}={value}", f"lie around {around:g}")


def _list(value, what, check):
    _require(isinstance(value, list), what, "be a list")
    for n, one in enumerate(value):
        check(one, f"{what}[{n}]")


def _split(value, what):
    """Errors by metric and by band."""
    by_metric, by_band = value
    _require(isinstance(by_metric, dict) and set(by_metric) <= set(METRIC), f"{what}.by_metric", "name metrics")
    for metric, one in by_metric.items():
        _number(one, f"{what}.by_metric.{metric}", 0.0, LARGEST)
    _require(isinstance(by_band, list) and len(by_band) == len(BANDS_HZ), f"{what}.by_band",
             f"hold {len(BANDS_HZ)} octaves")
    for one in by_band:
        if one is not None:
            _number(one, f"{what}.by_band", 0.0, LARGEST)


def _errors(value, what):
    _keys(value, what, WAYS)
    for way in WAYS:
        _keys(value[way], f"{what}.{way}", ("error", "ci", "by_metric", "by_band"))
        _number(value[way]["error"], f"{what}.{way}.error", 0.0, LARGEST)
        if value[way]["ci"] is not None:  # of a single room
            _interval(value[way]["ci"], f"{what}.{way}.ci", value[way]["error"])
        _split((value[way]["by_metric"], value[way]["by_band"]), f"{what}.{way}")


def _effect(value, what):
    _require(isinstance(value, str) and value in CATALOGUE, f"{what}={value!r:.60}", "be an effect of the catalogue")


def _candidate(value, what):
    _keys(value, what, ("effect", "gain", "ci", "p", "size_jnd"))
    _effect(value["effect"], f"{what}.effect")
    _number(value["gain"], f"{what}.gain")
    _interval(value["ci"], f"{what}.ci")
    _number(value["p"], f"{what}.p", 0.0, 1.0)
    _number(value["size_jnd"], f"{what}.size_jnd", 0.0)


def _iteration(value, what):
    _keys(value, what, ("effect", "scope", "size_jnd", "parameters", "scored_on", "heldout_error_before",
                        "heldout_error_after", "heldout_error_ci", "p", "by_metric", "by_band", "ranking"))
    _effect(value["effect"], f"{what}.effect")
    scope = CATALOGUE[value["effect"]].SCOPE
    _require(value["scope"] == scope, f"{what}.scope={value['scope']!r:.60}", f"be {scope!r}")
    _require(value["scored_on"] in [f"unseen {way}" for way in WAYS], f"{what}.scored_on={value['scored_on']!r:.60}",
             "be unseen positions or unseen rooms")
    for key in ("heldout_error_before", "heldout_error_after"):
        _number(value[key], f"{what}.{key}", 0.0, LARGEST)
    _interval(value["heldout_error_ci"], f"{what}.heldout_error_ci", value["heldout_error_after"])
    _number(value["p"], f"{what}.p", 0.0, 1.0)
    _number(value["size_jnd"], f"{what}.size_jnd", 0.0)
    _parameters(value["parameters"], CATALOGUE[value["effect"]], f"{what}.parameters")
    for key in ("by_metric", "by_band"):
        _keys(value[key], f"{what}.{key}", ("before", "after"))
    for when in ("before", "after"):
        _split((value["by_metric"][when], value["by_band"][when]), f"{what} {when}")
    _list(value["ranking"], f"{what}.ranking", _candidate)
    _list(value.get("cannot_tell", []), f"{what}.cannot_tell", _effect)
    _require(value.get("cannot_tell", [value["effect"]])[:1] == [value["effect"]], f"{what}.cannot_tell",
             "begin with its effect")


def _parameters(value, effect, what):
    _require(isinstance(value, dict) and value and all(isinstance(one, dict) for one in value.values()), what,
             "give the best of each unit")
    for unit, one in value.items():
        try:
            read_parameters(f"{what}[{unit!r}].best", effect, one.get("best"))
        except ValueError as error:
            raise _Wrong(str(error).rpartition(": ")[0]) from None


def _unexplained(value, what):
    _keys(value, what, ("metric", "time_region", "bands_hz", "varies_with", "size_jnd", "p"))
    _require(value["metric"] in list(REGION), f"{what}.metric={value['metric']!r:.60}", "be a metric")
    region = REGION[value["metric"]]
    _require(value["time_region"] == region, f"{what}.time_region={value['time_region']!r:.60}", f"be {region!r}")
    _require(isinstance(value["bands_hz"], list) and all(one in BANDS_HZ for one in value["bands_hz"]),
             f"{what}.bands_hz={value['bands_hz']!r:.60}", "hold octaves")
    _require(value["varies_with"] in _VARIES, f"{what}.varies_with={value['varies_with']!r:.60}",
             f"be one of {', '.join(_VARIES)}")
    _number(value["size_jnd"], f"{what}.size_jnd")
    _number(value["p"], f"{what}.p", 0.0, 1.0)


def _check_ledger(ledger):
    _keys(ledger, "it", ("rirs", "rooms", "given", "baseline", "iterations", "ranking", "unexplained",
                         "unexplained_all", "final"))
    for key in ("rirs", "rooms"):
        _require(isinstance(ledger[key], int) and not isinstance(ledger[key], bool) and ledger[key] > 0,
                 f"{key}={ledger[key]!r:.60}", "be a positive whole number")
    for key in ("baseline", "final"):
        _errors(ledger[key], key)
    _list(ledger["iterations"], "iterations", _iteration)
    _list(ledger["ranking"], "ranking", _candidate)
    _list(ledger["unexplained_all"], "unexplained_all", _unexplained)
    _require(ledger["unexplained"] == (ledger["unexplained_all"] or [None])[0], "unexplained",
             "be the first of unexplained_all")
    iterations = ledger["iterations"]
    _list(ledger["given"], "given", _effect)
    names = [*ledger["given"], *(one["effect"] for one in iterations)]
    _require(len(set(names)) == len(names), "given and iterations", "name each effect once")
    if not iterations:
        _require(ledger["final"] == ledger["baseline"], "final", "be the baseline where nothing was found")
    else:
        for what, whole, one, key in (("baseline", ledger["baseline"], iterations[0], "heldout_error_before"),
                                      ("final", ledger["final"], iterations[-1], "heldout_error_after")):
            way = one["scored_on"].removeprefix("unseen ")
            _require(whole[way]["error"] == one[key], f"{what}.{way}.error={whole[way]['error']:g}",
                     f"be the {key} of its iteration, {one[key]:g}")
    if "test" in ledger:
        _keys(ledger["test"], "test", ("rirs", "rooms", "before", "after"))
        for key in ("before", "after"):
            _errors(ledger["test"][key], f"test.{key}")
