#!/usr/bin/env python
"""The simulator in a documented, measured room: seminar room CR2 of BRAS (Aspöck et al., 2020).

Plan, materials, air and positions are those of `scene.json`; nothing is fitted here. Ten pairs of loudspeaker and
microphone are simulated with the two documented sets of absorption coefficients: `initial`, from tables and tube
measurements, and `fitted`, which are scaled to the measured decay with Eyring's formula. Each is compared with the
measured parameters with and without the wave field at low frequencies.

- A material's coefficient in an octave is the mean of its third octaves; a wall of two materials takes their mean by
  area.
- The dodecahedron has three drivers at different heights. Each is simulated at its own, and the responses are added
  with complementary crossovers.
- The measured parameters count each octave's time from the first sample within 20 dB of the octave's peak, because the
  crossover of the loudspeaker delays low frequencies by up to 20 ms. The simulated ones are measured alike.
- Fine structure is the level from 30 to 175 Hz in steps of 1/24 octave, less its mean over the surrounding octave.
- The time of the ten pairs is measured with one driver of each loudspeaker, beside pyroomacoustics' room of the same
  plan, materials and number of rays, both on two threads.

e.g.: python tests/bench/real/bras_cr2.py --out exp/bench
"""

import csv
import itertools
import json
import sys
import tempfile
import time
from functools import cache
from pathlib import Path

import numpy as np

PROJECT = Path(__file__).resolve().parents[3]
sys.path[:1] = [str(PROJECT / "pysrc"), str(PROJECT / "tests")]

from bench.threads import use_threads  # noqa: E402

use_threads()

import roomeq  # noqa: E402
from bench import kit, peer  # noqa: E402
from roomeq.acoustics.decibels import power_db  # noqa: E402
from roomeq.acoustics.iso3382 import EARLY_S, decay_time, energy_decay  # noqa: E402
from roomeq.acoustics.octaves import octave_bands  # noqa: E402
from roomeq.core.audio import read_audio  # noqa: E402
from roomeq.core.constants import BANDS_HZ, FS_HZ  # noqa: E402
from roomeq.core.rng import rng_for  # noqa: E402
from roomeq.effects.model import apply_to_rir, direct_gain  # noqa: E402
from roomeq.effects.room_modes import RoomModes  # noqa: E402
from roomeq.effects.wavefield import MAX_CROSSOVER_HZ  # noqa: E402
from roomeq.sim.defaults import NUM_RAYS  # noqa: E402

DATA = PROJECT.parent / "shared/data/rooms/bras_cr2"
BRAS_ORIGIN_M = (3.036, 4.255)  # of BRAS's coordinates, in those of measured_parameters.csv
MIXED_WALLS = {0: {"plaster": 0.65, "concrete": 0.35}, 8: {"windows": 0.53, "concrete": 0.47},
               11: {"plaster": 0.63, "concrete": 0.37}}  # share of materials by number of the wall's first corner
SETS = ("initial", "fitted")
ONSET = 0.01  # power of a band's onset relative to its peak
TIME_JND = 0.05  # relative, T20 and EDT
C50_JND_DB = 1.1
HELD = slice(1, 7)  # 125 Hz to 4 kHz
LIMIT_JND = {"T20": 2.0, "EDT": 2.0, "C50": 1.0}
FINE_HZ = 30.0 * 2.0 ** (np.arange(62) / 24.0)  # up to 175 Hz
PEER_FINE = 0.63  # of RoomCAD with a wave solver, mean over the ten pairs
PEER_FINE_SPREAD = 0.08
SEED = 0


@cache
def document():
    """Return the content of scene.json."""
    return json.loads((DATA / "scene.json").read_text())


def surfaces():
    """Return the shares of materials of each surface, in the order of the mesh's faces: walls, floor, ceiling."""
    named = {f"wall{n}": shares for n, shares in MIXED_WALLS.items()}
    return {**named, "concrete": {"concrete": 1.0}, "floor": {"floor": 1.0}, "ceiling": {"ceiling": 1.0}}


