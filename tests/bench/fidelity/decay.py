"""Decay times of rendered responses against the reference, in eighteen rooms and in rooms with unequal walls."""

import numpy as np

from bench import ours, peer
from bench.fidelity.analytic import eyring_time_s
from bench.fidelity.estimate import decay_time_s, rir_decay_time_s
from bench.fidelity.reference import trace_energy
from bench.kit import Check, Section

SIZES_M = ((6.0, 4.0, 3.0), (12.0, 8.0, 4.0), (20.0, 10.0, 5.0))
ABSORPTIONS = (0.1, 0.3)
SCATTERINGS = (0.1, 0.5, 0.9)
CEILING = (0.1, 0.1, 0.1, 0.1, 0.1, 0.8)
N_SOURCES, N_MICS = 3, 4
N_SOURCES_UNEQUAL = 12  # where sound decays unevenly: at 12 pairs, the reference itself is 6 % off its mean in a room
REFERENCE_RAYS = 50_000  # a source, twice as many where walls differ: a tenth of what our own response scatters by
WALL_DISTANCE_M = 0.6
SPHERE_M = 0.4


def run(quick):
    """Eighteen rooms with equal walls: every room within 5 %, median within 2 %."""
    sizes = SIZES_M[:2] if quick else SIZES_M
    rooms = [(size, alpha, s) for size in sizes for alpha in ABSORPTIONS for s in SCATTERINGS]
    section = _compare("decay", f"Decay time, -5 to -25 dB, {len(rooms)} shoeboxes with equal walls", rooms, quick,
                       N_SOURCES)
    ours_pct, peer_pct = (np.array(section.curves[who], dtype=float) for who in ("ours_pct", "peer_pct"))
    section.checks = [
        Check("largest deviation of any room", float(np.max(np.abs(ours_pct))), high=5.0, unit="%"),
        Check("median deviation", float(np.median(np.abs(ours_pct))), high=2.0, unit="%")]
    if not np.isnan(peer_pct).any():
        section.checks += [
            Check("pyroomacoustics, largest deviation", float(np.max(np.abs(peer_pct))), unit="%"),
            Check("pyroomacoustics, median deviation", float(np.median(np.abs(peer_pct))), unit="%")]
    return section


def run_unequal(quick):
    """One absorbing ceiling (0.8, the other walls 0.1), where Eyring's formula is wrong."""
    sizes = SIZES_M[:1] if quick else SIZES_M
    rooms = [(size, CEILING, s) for size in sizes for s in SCATTERINGS]
    section = _compare("unequal", f"Decay time with an absorbing ceiling, {len(rooms)} shoeboxes", rooms, quick,
                       N_SOURCES if quick else N_SOURCES_UNEQUAL)
    largest = float(np.max(np.abs(section.curves["ours_pct"])))
    section.checks = [Check("largest deviation of any room", largest, high=5.0, unit="%")]
    return section


def positions(dims_m, rng, *, apart_m, n_sources=N_SOURCES):
    """Draw sources and microphones, clear of the walls and at least `apart_m` from each other.

    Returns
    -------
    sources : ndarray, shape (n_sources, 3)
    mics : ndarray, shape (n_sources, N_MICS, 3)
    """
    low, high = np.full(3, WALL_DISTANCE_M), np.asarray(dims_m) - WALL_DISTANCE_M
    while True:
        sources = rng.uniform(low, high, (n_sources, 3))
        candidates = rng.uniform(low, high, (n_sources, 400, 3))
        far = np.linalg.norm(candidates - sources[:, None], axis=2) >= apart_m
        if np.all(far.sum(axis=1) >= N_MICS):
            return sources, np.stack([some[ok][:N_MICS] for some, ok in zip(candidates, far, strict=True)])


