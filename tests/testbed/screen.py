"""An obstacle between sources and microphones: a hard screen that hangs in the room."""

from dataclasses import replace
from functools import cache

import numpy as np
from scipy.special import fresnel

from testbed.draws import C0, FREQUENCY_HZ, generator
from testbed.paths import OWN, condensed, rays
from testbed.render import Extra
from testbed.trace import COHERENT_ORDER

HALF_M = (1.0, 0.8)  # half width and half height at scale 1
AWAY_M = 0.2  # nobody stands nearer to the screen's plane
N_TRIES = 300
_COARSE_HZ = np.linspace(0.0, FREQUENCY_HZ[-1], 1025)


def draw_screens(seed, rooms):
    """Per room the screen that stands between most pairs: centre and direction it faces, both horizontal."""
    result = {}
    for room in rooms:
        rng = generator(seed, "screen", room.room_id)
        best = (-1, None)
        for _ in range(N_TRIES):
            s, m = rng.integers(len(room.sources_m)), rng.integers(len(room.mics_m))
            part = rng.uniform(0.2, 0.8)
            centre = part * room.sources_m[s] + (1.0 - part) * room.mics_m[m]
            turn = rng.uniform(0.0, np.pi)
            blocked = _blocked(room, centre, turn)
            if blocked > best[0]:
                best = blocked, dict(centre_m=centre.tolist(), turn_rad=float(turn))
        result[room.room_id] = best[1]
    return result


def _blocked(room, centre, turn):
    """Pairs that a screen half the size stands between; -1 where somebody stands too near."""
    normal = np.array([np.cos(turn), np.sin(turn), 0.0])
    everyone = np.concatenate([room.sources_m, room.mics_m]) - centre
    if np.abs(everyone @ normal).min() < AWAY_M:
        return -1
    screen = _screen(room, dict(centre_m=centre, turn_rad=turn), 0.5)
    return sum(_crossing(room.sources_m[s], _unit(room.mics_m[m] - room.sources_m[s]), screen)[0]
               < np.linalg.norm(room.mics_m[m] - room.sources_m[s])
               for s in range(len(room.sources_m)) for m in range(len(room.mics_m)))


def _screen(room, where, scale):
    """Centre, axes (across, up, normal) and half sizes; it ends 10 cm before walls, floor and ceiling."""
    centre, turn = np.array(where["centre_m"]), where["turn_rad"]
    axes = np.array([[-np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0], [np.cos(turn), np.sin(turn), 0.0]])
    clear = np.minimum(centre, room.dims_m - centre) - 0.1
    half = scale * np.array(HALF_M)
    with np.errstate(divide="ignore"):
        half[0] = min(half[0], *(clear[:2] / np.abs(axes[0, :2])))
    half[1] = min(half[1], clear[2])
    return centre, axes, half


def occlusion(parameters, scale):
    """What the screen of each room does to specular paths that it stands in, and to rays.

    Another base than the testbed's own traces no rays past a screen: there they stay as they are, as do the specular
    paths of more than `COHERENT_ORDER` reflections, since what a hard screen takes from one late path another gets.
    """
    @cache
    def traced(room_id):
        return condensed(rays(rooms[room_id], _screen(rooms[room_id], parameters[room_id], scale)))

    rooms = {}

    def scene(field):
        if field.base != OWN:
            return field
        room = rooms.setdefault(field.room.room_id, field.room)
        energy, share = traced(room.room_id)
        pair = field.rir.source, field.rir.mic
        return replace(field, energy=energy[pair], share=share[pair])

    def blocking(field):
        screen = _screen(field.room, parameters[field.room.room_id], scale)
        source = field.room.sources_m[field.rir.source]
        result = {}
        for k in np.flatnonzero(field.images.order <= COHERENT_ORDER):
            length, way = field.images.length_m[k], field.images.departure[k]
            transfer = np.ones(len(_COARSE_HZ), dtype=complex)
            for before, x, y, across in _met(field.room.dims_m, source, way, length, screen):
                transfer = transfer * past_screen(before, length - before, x, y, across, screen[2], _COARSE_HZ)
            if np.any(transfer != 1.0):
                result[k] = np.interp(FREQUENCY_HZ, _COARSE_HZ, transfer)
        return result
    return Extra(scene=scene, blocking=blocking)


def past_screen(before_m, behind_m, x, y, across, half, frequency_hz):
    """Transfer function of what passes by a rectangular screen, relative to the free path.

    One less the field through an opening of the screen's shape, a product of Fresnel integrals (Babinet's principle
    and Kirchhoff's approximation; Born & Wolf, Principles of Optics, 8.7) whose arguments come from the exact detours.
    Kirchhoff's edges know no pressure on the screen: each is as much louder as Sommerfeld's hard half-plane says for
    large arguments.

    Parameters
    ----------
    before_m, behind_m : float
        Way to the screen and from it.
    x, y : float
        Where the path goes through its plane, from its centre [m].
    across : tuple of float
        How much of the screen's width and height the path sees, 0 to 1.
    half : sequence of float
        Half width and half height [m].
    frequency_hz : ndarray
    """
    opening = 1.0
    for at, size, seen in zip((x, y), half, across, strict=True):
        part = 1.0
        for edge in (size + at, size - at):
            off = edge * seen
            detour = np.hypot(before_m, off) + np.hypot(behind_m, off) - before_m - behind_m
            sine, cosine = fresnel(np.sqrt(4.0 * detour * frequency_hz / C0))
            angles = np.arctan2(before_m, off), np.arctan2(behind_m, off)
            louder = 1.0 + np.cos((angles[0] + angles[1]) / 2.0) / np.cos((angles[0] - angles[1]) / 2.0)
            part = part - louder * (0.5 - (cosine - 1j * sine) / (1.0 - 1j))
        opening = opening * part
    return 1.0 - opening


def _met(dims, source, way, length, screen):
    """Where a specular path of a shoebox goes through the screen: (way so far, x, y, share seen) each time."""
    at, way, dims, gone = source.tolist(), way.tolist(), dims.tolist(), 0.0
    while gone < length - 1e-9:
        reach, axis = min(((dims[k] - at[k] if way[k] > 0.0 else -at[k]) / way[k] if way[k] else np.inf, k)
                          for k in range(3))
        step = min(reach, length - gone)
        t, x, y = _crossing(at, way, screen)
        if t < step and 0.0 < gone + t < length:
            yield gone + t, x, y, tuple(np.sqrt(1.0 - (screen[1][:2] @ way) ** 2))
        at = [at[k] + step * way[k] for k in range(3)]
        gone += step
        way[axis] = -way[axis]


def _crossing(at, way, screen):
    """Distance along a ray to the screen (infinite if it passes by) and the place on it; lists, for speed."""
    (cx, cy, cz), axes, half = screen
    ax, ay = axes[0][0], axes[0][1]  # the normal is (ay, -ax, 0)
    facing = way[0] * ay - way[1] * ax
    t = ((cx - at[0]) * ay - (cy - at[1]) * ax) / facing if abs(facing) > 1e-9 else np.inf
    if not 1e-6 < t < np.inf:
        return np.inf, 0.0, 0.0
    x = (at[0] + t * way[0] - cx) * ax + (at[1] + t * way[1] - cy) * ay
    y = at[2] + t * way[2] - cz
    return (t, x, y) if abs(x) <= half[0] and abs(y) <= half[1] else (np.inf, x, y)


def _unit(vector):
    return vector / np.linalg.norm(vector)
