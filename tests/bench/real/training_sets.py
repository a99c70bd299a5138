#!/usr/bin/env python3
"""Decay and spectrum of the RIRs of each training set: measured, simulated, compensated, of the loop, of drawn rooms.

Usage: tests/bench/real/training_sets.py [--data data] [--eq exp/eq] [--out exp/bench]

Reads DATA/rirs.KIND.train, as the recipe makes them, and no other RIRs: what differs between the training sets is told
without the rooms of the test set. Every room counts the same. Writes `training_sets.json`.

- Levels are those of octaves relative to 1 kHz, of the direct sound (1 ms before it to 5 ms after), of what arrives
  within 50 ms, of what arrives later, and of all. The octave at 8 kHz ends at 7.9 kHz, below anti-alias filters.
- The spread is the standard deviation over RIRs; in parentheses, that within rooms, if rooms have several RIRs.
- "real, in the EQ mixture": the measured RIRs without those that EQ/screening.json lists. Compensation learnt from
  these alone.
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np
from scipy.fft import next_fast_len

PROJECT = Path(__file__).resolve().parents[3]
sys.path[:1] = [str(PROJECT / name) for name in ("pysrc", "tests")]

from bench import kit  # noqa: E402
from roomeq.acoustics.decibels import power_db  # noqa: E402
from roomeq.core.audio import read_audio  # noqa: E402
from roomeq.core.constants import BAND_1KHZ, BANDS_HZ, FS_HZ  # noqa: E402
from roomeq.records.rir_dir import read_rirs  # noqa: E402

KINDS = ("real", "sim", "sim.EQ", "sim.loop", "sim.free")
OCTAVES_HZ = BANDS_HZ[2:]  # a direct sound of 6 ms tells nothing of lower ones
PARTS_S = {"direct": (-0.001, 0.005), "early": (-0.001, 0.05), "late": (0.05, np.inf), "all": (-0.001, np.inf)}
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
LEAST_FFT = 32768
FITTED = "real, in the EQ mixture"


def levels_db(rir, direct_sample):
    """Return the octave levels of the parts of an RIR relative to 1 kHz, shape (n_parts, n_octaves)."""
    n_fft = next_fast_len(max(len(rir), LEAST_FFT))
    frequency_hz, result = np.fft.rfftfreq(n_fft, 1.0 / FS_HZ), []
    for start_s, end_s in PARTS_S.values():
        start, end = (int(np.clip(direct_sample + second * FS_HZ, 0, len(rir))) for second in (start_s, end_s))
        power = np.abs(np.fft.rfft(rir[start:end], n_fft)) ** 2
        level_db = np.array([power_db(power[(frequency_hz >= hz / np.sqrt(2.0))
                                            & (frequency_hz < min(hz * np.sqrt(2.0), 7900.0))].mean())
                             for hz in OCTAVES_HZ])
        result.append(level_db - level_db[OCTAVES_HZ.index(1000.0)])
    return np.array(result)


def read_set(directory, screened=()):
    """Return rooms, levels [dB], T20 at 1 kHz [s] and DRR [dB] of the RIRs of a training set; NaN where unknown."""
    rows = [row for row in read_rirs(directory) if not row.get("noise_for") and row["id"] not in screened]
    parameters = [row["acoustic_parameters"] for row in rows]
    levels = [levels_db(np.atleast_2d(read_audio(directory / row["wav"]))[0], of_row["direct_sample"])
              for row, of_row in zip(rows, parameters, strict=True)]
    t20_s = [of_row["t20_s"][BAND_1KHZ] if of_row["t20_valid"][BAND_1KHZ] else np.nan for of_row in parameters]
    drr_db = [np.nan if of_row["drr_db"] is None else of_row["drr_db"] for of_row in parameters]
    _, room = np.unique([row["room_id"] for row in rows], return_inverse=True)
    return room, np.array(levels), np.array(t20_s, dtype=float), np.array(drr_db)


def weighted_quantiles(values, weights):
    """Return `QUANTILES` of the known values."""
    known = np.isfinite(values)
    return np.quantile(values[known], QUANTILES, weights=weights[known], method="inverted_cdf")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("data"))
    parser.add_argument("--eq", type=Path, default=Path("exp/eq"))
    parser.add_argument("--out", type=Path, default=Path("exp/bench"))
    given = parser.parse_args()
    decay = kit.Section("decay", "Decay and directness of the training RIRs",
                        ["RIRs", "number", "quantity", *(f"{100 * q:g} %" for q in QUANTILES)])
    spectrum = kit.Section("spectrum", "Level of octaves relative to 1 kHz, mean ± spread (within rooms) [dB]",
                         ["RIRs", "part", *(f"{hz:g} Hz" for hz in OCTAVES_HZ)])
    screening = given.eq / "screening.json"
    screened = json.loads(screening.read_text())["screened"] if screening.is_file() else ()
    for kind in (*KINDS[:1], *((FITTED,) if screened else ()), *KINDS[1:]):
        directory = given.data / f"rirs.{'real' if kind == FITTED else kind}.train"
        if not directory.is_dir():
            continue
        room, levels, t20_s, drr_db = read_set(directory, screened if kind == FITTED else ())
        weights = 1.0 / np.bincount(room)[room]
        for quantity, values in (("T20 at 1 kHz [s]", t20_s), ("DRR [dB]", drr_db)):
            decay.rows.append([kind, len(weights), quantity, *weighted_quantiles(values, weights)])
        for n, part in enumerate(PARTS_S):
            of_rooms = np.array([levels[room == r, n].mean(axis=0) for r in range(room.max() + 1)])
            mean = of_rooms.mean(axis=0)
            spread, within = (np.sqrt(np.average((levels[:, n] - centre) ** 2, axis=0, weights=weights))
                              for centre in (mean, of_rooms[room]))
            spectrum.rows.append([kind, part, *(f"{m:+.1f} ± {s:.1f}" + (f" ({w:.1f})" if w else "")
                                              for m, s, w in zip(mean, spread, within, strict=True))])
    if not decay.rows:
        sys.exit(f"{given.data}: holds no rirs.KIND.train: make them with stages 1 to 5 of run.sh, or correct --data")
    for section in (decay, spectrum):
        section.show()
    given.out.mkdir(parents=True, exist_ok=True)
    content = dict(machine=kit.machine(), sections={section.name: vars(section) for section in (decay, spectrum)})
    (given.out / "training_sets.json").write_text(json.dumps(kit.plain(content), indent=1) + "\n")


if __name__ == "__main__":
    main()