def _compare(name, title, rooms, quick, n_sources):
    pra = peer.load()
    rows, ours_pct, peer_pct, labels = [], [], [], []
    for index, (dims_m, absorption, scattering) in enumerate(rooms):
        eyring_s = eyring_time_s(dims_m, absorption)
        # ISO 3382-2 asks for 2 sqrt(V / c T) between source and microphone
        apart_m = min(2.0 * np.sqrt(np.prod(dims_m) / (343.0 * eyring_s)), 0.5 * np.linalg.norm(dims_m))
        sources, mics = positions(dims_m, np.random.default_rng(index), apart_m=apart_m, n_sources=n_sources)
        total_s, error_s, here_s = reference_times(dims_m, absorption, scattering, sources, mics, eyring_s, quick)
        own = _own_times(dims_m, absorption, scattering, sources, mics)
        other = _peer_times(dims_m, absorption, scattering, sources, mics) if pra else np.full(own.shape, np.nan)
        deviation = [100.0 * (np.mean(times) / total_s - 1.0) for times in (own, other, here_s)]
        ours_pct.append(deviation[0])
        peer_pct.append(deviation[1])
        labels.append("x".join(f"{size:g}" for size in dims_m))
        rows.append([labels[-1], "ceiling 0.8" if np.ndim(absorption) else absorption, scattering,
                     total_s, 100.0 * error_s / total_s, np.mean(own), deviation[0],
                     100.0 * np.std(own) / np.sqrt(own.size) / total_s, deviation[1], deviation[2],
                     100.0 * (eyring_s / total_s - 1.0)])
    columns = ["room", "alpha", "scatter", "reference s", "+-%", "ours s", "ours %", "+-%", "pyroomacoustics %",
               "reference here %", "Eyring %"]
    notes = [f"mean over {n_sources * N_MICS} source-microphone pairs, {ours.N_RAYS} rays, air absorbs nothing; "
             "'reference here': the reference's own energy in spheres around these microphones, so what is due to "
             "the positions"]
    if not pra:
        notes.append(peer.ABSENT)
    curves = {"ours_pct": ours_pct, "peer_pct": peer_pct, "rooms": labels}
    return Section(name, title, columns, rows, notes=notes, curves=curves)


def reference_times(dims_m, absorption, scattering, sources, mics, eyring_s, quick):
    """Decay time of the total energy, its standard error, and the decay times at the microphones."""
    batches, here = [], []
    for n, (source, around) in enumerate(zip(sources, mics, strict=True)):
        decay = trace_energy(dims_m, absorption, scattering, source_pos_m=source, mics_m=around, radius_m=SPHERE_M,
                             duration_s=1.6 * eyring_s + 0.1, seed=n + 1,
                             n_rays=REFERENCE_RAYS * (1 if quick or not np.ndim(absorption) else 2))
        batches.append(decay.energy)
        step_s = decay.time_s[1]
        here += [decay_time_s(curve[np.flatnonzero(curve)[0]:], step_s) for curve in decay.density_per_m3]
    energy = np.mean(batches, axis=0)
    single = [decay_time_s(curve, step_s) for curve in energy]
    return decay_time_s(energy.mean(axis=0), step_s), np.std(single, ddof=1) / np.sqrt(len(single)), np.array(here)


def _own_times(dims_m, absorption, scattering, sources, mics):
    scene = ours.box_scene(dims_m, absorption, scattering)
    return np.array([[rir_decay_time_s(one.rir, one.fs_hz, one.direct_sample)
                      for one in ours.simulate(scene, source, around, seed=n)]
                     for n, (source, around) in enumerate(zip(sources, mics, strict=True))])


def _peer_times(dims_m, absorption, scattering, sources, mics):
    return np.array([[rir_decay_time_s(one.rir, one.fs_hz, one.direct_sample)
                      for one in peer.hybrid(dims_m, absorption, scattering, source, around, seed=n)[0]]
                     for n, (source, around) in enumerate(zip(sources, mics, strict=True))])


def draw(axis, section):
    """Deviation of each room."""
    index = np.arange(len(section.curves["rooms"]))
    axis.axhspan(-5, 5, color="0.9")
    axis.plot(index, np.array(section.curves["ours_pct"], dtype=float), "o", label="roomeq")
    axis.plot(index, np.array(section.curves["peer_pct"], dtype=float), "x", label="pyroomacoustics")
    axis.set(title=section.name + ": decay time", ylabel="deviation from the reference (%)", xlabel="room")
    axis.legend()