@cache
def room():
    """Extrude the plan to its height."""
    plan, height_m = np.array(document()["corners"]) + BRAS_ORIGIN_M, document()["height"]
    n = len(plan)
    corners = [f"v {x:.6f} {y:.6f} {z:.6f}" for z in (0.0, height_m) for x, y in plan]
    faces = [("floor", range(n, 0, -1)), ("ceiling", range(n + 1, 2 * n + 1))]
    for i in range(n):
        name = f"wall{i}" if i in MIXED_WALLS else "concrete"
        faces.append((name, (i + 1, (i + 1) % n + 1, n + (i + 1) % n + 1, n + i + 1)))
    lines = [f"usemtl {name}\nf {' '.join(map(str, face))}" for name, face in faces]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cr2.obj"
        path.write_text("\n".join([*corners, *lines]) + "\n")
        return roomeq.load_mesh(path)


def octave_means(shares, table):
    """Return eight coefficients of a surface from the third octaves of its materials."""
    frequencies = np.array(document()["frequencies"])
    values = sum(share * np.array(table[material]) for material, share in shares.items())
    middle = [int(np.argmin(np.abs(np.log(frequencies / band_hz)))) for band_hz in BANDS_HZ]
    return tuple(float(np.mean(values[n - 1:n + 2])) for n in middle)


def scene(materials):
    """Return the scene with one of `SETS`."""
    content = document()
    return roomeq.Scene(room(), [roomeq.Material(name, octave_means(surfaces()[name], content["absorption"][materials]),
                                                 octave_means(surfaces()[name], content["scattering"]))
                                 for name in room().surfaces],
                        roomeq.Air(content["temperature_c"], content["humidity_pct"]))


def add_drivers(responses):
    """Add the responses of the drivers, lowest first, with zero-phase crossovers whose gains add up to one."""
    crossovers_hz = document()["sources"]["crossovers_hz"]
    n_fft = 2 * max(map(len, responses))
    frequency = np.maximum(np.fft.rfftfreq(n_fft, 1.0 / FS_HZ), 1e-3)
    above = [np.sin(0.5 * np.pi * np.clip(np.log2(frequency / hz) + 0.5, 0.0, 1.0)) ** 2 for hz in crossovers_hz]
    gains = -np.diff(above, axis=0, prepend=1.0, append=0.0)
    spectrum = sum(gain * np.fft.rfft(rir, n_fft) for gain, rir in zip(gains, responses, strict=True))
    return np.fft.irfft(spectrum, n_fft)[:max(map(len, responses))]


@cache
def simulated(materials):
    """Simulate the ten pairs; return two dicts from pair to response: of rays alone, and with the wave field."""
    the_scene, content = scene(materials), document()
    mics = {name: tuple(np.add(at, (*BRAS_ORIGIN_M, 0.0))) for name, at in content["receivers"].items()}
    rays, waves = {}, {}
    for source, plan in content["sources"].items():
        if not source.startswith("LS"):
            continue
        by_driver = []
        for z in content["sources"]["drivers_z"]:
            at = (*np.add(plan, BRAS_ORIGIN_M), z)
            responses = roomeq.simulate_responses(the_scene, at, list(mics.values()), seed=SEED)
            by_driver.append([(response.rir, _with_modes(the_scene, response.rir, at, mic))
                              for response, mic in zip(responses, mics.values(), strict=True)])
        for mic, drivers in zip(mics, zip(*by_driver, strict=True), strict=True):
            for result, parts in zip((rays, waves), zip(*drivers, strict=True), strict=True):
                result[f"{source}-{mic}"] = add_drivers(parts)
    return rays, waves


def _with_modes(the_scene, rir, source_m, mic_m):
    effects = [RoomModes(MAX_CROSSOVER_HZ)]
    return apply_to_rir(effects, rir, the_scene, source_m, mic_m, direct_gain(the_scene, source_m, mic_m),
                        rng_for(SEED, "effects", ""))


def parameters(rir):
    """Return T20 [s], EDT [s] and C50 [dB] per octave, each from the octave's own onset on; shape (3, 8)."""
    result = []
    for band in octave_bands(rir, FS_HZ):
        band = band[int(np.argmax(band ** 2 >= ONSET * np.max(band ** 2))):]
        decay, early = energy_decay(band, FS_HZ, 0.0), round(EARLY_S * FS_HZ)
        late = np.sum(band[early:decay.intersection.sample] ** 2) + decay.intersection.rest_energy
        times = [decay_time(decay.edc_db, FS_HZ, which) or np.nan for which in ("t20", "edt")]
        result.append([*times, power_db(np.sum(band[:early] ** 2)) - power_db(late)])
    return np.array(result).T


