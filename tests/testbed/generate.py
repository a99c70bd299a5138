"""Making a set of rooms: scaling its effect to the strength asked for, and writing it."""

from pathlib import Path

import numpy as np

from roomeq.core.audio import write_wav
from roomeq.core.files import write_json
from roomeq.records.rir_dir import write_rirs
from testbed.bases import room_set_fields
from testbed.draws import DECLARED_C, DECLARED_PCT, FS_HZ, N_SAMPLES, generator
from testbed.kinds import KINDS
from testbed.paths import OWN
from testbed.render import render
from testbed.size import cells, changes, mean_size, summary

N_FIT, N_JUDGE = 8, 2  # rooms
N_PROBES = 24  # RIRs that the scale is sought on
TOLERANCE = 0.03  # of the strength, on the probes
CLOSE = 0.08  # on all RIRs


def make_room_set(kind, strength_jnd, seed, out_dir, *, n_fit=N_FIT, n_judge=N_JUDGE, cache=None, base=OWN):
    """Make measured-like RIR directories with an effect that their rows don't tell.

    Writes `fit/` and `test/` (RIR directories; rooms of one are not in the other) and `truth.json`. The same
    seed has the same rooms, positions and noises for every kind and strength.

    Parameters
    ----------
    kind : str
        ``"clean"``, a key of `KINDS`, or several joined by ``+``, each at the strength asked for.
    strength_jnd : float
        Mean absolute change over the cells that the effect touches.
    seed : int
    out_dir : Path
    n_fit, n_judge : int
        Rooms of each part, eight RIRs a room.
    cache : Path, optional
        Folder that keeps traced rooms for other sets of this seed.
    base : str
        The simulator of the rooms without the effect, one of `testbed.bases.BASES`; who stands where, walls and
        noises are the same for each.

    Returns
    -------
    truth : dict
        What `truth.json` holds.
    """
    names = [] if kind == "clean" else kind.split("+")
    for name in names:
        if name not in KINDS:
            raise ValueError(f"kind={name!r} must be clean or one of {', '.join(KINDS)}, or some of them joined by +")
    rooms = room_set_fields(seed, n_fit + n_judge, cache, base)
    fit = [field for room in rooms[:n_fit] for field in room]
    test = [field for room in rooms[n_fit:] for field in room]
    clean = [cells(render(field), field) for field in fit] if names else []
    extras, effects = [], {}
    for name in names:
        drawn = KINDS[name].draw(seed, [room[0].room for room in rooms])
        scale, found = scaled(KINDS[name], drawn, strength_jnd, fit, clean)
        extras.append(KINDS[name].extra(drawn, scale))
        effects[name] = dict(scale=scale, parameters=drawn, cells=summary(found), mean_jnd=mean_size(found),
                             achieved_jnd=mean_size(found, KINDS[name].measured_by),
                             measured_by=list(KINDS[name].measured_by))
    truth = dict(kind=kind, base=base, strength_jnd=float(strength_jnd), seed=int(seed), effects=effects,
                 achieved_jnd={name: effects[name]["achieved_jnd"] for name in names},
                 rooms=[_room(room[0].room) for room in rooms])
    _write(Path(out_dir) / "fit", fit, extras)
    _write(Path(out_dir) / "test", test, extras)
    write_json(Path(out_dir) / "truth.json", truth)
    return truth


def scaled(kind, drawn, strength_jnd, fit, clean):
    """Find the scale at which an effect has a strength, or the end of its range that comes nearest.

    Returns
    -------
    scale : float
    found : dict
        Changes of all responses at that scale, see `testbed.size.changes`.
    """
    def sizes_at(scale, chosen):
        extra = [kind.extra(drawn, scale)]
        return changes([clean[k] for k in chosen], [cells(render(fit[k], extra), fit[k]) for k in chosen])

    names = list(dict.fromkeys(field.room.room_id for field in fit))[:kind.probe_rooms]
    few = [field for field in fit if field.room.room_id in names]  # the first of all, so that numbers are the same
    # the same pair of positions of every room would show one loudspeaker or one angle
    probes = np.sort(generator(fit[0].room.seed, "probes").permutation(len(few))[:N_PROBES])
    wanted = strength_jnd
    for _ in range(2):
        scale = _solved(lambda x: mean_size(sizes_at(x, probes), kind.measured_by), kind.scales, wanted)  # noqa: B023
        found = sizes_at(scale, range(len(fit)))
        size = mean_size(found, kind.measured_by)
        if np.isclose(scale, kind.scales).any() or abs(size / strength_jnd - 1.0) < CLOSE:
            break
        wanted *= strength_jnd / max(size, 1e-3)  # the probes aren't quite like the others
    return scale, found


def _solved(size_of, scales, wanted):
    """Solve size(scale) = wanted within the range: secant steps over both logarithms, inside what is bracketed."""
    low, high = np.log(scales)
    x, slope, last = 0.5 * (low + high), 0.7, None
    for _ in range(12):
        y = np.log(max(size_of(np.exp(x)), 1e-3) / wanted)
        if abs(y) < TOLERANCE or (x == high and y < 0.0) or (x == low and y > 0.0):
            break
        low, high = (low, x) if y > 0.0 else (x, high)
        if last is not None and x != last[0]:
            slope = np.clip((y - last[1]) / (x - last[0]), 0.2, 5.0)
        last = x, y
        x = np.clip(x - y / slope, low, high)
        if x == last[0]:
            break
        if high - low < np.log(scales[1] / scales[0]) and x in (low, high) and x not in np.log(scales):
            x = 0.5 * (low + high)
    return float(np.exp(x))


def _room(room):
    return dict(room_id=room.room_id, dims_m=room.dims_m.tolist(), absorption=room.absorption.round(4).tolist(),
                scattering=room.scattering.round(4).tolist(), sources_m=room.sources_m.tolist(),
                mics_m=room.mics_m.tolist())


def _write(directory, fields, extras):
    """Write the responses of some fields as an RIR directory."""
    rows = []
    for field in fields:
        rir = field.rir
        wav = f"audio/{rir.rir_id}.wav"
        write_wav(directory / wav, render(field, extras), FS_HZ)
        rows.append(dict(
            id=rir.rir_id, wav=wav, room_id=field.room.room_id, source_id=rir.source_id, mic_id=rir.mic_id,
            fs_hz=FS_HZ, n_samples=N_SAMPLES, room_dims_m=field.room.dims_m.round(3).tolist(),
            source_pos_m=rir.declared_source_m.round(4).tolist(), mic_pos_m=rir.declared_mic_m.round(4).tolist(),
            source_dir=rir.facing.round(6).tolist(), temperature_c=DECLARED_C, humidity_pct=DECLARED_PCT,
            tof_removed=False))
    write_rirs(directory, rows)
