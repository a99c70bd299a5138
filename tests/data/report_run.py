"""A small synthetic run for the tests of the report: the steps of the recipe on decaying noise."""

import numpy as np
from loop_run import make_loop
from wer_run import put_example

from roomeq.acoustics.parameters import measure
from roomeq.augment import augment
from roomeq.core.audio import write_flac, write_wav
from roomeq.core.constants import BANDS_HZ, FS_HZ
from roomeq.core.rng import rng_for
from roomeq.corpora.characterise import characterise
from roomeq.corpora.split import split_rirs
from roomeq.eq.steps import compensate, fit_eq
from roomeq.kaldi.wavscp import flac_entry
from roomeq.kaldi.write import OutUtterance, write_data_dir
from roomeq.records.rir_dir import read_rirs, write_noises, write_rirs
from roomeq.wer import measure_wer

ROOMS = {"office": (0.4, (8, 6, 2, 1, 0, -2, -4, -9)), "hall": (0.9, (4, 9, 5, 2, 0, -1, -3, -6)),
         "kitchen": (0.6, (-3, 4, 3, 0, 0, -1, -5, -12)), "studio": (0.3, (9, 3, -1, 1, 0, 0, -2, -7))}
HOSTILE = ("<script>alert(1)</script>", '"><img onerror=alert(1)>', "'><svg/onload=alert(1)>&lt;", "a&amp;b")
RIRS_PER_ROOM = 11
HUMS = ("hum1", "hum2", "hum3")


def make_run(root):
    """Make ``root/data`` and ``root/exp`` with all inputs of a report, and return both."""
    data, exp = root / "data", root / "exp"
    make_measured(data / "measured")
    characterise(data / "measured", data / "rirs.real")
    split_rirs(data / "rirs.real", data / "rirs.real", sizes=(26, 8, 10), seed=0)
    for x in ("train", "dev"):
        make_simulated(read_rirs(data / f"rirs.real.{x}"), data / f"rirs.sim.{x}")
        make_simulated(read_rirs(data / f"rirs.real.{x}"), data / f"rirs.sim.loop.{x}")
    make_loop(exp / "loop")
    workspaces = put_example(root / "decoded", seeds=2, columns=("fglarge", "online"))
    measure_wer(workspaces, exp / "wer", rirs=[root / "decoded/rirs"])
    fit_eq(data / "rirs.real.train", [data / "rirs.sim.train"], exp / "eq", n_components=3, seed=0)
    for x in ("train", "dev"):
        compensate(data / f"rirs.sim.{x}", exp / "eq", data / f"rirs.sim.EQ.{x}", seed=0)
    for x in ("train", "dev", "test"):
        make_clean(data / f"{x}.clean", x)
        for kind in ("real", "sim", "sim.EQ", "sim.loop"):
            if (data / f"rirs.{kind}.{x}").is_dir():
                augment(data / f"{x}.clean", data / f"rirs.{kind}.{x}", data / f"{x}.{kind}.rvb", seed=0)
    return data, exp


def decay(rng, t60_s, eq_db, length_s=0.7):
    """Return exponentially decaying noise with the EQ `eq_db` after a direct sound at sample 32."""
    n = round(length_s * FS_HZ)
    tail = rng.standard_normal(n) * 10 ** (-3 * np.arange(n) / (t60_s * FS_HZ)) * 0.05
    tail[0] = 0.6
    frequency_hz = np.maximum(np.fft.rfftfreq(2 * n, 1 / FS_HZ), 1.0)
    target_db = np.interp(np.log(frequency_hz), np.log(BANDS_HZ), eq_db)
    tail = np.fft.irfft(np.fft.rfft(tail, 2 * n) * 10 ** (target_db / 20))[:n]
    rir = np.concatenate([np.zeros(32), tail[:n - 32]])
    return rir / np.abs(rir).max() * 0.5


def make_measured(directory):
    """Write measured RIRs of all rooms and their ambient noises; every row has a hostile corpus name."""
    rows = []
    for room, (t60_s, eq_db) in ROOMS.items():
        for n in range(RIRS_PER_ROOM):
            rng = rng_for(0, "measured", f"{room}{n}")
            name = f"{room}-{n:02d}"
            rir = decay(rng, t60_s, np.array(eq_db) + rng.normal(0, 1.5, 8))
            write_wav(directory / f"{name}.wav", rir)
            rows.append(row_of(name, room, rir, corpus=HOSTILE[n % 4], binaural=n == 3))
    write_rirs(directory, rows)
    for name in HUMS:
        write_wav(directory / f"{name}.wav", 0.01 * rng_for(0, name, "").standard_normal(5 * FS_HZ))
    write_hums(directory, "")


def write_hums(directory, prefix):
    """Write the rows of the ambient noises; `prefix` leads to their audio."""
    write_noises(directory, [dict(id=name, wav=f"{prefix}{name}.wav", room_id=None, kind="ambient", duration_s=5.0,
                                  fs_hz=FS_HZ) for name in HUMS])


def row_of(name, room, rir, **optional):
    """Return the row of an RIR without coordinates."""
    return dict(id=name, wav=f"{name}.wav", room_id=room, source_id="s", mic_id="m", fs_hz=FS_HZ, n_samples=len(rir),
                room_dims_m=[6.0, 5.0, 3.0], source_pos_m=None, mic_pos_m=None, **optional)


def make_simulated(measured, directory):
    """Write a simulated RIR for each measured RIR, with a T30 near its target."""
    rows = []
    for row in measured:
        rng = rng_for(0, "simulated", row["id"])
        target_s = rng.uniform(0.25, 1.2)
        achieved_s = target_s * rng.uniform(0.97, 1.03)
        rir = decay(rng, achieved_s, np.zeros(8))
        write_wav(directory / f"{row['id']}.wav", rir)
        rows.append(row_of(row["id"], row["room_id"], rir, measured_id=row["id"], target_t60_s=target_s,
                           t30_s=achieved_s, direct_sample=32.0, direct_polarity=1, leaked_share=0.0,
                           acoustic_parameters=measure(rir, direct=(32.0, 1)),
                           drawn=["mic_pos_m.2"], noise_for=None, seed=0))
    write_rirs(directory, rows)
    write_hums(directory, "../measured/")


def make_clean(directory, name):
    """Write a clean data directory: one recording with four utterances of modulated tones."""
    rng = rng_for(0, "speech", name)
    samples, utterances, start = [], [], 0
    for n in range(4):
        length = FS_HZ * (2 + n) // 2
        t = np.arange(length) / FS_HZ
        envelope = 0.5 - 0.5 * np.cos(2 * np.pi * 3 * t)
        samples.append(0.3 * envelope * np.sin(2 * np.pi * (150 + 60 * rng.random()) * t))
        ident, words = f"{name}-{n}{HOSTILE[0]}", " ".join(HOSTILE)
        utterances.append(OutUtterance(ident, name, f"{name}-all", start, length, words))
        start += length
    write_flac(directory / "all.flac", np.concatenate(samples))
    write_data_dir(directory, {f"{name}-all": (flac_entry(str(directory / "all.flac")), start)}, utterances)
