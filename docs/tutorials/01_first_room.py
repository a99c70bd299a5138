"""
A first room in Python
======================

Simulate a room impulse response (RIR), measure its acoustic parameters, look at it, and make far-field speech with it.
"""

# %%
# A room is a shoebox or a mesh with materials, a reverberation time, or both. With ``t60_s`` the absorption of all
# surfaces is scaled until T30 of the response itself has that value at 1 kHz. The surfaces of a shoebox are its walls
# ``west``, ``east``, ``south`` and ``north``, ``floor`` and ``ceiling``; materials are names of ``conf/materials.toml``
# or absorption coefficients.

import matplotlib.pyplot as plt
import numpy as np

import roomeq

room = roomeq.Room((6.0, 4.0, 3.0), materials={"floor": "carpet_on_felt", "ceiling": "mineral_fibre_ceiling",
                                            "default": "gypsum_board_on_studs"}, t60_s=0.6)

# %%
# The source is traced once and serves every microphone, at any sample rate from 8 to 48 kHz. The result is an array
# with a row for each microphone. Sample 0 is the emission, and the direct sound has the pressure 1 / (4 pi r).

fs = 48000
microphones_m = [(4.0, 3.0, 1.2), (4.05, 3.0, 1.2)]
rirs = roomeq.simulate_rir(room, source=(2.0, 1.5, 1.5), mics=microphones_m, fs=fs, seed=0)
print(rirs.shape)

# %%
# The acoustic parameters are those of ISO 3382-1, in the octave bands below half the sample rate, each with a flag that
# says whether the response allows the measurement.

parameters = roomeq.analyse(rirs[0], fs)
for name in ("t30_s", "edt_s", "c50_db"):
    print(name, np.round(parameters[name][3:], 2), "at 500 Hz to 16 kHz")
print(f"drr_db {parameters['drr_db']:.1f}")

# %%
# All of it at a glance. In a notebook, the call alone shows the figure.

sheet = roomeq.plot_rir(rirs[0], fs)

# %%
# Sources and microphones may be directive: patterns of the first order, a loudspeaker as a membrane in a cabinet, or a
# table that was measured (``roomeq.read_directivity`` reads SOFA files). The energy of a cardioid that faces the
# microphone, and of one that faces away:

for name, facing in (("towards", (2.0, 1.5, -0.3)), ("away", (-2.0, -1.5, 0.3))):
    talker = roomeq.FirstOrder("cardioid", facing)
    rir = roomeq.simulate_rir(room, (2.0, 1.5, 1.5), microphones_m[0], fs, source_directivity=talker)
    print(name, f"{10 * np.log10(np.sum(rir ** 2) / np.sum(rirs[0] ** 2)):.1f} dB")

# %%
# ``Reverberate`` makes far-field speech on the fly. Alignment, length and level stay those of the clean speech. Bursts
# of noise stand for syllables here.

rng = np.random.default_rng(0)
time_s = np.arange(fs) / fs
clean = (0.1 * np.clip(np.sin(2 * np.pi * 3 * time_s), 0, None) * rng.standard_normal(fs)).astype(np.float32)
reverberate = roomeq.Reverberate(rirs, noises=[rng.standard_normal(fs)], snr=20, fs=fs)
far_field = reverberate(clean, fs)

figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
for samples, label in ((far_field, "Far field"), (clean, "Clean")):
    axes.plot(time_s, samples, linewidth=0.5, label=label)
axes.set(xlabel="Time (s)", ylabel="Amplitude")
axes.legend()
