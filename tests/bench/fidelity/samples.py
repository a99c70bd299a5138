"""Echograms from path samples against those from all paths, at the absorption that the recipe renders with."""

import numpy as np

from bench import ours
from bench.fidelity.targets import RANGE_S
from bench.kit import Check, Section

N_ROOMS = 800
FRAME_S = 1e-3
SMALLEST_M, LARGEST_M = (2.0, 1.6, 2.2), (30.0, 20.0, 8.0)
RANGES_DB = {"T30": (-5.0, -35.0), "EDT": (0.0, -10.0)}
DEEPEST_DB = -40.0  # of the decay, down to which the level is compared
WINDOW = 7  # frames, as the simulator smooths the late echogram
QUANTITIES = ("T30, %", "EDT, %", "energy, dB", "level, dB")
CASES = ("target", "noise")


def run(quick):
    """Errors per band of T30, EDT, energy and the level of 7 ms, and the largest path in its frame."""
    errors = {(case, what): [] for case in CASES for what in QUANTITIES}
    largest, lost, broken, refused, followed = {case: [] for case in CASES}, 0, 0, 0, 0
    n_rooms = 40 if quick else N_ROOMS
    for number in range(n_rooms):
        try:
            pairs = ours.sampled_and_full(*_draw(number), seed=number)
        except ValueError:
            refused += 1
            continue
        for case, pair in zip(CASES, pairs, strict=True):
            if pair is None:
                followed += 1
                continue
            sampled, full, share = pair
            if not np.all(np.isfinite(sampled)):
                broken += 1
                continue
            largest[case].append(float(share))
            for band in range(full.shape[1]):
                found, known = (_quantities(energy[:, band]) for energy in (sampled, full))
                lost += sum(there is not None and here is None for here, there in zip(found, known, strict=True))
                for what, here, there in zip(QUANTITIES, found, known, strict=False):
                    if here is not None and there is not None:
                        errors[case, what].append(10.0 * np.log10(here / there) if what.endswith("dB")
                                                  else 100.0 * (here / there - 1.0))
                errors[case, "level, dB"].append(_level_error_db(sampled[:, band], full[:, band]))
    rows = [[case, what, len(values), *np.quantile(np.abs(values), (0.5, 0.95, 0.99, 0.999, 1.0))]
            for (case, what), values in errors.items()]
    rows += [[case, "largest path / frame", len(values), *np.quantile(values, (0.5, 0.95, 0.99, 0.999, 1.0))]
             for case, values in largest.items()]
    checks = [Check("echograms that are not finite", broken, high=0.0),
              Check("decay times that the sample lost", lost, high=0.0)]
    checks += [Check(f"T30 of a band, {case}, within 5 %",
                     100.0 * float(np.mean(np.abs(errors[case, "T30, %"]) <= 5.0)), low=99.0, unit="%")
               for case in CASES]
    return Section("samples", f"Path samples against all paths, {n_rooms} drawn rooms and targets",
                   ["case", "quantity", "bands", "median", "95 %", "99 %", "99.9 %", "largest"], rows, checks,
                   ["target: the sample that the search for the target used, at the absorption that it found; noise: "
                    "that of a noise source, drawn at that absorption",
                    f"level: largest error of the mean over {WINDOW} ms, down to {DEEPEST_DB:g} dB of the decay; "
                    "largest path: energy that a sample gives to one path, relative to all paths of its 1 ms",
                    f"{refused} of the draws had a target out of reach; in {followed} the search ended so far from "
                    "where it began that all paths were followed"])


def _draw(number):
    """Draw the sides of a room, two sources and a microphone, and a target."""
    rng = np.random.default_rng([7, number])
    dims_m = np.exp(rng.uniform(np.log(SMALLEST_M), np.log(LARGEST_M)))
    while True:
        positions = rng.uniform(0.3, dims_m - 0.3, (3, 3))
        if min(np.linalg.norm(positions[n] - positions[2]) for n in (0, 1)) > 0.3:
            return dims_m, *positions, rng.uniform(*RANGE_S)


def _quantities(energy):
    """T30 and EDT [s], None where they cannot be measured, and the energy, of one band, shape (n_frames,)."""
    decay = np.cumsum(energy[::-1])[::-1]
    decay_db = 10.0 * np.log10(np.maximum(decay / max(decay[0], 1e-300), 1e-30))
    found = []
    for top_db, bottom_db in RANGES_DB.values():
        chosen = np.flatnonzero((decay_db <= top_db) & (decay_db >= bottom_db))
        slope = np.polyfit(chosen * FRAME_S, decay_db[chosen], 1)[0] if len(chosen) > 2 else 0.0
        found.append(-60.0 / slope if slope < 0.0 and decay_db[-1] < bottom_db else None)
    return (*found, decay[0] or None)


def _level_error_db(sampled, full):
    found, known = (np.convolve(energy, np.full(WINDOW, 1.0 / WINDOW), "valid") for energy in (sampled, full))
    remaining = np.cumsum(known[::-1])[::-1]
    held = (remaining > 10.0 ** (0.1 * DEEPEST_DB) * remaining[0]) & (known > 0.0)
    return np.max(np.abs(10.0 * np.log10(np.maximum(found[held], 1e-3 * known[held]) / known[held])), initial=0.0)