@cache
def measured():
    """Return {pair: the same as `parameters`} as documented."""
    result = {}
    with (DATA / "measured_parameters.csv").open() as lines:
        for row in csv.DictReader(lines):
            column = np.array([float(row[key]) for key in ("t20_s", "edt_s", "c50_db")])
            result.setdefault(row["pair"], []).append(column)
    return {pair: np.array(columns).T for pair, columns in result.items()}


def deviations_jnd(responses):
    """Return the deviation of the mean over the pairs, and the mean deviation of a pair, shape (3, 8) each [JND]."""
    real = np.array([measured()[pair] for pair in responses])
    model = np.array([parameters(rir) for rir in responses.values()])

    def jnd(a, b):
        return np.array([*((a - b) / (TIME_JND * b))[:2], (a - b)[2] / C50_JND_DB])

    pairs = [np.abs(jnd(*both)) for both in zip(model, real, strict=True)]
    return jnd(model.mean(axis=0), real.mean(axis=0)), np.mean(pairs, axis=0)


def run_parameters(_quick):
    """Compare decay times and clarity with and without the wave field."""
    section = kit.Section("parameters", "BRAS CR2: simulated less measured, mean over ten pairs [JND]",
                          ["materials", "model", "quantity", *(f"{hz:g} Hz" for hz in BANDS_HZ),
                           "mean size, 125 Hz to 4 kHz", "the same, single pairs"])
    for materials in SETS:
        for model, responses in zip(("rays", "rays and wave field"), simulated(materials), strict=True):
            mean, pair = deviations_jnd(responses)
            for quantity, by_band, by_pair in zip(LIMIT_JND, mean, pair, strict=True):
                size = float(np.mean(np.abs(by_band[HELD])))
                section.rows.append([materials, model, quantity, *(f"{value:+.1f}" for value in by_band), size,
                                     float(np.mean(by_pair[HELD]))])
                held = materials == "fitted" and model != "rays"
                section.checks.append(kit.Check(f"{quantity}, {materials} absorption, {model}", size,
                                                high=LIMIT_JND[quantity] if held else None, unit="JND"))
    section.notes.append("`initial` has coefficients from tables and tube measurements, `fitted` has them scaled to "
                         "the measured decay with Eyring's formula. The deviation of single pairs contains the "
                         "interference at each position.")
    return section


def fine_structure(rir):
    """Return the level in steps of 1/24 octave, less the mean over the surrounding octave [dB]."""
    n_fft = 1 << 17
    frequency, power = np.fft.rfftfreq(n_fft, 1.0 / FS_HZ), np.abs(np.fft.rfft(rir, n_fft)) ** 2
    level = power_db(np.array([power[np.abs(np.log2(np.maximum(frequency, 1.0) / hz)) < 1.0 / 48.0].mean()
                               for hz in FINE_HZ]))
    steps = np.arange(len(level))
    return np.array([level[n] - level[np.abs(steps - n) <= 12].mean() for n in steps])


def run_fine_structure(_quick):
    """Correlate the modal peaks and dips of the one measured response with the simulated ones."""
    section = kit.Section("fine_structure", "BRAS CR2: correlation of fine structure from 30 to 175 Hz, LS1-MP1",
                          ["materials", "rays", "rays and wave field"])
    real = fine_structure(read_audio(DATA / "scene9_LS1_MP1.flac"))
    section.curves = dict(frequency_hz=FINE_HZ, measured=real)
    for materials in SETS:
        levels = [fine_structure(responses["LS1-MP1"]) for responses in simulated(materials)]
        section.rows.append([materials, *(float(np.corrcoef(level, real)[0, 1]) for level in levels)])
        section.curves |= {f"{materials} rays": levels[0], f"{materials} wave field": levels[1]}
        section.checks.append(kit.Check(f"correlation with the wave field, {materials} absorption",
                                        section.rows[-1][-1], low=PEER_FINE - PEER_FINE_SPREAD))
    section.notes.append(f"RoomCAD, an independent simulator with a wave solver, has {PEER_FINE} ± {PEER_FINE_SPREAD} "
                         "over the ten pairs, and 0.13 ± 0.15 without the wave solver. The limit is its mean less its "
                         "standard deviation.")
    return section


