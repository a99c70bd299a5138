"""Russian roulette, which late rays play so that few of them describe the late decay.

Once reflections are denser than samples, far more paths arrive than a smooth decay needs. From then on, rays that would
carry little energy with materials like the expected ones play Russian roulette (Arvo and Kirk, SIGGRAPH 1990, 63): half
of them end, and the others represent two. The rays that remain carry about equal energies, so that few of them describe
the late decay. The result is unbiased for any absorption, and least noisy near the expected one.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from roomeq.core.arrays import FloatArray, IntArray, Number, Numbers
from roomeq.core.jit import inlined, uniform
from roomeq.sim.room import Room

LATE_RAYS = 5000
"""Rays that remain in a diffuse field once reflections are dense, if there are so many."""
MAX_SHARE = 4.0
"""Largest energy of a late ray that has lost as much as a diffuse field, in units of that of an early one."""
_FAIR_BITS = 8  # of the number of a ray
_LOG_2 = float(np.log(2.0))
_LEAST_ENERGY = 1e-8  # of a diffuse field, at which rays end whatever their number
_LOG_LEAST = float(np.log(_LEAST_ENERGY))


class Roulette(NamedTuple):
    """When a ray plays Russian roulette.

    Attributes
    ----------
    late_m
        Only beyond this length of path.
    log_reflected
        Logarithm of the energy that is expected to be reflected by each face, shape (n_faces,).
    decay_per_m
        Of the logarithm of the expected energy in a diffuse field, by Eyring's formula.
    log_share
        Logarithm of the least energy of a ray, relative to that of a diffuse field, that is spared.
    """

    late_m: float
    log_reflected: FloatArray
    decay_per_m: float
    log_share: float


def roulette_for(room: Room, absorption: ArrayLike, num_rays: int, face_surface: IntArray, late_m: float) -> Roulette:
    """Return when rays play, beyond `late_m` of path, if surfaces absorb as expected.

    Parameters
    ----------
    room
    absorption
        That is expected of each surface, shape (n_surfaces,) or one for all.
    num_rays
        From the source.
    face_surface
        Surface of each face, shape (n_faces,).
    late_m
        See `Roulette`.
    """
    area_m2 = room.surface_area_m2
    reflected = np.maximum(1.0 - np.broadcast_to(absorption, area_m2.shape), _LEAST_ENERGY)
    decay_per_m = -np.log(area_m2 @ reflected / area_m2.sum()) * area_m2.sum() / (4.0 * room.volume_m3)
    return Roulette(late_m, np.log(reflected)[face_surface], float(decay_per_m),
                    float(np.log(np.clip(num_rays / LATE_RAYS, 1.0, MAX_SHARE))))


@inlined
def plays_at(roulette: Roulette, length: Number, log_energy: Number) -> Number:
    """Return whether a ray carries too little energy to be followed without Russian roulette."""
    diffuse_field = max(-roulette.decay_per_m * length, _LOG_LEAST)
    return (length > roulette.late_m) & (log_energy < roulette.log_share + diffuse_field)


@inlined
def play_at(roulette: Roulette, ray: Number, stream: Number, n: Number, length: Number, log_energy: Number,
            plays: Number) -> Numbers:
    """Let a ray play Russian roulette at reflection `n`, if it carries too little energy to be followed otherwise.

    The order of the rays is random, so that the bits of a ray's number are fair coins; and where all rays play, exactly
    half of them end.

    Returns
    -------
    represents_two, ends : bool
    log_energy : float
        From this reflection on.
    plays : int
        How often the ray has survived.
    """
    if not plays_at(roulette, length, log_energy):
        return False, False, log_energy, plays
    if (ray >> plays) & 1 == 1 if plays < _FAIR_BITS else uniform(stream, 4 * n + 3) < 0.5:
        return True, False, log_energy + _LOG_2, plays + 1
    return False, True, log_energy, plays
