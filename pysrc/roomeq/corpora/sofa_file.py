"""SOFA files (AES69) of measured rooms, read with `sofar`: one RIR per measurement, receiver and emitter.

The data types FIR, FIR-E and FIRE (FIR-E of old) are read: `SingleRoomSRIR`, `SingleRoomMIMOSRIR`,
`MultiSpeakerBRIR`, `GeneralFIR`, `GeneralFIR-E` and similar conventions. Where the file states the room's corners,
positions are relative to its lowest corner; without corners the distance to the walls is unknown, and only the distance
of source and microphone is kept.
"""

import math
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from roomeq.core.arrays import FloatArray
from roomeq.core.audio import MAX_RATE_HZ
from roomeq.core.extras import require_packages
from roomeq.core.limits import AUDIO_HOURS, max_audio_samples
from roomeq.corpora.record import Recording, is_binaural_name, rir_row
from roomeq.records.schema import LARGEST

_DATA_TYPES = ("FIR", "FIR-E", "FIRE")
_FREE_FIELD = ("HRIR", "HRTF", "Directivity", "Headphone")
_BINAURAL = ("MultiSpeakerBRIR", "SingleRoomDRIR")
_HEADS = ("dummy", "head", "kemar", "ku100", "ku 100", "hats", "artificial", "human")
_DEFAULT_CORNERS = ([0.0, 0.0, 0.0], [1.0, 2.0, 3.0])
_DEFAULT_POSITIONS = ([0.0, 0.0, 1.0], [0.0, 0.0, 0.0])
_TEMPERATURES_C = (-30.0, 60.0)
_ORTHOGONAL = 1e-6
_MAX_CHARACTERS = 10**6  # of names and descriptions
_MAX_VARIABLES = 1000  # a convention has about 50, attributes included; each takes time to read


def sofa_signals(recording: Recording) -> Iterator[tuple[dict[str, Any], FloatArray, int]]:
    """Yield row (with its `id`), samples and sample rate [Hz] of every RIR of a SOFA file.

    Raises
    ------
    ValueError
        The file is not a SOFA file, is too large, holds no impulse responses of a room, or its arrays do not fit each
        other.
    """
    path = recording.path
    sofa = _open(path)
    try:
        yield from _signals(sofa, recording)
    except (ValueError, TypeError, IndexError) as error:  # arrays of texts, of other shapes, empty ones
        text = str(error)
        raise ValueError(text if text.startswith(str(path)) else f"{path}: arrays do not fit each other ({text}): "
                         "export it again") from None


def _signals(sofa: Any, recording: Recording) -> Iterator[tuple[dict[str, Any], FloatArray, int]]:
    path = recording.path
    irs = _array(sofa, "Data_IR")
    if irs is None or irs.ndim not in (3, 4):
        raise ValueError(f"{path}: Data.IR must have the dimensions M x R x N (x E): export it as FIR")
    irs = irs if irs.ndim == 4 else irs[..., np.newaxis]
    if sofa.GLOBAL_DataType == "FIRE":  # M x R x E x N
        irs = np.moveaxis(irs, 2, 3)
    n_measurements, n_receivers, n_samples, n_emitters = irs.shape
    rates_hz = _array(sofa, "Data_SamplingRate")
    rates_hz = np.zeros(1) if rates_hz is None else np.atleast_1d(rates_hz)
    room = _room(sofa, recording.id)
    binaural = _is_binaural(sofa, n_receivers)
    for m in range(n_measurements):
        rate_hz = float(rates_hz[min(m, len(rates_hz) - 1)])
        if not 0 < rate_hz <= MAX_RATE_HZ or rate_hz != round(rate_hz):
            raise ValueError(f"{path}: Data.SamplingRate={rate_hz:g} must be a whole number of hertz, at most "
                             f"{MAX_RATE_HZ}: export it again")
        for r in range(n_receivers):
            for e in range(n_emitters):
                suffix = "".join((f"_m{m:0{len(str(n_measurements - 1))}d}" * (n_measurements > 1),
                                  f"_ch{r}" * (n_receivers > 1), f"_e{e}" * (n_emitters > 1)))
                # what a CSV states of the file comes before what the file itself states
                named = dict(binaural=binaural, source_id=_named(sofa, "Source"), mic_id=_named(sofa, "Listener"))
                facings = dict(source_dir=_facing(sofa, "Source", m), mic_dir=_facing(sofa, "Listener", m))
                known = room | _positions(sofa, m, r, e) | facings | named | recording.row
                known["source_id"] += str(e or "")
                known["mic_id"] += f"-ch{r}" * (n_receivers > 1)
                row = rir_row(**known)
                delay = _delay_samples(sofa, m, r, e, path)
                yield row | dict(id=recording.id + suffix), np.pad(irs[m, r, :, e], (delay, 0)), round(rate_hz)


