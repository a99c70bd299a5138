"""Shoebox rooms, their walls, and who stands where in them."""

from dataclasses import dataclass

import numpy as np

from testbed.draws import N_BANDS, generator

N_SOURCES, N_MICS = 2, 4
POSITION_SD_M = 0.02  # of each declared coordinate
FAMILIES = {
    "plaster": (0.20, 0.18, 0.12, 0.08, 0.06, 0.05, 0.05, 0.06),
    "concrete": (0.02, 0.02, 0.02, 0.03, 0.04, 0.05, 0.06, 0.07),
    "wood": (0.30, 0.28, 0.22, 0.16, 0.11, 0.09, 0.08, 0.08),
    "carpet": (0.04, 0.06, 0.10, 0.18, 0.30, 0.42, 0.52, 0.58),
    "tile": (0.22, 0.30, 0.42, 0.52, 0.56, 0.58, 0.56, 0.52),
    "curtain": (0.05, 0.09, 0.18, 0.28, 0.36, 0.42, 0.46, 0.48),
    "glass": (0.24, 0.20, 0.13, 0.09, 0.06, 0.05, 0.04, 0.04),
    "linoleum": (0.02, 0.03, 0.03, 0.04, 0.05, 0.05, 0.06, 0.06),
}
"""Absorption of the walls per octave, made up after what textbooks list."""

_WALLS = ("plaster", "concrete", "wood", "curtain", "glass")
_FLOORS = ("carpet", "linoleum", "wood", "concrete")
_CEILINGS = ("plaster", "tile", "concrete", "wood")


@dataclass(frozen=True)
class Rir:
    """One source-microphone pair of a room."""

    rir_id: str
    source: int
    mic: int
    source_id: str
    mic_id: str
    facing: np.ndarray
    declared_source_m: np.ndarray
    declared_mic_m: np.ndarray


@dataclass(frozen=True, eq=False)
class Room:
    """A room as it is.

    Attributes
    ----------
    seed : int
        Of the room set.
    room_id : str
    dims_m : ndarray, shape (3,)
    absorption : ndarray, shape (6, 8)
        Walls x=0, x=L, y=0, y=L, floor, ceiling, per octave.
    scattering : ndarray, shape (6,)
    sources_m, mics_m : ndarray, shape (2, 3) and (4, 3)
        Where they truly are.
    rirs : tuple of Rir
    """

    seed: int
    room_id: str
    dims_m: np.ndarray
    absorption: np.ndarray
    scattering: np.ndarray
    sources_m: np.ndarray
    mics_m: np.ndarray
    rirs: tuple

    @property
    def volume_m3(self):
        return float(np.prod(self.dims_m))

    @property
    def areas_m2(self):
        """Shape (6,)."""
        x, y, z = self.dims_m
        return np.repeat([y * z, x * z, x * y], 2)

    @property
    def eyring_s(self):
        """Reverberation time per octave without air, shape (8,)."""
        return self.volume_m3 * 0.161 / _exponent(self.absorption, self.areas_m2)


def draw_room(seed, number):
    """Draw room `number` of the set of a seed; kinds and strengths have no say in it."""
    rng = generator(seed, "room", number)
    volume = np.exp(rng.uniform(np.log(40.0), np.log(250.0)))
    height = np.clip(rng.uniform(0.85, 1.15) * volume ** 0.24, 2.4, 4.2)
    width = np.sqrt(volume / height / rng.uniform(1.05, 1.9))
    dims = np.array([volume / height / width, width, height])
    absorption = _draw_absorption(rng, dims)
    scattering = rng.uniform(0.1, 0.5, 6)
    sources, mics = _draw_positions(rng, dims)
    room_id = f"w{seed:03d}r{number:02d}"
    rirs = tuple(_draw_rir(seed, room_id, s, m, sources[s], mics[m])
                 for s in range(N_SOURCES) for m in range(N_MICS))
    return Room(seed, room_id, dims, absorption, scattering, sources, mics, rirs)


def _exponent(absorption, areas):
    """Eyring's absorption area -S ln(1 - mean) per band [m²]."""
    mean = areas @ absorption / areas.sum()
    return -areas.sum() * np.log1p(-mean)


def _draw_absorption(rng, dims):
    x, y, z = dims
    areas = np.repeat([y * z, x * z, x * y], 2)
    main = rng.choice(_WALLS)
    names = [main if rng.random() < 0.6 else rng.choice(_WALLS) for _ in range(4)]
    names += [rng.choice(_FLOORS), rng.choice(_CEILINGS)]
    octave = np.linspace(-1.0, 1.0, N_BANDS)
    nepers = []
    for name in names:
        bend = rng.normal(0.0, 0.15) + rng.normal(0.0, 0.15) * octave + rng.normal(0.0, 0.15) * np.cos(np.pi * octave)
        nepers.append(-np.log1p(-np.array(FAMILIES[name])) * np.exp(bend))
    nepers = np.array(nepers)
    volume = float(np.prod(dims))
    shortest = max(0.25, 0.161 * volume / (areas.sum() * -np.log1p(-0.45)))
    target = np.exp(rng.uniform(np.log(shortest), np.log(1.0)))
    spread = rng.uniform(0.8, 1.25)
    for _ in range(60):  # what furniture and leaks take keeps the octaves' times near each other
        time = 0.161 * volume / _exponent(-np.expm1(-nepers), areas)
        wanted = np.clip(time / time[4], 0.7 / spread, 1.5 * spread) * target
        nepers *= time / wanted
        nepers = np.minimum(nepers, 2.5)
    return -np.expm1(-nepers)


def _draw_positions(rng, dims):
    low, high = np.array([0.6, 0.6, 1.2]), dims - np.array([0.6, 0.6, 0.0])
    high[2] = min(1.7, dims[2] - 0.7)
    while True:
        sources = rng.uniform(low, high, (N_SOURCES, 3))
        mics = rng.uniform(low, high, (N_MICS, 3))
        apart = np.linalg.norm(sources[:, None] - mics, axis=-1)
        among = np.linalg.norm(mics[:, None] - mics, axis=-1) + np.eye(N_MICS)
        if apart.min() > 0.8 and among.min() > 0.4 and np.linalg.norm(sources[0] - sources[1]) > 0.5:
            return sources, mics


def _draw_rir(seed, room_id, s, m, source, mic):
    rng = generator(seed, "rir", room_id, s, m)
    # angles between facing and microphone run from 0 to 150 degrees over the eight pairs of a room
    order = generator(seed, "facing", room_id).permutation(N_SOURCES * N_MICS)[s * N_MICS + m]
    angle = np.radians(150.0 * (order + rng.random()) / (N_SOURCES * N_MICS))
    ahead = (mic - source) / np.linalg.norm(mic - source)
    across = np.cross(ahead, rng.standard_normal(3))
    facing = np.cos(angle) * ahead + np.sin(angle) * across / np.linalg.norm(across)
    return Rir(f"{room_id}-s{s}m{m}", s, m, f"spk{(s + m // 2) % 2 + 1}", f"mic{m % 2 + 1}", facing,
               source + rng.normal(0.0, POSITION_SD_M, 3), mic + rng.normal(0.0, POSITION_SD_M, 3))
