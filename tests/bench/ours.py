"""The simulator under test, as the benches call it: the only file of the benches that knows its functions."""

import time
from dataclasses import dataclass

import numpy as np

from bench.rooms import FURNISHED_M, box_triangles, furnished_triangles, l_triangles
from roomeq.acoustics.air import air_absorption_db_m
from roomeq.acoustics.filterbank import octave_filterbank
from roomeq.core.constants import FS_HZ
from roomeq.core.jit import on_threads
from roomeq.core.rng import rng_for
from roomeq.sim.context import add_image_sources, make_render_context, ray_echograms
from roomeq.sim.diffraction import Edges, Grid, deposit, diffract, find_edges
from roomeq.sim.echogram import FRAME_S, compute_echograms
from roomeq.sim.images import specular_paths
from roomeq.sim.materials import draw_materials, draw_scattering, read_materials
from roomeq.sim.mesh import make_room
from roomeq.sim.path_sample import sample_paths
from roomeq.sim.render import LOWEST_HZ
from roomeq.sim.response import (
    ISM_ORDER,
    SERVED,
    decay_length_s,
    eyring_exponent,
    needed_length_s,
    render_responses,
    render_to_target,
    simulate_responses,
    trace_source,
)
from roomeq.sim.scene import Air, Material, Scene, Shoebox
from roomeq.sim.target import scaled_absorption
from roomeq.sim.tree import first_hits

N_RAYS = 20_000
REFLECTIONS_FROM_HZ = LOWEST_HZ


@dataclass(frozen=True)
class StillAir:
    """Air that absorbs nothing: decays are then the same in all bands, and the reference needs no bands."""

    speed_m_s: float = 343.2

    @property
    def attenuation_per_m(self):
        return np.zeros(8)


@dataclass(frozen=True)
class Rendered:
    """An impulse response.

    Attributes
    ----------
    rir : ndarray, shape (n_samples,)
    fs_hz : float
    direct_sample : float
    """

    rir: np.ndarray
    fs_hz: float
    direct_sample: float


def box_scene(dims_m, absorption, scattering, air=None):
    """A shoebox of six walls.

    Parameters
    ----------
    dims_m : array_like, shape (3,)
    absorption : float or array_like, shape (6,) or (6, 8)
        Of x = 0, x = length, y = 0, y = width, z = 0, z = height.
    scattering : float or array_like, shape (8,)
    air : optional
        Air that absorbs nothing where not given.
    """
    rows = np.asarray(absorption, dtype=float)
    rows = np.broadcast_to(rows[:, None] if rows.ndim == 1 else rows, (6, 8))
    materials = [Material(f"wall{n}", tuple(row), scattering) for n, row in enumerate(rows)]
    return Scene(Shoebox(tuple(dims_m)), materials, StillAir() if air is None else air)


def simulate(scene, source_pos_m, mics_m, *, n_rays=N_RAYS, ism_order=ISM_ORDER, seed=0, target_t60_s=None):
    """Simulate and render; list of `Rendered`, one per microphone."""
    responses = simulate_responses(scene, source_pos_m, mics_m, num_rays=n_rays, ism_order=ism_order, seed=seed,
                             target_t60_s=target_t60_s)
    return [Rendered(response.rir, FS_HZ, response.direct_sample) for response in responses]


def real_air(temperature_c=20.0, humidity_pct=50.0):
    """The simulator's own air."""
    return Air(temperature_c, humidity_pct)


def specular_list(dims_m, absorption, source_pos_m, mic_pos_m, order):
    """Lengths [m] and pressure gains (scattering 0, no air) of its specular paths, sorted by length."""
    scene = box_scene(dims_m, absorption, 0.0)
    images = specular_paths(scene.room, source_pos_m, mic_pos_m, order)
    return images.distance_m, images.gains(scene.absorption, scene.scattering, np.zeros(8))[:, 0]