def draw_parameters(axis, section):
    """Draw the deviation of T20 by octave."""
    for row in section.rows:
        if row[2] == "T20":
            axis.plot(range(8), [float(value) for value in row[3:11]], label=f"{row[0]}, {row[1]}")
    axis.set_xticks(range(8), [f"{hz:g}" for hz in BANDS_HZ])
    axis.set(xlabel="octave [Hz]", ylabel="T20 less measured [JND]", ylim=(-8, 24))
    axis.axhline(0.0, color="0.7")
    axis.legend(fontsize=7)


def draw_fine_structure(axis, section):
    """Draw the fine structure, measured and simulated."""
    for name in ("measured", "fitted rays", "fitted wave field"):
        axis.plot(section.curves["frequency_hz"], section.curves[name], label=name)
    axis.set(xlabel="frequency [Hz]", ylabel="level [dB]", xscale="log")
    axis.legend(fontsize=7)


def run_speed(quick):
    """Time the ten pairs, with five microphones at once and each alone, beside pyroomacoustics."""
    content, the_scene = document(), scene("fitted")
    mics = [tuple(np.add(at, (*BRAS_ORIGIN_M, 0.0))) for at in content["receivers"].values()]
    sources = [(*np.add(plan, BRAS_ORIGIN_M), content["sources"]["drivers_z"][1])
               for name, plan in content["sources"].items() if name.startswith("LS")]
    simulators = {"roomeq": lambda source, group: roomeq.simulate_responses(the_scene, source, group, seed=SEED)}
    if peer.load():
        simulators["pyroomacoustics"] = lambda source, group: _peer(the_scene, source, group)
    section = kit.Section("speed", f"BRAS CR2: time of ten RIRs, {NUM_RAYS} rays",
                          ["microphones", "simulator", "s", "CPU s"])
    for how, groups in {"five at once": [mics], "one at a time": [[mic] for mic in mics]}.items():
        spent = {}
        for name, simulate in simulators.items():
            simulate(sources[0], groups[0])  # compiles, or reads what was compiled
            marks = [(time.perf_counter(), time.process_time())]
            for _ in range(1 if quick else 3):
                for source, group in itertools.product(sources, groups):
                    simulate(source, group)
                marks.append((time.perf_counter(), time.process_time()))
            spent[name] = np.median(np.diff(marks, axis=0), axis=0)
            section.rows.append([how, name, *spent[name]])
        section.checks.append(kit.Check(f"{how}: CPU time", float(spent["roomeq"][1]), high=3.0, unit="s"))
        if peer.load():
            section.checks.append(kit.Check(f"{how}: times faster than pyroomacoustics",
                                            float(spent["pyroomacoustics"][0] / spent["roomeq"][0]), low=10.0))
    section.notes.append("pyroomacoustics: its room of the same plan and height, with the same materials, air, octave "
                         "bands and number of rays, and image sources to order 3; both on two threads. roomeq traces "
                         "as many rays for each octave, whose scattering coefficients all differ."
                         if peer.load() else peer.ABSENT)
    return section


def _peer(the_scene, source, mics):
    materials = {material.name: (material.absorption, material.scattering) for material in the_scene.materials}
    plan = np.array(document()["corners"]) + BRAS_ORIGIN_M
    walls = [materials[f"wall{n}" if n in MIXED_WALLS else "concrete"] for n in range(len(plan))]
    return peer.extruded(plan, document()["height"], walls, materials["floor"], materials["ceiling"], source, mics,
                         n_rays=NUM_RAYS, speed_m_s=the_scene.air.speed_m_s)


SECTIONS = {"parameters": run_parameters, "fine_structure": run_fine_structure, "speed": run_speed}
FIGURES = {"parameters": draw_parameters, "fine_structure": draw_fine_structure}


def main():
    """Run the chosen sections."""
    chosen = kit.arguments(__doc__, SECTIONS)
    if not DATA.is_dir():
        print(f"{DATA} is absent: the measured room is not compared")
        return
    kit.run_sections("bras_cr2", SECTIONS, chosen, FIGURES)


if __name__ == "__main__":
    main()
