"""
Your own recordings
===================

Read measured RIRs from a folder, characterise them, simulate their rooms, and give the simulated RIRs the frequency
balance of the measured ones.

No recordings come with the toolkit, so this page first writes a folder of RIRs that stands for yours. Each step below
is also a command; the commands are named beside them.
"""

# %%
# A folder of audio files and a ``manifest.csv`` that says what is known: room, its dimensions, positions in metres. A
# coordinate that nobody measured is ``?``.

import csv
import json
import logging
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import soundfile

import roomeq
from roomeq.corpora import read_measured

logging.getLogger("roomeq").setLevel(logging.WARNING)
work = Path(tempfile.mkdtemp())
rng = np.random.default_rng(0)
(work / "recordings").mkdir()
rows = []
for room_id, dims_m, t60_s in (("office", (5.2, 4.1, 2.8), 0.45), ("class", (9.0, 7.0, 3.2), 0.8)):
    scene = roomeq.Scene(roomeq.Shoebox(dims_m), [roomeq.Material("walls", 0.2, 0.3)] * 6)
    source = (1.2, 1.4, 1.5)
    mics = [tuple(rng.uniform(1.0, np.array(dims_m) - 1.0)) for _ in range(6)]
    for n, response in enumerate(roomeq.simulate_responses(scene, source, mics, target_t60_s=t60_s, seed=1)):
        coloured = np.convolve(response.rir, [1.0, 0.55, 0.2])  # a loudspeaker that is weak at high frequencies
        coloured += 1e-5 * np.abs(coloured).max() * rng.standard_normal(len(coloured))
        name = f"{room_id}_{n}.wav"
        soundfile.write(work / "recordings" / name, 0.5 * coloured / np.abs(coloured).max(), 16000)
        rows.append(dict(file=name, room_id=room_id, room_dims_m=" ".join(map(str, dims_m)),
                         source_pos_m=" ".join(map(str, source)), mic_pos_m=" ".join(f"{x:.3f}" for x in mics[n])))
with open(work / "recordings" / "manifest.csv", "w", newline="") as file:
    writer = csv.DictWriter(file, fieldnames=rows[0])
    writer.writeheader()
    writer.writerows(rows)

# %%
# ``roomeq read-measured recordings measured`` makes an RIR directory of them: audio, and ``rirs.jsonl`` with one JSON
# object a line. ``roomeq characterise measured rirs.real`` measures every RIR and says which ones the later steps leave
# out, and why.

read_measured(work / "recordings", work / "measured")
roomeq.characterise(work / "measured", work / "rirs.real")
row = json.loads((work / "rirs.real" / "rirs.jsonl").read_text().splitlines()[0])
print(row["id"], row["room_dims_m"], row["mic_pos_m"])
print("T20", row["acoustic_parameters"]["t20_s"])

# %%
# ``roomeq simulate --t60-range measured rirs.real rirs.sim`` simulates one RIR for each measured RIR, with the same
# room, source and microphone positions. The reverberation time is drawn from the range of the measured rooms.

roomeq.simulate(work / "rirs.real", work / "rirs.sim", t60_range_s="measured", num_rays=5000, noise_rirs=0, seed=0)

# %%
# ``roomeq fit-eq rirs.real rirs.sim eq`` measures the sub-band EQ of all of them and fits a Gaussian mixture to the
# measured ones. ``roomeq compensate rirs.sim eq rirs.sim.EQ`` draws a target EQ for each simulated RIR and
# filters the RIR to match it.

roomeq.fit_eq(work / "rirs.real", [work / "rirs.sim"], work / "eq", n_components=2, seed=0)
summary = roomeq.compensate(work / "rirs.sim", work / "eq", work / "rirs.sim.EQ", seed=0)
print(f"|achieved - target|: median {summary['median_db']} dB, 95th percentile {summary['p95_db']} dB")

# %%
# Before compensation the simulated RIRs are flat; afterwards they have the colouration of the measured ones.

bands_hz = 62.5 * 2.0 ** np.arange(8)
figure, axes = plt.subplots(figsize=(7, 3.5))
for name, colour in (("rirs.real", "tab:blue"), ("rirs.sim", "tab:orange"), ("rirs.sim.EQ", "tab:green")):
    eq_db = np.array([row["acoustic_parameters"]["eq_db"] for row in roomeq.read_rirs(work / name)], dtype=float)
    axes.semilogx(bands_hz, eq_db.T, color=colour, alpha=0.25, linewidth=0.8)
    axes.semilogx(bands_hz, np.median(eq_db, axis=0), color=colour, linewidth=2.5, label=name)
axes.set(xlabel="Frequency (Hz)", ylabel="EQ relative to 1 kHz (dB)")
axes.legend()
figure.tight_layout()