def air_db_m(frequency_hz, temperature_c, humidity_pct):
    """Air absorption as the simulator computes it [dB/m]."""
    return float(air_absorption_db_m(frequency_hz, temperature_c, humidity_pct))


def filterbank_ripple_db(n_fft=32768):
    """Largest deviation of the sum of the octave filters from one [dB]."""
    return float(np.max(np.abs(20.0 * np.log10(np.sum(octave_filterbank(n_fft, FS_HZ), axis=0)))))


def echograms(scenes, source_pos_m, mics_m, *, duration_s, seed, n_rays=N_RAYS, ism_order=ISM_ORDER):
    """Energy per frame of `FRAME_S`, image sources included and air left out, shape (n_scenes, n_mics, n_frames).

    The scenes differ in absorption alone, so one trace serves all; materials must be the same in all bands.
    """
    (path,) = traced(scenes[0], source_pos_m, seed=seed, n_rays=n_rays, duration_s=duration_s).paths
    energies = np.array([compute_echograms(path, scene.room, scene.absorption, mics_m, ism_order=ism_order,
                                n_frames=round(duration_s / FRAME_S), speed_m_s=scene.air.speed_m_s).energy[:, :, 4]
                         for scene in scenes])
    for m, mic in enumerate(mics_m):
        images = specular_paths(scenes[0].room, source_pos_m, mic, ism_order)
        frame = (images.distance_m / scenes[0].air.speed_m_s / FRAME_S).astype(int)
        inside = frame < energies.shape[2]
        for energy, scene in zip(energies, scenes, strict=True):
            gains = images.gains(scene.absorption, scene.scattering, scene.air.attenuation_per_m)[:, 4]
            np.add.at(energy[m], frame[inside], gains[inside] ** 2)
    return energies


def mesh_scene(triangles, names, absorption, scattering, air=None):
    """A mesh whose materials all have one absorption and scattering."""
    room = make_room(triangles, names)
    materials = [Material(surface, absorption, scattering) for surface in room.surfaces]
    return Scene(room, materials, StillAir() if air is None else air)


def l_room_lengths(source_pos_m, mic_pos_m, order):
    """Lengths of the simulator's specular paths in the L-shaped room, sorted [m]."""
    scene = mesh_scene(*l_triangles(), 0.1, 0.0)
    return np.sort(specular_paths(scene.room, source_pos_m, mic_pos_m, order).distance_m)


def half_plane_speed_m_s():
    """Speed of sound that `half_plane` takes."""
    return StillAir().speed_m_s


def half_plane(source_pos_m, mic_pos_m, length_m, frequencies_hz):
    """Spectrum of the diffraction at the edge along z of a rigid half-plane y = 0, x > 0."""
    x, y, z = np.eye(3)
    edges = Edges(np.array([-0.5 * length_m * z]), z[None], np.array([length_m]), x[None], y[None],
                  np.array([2.0 * np.pi]), np.zeros((1, 2), dtype=int), np.array([[0, 1]]))
    grid = Grid.between(np.linalg.norm(source_pos_m - mic_pos_m), 1.1 * length_m, 1, half_plane_speed_m_s() / FS_HZ,
                        10 ** 6)
    deposit(grid, edges, np.array([0]), np.zeros(1), edges.length_m, source_pos_m, mic_pos_m, direct_visible=True)
    found = grid.sampled()
    time_s = (found.first_sample + np.arange(found.signals.shape[1])) / FS_HZ
    return np.exp(-2j * np.pi * np.outer(frequencies_hz, time_s)) @ found.signals.sum(axis=0)


def diffraction_ms(mics_m):
    """Median milliseconds per microphone that diffraction takes in the furnished mesh, and its number of edges."""
    room, spent = mesh_scene(*furnished_triangles(), 0.1, 0.5).room, []
    for mic_m in mics_m:
        start = time.perf_counter()
        diffract(room, (2.1, 3.3, 1.5), mic_m, speed_m_s=StillAir().speed_m_s, n_samples=FS_HZ, direct_visible=True)
        spent.append(1e3 * (time.perf_counter() - start))
    return float(np.median(spent)), len(find_edges(room))


