"""Small data and RIR directories for tests, with noise bursts as speech and exponential decays as RIRs."""

import numpy as np
import soundfile

from roomeq.core.audio import write_flac, write_wav
from roomeq.kaldi.wavscp import flac_entry
from roomeq.kaldi.write import OutUtterance, write_data_dir
from roomeq.records.rir_dir import write_noises, write_rirs

FS = 16000
LENGTHS = {"a-1-0001": 12345, "a-1-0002": 9001, "a-2-0001": 16000, "b-1-0001": 20011, "b-1-0002": 8000}


def burst(rng, n_samples, level=0.1):
    """Return noise with pauses: a sharp autocorrelation, and the level of speech."""
    envelope = np.repeat(rng.random(n_samples // 800 + 1) > 0.3, 800)[:n_samples]
    envelope[:400] = True
    return (level * rng.standard_normal(n_samples) * envelope).clip(-0.9, 0.9)


def speech_dir(path, lengths=None, seed=0):
    """Write a data directory without `segments`, one FLAC per utterance; the speaker is the id up to the first dash."""
    rng, recordings, utterances = np.random.default_rng(seed), {}, []
    for key, n_samples in (lengths or LENGTHS).items():
        write_flac(path / "wav" / f"{key}.flac", burst(rng, n_samples))
        recordings[key] = (flac_entry(path / "wav" / f"{key}.flac"), n_samples)
        utterances.append(OutUtterance(key, key.split("-")[0], key, 0, n_samples, text=f"WORDS OF {key.upper()}"))
    write_data_dir(path, recordings, utterances, spk2gender=dict(a="f", b="m"), segmented=False)
    return path


def decay(rng, n_samples=4000, direct=100, level=1.0):
    """Return an RIR: a direct sound of `level` at a given sample, then decaying noise."""
    h = level * 0.05 * rng.standard_normal(n_samples) * np.exp(-np.arange(n_samples) / 800)
    h[:direct + 1] = 0
    h[direct] = level
    return h


def rir_row(key, room, h, **more):
    row = dict(id=key, wav=f"wav/{key}.wav", room_id=room, source_id="s1", mic_id="m1", fs_hz=FS, n_samples=len(h),
               room_dims_m=None, source_pos_m=None, mic_pos_m=None)
    return row | more


def rir_dir(path, n_rooms=2, simulated=False, seed=1):
    """Write an RIR directory with three sources per room, ambient and point noises."""
    rng, rows, noises = np.random.default_rng(seed), [], []
    for room in (f"room{n}" for n in range(n_rooms)):
        for n in range(3):
            h = decay(rng, direct=50 + 37 * n, level=-0.5 if n == 1 else 1.0)
            more = dict(direct_sample=float(50 + 37 * n)) if simulated else {}
            if simulated and n == 2:
                more["noise_for"] = f"{room}-0"
            rows.append(rir_row(f"{room}-{n}", room, h, source_id=f"s{n}", **more))
            write_wav(path / rows[-1]["wav"], h)
        noises.append(dict(id=f"hum-{room}", wav=f"wav/hum-{room}.flac", room_id=room, kind="ambient",
                           duration_s=2.0, fs_hz=FS))
        write_flac(path / noises[-1]["wav"], 0.05 * rng.standard_normal(2 * FS).clip(-4, 4))
    noises.append(dict(id="tap", wav="wav/tap.flac", room_id=None, kind="point", duration_s=0.3, fs_hz=FS))
    write_flac(path / "wav/tap.flac", 0.05 * rng.standard_normal(4800).clip(-4, 4))
    write_rirs(path, rows)
    write_noises(path, noises)
    return path


def audio_of(data, utterance_id):
    """Read an utterance by its entries in the tables, as float64."""
    utterance = data.utterances[utterance_id]
    samples, fs_hz = soundfile.read(data.recordings[utterance.recording].text)
    assert fs_hz == FS
    stop = None if utterance.end_s is None else round(utterance.end_s * FS)
    return samples[round(utterance.start_s * FS):stop]
