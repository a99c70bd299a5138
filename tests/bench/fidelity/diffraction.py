"""Edge diffraction: the rigid half-plane's exact field, and what it costs in a furnished room."""

import numpy as np

from bench import ours
from bench.fidelity import halfplane
from bench.fidelity.halfplane import at
from bench.kit import Check, Section
from bench.rooms import FURNISHED_M

FREQUENCIES_HZ = np.array([100.0, 200.0, 500.0, 1000.0, 2000.0, 4000.0, 6000.0])
SOURCE_DEG = (20.0, 60.0, 135.0)
OFFSETS_DEG = (-60.0, -20.0, -3.0, -0.1, 0.1, 3.0, 20.0, 60.0)
LENGTH_M = 400.0


def run(quick):
    """Both sides of both shadow boundaries, a tenth of a degree to sixty off."""
    rows, worst = [], []
    for source_deg in SOURCE_DEG[1:2] if quick else SOURCE_DEG:
        for name, boundary_deg in (("shadow", 180.0 + source_deg), ("reflection", 180.0 - source_deg)):
            for offset_deg in OFFSETS_DEG:
                angle_deg = boundary_deg + offset_deg
                if 0.0 < angle_deg < 360.0:
                    errors_db, bare_db = _errors(at(1.7, source_deg), at(2.3, angle_deg, 0.7))
                    worst.append(np.abs(errors_db).max())
                    rows.append([f"{source_deg:g}", f"{name} {offset_deg:+g}", errors_db[0], errors_db[3],
                                 errors_db[-1], worst[-1], bare_db])
    milliseconds, n_edges = ours.diffraction_ms(np.random.default_rng(0).uniform(0.1, 0.4, (5, 3)) * FURNISHED_M)
    checks = [Check("total field against the exact one, worst", float(np.max(worst)), high=0.5, unit="dB"),
              Check(f"furnished mesh, {n_edges} edges, per microphone", milliseconds, unit="ms")]
    return Section("diffraction", "Diffraction at a rigid half-plane against Macdonald's exact solution, dB",
                   ["source, deg", "boundary, deg off", "100 Hz", "1 kHz", "6 kHz", "worst", "worst without"],
                   rows, checks, [f"an edge of {LENGTH_M:g} m, 100 Hz to 6 kHz; boundary: where the direct sound "
                                  "(shadow) or the reflection ends; without: rays alone"])


def _errors(source, mic):
    speed_m_s = ours.half_plane_speed_m_s()
    exact = halfplane.exact(source, mic, FREQUENCIES_HZ, speed_m_s)
    rays = halfplane.geometric(source, mic, FREQUENCIES_HZ, speed_m_s)
    total = rays + ours.half_plane(source, mic, LENGTH_M, FREQUENCIES_HZ)
    bare_db = 20.0 * np.log10(np.maximum(np.abs(rays), 1e-6) / np.abs(exact))
    return 20.0 * np.log10(np.abs(total / exact)), float(np.abs(bare_db).max())