def watertight_scenes():
    """Closed rooms: (name, scene, source)."""
    box = box_triangles(FURNISHED_M)
    return [("box", box_scene(FURNISHED_M, 0.1, 0.5), (2.1, 3.3, 1.5)),
            ("box as 12 triangles", mesh_scene(box, ["wall"] * 12, 0.1, 0.5), (2.1, 3.3, 1.5)),
            ("L", mesh_scene(*l_triangles(), 0.1, 0.5), (5.2, 1.1, 1.4)),
            ("furnished, 2,000 triangles", mesh_scene(*furnished_triangles(), 0.1, 0.5), (2.1, 3.3, 1.5))]


def leaked(scene, source_pos_m, *, n_rays, seed, duration_s=1.0):
    """Trace; return the number of reflections and of rays that leaked."""
    paths = traced(scene, source_pos_m, seed=seed, n_rays=n_rays, duration_s=duration_s).paths
    return int(sum(path.counts.sum() for path in paths)), int(sum(path.n_leaked for path in paths))


def simulate_drawn(dims_m, source_pos_m, mic_pos_m, target_s, *, seed, tries=10):
    """Simulate a target with drawn materials, as the recipe does: drawn again where a target is out of reach."""
    table, room, air = read_materials(), Shoebox(tuple(dims_m)), Air()
    rng = rng_for(seed, "materials", "")
    for draw in range(tries):
        scattering = draw_scattering(table, room, rng)
        scene = draw_materials(table, room, scattering, air, target_s, rng)
        try:
            return simulate(scene, source_pos_m, [mic_pos_m], seed=seed, target_t60_s=target_s)[0]
        except ValueError:
            if draw == tries - 1:
                raise


def sampled_and_full(dims_m, source_pos_m, noise_pos_m, mic_pos_m, target_s, *, seed):
    """Echograms from a path sample and from all paths, at the absorption that meets a target with drawn materials.

    Returns
    -------
    list of (sampled, full, largest)
        Of the source, with the sample that the search used (None where all paths were followed), and of a noise source,
        with a sample for what the search found. Energy, shape (n_frames, 8); and the most that a sample gives to one
        path, relative to its whole frame.
    """
    table, room, air, rng = read_materials(), Shoebox(tuple(dims_m)), Air(), rng_for(seed, "materials", "")
    scene = draw_materials(table, room, draw_scattering(table, room, rng), air, target_s, rng)
    expected = absorption = scaled_absorption(scene.absorption, eyring_exponent(scene, target_s))
    mics_m, pairs = [mic_pos_m], []
    length_s = needed_length_s(scene, target_s)
    for position_m in (source_pos_m, noise_pos_m):
        source = traced(scene, position_m, seed=seed, duration_s=length_s)
        n_frames = int(np.ceil(decay_length_s(scene, absorption) / FRAME_S))
        samples = sample_paths(source, mics_m, absorption, [rng_for(seed, "echoes", "")],
                               ism_order=ISM_ORDER, n_frames=min(n_frames, int(np.ceil(length_s / FRAME_S))))
        rngs = [rng_for(seed, "tail", "")]
        if not pairs:
            (found,) = render_to_target(source, mics_m, rngs, target_s, length_s=length_s, path_samples=samples)
            absorption = found.absorption
            exponent = np.median(np.log1p(-np.minimum(absorption, 1.0 - 1e-12)) / np.log1p(-expected))
            if not SERVED[0] < exponent < SERVED[1]:  # then all paths are followed
                pairs.append(None)
                continue
        energies = []
        for chosen in (samples, None):
            context = make_render_context(source, mics_m, rngs, length_s=length_s, ism_order=ISM_ORDER,
                                          diffraction=False, path_samples=chosen)
            rays = ray_echograms(context, absorption, range(8)).energy
            energies.append(add_image_sources(context, rays, context.image_gains(absorption, list(range(8))))[0])
        pairs.append((*energies, _largest_path(samples[0], source, absorption, context)))
    return pairs


