"""
Close the loop on your rooms
============================

The closed loop compares measured RIRs with simulated RIRs, decides on held-out rooms and positions which physical
effect the simulation lacks, adds that effect, and repeats.

No recordings come with the toolkit, so this page first writes a folder of RIRs that stands for yours: seven rooms, of
which one is kept to the end. Nobody declares how the loudspeakers sound, where they face, or how high the microphones
stood. Each step is also a command; the commands are named beside them.
"""

# %%
# The recordings
# --------------
#
# A folder of audio files and a ``manifest.csv``. The loop needs at least three rooms with two positions each, and of
# each RIR the dimensions of the room and the positions of source and microphone, in metres from one corner. A height
# that nobody measured is ``?``. Here two loudspeakers were recorded at four microphone positions in each room: ``ls1``
# is dark and radiates mostly ahead, ``ls2`` is bright and radiates alike in all directions. ``dataset`` is the same in
# both folders, as the devices are.

import csv
import json
import logging
import shutil
import tempfile
from functools import partial
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import soundfile

import roomeq
from roomeq.corpora import read_measured
from roomeq.effects.response import RESPONSE_HZ

logging.getLogger("roomeq").setLevel(logging.WARNING)
work = Path(tempfile.mkdtemp())
rng = np.random.default_rng(3)
colours = {"ls1": [1.0, 0.6, 0.2], "ls2": [1.0, -0.35, 0.1]}  # FIR filters
heights_m = [1.2, 1.5, 1.1, 1.6, 1.4, 1.2, 1.3]  # of the microphone's stand in each room
manifests = {"recordings": [], "another_room": []}
rooms_m = [(5.2, 4.1, 2.8), (7.5, 5.0, 3.0), (6.1, 6.4, 2.6), (9.0, 6.2, 3.4), (4.6, 3.9, 2.7), (8.2, 5.8, 3.1),
           (6.8, 5.4, 2.9)]
for k, dims_m in enumerate(rooms_m):
    folder = "another_room" if k == 6 else "recordings"
    (work / folder).mkdir(exist_ok=True)
    scene = roomeq.Scene(roomeq.Shoebox(dims_m), [roomeq.Material("walls", tuple(rng.uniform(0.15, 0.3, 8)), 0.3)] * 6)
    for source_id, fir in colours.items():
        source = rng.uniform(1.0, np.array(dims_m) - 1.0)
        mics = [(*rng.uniform(0.8, np.array(dims_m[:2]) - 0.8), heights_m[k]) for _ in range(4)]
        facing = np.array(dims_m) / 2.0 - source
        facing[2] = 0.0
        cabinet = roomeq.Loudspeaker(facing, 0.15, 0.08)
        directivity = partial(cabinet.pressure, fs_hz=16000) if source_id == "ls1" else None
        for n, response in enumerate(roomeq.simulate_responses(scene, source, mics, source_directivity=directivity,
                                                               seed=k)):
            rir = np.convolve(response.rir, fir)
            rir += 3e-6 * rng.standard_normal(len(rir))
            file = f"room{k}_{source_id}_{n}.wav"
            soundfile.write(work / folder / file, rir, 16000, subtype="FLOAT")
            manifests[folder].append(dict(
                file=file, dataset="ours", room_id=f"room{k}", room_dims_m=" ".join(map(str, dims_m)),
                source_id=source_id, mic_id="m1", source_pos_m="{:.3f} {:.3f} {:.3f}".format(*source),
                mic_pos_m="{:.3f} {:.3f} ?".format(*mics[n])))
for folder, rows in manifests.items():
    with open(work / folder / "manifest.csv", "w", newline="") as csv_file:
        writer = csv.DictWriter(csv_file, fieldnames=rows[0])
        writer.writeheader()
        writer.writerows(rows)

# %%
# ``roomeq read-measured recordings measured`` makes an RIR directory of a folder.

for folder in manifests:
    read_measured(work / folder, work / f"measured.{folder}")

# %%
# Without geometry, nothing can be simulated at the place of a recording. The loop then says what to measure, and ends:

(work / "bare").mkdir()
for rir in sorted((work / "recordings").glob("*.wav")):
    shutil.copy(rir, work / "bare")
read_measured(work / "bare", work / "measured.bare")
try:
    roomeq.close_loop([work / "measured.bare"], work / "loop.bare")
except ValueError as error:
    print(error)

# %%
# The loop
# --------
#
# ``roomeq close-loop measured.recordings --test measured.another_room --out loop``. The rooms of ``--test`` are only
# scored: no decision rests on them.

ledger = roomeq.close_loop([work / "measured.recordings"], work / "loop", test=[work / "measured.another_room"],
                           max_effects=3, seed=0)
print(f"{ledger['rirs']} RIRs of {ledger['rooms']} rooms were used; left out: {ledger['left_out'] or 'none'}")

