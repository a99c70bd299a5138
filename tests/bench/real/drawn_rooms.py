#!/usr/bin/env python3
"""Compare RIRs of drawn rooms with measured ones: reverberation time, C50, DRR and sub-band EQ, a value per room.

Usage: tests/bench/real/drawn_rooms.py [--out exp/bench] [--rooms 120] [--rirs DIR] [--nj 2]

Measured RIRs are those of `../shared/data`; without them only the drawn rooms are shown. A room's value is the median
over at most 12 of its RIRs. `drawn_rooms.json` holds the quantiles, `drawn_rooms.png` shows the distributions.
"""

import argparse
import csv
import json
import os
import resource
import sys
import time
from collections import defaultdict
from pathlib import Path

import numpy as np

PROJECT = Path(__file__).resolve().parents[3]
sys.path[:0] = [str(PROJECT / name) for name in ("pysrc", "tests")]

from roomeq.acoustics.parameters import measure  # noqa: E402
from roomeq.core.audio import read_audio  # noqa: E402
from roomeq.core.constants import BAND_1KHZ, BANDS_HZ  # noqa: E402
from roomeq.records.rir_dir import read_rirs  # noqa: E402
from roomeq.simulate_rirs import simulate  # noqa: E402

SHARED = PROJECT.parent / "shared" / "data"
SAME_ROOMS = "gtu_but_six"
"""A folder whose rooms two others have too."""
CROPPED = "gtu"
"""Rooms whose recordings lack the start, and so the direct sound: no DRR, C50 or EQ of the whole."""
RIRS_PER_ROOM = 12
WHO = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
QUANTILES = (0.1, 0.25, 0.5, 0.75, 0.9)
QUANTITIES = {"t20_s": "T20 at 1 kHz [s]", "c50_db": "C50 at 1 kHz [dB]", "drr_db": "DRR [dB]",
              **{f"eq_{hz:g}": f"EQ at {hz:g} Hz [dB]" for hz in BANDS_HZ if hz != 1000.0}}


def values_of(parameters, cropped=False):
    """Return the quantities of one RIR; NaN where one is not valid."""
    def in_band(key):
        value, valid = parameters[f"{key.split('_')[0]}_valid"][BAND_1KHZ], parameters[key][BAND_1KHZ]
        return float(valid) if value and valid is not None else np.nan

    eq = {f"eq_{hz:g}": db if valid else np.nan
          for hz, db, valid in zip(BANDS_HZ, parameters["eq_db"], parameters["eq_valid"], strict=True) if hz != 1000.0}
    result = dict(t20_s=in_band("t20_s"), c50_db=in_band("c50_db"),
                  drr_db=np.nan if parameters["drr_db"] is None else parameters["drr_db"]) | eq
    return {key: value if key == "t20_s" or not cropped else np.nan for key, value in result.items()}


def measured_rooms():
    """Return the quantities of each measured room."""
    of_room = defaultdict(list)
    manifests = [*sorted((SHARED / "rooms").glob("*/manifest.csv")), SHARED / "measured" / "manifest.csv"]
    for manifest in (path for path in manifests if path.is_file() and path.parent.name != SAME_ROOMS):
        with open(manifest, encoding="utf-8") as stream:
            for row in csv.DictReader(stream):
                if len(of_room[row["room"]]) < RIRS_PER_ROOM and row.get("binaural") not in ("1", "true"):
                    rir = read_audio(manifest.parent / row["file"], channel=0)
                    of_room[row["room"]].append(values_of(measure(rir), row["room"].startswith(CROPPED)))
    return [median(rirs) for rirs in of_room.values() if rirs]


def drawn_rooms(directory):
    """Return the quantities of each drawn room."""
    of_room = defaultdict(list)
    for row in read_rirs(directory):
        if not row["noise_for"]:
            of_room[row["room_id"]].append(values_of(row["acoustic_parameters"]))
    return [median(rirs) for rirs in of_room.values()]


def median(rirs):
    columns = {key: np.array([rir[key] for rir in rirs], dtype=float) for key in QUANTITIES}
    return {key: float(np.nanmedian(values)) if np.isfinite(values).any() else np.nan
            for key, values in columns.items()}


def finite(rooms, key):
    values = np.array([room[key] for room in rooms])
    return values[np.isfinite(values)]


