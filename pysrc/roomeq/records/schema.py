"""Rules of one row of `rirs.jsonl` or `noises.jsonl`: what ids, names and numbers may be."""

import hashlib
import re
from collections.abc import Callable

from roomeq.core.constants import BANDS_HZ

MAX_ID = 200
"""Longest id: files are named by ids, with something behind them."""

LARGEST = 1e9
"""No length, time or level of a room comes near it."""

_SUFFIX = 50  # room for what is put behind an id: a channel, "-noise1"
_HASH = 12
_ID = re.compile(r"[A-Za-z0-9_+][A-Za-z0-9._+-]*")
_ID_RULE = f"1 to {MAX_ID} letters, digits or ._+-, no dash or dot first, no path"
_KINDS = ("ambient", "point")


def is_id(text: str) -> bool:
    """Tell whether a text may be an id: letters, digits and ``._+-``, no path, no leading dash or dot."""
    return isinstance(text, str) and len(text) <= MAX_ID and _ID.fullmatch(text) is not None


def make_id(text: str) -> str:
    """Return the text with everything that an id may not hold turned into ``-``.

    A hash stands at the end where little would be left to tell two texts apart: of a long one, and of one in
    another script.
    """
    cleaned = re.sub(r"[^A-Za-z0-9._+-]+", "-", text).lstrip(".-") or "x"
    if len(cleaned) <= MAX_ID - _SUFFIX and text.isascii():
        return cleaned
    digest = hashlib.sha256(text.encode(errors="surrogatepass")).hexdigest()[:_HASH]
    return f"{cleaned[:MAX_ID - _SUFFIX - _HASH - 1].rstrip('-')}-{digest}"


def _is_number(value) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= LARGEST


def _is_amount(value) -> bool:
    return _is_number(value) and value >= 0


def _is_count(value) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 < value <= LARGEST


def _is_file_name(value) -> bool:
    # a lone surrogate comes from JSON's \ud800 and is no text that a file system takes
    return isinstance(value, str) and value != "" and not re.search("[\0\r\n\ud800-\udfff]", value)


def _is_bool(value) -> bool:
    return isinstance(value, bool)


def _is_list(fits: Callable, length: int) -> Callable:
    return lambda value: isinstance(value, list) and len(value) == length and all(map(fits, value))


def _is_a(kind: type) -> Callable:
    return lambda value: isinstance(value, kind)


_BANDS = len(BANDS_HZ)
_AUDIO = {"wav": (_is_file_name, "a file name"), "fs_hz": (_is_count, "a positive whole number")}
_DIRECT = (lambda value: _is_number(value) and value > -1, "a number of samples, not negative")
_REQUIRED = {
    **dict.fromkeys(("id", "room_id", "source_id", "mic_id"), (is_id, _ID_RULE)),
    **_AUDIO, "n_samples": (_is_count, "a positive whole number"),
}
_OPTIONAL = {
    **dict.fromkeys(("room_dims_m", "source_pos_m", "mic_pos_m", "source_dir", "mic_dir"),
                    (_is_list(lambda x: x is None or _is_number(x), 3), "three numbers (each may be null)")),
    **dict.fromkeys(("distance_m", "documented_t60_s", "target_t60_s", "t30_s"),
                    (_is_amount, "a number, not negative")),
    **dict.fromkeys(("temperature_c", "humidity_pct"), (_is_number, "a number")),
    "direct_sample": _DIRECT,
    "direct_polarity": (lambda value: _is_number(value) and abs(value) == 1, "1 or -1"),
    **dict.fromkeys(("binaural", "unreliable_geometry", "uncommon", "tof_removed"), (_is_bool, "true or false")),
    **dict.fromkeys(("corpus", "room_type", "excitation", "session", "geometry_problem", "screen"),
                    (_is_a(str), "a text")),
    **dict.fromkeys(("noise_for", "repeat_of", "measured_id"), (is_id, "the id of an RIR")),
    "mesh": (_is_file_name, "a file name"),
    "model": (_is_a(list), "a list of effects"),
    **dict.fromkeys(("materials", "acoustic_parameters"), (_is_a(dict), "an object")),
}
"""What the keys of a row hold, null apart: a test and its name."""

_ACOUSTIC_PARAMETERS = {
    "direct_sample": _DIRECT,
    "eq_db": (_is_list(_is_number, _BANDS), f"{_BANDS} numbers"),
    "eq_valid": (_is_list(_is_bool, _BANDS), f"{_BANDS} times true or false"),
    "eq_edge_db": (lambda value: value is None or _is_number(value), "a number or null"),
    "t20_s": (_is_list(lambda x: x is None or _is_amount(x), _BANDS), f"{_BANDS} times, not negative (or null)"),
    "t20_valid": (_is_list(_is_bool, _BANDS), f"{_BANDS} times true or false"),
    "drr_db": (lambda value: value is None or _is_number(value), "a number or null"),
}
"""What steps read of the acoustic parameters."""
_TOGETHER = {"eq_": "eq_db", "t20_": "t20_valid"}
"""Keys that begin alike come together: all are required where this one is there."""

_NOISE = {"id": (is_id, _ID_RULE), "wav": _AUDIO["wav"], "kind": (_KINDS.__contains__, " or ".join(map(repr, _KINDS)))}
_NOISE_OPTIONAL = {"room_id": (is_id, _ID_RULE), "fs_hz": _AUDIO["fs_hz"],
                   "duration_s": (_is_amount, "a number, not negative")}


def row_problem(row: dict) -> str | None:
    """Return what is wrong with one row of `rirs.jsonl`, or None."""
    problem = _problem(row, _REQUIRED, _OPTIONAL)
    parameters = row.get("acoustic_parameters")
    if problem or not parameters:
        return problem
    begins = tuple(begin for begin, key in _TOGETHER.items() if key in parameters)
    required = {key: rule for key, rule in _ACOUSTIC_PARAMETERS.items() if key.startswith(begins)}
    problem = _problem(parameters, required, _ACOUSTIC_PARAMETERS)
    return problem and f"acoustic_parameters: {problem}"


def noise_problem(row: dict) -> str | None:
    """Return what is wrong with one row of `noises.jsonl`, or None."""
    return _problem(row, _NOISE, _NOISE_OPTIONAL)


def _problem(row: dict, required: dict, optional: dict) -> str | None:
    for key, (fits, rule) in required.items():
        if key not in row:
            return f"key {key!r} is missing"
        if not fits(row[key]):
            return f"{key}={_brief(row[key])} must be {rule}"
    for key, (fits, rule) in optional.items():
        if row.get(key) is not None and not fits(row[key]):
            return f"{key}={_brief(row[key])} must be {rule}"
    return None


def _brief(value) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:60]}..."
