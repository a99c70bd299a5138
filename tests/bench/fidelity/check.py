"""The reference itself, where the answer is known otherwise."""

import numpy as np

from bench.fidelity import analytic
from bench.fidelity.decay import CEILING, SIZES_M
from bench.fidelity.reference import trace_energy
from bench.kit import Check, Section


def run(quick):
    """Conservation and mean free path at alpha 0; mirror walls by quadrature; Lambert walls by integral equation."""
    rays = 30_000 if quick else 200_000
    rows, mirror_db, lambert_pct, hits_pct, lost = [], [], [], [], []
    for dims_m in SIZES_M[:1] if quick else SIZES_M:
        name = "x".join(f"{size:g}" for size in dims_m)
        for scattering in (0.0, 0.5, 1.0):
            decay = trace_energy(dims_m, 0.0, scattering, duration_s=0.5, n_rays=rays // 2)
            lost.append(abs(1.0 - decay.energy.mean()))
            hits_pct.append(100.0 * (decay.hits_per_s / analytic.mean_hits_per_s(dims_m) - 1.0))
        known = analytic.mean_hits_per_s(dims_m)
        rows.append([name, "hits per second, alpha 0", known, decay.hits_per_s, hits_pct[-1]])
        for absorption in (0.1, 0.3, CEILING):
            label = "ceiling 0.8" if np.ndim(absorption) else f"alpha {absorption:g}"
            eyring_s = analytic.eyring_time_s(dims_m, absorption)
            mirror_db.append(_mirror(rows, name, label, dims_m, absorption, eyring_s, rays))
            lambert_pct.append(_lambert(rows, name, label, dims_m, absorption, eyring_s, rays))
    checks = [Check("energy lost at alpha 0", float(np.max(lost)), high=1e-9),
              Check("mean free path, worst", float(np.max(np.abs(hits_pct))), high=0.3, unit="%"),
              Check("mirror walls, energy left, worst", float(np.max(np.abs(mirror_db))), high=0.15, unit="dB"),
              Check("Lambert walls, decay rate, worst", float(np.max(np.abs(lambert_pct))), high=1.0, unit="%")]
    return Section("reference", "The reference against what is known otherwise",
                   ["room", "what", "known", "reference", "deviation (%, dB)"], rows, checks,
                   ["mirror walls: quadrature over directions; Lambert walls: largest eigenvalue of Kuttruff's "
                    "integral equation, extrapolated from two patch sizes"])


def _mirror(rows, name, label, dims_m, absorption, eyring_s, rays):
    decay = trace_energy(dims_m, absorption, 0.0, duration_s=0.5 * eyring_s, n_rays=rays)
    chosen = np.linspace(1, len(decay.time_s) - 1, 5).astype(int)
    known = analytic.mirror_energy(dims_m, absorption, decay.time_s[chosen])
    found = decay.energy.mean(axis=0)[chosen]
    deviation_db = 10.0 * np.log10(found / known)
    rows.append([name, f"mirrors, {label}, energy left at {1e3 * decay.time_s[chosen[-1]]:.0f} ms", known[-1],
                 found[-1], deviation_db[-1]])
    return deviation_db[np.argmax(np.abs(deviation_db))]


def _lambert(rows, name, label, dims_m, absorption, eyring_s, rays):
    decay = trace_energy(dims_m, absorption, 1.0, duration_s=0.9 * eyring_s, n_rays=rays)
    first, last = int(0.2 * len(decay.time_s)), int(0.65 * len(decay.time_s))
    energy = decay.energy.mean(axis=0)
    found = -np.log(energy[last] / energy[first]) / (decay.time_s[last] - decay.time_s[first])
    coarse, fine = (analytic.lambert_decay_per_s(dims_m, absorption, patch_m=max(dims_m) / n) for n in (10, 16))
    known = fine + (fine - coarse) * 10 ** 2 / (16 ** 2 - 10 ** 2)  # the error goes with the square of the patch
    rows.append([name, f"Lambert, {label}, decay per second", known, found, 100.0 * (found / known - 1.0)])
    return rows[-1][-1]