def _largest_path(sample, source, absorption, context):
    """Most energy that a sample gives to one path, relative to that of all paths of its frame, over frames and bands.

    Frames of which all paths together hold less than 1e-6 of the band's energy do not count.
    """
    largest, trace_of_band = 0.0, np.array(source.trace_of_band)
    for trace in np.unique(trace_of_band):
        full = compute_echograms(source.paths[trace], source.scene.room, absorption, context.mics_m,
                                 ism_order=ISM_ORDER, n_frames=sample.weight.shape[1],
                                 speed_m_s=source.scene.air.speed_m_s, visible=context.visible[trace]).energy[0]
        for band in np.flatnonzero(trace_of_band == trace):
            energy = np.log(np.maximum(1.0 - absorption[:, band], 1e-30)) @ sample.reflection_counts[trace, ..., None]
            energy = sample.weight[trace] * np.exp(energy[..., 0])
            held = full[:, band] > 1e-6 * full[:, band].sum()
            largest = np.maximum(largest, np.max(energy[held] / full[held, band, None], initial=0.0))
    return largest


def traced(scene, source_pos_m, *, seed, n_rays=N_RAYS, duration_s=1.5):
    """Trace only."""
    return trace_source(scene, source_pos_m, num_rays=n_rays, max_length_s=duration_s, rng=rng_for(seed, "trace", ""))


def stages(scene, source_pos_m, mics_m, *, repeats):
    """Median seconds of the stages of some microphones.

    ``trace``; ``sample`` (once per microphone: a share of the paths that reach it); then, for each new set of
    materials, ``new materials`` (echograms of all bands from the samples), ``rendering`` (echograms and responses), or
    ``gather`` (echograms from all paths); and ``target``: responses that meet a T30, from the samples.
    """
    length_s, air = needed_length_s(scene), scene.air
    n_frames, spent = int(length_s / FRAME_S), {}
    for n in range(repeats + 1):
        rngs = [rng_for(n, "tail", str(k)) for k in range(len(mics_m))]
        marks = [time.perf_counter()]
        source = traced(scene, source_pos_m, seed=n, duration_s=length_s)
        marks.append(time.perf_counter())
        for one in source.paths:
            compute_echograms(one, scene.room, scene.absorption, mics_m, ism_order=ISM_ORDER, n_frames=n_frames,
                   speed_m_s=air.speed_m_s)
        marks.append(time.perf_counter())
        path_samples = sample_paths(source, mics_m, scene.absorption, rngs, ism_order=ISM_ORDER, n_frames=n_frames)
        marks.append(time.perf_counter())
        on_threads(lambda sample: sample.echogram(0.9 * scene.absorption),  # noqa: B023
                   [(sample,) for sample in path_samples])
        marks.append(time.perf_counter())
        render_responses(source, mics_m, rngs, absorption=0.9 * scene.absorption, path_samples=path_samples)
        marks.append(time.perf_counter())
        render_to_target(source, mics_m, rngs, 0.8, path_samples=path_samples)
        marks.append(time.perf_counter())
        for key, seconds in zip(("trace", "gather", "sample", "new materials", "rendering", "target"), np.diff(marks),
                                strict=True):
            spent.setdefault(key, []).append(seconds)
    return {key: float(np.median(values[1:])) for key, values in spent.items()}


def closest_hits(room, origins, directions):
    """Find the closest hits of rays in a mesh."""
    return first_hits(room.tree, origins, directions)


def reflections(traced_source):
    """Number of reflections of a traced source."""
    return int(sum(path.counts.sum() for path in traced_source.paths))
