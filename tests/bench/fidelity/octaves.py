"""Decay times of octaves beside octaves that decay longer, in a room whose absorption depends on frequency."""

import numpy as np

from bench import ours
from bench.fidelity.analytic import eyring_time_s
from bench.fidelity.decay import positions
from bench.fidelity.estimate import decay_time_s
from bench.fidelity.reference import trace_energy
from bench.fidelity.targets import octave_t30_s
from bench.kit import Check, Section

DIMS_M = (6.3, 4.7, 3.1)
SCATTERING = 0.4
CENTRES_HZ = (125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0)
# octaves from 62.5 Hz to 8 kHz; chosen by hand, of no table
PLASTER = (0.10, 0.08, 0.06, 0.05, 0.04, 0.04, 0.04, 0.04)
PERFORATED = (0.15, 0.40, 0.90, 0.95, 0.60, 0.40, 0.30, 0.30)
CARPET = (0.02, 0.02, 0.06, 0.14, 0.37, 0.60, 0.65, 0.65)
TILES = (0.10, 0.20, 0.45, 0.80, 0.95, 0.95, 0.90, 0.90)
POROUS = (0.03, 0.05, 0.09, 0.21, 0.36, 0.42, 0.42, 0.42)
ROOMS = {"perforated ceiling": (PLASTER, PERFORATED), "carpet and tiles": (CARPET, TILES),
         "porous on all walls": (POROUS, POROUS)}
"""Floor and ceiling; the walls are plaster, or porous as they are."""


def run(quick):
    """T30 of octaves: in the usual rooms within 10 % of the reference, which has one absorption for each octave."""
    rows, steep_pct, usual_pct = [], [], []
    sources, mics = positions(DIMS_M, np.random.default_rng(0), apart_m=1.5)
    for name, (floor, ceiling) in ROOMS.items():
        walls = POROUS if floor is POROUS else PLASTER
        absorption = np.array([walls, walls, walls, walls, floor, ceiling])
        scene = ours.box_scene(DIMS_M, absorption, SCATTERING)
        responses = [one for n, (source, around) in enumerate(zip(sources, mics, strict=True))
                     for one in ours.simulate(scene, source, around, seed=n)]
        for octave, centre_hz in enumerate(CENTRES_HZ, start=1):
            decay = trace_energy(DIMS_M, absorption[:, octave], SCATTERING, seed=octave,
                                 duration_s=1.5 * eyring_time_s(DIMS_M, absorption[:, octave]) + 0.2,
                                 n_rays=20_000 if quick else 100_000)
            reference_s = decay_time_s(decay.energy.mean(axis=0), decay.time_s[1], bottom_db=-35.0)
            found_s = [octave_t30_s(one, centre_hz) for one in responses]
            deviation_pct = 100.0 * (np.mean(found_s) / reference_s - 1.0)
            (steep_pct if floor is POROUS else usual_pct).append(deviation_pct)
            rows.append([name, centre_hz, reference_s, np.mean(found_s), deviation_pct,
                         100.0 * np.std(found_s) / np.sqrt(len(found_s)) / reference_s])
    checks = [Check("usual rooms, largest deviation of an octave", float(np.max(np.abs(usual_pct))), high=10.0,
                    unit="%"),
              Check("porous on all walls, largest deviation of an octave", float(np.max(np.abs(steep_pct))), unit="%")]
    return Section("octaves", "T30 of octaves beside others, 6.3x4.7x3.1 m",
                   ["room", "octave, Hz", "reference s", "ours s", "ours %", "+-%"], rows, checks,
                   ["mean over 12 source-microphone pairs, octave filter and fit of the bench's own; the reference has "
                    "no filter: of an octave that decays in half the time of the one below, the filter also passes the "
                    "end of the latter's decay"])
