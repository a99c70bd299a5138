"""
A first room in Python
======================

Simulate a room impulse response (RIR), measure its acoustic parameters and look at it.
"""

# %%
# A scene is a room, one material for each of its surfaces, and air. A shoebox has six surfaces: two walls across x, two
# across y, floor and ceiling.

import matplotlib.pyplot as plt
import numpy as np

import roomeq

room = roomeq.Shoebox((6.0, 4.0, 3.0))
plaster = roomeq.Material("plaster", absorption=0.1, scattering=0.2)
scene = roomeq.Scene(room, [plaster] * 6)

# %%
# Rays are traced once for a source and serve every microphone. With ``target_t60_s`` the absorption of all surfaces is
# scaled until the rendered response has that reverberation time at 1 kHz.

microphones_m = [(4.0, 3.0, 1.2), (4.5, 1.0, 1.2)]
near, far = roomeq.simulate_responses(scene, source_pos_m=(2.0, 1.5, 1.5), mics_m=microphones_m, target_t60_s=0.6,
                                       seed=0)
print(f"direct sound at sample {near.direct_sample:.1f}, T30 {near.t30_s:.2f} s")

# %%
# The acoustic parameters are those of ISO 3382-1, in octave bands from 62.5 Hz to 8 kHz, each with a flag that says
# whether the response allows the measurement.

parameters = roomeq.analyse(near.rir)
for name in ("t30_s", "edt_s", "c50_db"):
    print(name, np.round(parameters[name][3:7], 2), "at 500 Hz to 4 kHz")
print(f"drr_db {parameters['drr_db']:.1f}")

# %%
# The response and its decay.

time_s = np.arange(len(near.rir)) / 16000
level_db = 10 * np.log10(np.cumsum(near.rir[::-1] ** 2)[::-1] / np.sum(near.rir ** 2) + 1e-12)
figure, (top, bottom) = plt.subplots(2, 1, sharex=True, figsize=(7, 4.5))
top.plot(time_s, near.rir, linewidth=0.6)
top.set_ylabel("Pressure")
bottom.plot(time_s, level_db)
bottom.set(ylim=(-70, 3), xlabel="Time (s)", ylabel="Energy decay (dB)")
figure.tight_layout()

# %%
# The first reflections arrive as single pulses; later the pulses overlap and the response resembles decaying noise.

first = slice(round(near.direct_sample) - 20, round(near.direct_sample) + 480)
figure, axes = plt.subplots(figsize=(7, 2.6))
axes.plot(1000 * time_s[first], near.rir[first])
axes.set(xlabel="Time (ms)", ylabel="Pressure", title="Direct sound and early reflections")
figure.tight_layout()