def open_sofa(path: Path) -> Any:
    """Return the content of a SOFA file, as `sofar` reads it.

    Raises
    ------
    ValueError
        The file cannot be read as SOFA, or is too large.
    """
    require_packages("sofar")
    import sofar

    if path.suffix != ".sofa":  # which `sofar` would put in place of another one
        raise ValueError(f"{path}: a SOFA file's name must end in .sofa: rename it")
    try:
        _check_size(path)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # preliminary conventions: this module checks what it needs
            sofa = sofar.read_sofa(str(path), verify=False, verbose=False)
    except Exception as error:  # netCDF and sofar raise errors of any type on broken bytes
        raise ValueError(f"{path}: cannot be read as SOFA ({' '.join(str(error).split())[:120]}): export it "
                         "again") from None
    return sofa


def _open(path: Path) -> Any:
    sofa = open_sofa(path)
    convention, data_type = sofa.GLOBAL_SOFAConventions, sofa.GLOBAL_DataType
    if data_type not in _DATA_TYPES:
        raise ValueError(f"{path}: data type {data_type!r} must be FIR or FIR-E: export impulse responses")
    if any(word in convention for word in _FREE_FIELD):
        raise ValueError(f"{path}: convention {convention} describes a free field, no room: leave the file out")
    return sofa


def _check_size(path: Path) -> None:
    """Refuse a file whose arrays are too large before they are read; compressed arrays make small files.

    AES69 knows numbers and characters. A string or an array as a value takes memory by its own length.
    """
    from netCDF4 import Dataset

    with Dataset(str(path)) as file:
        variables = file.variables.values()
        for variable in variables:
            if not (isinstance(variable.datatype, np.dtype) and variable.datatype.kind in "iufS"):
                raise ValueError(f"variable {variable.name!r:.60} must hold plain numbers or characters, no strings or "
                                 "records")
            if variable.datatype.kind == "S" and math.prod(variable.shape) > _MAX_CHARACTERS:
                raise ValueError(f"variable {variable.name!r:.60} of {math.prod(variable.shape)} characters must hold "
                                 f"at most {_MAX_CHARACTERS}")
        n_read = len(file.ncattrs()) + sum(1 + len(variable.ncattrs()) for variable in variables)
        n_values = sum(math.prod(variable.shape) for variable in variables)
    if n_read > _MAX_VARIABLES:
        raise ValueError(f"{n_read} variables and attributes must be at most {_MAX_VARIABLES}")
    if n_values > max_audio_samples():
        raise ValueError(f"{n_values} values must be at most {max_audio_samples()}, see roomeq --{AUDIO_HOURS.option}")


def _array(sofa: Any, name: str) -> FloatArray | None:
    value = getattr(sofa, name, None)
    return None if value is None else np.asarray(value, dtype=float)


def _corners(sofa: Any) -> tuple[FloatArray, FloatArray] | None:
    """Return two opposite corners of the room, shape (3,) each [m], or None where the file has no plausible ones.

    The corners of the convention's example are those that nobody has replaced.
    """
    a, b = _array(sofa, "RoomCornerA"), _array(sofa, "RoomCornerB")
    if a is None or b is None or not a.size == b.size == 3:
        return None
    a, b = a.ravel(), b.ravel()
    plausible = (a.tolist(), b.tolist()) != _DEFAULT_CORNERS and (np.abs(b - a) > 0).all() and (
        np.abs([a, b]) <= LARGEST).all()
    return (a, b) if plausible else None


def _room(sofa: Any, file_id: str) -> dict[str, Any]:
    """Return the keys of a row that describe the room; without a name it has the id of its file."""
    corners = _corners(sofa)
    dims_m = None if corners is None else np.abs(corners[1] - corners[0]).tolist()
    named = str(getattr(sofa, "GLOBAL_RoomShortName", "") or "").strip()
    return dict(room_id=named or file_id, room_dims_m=dims_m, temperature_c=_temperature_c(sofa),
                room_type=str(getattr(sofa, "GLOBAL_RoomDescription", "") or "").strip() or None)


def _temperature_c(sofa: Any) -> float | None:
    value = _array(sofa, "RoomTemperature")
    if value is None or value.size != 1:
        return None
    kelvin = str(getattr(sofa, "RoomTemperature_Units", "kelvin")).lower().startswith("k")
    celsius = round(float(value.ravel()[0]) - (273.15 if kelvin else 0.0), 3)
    return celsius if _TEMPERATURES_C[0] < celsius < _TEMPERATURES_C[1] and value.any() else None


def _positions(sofa: Any, m: int, r: int, e: int) -> dict[str, Any]:
    """Return positions (relative to the room's lowest corner) or distance of one measurement, or why it has neither."""
    centres = [vector_of(sofa, f"{who}Position", 0, m) for who in ("Source", "Listener")]
    source = _position(sofa, "Source", "Emitter", m, e)
    mic = _position(sofa, "Listener", "Receiver", m, r)
    if all(centre is not None and centre.tolist() == default
           for centre, default in zip(centres, _DEFAULT_POSITIONS, strict=True)):
        return dict(geometry_problem="SourcePosition and ListenerPosition are those of the convention's example, which "
                                     "nobody has replaced")
    if source is None or mic is None:
        unusable = " and ".join(f"{who}Position" for who, position in (("Source", source), ("Listener", mic))
                                if position is None)
        return dict(geometry_problem=f"{unusable} is absent, or no finite vector in Cartesian or spherical coordinates "
                                     f"of at most {LARGEST:g} m")
    corners = _corners(sofa)
    if corners is None:
        return dict(distance_m=round(float(np.linalg.norm(source - mic)), 4))
    corner = np.minimum(*corners)
    return dict(source_pos_m=np.round(source - corner, 4).tolist(), mic_pos_m=np.round(mic - corner, 4).tolist())


