"""
Close the loop on your rooms
============================

The closed loop compares measured RIRs with simulated RIRs, decides on held-out rooms and positions which physical
effect the simulation lacks, adds that effect, and repeats.

No recordings come with the toolkit. This page generates four rooms whose loudspeakers have a colouration that nobody
declares, and lets the loop find it. With recordings of your own, begin at the second step.
"""

# %%
# Four rooms, eight RIRs each, two loudspeakers. Every RIR passes the loudspeaker's response, which the rows do not
# mention.

import json
import logging
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import soundfile

import roomeq
from roomeq.effects.response import RESPONSE_HZ

logging.getLogger("roomeq").setLevel(logging.WARNING)
work = Path(tempfile.mkdtemp())
(work / "measured").mkdir()
rng = np.random.default_rng(3)
colours = {"ls1": [1.0, 0.6, 0.2], "ls2": [1.0, -0.35, 0.1]}  # FIR filters: one dark, one bright loudspeaker
rows = []
for k, dims_m in enumerate([(5.2, 4.1, 2.8), (7.5, 5.0, 3.0), (6.1, 6.4, 2.6), (9.0, 6.2, 3.4)]):
    walls = roomeq.Material("walls", tuple(rng.uniform(0.15, 0.3, 8)), 0.3)
    scene = roomeq.Scene(roomeq.Shoebox(dims_m), [walls] * 6)
    for source_id, fir in colours.items():
        source = rng.uniform(1.0, np.array(dims_m) - 1.0)
        mics = [rng.uniform(0.8, np.array(dims_m) - 0.8) for _ in range(4)]
        for n, response in enumerate(roomeq.simulate_responses(scene, source, mics, seed=k)):
            rir = np.convolve(response.rir, fir)
            rir += 3e-6 * rng.standard_normal(len(rir))
            name = f"room{k}_{source_id}_{n}"
            soundfile.write(work / "measured" / f"{name}.wav", rir, 16000, subtype="FLOAT")
            rows.append(dict(id=name, wav=f"{name}.wav", room_id=f"room{k}", room_dims_m=list(dims_m), fs_hz=16000,
                             n_samples=len(rir), source_id=source_id, mic_id="m1", source_pos_m=source.tolist(),
                             mic_pos_m=mics[n].tolist()))
rows.sort(key=lambda row: row["id"])
_ = (work / "measured" / "rirs.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))

# %%
# One call, or ``roomeq close-loop measured --out loop``. The loop needs measured RIRs of at least three rooms with two
# positions each, and their geometry.

ledger = roomeq.close_loop([work / "measured"], work / "loop", max_effects=2, seed=0)

# %%
# ``ledger.json`` says what was added, with the error on held-out positions and in held-out rooms, in just noticeable
# differences (JND), before and after.

for iteration in ledger["iterations"]:
    low, high = iteration["heldout_error_ci"]
    print(f"{iteration['effect']}: held-out error {iteration['heldout_error_before']:.2f} -> "
          f"{iteration['heldout_error_after']:.2f} JND, 95 % interval [{low:.2f}, {high:.2f}]")
print("unexplained:", ledger["unexplained"])

# %%
# It also says which RIRs could not be used and why, and how much of the error a model of this kind can explain at all:
# the noise ceiling is the error that would remain if the recordings followed the model.

print(f"{ledger['rirs']} RIRs of {ledger['rooms']} rooms were used; left out: {ledger['left_out'] or 'none'}")
share = ledger["explained"]["leave_room_out"]
print(f"of the explainable error in left-out rooms, {100 * share['share']:.0f} % is explained; nothing is left to "
      f"explain in: {', '.join(share['at_ceiling']) or 'none'}")

# %%
# The error of each metric in left-out rooms: what was wrong, what the found effects mended, and where the ceiling is.

metrics = list(ledger["baseline"]["leave_room_out"]["by_metric"])
figure, axes = plt.subplots(figsize=(7, 3.5))
for n, stage in enumerate(("baseline", "final", "ceiling")):
    by_metric = ledger[stage]["leave_room_out"]["by_metric"]
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
# ``model.json`` holds the effects with their parameters; ``roomeq simulate --model loop/model.json`` simulates with
# them. The response that the loop found for each loudspeaker, beside the one that was applied:

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