# %%
# What the rows do not state was estimated from the arrivals of the first reflections, with its uncertainty. Nothing is
# drawn. Documented dimensions are checked as well, and replaced only if the recordings clearly contradict them.

for estimate in ledger["geometry"]:
    if estimate["used"]:
        print(f"{estimate['room']}: {estimate['quantity']} {estimate['posterior'][0]:.2f} +- "
              f"{estimate['posterior'][1]:.2f} {estimate['unit']}")
print("in truth:", heights_m[:6])

# %%
# Where a loudspeaker faces shows in its direct sound: off the axis, high frequencies are weaker.

for facing in ledger["facings"]:
    print(f"{facing['source']}: {facing['hypothesis']}, {facing['angle_deg']:.0f} degrees from the microphone in the "
          "mean")

# %%
# ``ledger.json`` holds what was added, with the error on held-out positions or in held-out rooms, in just noticeable
# differences (JND), before and after. Where the recordings cannot tell two effects apart, it names both.

for iteration in ledger["iterations"]:
    name = iteration.get("effect") or " or ".join(iteration["cannot_tell"])
    low, high = iteration["heldout_error_ci"]
    print(f"{name}: held-out error {iteration['heldout_error_before']:.2f} -> "
          f"{iteration['heldout_error_after']:.2f} JND, 95 % interval [{low:.2f}, {high:.2f}]")
print("unexplained:", ledger["unexplained"] or "nothing significant")

# %%
# How good is that? No model knows the phases of reflections or exact positions. The noise ceiling is the error that
# would remain if the recordings followed the model, and the explained share is what was gained of what can be gained.


def explained(of_split):
    """Say how much is explained; None: the base model is as good as a model of this kind can be."""
    share = of_split["share"]
    return "nothing to explain" if share is None else f"{100 * share:.0f} % of the explainable error"


for name, entry in (("the six rooms", ledger), ("the room of --test", ledger["test"])):
    for split in ("leave_positions_out", "leave_room_out"):
        print(f"{name}, {split.replace('_', '-')}: {explained(entry['explained'][split])}")

# %%
# The error of each metric on held-out positions: what was wrong, what the found effects mended, and where the ceiling
# is.

metrics = list(ledger["baseline"]["leave_positions_out"]["by_metric"])
figure, axes = plt.subplots(figsize=(7, 3.5))
for n, stage in enumerate(("baseline", "final", "ceiling")):
    by_metric = ledger[stage]["leave_positions_out"]["by_metric"]
    axes.bar(np.arange(len(metrics)) + 0.27 * (n - 1), [by_metric.get(metric, 0.0) for metric in metrics], 0.25,
             label=stage)
axes.set_xticks(range(len(metrics)), metrics, rotation=30)
axes.set_ylabel("Held-out error (JND)")
axes.legend()
figure.tight_layout()

# %%
# How the candidates of the first iteration ranked: the gain is the increase of the log density of rooms that were left
# out of the fit.

ranking = (ledger["iterations"] or [ledger])[0]["ranking"]
figure, axes = plt.subplots(figsize=(7, 0.4 * len(ranking) + 1.2))
axes.barh([entry["effect"] for entry in ranking][::-1], [entry["gain"] for entry in ranking][::-1])
axes.set_xlabel("Gain of log density in left-out rooms")
figure.tight_layout()

# %%
# An effect that was not added may still be there. The ledger says from which size on these recordings would have shown
# it, and which measurement would show less.

for entry in ledger["ranking"]:
    size = entry["detectable_jnd"]
    stated = "unknown" if size is None else f"{size:.1f} JND"
    print(f"{entry['effect']}: {stated}; smaller ones by {entry['would_show']}")

# %%
# Simulate with what was found
# ----------------------------
#
# ``model.json`` holds the effects with their parameters; ``roomeq simulate --model loop/model.json`` simulates with
# them. ``roomeq show loop --out loop.html`` makes a page with pictures and sounds. The response that the loop found for
# each loudspeaker, beside the one that was applied:

model = json.loads((work / "loop" / "model.json").read_text())
figure, axes = plt.subplots(figsize=(7, 3.5))
for colour, (source_id, fir) in zip(("tab:blue", "tab:orange"), colours.items(), strict=True):
    bins = np.round(np.array(RESPONSE_HZ) * 16384 / 16000).astype(int)
    applied_db = 20 * np.log10(np.abs(np.fft.rfft(fir, 16384)))[bins]
    axes.semilogx(RESPONSE_HZ, applied_db - applied_db.mean(), "--", color=colour, label=f"{source_id}, applied")
    for effect in model["effects"]:
        if effect["effect"] == "source_response":
            found_db = np.array(effect["of"][source_id]["gains_db"])
            axes.semilogx(RESPONSE_HZ, found_db - found_db.mean(), color=colour, label=f"{source_id}, found")
axes.set(xlabel="Frequency (Hz)", ylabel="Level (dB)")
axes.legend()
figure.tight_layout()