def table(measured, drawn):
    """Return for each quantity the quantiles over measured and over drawn rooms."""
    return {key: dict(title=title) | {
        name: dict(rooms=len(finite(rooms, key)),
                   quantiles=[round(float(value), 3) for value in np.quantile(finite(rooms, key), QUANTILES)])
        for name, rooms in (("measured", measured), ("drawn", drawn)) if len(finite(rooms, key))}
            for key, title in QUANTITIES.items()}


def draw_figure(measured, drawn, path):
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, panels = pyplot.subplots(2, 3, figsize=(12, 7), layout="constrained")
    sets = (("measured", measured, "C0"), ("drawn", drawn, "C1"))
    for axes, key in zip(panels.flat, ("t20_s", "c50_db", "drr_db"), strict=False):
        for name, rooms, colour in sets:
            values = np.sort(finite(rooms, key))
            axes.step(values, (np.arange(len(values)) + 0.5) / max(len(values), 1), color=colour,
                      label=f"{name}, {len(values)} rooms", where="mid")
        axes.set(xlabel=QUANTITIES[key], ylabel="share of rooms below")
        axes.legend()
    for axes, (x, y) in zip(panels.flat[3:5], (("t20_s", "c50_db"), ("c50_db", "drr_db")), strict=False):
        for _, rooms, colour in sets:
            axes.plot([room[x] for room in rooms], [room[y] for room in rooms], "o", ms=4, alpha=0.6, color=colour)
        axes.set(xlabel=QUANTITIES[x], ylabel=QUANTITIES[y])
    axes = panels.flat[5]
    keys = [key for key in QUANTITIES if key.startswith("eq_")]
    frequencies_hz = [float(key.removeprefix("eq_")) for key in keys]
    for _, rooms, colour in sets:
        if rooms:
            low, middle, high = np.transpose([np.quantile(finite(rooms, key), (0.1, 0.5, 0.9)) for key in keys])
            axes.semilogx(frequencies_hz, middle, "o-", color=colour)
            axes.fill_between(frequencies_hz, low, high, color=colour, alpha=0.2)
    axes.set(xlabel="frequency [Hz]", ylabel="EQ relative to 1 kHz [dB]: median, 10 to 90 %")
    figure.savefig(path, dpi=110)


def cpu_s():
    """Return the CPU time of this process and of its workers that have ended."""
    end_workers()
    return sum(usage.ru_utime + usage.ru_stime for usage in map(resource.getrusage, WHO))


def end_workers():
    from joblib.externals.loky import get_reusable_executor

    get_reusable_executor().shutdown(wait=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("exp/bench"))
    parser.add_argument("--rooms", type=int, default=120)
    parser.add_argument("--rirs", type=Path, help="RIR directory of drawn rooms, instead of drawing some")
    parser.add_argument("--nj", type=int, default=2)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    result = {}
    directory = options.rirs or options.out / "drawn_rooms"
    if options.rirs is None:
        start_s, start_cpu_s = time.monotonic(), cpu_s()
        simulate(None, directory, rooms=options.rooms, nj=options.nj)
        result["speed"] = dict(rooms=options.rooms, jobs=options.nj, wall_s=round(time.monotonic() - start_s, 1),
                               cpu_s=round(cpu_s() - start_cpu_s, 1), load=round(os.getloadavg()[0], 1),
                               peak_mib=round(max(resource.getrusage(who).ru_maxrss for who in WHO) / 1024))
    measured = measured_rooms()
    if not measured:
        print(f"{SHARED}: no measured RIRs there: the drawn rooms stand alone", file=sys.stderr)
    drawn = drawn_rooms(directory)
    result["quantiles"] = list(QUANTILES)
    result["quantities"] = table(measured, drawn)
    (options.out / "drawn_rooms.json").write_text(json.dumps(result, indent=1) + "\n")
    draw_figure(measured, drawn, options.out / "drawn_rooms.png")
    for key, rows in result["quantities"].items():
        for name in ("measured", "drawn"):
            row = rows.get(name, dict(rooms=0, quantiles=[]))
            print(f"{QUANTITIES[key]:22s} {name:9s} {row['rooms']:4d} rooms  "
                  + "  ".join(f"{value:8.2f}" for value in row["quantiles"]))


if __name__ == "__main__":
    main()