def _facing(sofa: Any, who: str, m: int) -> list[float] | None:
    """Return the unit vector of a view that changes from measurement to measurement.

    One view for all may be that of the convention's example, which nobody has replaced.
    """
    views = _array(sofa, f"{who}View")
    if views is None or views.ndim != 2 or np.all(views == views[0]):
        return None
    view = vector_of(sofa, f"{who}View", 0, m)
    return None if view is None or not view.any() else np.round(view / np.linalg.norm(view), 6).tolist()


def _position(sofa: Any, whole: str, part: str, m: int, n: int) -> FloatArray | None:
    """Return the position of the n-th part (receiver, emitter) of the whole (listener, source), shape (3,) [m]."""
    centre = vector_of(sofa, f"{whole}Position", 0, m)
    local = vector_of(sofa, f"{part}Position", n, m)
    if centre is None or local is None or not local.any():
        return centre
    forward, up = vector_of(sofa, f"{whole}View", 0, m), vector_of(sofa, f"{whole}Up", 0, m)
    axes = axes_of(forward if forward is not None and forward.any() else None, up)
    if axes is None:
        return centre
    position: FloatArray = centre + axes @ local
    return position


def axes_of(forward: FloatArray | None, up: FloatArray | None) -> FloatArray | None:
    """Return the local axes of a device with a view, by default x, and a direction up, by default z.

    Returns
    -------
    ndarray, shape (3, 3), or None
        Unit vectors in columns: x is the view, z is up, and y, to the left, completes a right-handed frame. None if the
        two do not point in two different directions.
    """
    forward = np.array([1.0, 0.0, 0.0]) if forward is None else forward
    if not forward.any():
        return None
    forward = forward / np.linalg.norm(forward)
    up = np.array([0.0, 0.0, 1.0]) if up is None else up
    up = up - (up @ forward) * forward
    if np.linalg.norm(up) < _ORTHOGONAL:
        return None
    up /= np.linalg.norm(up)
    return np.column_stack([forward, np.cross(up, forward), up])


def vector_of(sofa: Any, name: str, n: int, m: int) -> FloatArray | None:
    """Return a Cartesian vector from an array of shape (1|M, 3) or (n, 3[, 1|M]); None if absent or not finite."""
    array = _array(sofa, name)
    if array is None or array.ndim not in (2, 3) or array.shape[1] != 3:
        return None
    relative = name.startswith(("Emitter", "Receiver"))
    row: FloatArray = array[min(n if relative else m, len(array) - 1)]
    vector: FloatArray = row if row.ndim == 1 else row[:, min(m, row.shape[1] - 1)]
    kind, units = (str(getattr(sofa, f"{name.replace('Up', 'View')}_{key}", "")).lower() for key in ("Type", "Units"))
    if not (np.abs(vector) <= LARGEST).all() or kind not in ("", "cartesian", "spherical"):
        return None
    if kind != "spherical":
        return vector
    # degrees by AES69; some files state radians
    azimuth, elevation = vector[:2] if units.startswith("rad") else np.deg2rad(vector[:2])
    cartesian: FloatArray = vector[2] * np.array([np.cos(elevation) * np.cos(azimuth),
                                                  np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    return cartesian


def _delay_samples(sofa: Any, m: int, r: int, e: int, path: Path) -> int:
    """Return the number of samples, rounded, by which Data.Delay delays the stored response."""
    delay = _array(sofa, "Data_Delay")
    if delay is None or not delay.any():
        return 0
    delay = delay.reshape((1,) * (3 - delay.ndim) + delay.shape) if delay.ndim < 2 else delay
    delay = delay[..., np.newaxis] if delay.ndim == 2 else delay
    at = tuple(min(i, size - 1) for i, size in zip((m, r, e), delay.shape, strict=True))
    if not 0 <= delay[at] < 1e6:
        raise ValueError(f"{path}: Data.Delay={delay[at]:g} samples must lie in [0, 1e6): export it again")
    return round(float(delay[at]))


def _is_binaural(sofa: Any, n_receivers: int) -> bool:
    described = " ".join(str(getattr(sofa, f"GLOBAL_{key}", "")) for key in
                         ("ListenerShortName", "ListenerDescription", "ReceiverShortName", "Title")).lower()
    return sofa.GLOBAL_SOFAConventions in _BINAURAL or (
        n_receivers == 2 and (any(head in described for head in _HEADS) or is_binaural_name(described)))


def _named(sofa: Any, who: str) -> str:
    return str(getattr(sofa, f"GLOBAL_{who}ShortName", "") or "").strip() or "unknown"
