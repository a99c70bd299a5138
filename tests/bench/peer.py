"""pyroomacoustics, as the benches call it. It is an optional requirement (`requirements.txt`)."""

import time

import numpy as np

from bench.ours import Rendered

FS_HZ = 16000
ABSENT = "pyroomacoustics is not installed (pip install -r tests/bench/requirements.txt): its columns are empty"


def load():
    """Return the module, or None where it isn't installed."""
    try:
        import pyroomacoustics
    except ImportError:
        return None
    return pyroomacoustics


def hybrid(dims_m, absorption, scattering, source_pos_m, mics_m, *, n_rays=20_000, order=3, speed_m_s=343.2,
           n_bands=1, threads=2, seed=1, air=False):
    """Simulate with image sources up to `order` and ray tracing, and render.

    Parameters
    ----------
    dims_m : array_like, shape (3,)
    absorption : float or array_like, shape (6,)
    scattering : float
    source_pos_m : array_like, shape (3,)
    mics_m : array_like, shape (n_mics, 3)
    n_bands : int
        1: a flat material, which it renders in one band; 7 or 8: octaves from 125 or from 62.5 Hz, each with the
        same coefficients.
    air : bool
        Air absorption, which makes it render in bands.

    Returns
    -------
    responses : list of Rendered
        Scaled by 1 / (4 pi): its direct sound is 1 / r.
    seconds : dict
        Wall time of ``images``, ``rays`` and ``render``.
    """
    pra = load()
    pra.constants.set("num_threads", threads)
    pra.constants.set("c", speed_m_s)
    pra.constants.set("octave_bands_base_freq", 62.5 if n_bands == 8 else 125.0)
    pra.random.seed(seed)
    start = time.perf_counter()
    room = pra.ShoeBox(list(dims_m), fs=FS_HZ, materials=_materials(pra, absorption, scattering, n_bands),
                       max_order=order, ray_tracing=n_rays > 0, air_absorption=air)
    if n_rays > 0:
        room.set_ray_tracing(n_rays=n_rays)
    return _rendered(pra, room, source_pos_m, mics_m, start)


def extruded(plan_m, height_m, walls, floor, ceiling, source_pos_m, mics_m, *, n_rays, order=3, speed_m_s=343.2,
             threads=2, seed=1):
    """Simulate as `hybrid` does, in a room with a polygon as its plan, with eight octave bands and air.

    Parameters
    ----------
    plan_m : array_like, shape (n_walls, 2)
        Corners, anticlockwise.
    height_m : float
    walls : list of tuple
        Absorption and scattering of each wall, shape (8,) each; wall n leads from corner n to the next.
    floor, ceiling : tuple
    """
    pra = load()
    pra.constants.set("num_threads", threads)
    pra.constants.set("c", speed_m_s)
    pra.constants.set("octave_bands_base_freq", 62.5)
    pra.random.seed(seed)
    start = time.perf_counter()
    room = pra.Room.from_corners(np.asarray(plan_m).T, fs=FS_HZ, materials=[_octaves(pra, *wall) for wall in walls],
                                 max_order=order, ray_tracing=True, air_absorption=True)
    room.extrude(height_m, materials={"floor": _octaves(pra, *floor), "ceiling": _octaves(pra, *ceiling)})
    room.set_ray_tracing(n_rays=n_rays)
    return _rendered(pra, room, source_pos_m, mics_m, start)


def _rendered(pra, room, source_pos_m, mics_m, start):
    """Add source and microphones, simulate and render; see `hybrid` for what is returned."""
    room.add_source(list(source_pos_m))
    room.add_microphone_array(np.atleast_2d(mics_m).T)
    marks = [start]
    for step in (room.image_source_model, room.ray_tracing, room.compute_rir):
        step()
        marks.append(time.perf_counter())
    delay = pra.constants.get("frac_delay_length") // 2
    distance_m = np.linalg.norm(np.atleast_2d(mics_m) - np.asarray(source_pos_m), axis=1)
    direct = distance_m / pra.constants.get("c") * FS_HZ + delay
    responses = [Rendered(np.asarray(rir[0], dtype=float) / (4.0 * np.pi), FS_HZ, float(sample))
                 for rir, sample in zip(room.rir, direct, strict=True)]
    return responses, dict(zip(("images", "rays", "render"), np.diff(marks), strict=True))


def image_paths(dims_m, absorption, source_pos_m, mic_pos_m, *, order):
    """Its image sources.

    Returns
    -------
    distance_m : ndarray, shape (n_paths,)
        Sorted.
    gain : ndarray, shape (n_paths,)
        Pressure relative to a direct sound of 1 / (4 pi r).
    """
    pra = load()
    pra.constants.set("octave_bands_base_freq", 125.0)
    room = pra.ShoeBox(list(dims_m), fs=FS_HZ, materials=_materials(pra, absorption, 0.0, 1), max_order=order)
    room.add_source(list(source_pos_m))
    room.add_microphone(list(mic_pos_m))
    room.image_source_model()
    source = room.sources[0]
    distance_m = np.linalg.norm(source.images.T - np.asarray(mic_pos_m), axis=1)
    gain = source.damping[0] / (4.0 * np.pi * distance_m)
    by_length = np.argsort(distance_m, kind="stable")
    return distance_m[by_length], gain[by_length]


def _octaves(pra, absorption, scattering):
    """A material with coefficients of eight octaves."""
    centres = [62.5 * 2 ** k for k in range(8)]

    def spread(values):
        return {"coeffs": [float(value) for value in values], "center_freqs": centres}

    return pra.Material(energy_absorption=spread(absorption), scattering=spread(scattering))


def _materials(pra, absorption, scattering, n_bands):
    """One material per wall; with bands, the same coefficient at each centre frequency."""
    centres = None if n_bands == 1 else [(62.5 if n_bands == 8 else 125.0) * 2 ** k for k in range(n_bands)]

    def spread(value):
        return float(value) if centres is None else {"coeffs": [float(value)] * n_bands, "center_freqs": centres}

    names = ("west", "east", "south", "north", "floor", "ceiling")
    return {name: pra.Material(energy_absorption=spread(value), scattering=spread(scattering))
            for name, value in zip(names, np.broadcast_to(absorption, 6), strict=True)}
