"""Energy balance: nothing is lost or gained by scattering, and no ray leaks."""

import numpy as np

from bench import ours
from bench.fidelity.decay import CEILING
from bench.fidelity.reference import SPEED_M_S, trace_energy
from bench.kit import Check, Section

ROOM_M = (6.0, 4.0, 3.0)
SCATTERINGS = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0)
CLEAR_M, SPHERE_M = 0.45, 0.4
N_SOURCES = 4


def run(quick):
    """At alpha 0 all energy stays; with absorption what is left is what the reference has left; within 1 %."""
    rows, lossless_pct, absorbing_pct = [], [], []
    n_mics = 12 if quick else 60
    sources, mics = lattice(n_mics)
    for scattering in SCATTERINGS[::3] if quick else SCATTERINGS:
        kept, *absorbed = received((0.0, 0.3, CEILING), scattering, sources, mics)
        early, late = (float(np.mean(kept[first:last])) for first, last in ((50, 100), (300, 400)))
        lossless_pct.append(100.0 * (late - 1.0))
        ratios = []
        for absorption, energy in zip((0.3, CEILING), absorbed, strict=True):
            left = [trace_energy(ROOM_M, absorption, scattering, duration_s=0.25, source_pos_m=source, mics_m=mics,
                                 radius_m=SPHERE_M, n_rays=20_000 if quick else 60_000, seed=n + 1).density_per_m3
                    for n, source in enumerate(sources)]
            expected = np.mean(left, axis=(0, 1)) * np.prod(ROOM_M)
            found = energy[:len(expected)]
            ratios.append(100.0 * (found[20:250].sum() / expected[20:250].sum() - 1.0))
        absorbing_pct += ratios
        rows.append([scattering, 100.0 * (early - 1.0), lossless_pct[-1], *ratios])
    checks = [Check("alpha 0, worst", float(np.max(np.abs(lossless_pct))), high=1.0, unit="%"),
              Check("with absorption, worst", float(np.max(np.abs(absorbing_pct))), high=1.0, unit="%")]
    rows_leak, checks_leak = _leaks(quick)
    notes = [f"energy received by {n_mics} x {N_SOURCES} source-microphone pairs spread over the room (echogram and "
             "image sources, before rendering); alpha 0: against the energy emitted, evenly spread; with absorption: "
             "against the reference's in spheres around the same microphones"]
    notes += [f"{name}: {rays} rays, {reflections:.3g} reflections, {leaked} leaked ({share:.2g})"
              for name, rays, reflections, leaked, share in rows_leak]
    return Section("balance", "Energy balance over scattering, 6x4x3 m",
                   ["scattering", "alpha 0, 50-100 ms, %", "alpha 0, 300-400 ms, %", "alpha 0.3, from 20 ms, %",
                    "ceiling 0.8, from 20 ms, %"], rows, checks + checks_leak, notes)


def lattice(n_mics):
    """Sources and microphones, spread evenly over the room but for `CLEAR_M` at the walls."""
    low, high = CLEAR_M, np.asarray(ROOM_M) - CLEAR_M
    # additive recurrence of the plastic number's analogue in three dimensions (Roberts 2018): even, no seed
    steps = np.outer(np.arange(1, N_SOURCES + n_mics + 1), [0.8191725134, 0.6710436067, 0.5497004779])
    points = low + (high - low) * ((0.5 + steps) % 1.0)
    return points[:N_SOURCES], points[N_SOURCES:]


def received(absorptions, scattering, sources, mics):
    """Energy per 1 ms frame over that of an even spread of the emitted energy, mean over all pairs.

    Returns
    -------
    shares : ndarray, shape (n_absorptions, n_frames)
    """
    scenes = [ours.box_scene(ROOM_M, absorption, scattering) for absorption in absorptions]
    echoes = [ours.echograms(scenes, source, mics, duration_s=0.5, seed=n) for n, source in enumerate(sources)]
    even = SPEED_M_S / (4.0 * np.pi * np.prod(ROOM_M)) * ours.FRAME_S
    return np.mean(echoes, axis=(0, 2)) / even


def _leaks(quick):
    """Leaked rays of the shoebox and of meshes."""
    rows = []
    for name, scene, source in ours.watertight_scenes():
        rays, repeats = 5_000 if quick else 50_000, 1 if quick else 4
        reflections, leaked = np.sum([ours.leaked(scene, source, n_rays=rays, seed=n) for n in range(repeats)], axis=0)
        rows.append([name, rays * repeats, int(reflections), int(leaked), float(leaked / (rays * repeats))])
    worst = max((row[4] for row in rows), default=0.0)
    return rows, [Check("leaked rays, worst share", worst, high=1e-5)]


def draw(axis, section):
    """Deviations over scattering."""
    rows = np.array(section.rows, dtype=float)
    axis.axhspan(-1, 1, color="0.9")
    for column, label in ((2, "alpha 0"), (3, "alpha 0.3"), (4, "ceiling 0.8")):
        axis.plot(rows[:, 0], rows[:, column], "o-", label=label)
    axis.set(title="balance: energy received", xlabel="scattering", ylabel="deviation (%)")
    axis.legend()
