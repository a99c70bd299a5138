"""Level: the direct sound at any distance, and the late energy against the diffuse-field formula."""

import numpy as np

from bench import ours
from bench.fidelity.decay import SIZES_M, SPHERE_M, positions
from bench.fidelity.pulses import fit_pulses
from bench.fidelity.reference import SPEED_M_S, trace_energy
from bench.kit import Check, Section

DISTANCES_M = (0.3, 0.5, 1.0, 2.0, 4.0, 8.0, 15.0, 30.0)
LOWEST_HZ = 177.0  # below, image sources of one sign add up coherently, as they do in a real room
REPEATS = 4  # simulations of each source: Gaussian tails alone make the mean of 12 responses uncertain by 0.08 dB
LATE_FREE_PATHS = 4.0  # mean free paths after the emission, from where the field is taken as diffuse


def run(quick):
    """Direct sound within 0.1 dB of 1 / (4 pi r); late energy."""
    rows, direct_db, shifts = [], [], []
    scene = ours.box_scene((60.0, 50.0, 50.0), 1.0, 0.5)
    for distance_m in DISTANCES_M:
        source = np.array([15.0, 15.0, 15.0])
        mic = source + distance_m * np.array([2.0, 1.0, 2.0]) / 3.0
        one = ours.simulate(scene, source, [mic], n_rays=2000)[0]
        expected = distance_m / SPEED_M_S * ours.FS_HZ
        gain = 1.0 / (4.0 * np.pi * distance_m)
        level_db, shift = fit_pulses(one.rir, np.array([expected]), np.array([gain]))
        direct_db.append(level_db[0])
        shifts.append(abs(shift[0]))
        rows.append([f"direct at {distance_m:g} m", 20.0 * np.log10(gain), level_db[0], shift[0], None])
    late_db = []
    rooms = [(size, a, s) for size in SIZES_M for a in (0.1, 0.3) for s in (0.1, 0.5)]
    for size, absorption, scattering in rooms[:2] if quick else rooms:
        diffuse, here, repeats = late_energy(size, absorption, scattering)
        measured = repeats.mean()
        late_db.append(10.0 * np.log10(measured / here))
        name = "x".join(f"{length:g}" for length in size)
        rows.append([f"late, {name}, alpha {absorption:g}, scattering {scattering:g}",
                     10.0 * np.log10(here), late_db[-1], 10.0 * np.log10(measured / diffuse),
                     4.34 * repeats.std(ddof=1) / measured / np.sqrt(REPEATS)])
    checks = [Check("direct sound, worst level", float(np.max(np.abs(direct_db))), high=0.1, unit="dB"),
              Check("direct sound, worst arrival", float(np.max(shifts)), high=0.1, unit="samples"),
              Check("late energy, worst room", float(np.max(np.abs(late_db))), high=0.2, unit="dB")]
    return Section("level", "Level of the direct sound and of the late field",
                   ["what", "expected, dB", "deviation, dB", "arrival, samples / diffuse, dB", "+- dB"], rows, checks,
                   [f"late: after {LATE_FREE_PATHS:g} mean free paths, 12 microphones, {REPEATS} simulations each (+-: "
                    f"standard error), {LOWEST_HZ:g} Hz up, against the reference's energy in spheres around them; "
                    "diffuse: against its energy in the whole room spread evenly, c / (4 pi V) times the energy left "
                    "(there is more in the middle of a room)"])


def late_energy(dims_m, absorption, scattering):
    """Squared pressure after the first reflections: of a diffuse field, expected at the microphones, simulated.

    The last is an array of shape (REPEATS,).

    A source whose direct sound is 1 / (4 pi r) emits the energy that fills the room with the squared pressure
    ``c / (4 pi) w(t)``, w being the density of what is left of it; in a diffuse field ``w = E(t) / V``
    (Kuttruff, Room Acoustics, eq. 5.37 for the stationary case).
    """
    volume_m3, area_m2 = np.prod(dims_m), 2.0 * sum(np.prod(dims_m) / size for size in dims_m)
    start_s = np.ceil(LATE_FREE_PATHS * 4e3 * volume_m3 / area_m2 / SPEED_M_S) * 1e-3  # a step of the reference
    duration_s = start_s + 48.0 * volume_m3 / (-np.log(1.0 - absorption) * area_m2 * SPEED_M_S)
    sources, mics = positions(dims_m, np.random.default_rng(7), apart_m=1.5)
    scene = ours.box_scene(dims_m, absorption, scattering)
    diffuse, here, measured = [], [], []
    for n, (source, around) in enumerate(zip(sources, mics, strict=True)):
        decay = trace_energy(dims_m, absorption, scattering, duration_s=duration_s, source_pos_m=source,
                             mics_m=around, radius_m=SPHERE_M, n_rays=200_000, seed=n + 1)
        late = decay.time_s >= start_s - 1e-6
        scale = SPEED_M_S / (4.0 * np.pi) * decay.time_s[1]
        diffuse.append(scale / volume_m3 * decay.energy.mean(axis=0)[late].sum())
        here.append(scale * decay.density_per_m3[:, late].sum(axis=1).mean())
        measured.append([[_power(one, start_s) for one in ours.simulate(scene, source, around, seed=n + 100 * repeat)]
                         for repeat in range(REPEATS)])
    return float(np.mean(diffuse)), float(np.mean(here)), np.mean(measured, axis=(0, 2))


def _power(one, start_s):
    """Squared pressure from a time on, from `LOWEST_HZ` up (scaled to the whole spectrum)."""
    spectrum = np.abs(np.fft.rfft(one.rir[round(start_s * one.fs_hz):])) ** 2
    count = 2 * (len(spectrum) - 1)
    first = int(np.ceil(LOWEST_HZ / one.fs_hz * count))
    return float(2.0 * spectrum[first:].sum() / count) / (1.0 - 2.0 * LOWEST_HZ / one.fs_hz)


def draw(axis, section):
    """Deviations of the direct sound over distance."""
    deviation = [row[2] for row in section.rows[:len(DISTANCES_M)]]
    axis.axhspan(-0.1, 0.1, color="0.9")
    axis.semilogx(DISTANCES_M, deviation, "o-")
    axis.set(title="level: direct sound", xlabel="distance (m)", ylabel="deviation from 1/(4 pi r) (dB)")
