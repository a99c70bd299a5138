"""The simulators that the rooms without any effect come from."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

from testbed import own, paths
from testbed.rooms import draw_room

PYROOMACOUSTICS = "pyroomacoustics"
BASES = (paths.OWN, PYROOMACOUSTICS)


@dataclass(frozen=True)
class Base:
    """What a simulator does, for `testbed.render`; spectra have the shape (N_FFT // 2 + 1,).

    Attributes
    ----------
    fields_of : callable
        (room, cache folder or None) -> the fields of its eight pairs.
    pulses : callable
        (length of each path [m], pressure, shape (8, n), speed of sound, air) -> spectrum of these paths.
    spread : callable
        (energy, shape (8, N_BINS)) -> the same, without the noise of single rays.
    late : callable
        (field, energy, speed of sound, air) -> spectrum of noise that has this energy.
    finished : callable
        (rir, speed of sound, air) -> rir, once all is added up.
    """

    fields_of: Callable
    pulses: Callable
    spread: Callable
    late: Callable
    finished: Callable


@cache
def base_named(name):
    """Return a base of `BASES`."""
    if name == paths.OWN:
        return Base(paths.fields_of, own.pulses, paths.smoothed, own.late, own.finished)
    if name != PYROOMACOUSTICS:
        raise ValueError(f"base={name!r} must be one of {', '.join(BASES)}")
    try:
        from testbed import pyroom
    except ModuleNotFoundError as error:
        if error.name != PYROOMACOUSTICS:
            raise
        raise ValueError(f"base={name!r} needs pyroomacoustics: pip install -r tests/bench/requirements.txt") from None
    return Base(pyroom.fields_of, pyroom.pulses, pyroom.spread, pyroom.late, pyroom.finished)


def room_set_fields(seed, n_rooms, cache=None, base=paths.OWN):
    """Fields of the rooms of a set, one list per room."""
    return [base_named(base).fields_of(draw_room(seed, number), cache) for number in range(n_rooms)]
