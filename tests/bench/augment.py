#!/usr/bin/env python3
"""Measure augmentation: times real time on one core, reading and writing FLAC included, and memory.

Usage: tests/bench/augment.py [--speech ../shared/data/speech] [--measured ../shared/data/measured]
                              [--noise ../shared/data/noise] [--min-s 10] [--copies 10] [--rounds 3]

Kaldi's wav-reverberate, lhotse and audiomentations, as far as they are here, do the same work (reverberation and one
ambient noise) on the same utterances, in turns with ours, and the audio is compared without noise.
Prints one JSON object. CPU seconds of the process and its children count, so a busy machine disturbs less. Exit
status 1 where audio that should be the same differs by more than -60 dB.
"""

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path

import numpy as np
import soundfile
from scipy.signal import fftconvolve

PROJECT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(PROJECT / "pysrc"), str(PROJECT / "tests")]

from bench.augment_peers import Task, convolve_as_kaldi, present  # noqa: E402
from roomeq.augment import augment  # noqa: E402
from roomeq.augment.mix import without_rumble  # noqa: E402
from roomeq.corpora import read_measured, read_noises  # noqa: E402
from roomeq.kaldi.datadir import read_data_dir, read_utterance  # noqa: E402
from roomeq.kaldi.wavscp import flac_entry  # noqa: E402
from roomeq.kaldi.write import OutUtterance, write_data_dir  # noqa: E402
from roomeq.records.rir_dir import load_rir, read_rirs, write_rirs  # noqa: E402
from roomeq.records.rir_dir import read_noises as noise_rows  # noqa: E402

FS = 16000
LONGEST_S = 36  # of an utterance
MOST_DB = -60.0  # of difference, where both did the same
SAME = ("ours_to_float64", "ours_to_lhotse", "ours_to_audiomentations", "wav_reverberate_to_its_faulty_product")
LIBRISPEECH_UTTERANCES = 132553  # train-clean-100 and 360


def main():
    shared = PROJECT.parent / "shared/data"
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--speech", type=Path, default=shared / "speech", help="folder with FLAC files")
    parser.add_argument("--measured", type=Path, default=shared / "measured", help="RIR corpus")
    parser.add_argument("--noise", type=Path, default=shared / "noise", help="folder of noises")
    parser.add_argument("--min-s", type=float, default=10.0, help="shortest utterance [s]; LibriSpeech's mean is 12.3")
    parser.add_argument("--copies", type=int, default=10)
    parser.add_argument("--rounds", type=int, default=3)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        result = measure(given, Path(folder))
    print(json.dumps(result, indent=1))
    differ = [name for name, found in result["difference_db"].items() if name in SAME and found["worst"] > MOST_DB]
    if differ:
        print(f"more than {MOST_DB:g} dB apart: {', '.join(differ)}", file=sys.stderr)
    return 1 if differ else 0


def measure(given, work):
    speech, rirs, noises = work / "speech", work / "rirs", work / "noises"
    total_s = make_speech_dir(given.speech, speech, given.min_s)
    read_measured(given.measured, rirs)
    read_noises(given.noise, noises)
    rates, tasks, peers, absent = defaultdict(list), [], {}, []
    for n in range(given.rounds):
        for name, prob in (("roomeq", 0.0), ("roomeq_and_point_noise_for_half", 0.5)):
            before = cpu_s()
            augment(speech, rirs, work / f"{name}{n}", seed=n, noises=[noises], copies=given.copies,
                    point_noise_prob=prob)
            rates[name].append(given.copies * total_s / (cpu_s() - before))
        if not tasks:
            tasks = tasks_of(speech, rirs, noises, work / f"roomeq{n}", work / "others")
            peers, absent = present(tasks)
            for peer in peers.values():
                peer.make(tasks[0])  # what they import and compile late is not their speed
        for name, peer in peers.items():
            rates[name].append(rate_of(peer, tasks))
    ours = statistics.median(rates["roomeq"])
    return dict(
        utterances=len(read_data_dir(speech).utterances), speech_s=round(total_s, 1), copies=given.copies,
        left_out=absent, times_real_time={name: summary(values) for name, values in rates.items()},
        ratio={name: round(ours / statistics.median(rates[name]), 2) for name in peers},
        flac_mib_per_hour=round(sum(path.stat().st_size for path in work.glob("roomeq_and*/audio/*/*.flac")) / 2**20
                                / (given.rounds * given.copies * total_s / 3600), 1),
        difference_db=compare(speech, rirs, work), peak_memory_mib=memory(speech, rirs, noises, work))


def summary(rates):
    return dict(median=round(statistics.median(rates)), best=round(max(rates)))


def cpu_s():
    usage = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in usage)


def make_speech_dir(source, out, min_s):
    """Write a data directory of the FLAC files below a folder that are long enough; return their length [s]."""
    recordings, utterances, total = {}, [], 0
    for path in sorted(source.rglob("*.flac"), key=lambda path: path.stem):
        frames = soundfile.info(path).frames
        if frames >= min_s * FS:
            recordings[path.stem] = (flac_entry(path), frames)
            utterances.append(OutUtterance(path.stem, path.stem.partition("-")[0], path.stem, 0, frames, text="X"))
            total += frames
    write_data_dir(out, recordings, utterances, segmented=False)
    return total / FS


def pcm_wav(path, samples):
    """Write a 16-bit WAV at full scale: `wav-reverberate` reads nothing else."""
    if not path.exists():
        path.parent.mkdir(exist_ok=True)
        soundfile.write(path, 0.9 * samples / np.abs(samples).max(), FS, subtype="PCM_16")
    return path


def tasks_of(speech, rirs, noises, made, out):
    """Return as tasks for others what the first copies of a directory of ours are made of."""
    responses = {row["id"]: row for row in read_rirs(rirs)}
    sounds = {row["id"]: row for row in noise_rows(noises)}
    data, tasks = read_data_dir(speech), []
    for row in map(json.loads, open(made / "augment.jsonl")):
        if row["id"] in data.utterances or row["id"].endswith("-rvb1"):
            (noise,) = row["noises"]
            sound = np.resize(soundfile.read(noises / sounds[noise["id"]]["wav"])[0], LONGEST_S * FS)
            tasks.append(Task(Path(data.recordings[row["clean"]].text),
                              pcm_wav(out / f"{row['rir']}.wav", load_rir(rirs, responses[row["rir"]])),
                              out / f"{row['clean']}.flac", row["n_samples"],
                              pcm_wav(out / f"noise.{noise['id']}.wav", sound), noise["snr_db"]))
    return tasks


def rate_of(peer, tasks):
    """Return how many times faster than real time somebody else does the tasks."""
    before = cpu_s()
    for task in tasks:
        peer.make(task)
    return sum(task.n_samples for task in tasks) / FS / (cpu_s() - before)


def compare(speech, rirs, work):
    """Return how far each is from a convolution in float64, and ours from each [dB], aligned and at equal levels.

    Ours is compared with a convolution of the speech from 20 Hz on.

    Others advance by the largest sample, or not at all, so RIRs are taken whose direct sound that is, at the 16 bits
    that Kaldi reads. Results that clip are left out.
    """
    some, rows = work / "rirs.some", []
    for row in read_rirs(rirs):
        h = load_rir(rirs, row)
        if np.abs(h).argmax() == h.argmax():
            rows.append(row | dict(wav=f"wav/{row['id']}.wav"))
            (some / "wav").mkdir(parents=True, exist_ok=True)
            pcm_wav(some / rows[-1]["wav"], h)
    write_rirs(some, rows)
    augment(speech, some, work / "plain", snr_db="none", point_noise_prob=0)
    clean, result = read_data_dir(speech), read_data_dir(work / "plain")
    by_id, found = {row["id"]: row for row in rows}, {}
    drawn = [row for row in map(json.loads, open(work / "plain/augment.jsonl"))
             if np.abs(load_rir(some, by_id[row["rir"]])).argmax() == row["shift"]]
    tasks = [Task(Path(clean.recordings[row["clean"]].text), some / by_id[row["rir"]]["wav"],
                  work / f"plain.{row['id']}.flac", row["n_samples"]) for row in drawn]
    peers, _ = present(tasks)
    for row, task in zip(drawn, tasks, strict=True):
        dry, h = soundfile.read(task.clean)[0], load_rir(some, by_id[row["rir"]])
        exact = fftconvolve(dry, h)[row["shift"]:row["shift"] + task.n_samples]
        ours = read_utterance(result, result.utterances[row["id"]]).astype(float)
        from_20_hz = fftconvolve(without_rumble(dry, FS), h)[row["shift"]:row["shift"] + task.n_samples]
        found.setdefault("ours_to_float64", []).append(difference_db(ours, from_20_hz))
        for name, peer in peers.items():
            peer.make(task)
            theirs = soundfile.read(task.out)[0][row["shift"] if name == "audiomentations" else 0:task.n_samples]
            if np.abs(theirs).max() < 0.999:
                found.setdefault(f"{name}_to_float64", []).append(difference_db(theirs, exact))
                found.setdefault(f"ours_to_{name}", []).append(difference_db(ours, theirs))
                if name == "wav_reverberate":
                    faulty = convolve_as_kaldi(dry, h)[row["shift"]:row["shift"] + task.n_samples]
                    found.setdefault(f"{name}_to_its_faulty_product", []).append(difference_db(theirs, faulty))
    return {name: dict(utterances=len(values), median=round(statistics.median(values), 1), worst=round(max(values), 1))
            for name, values in sorted(found.items())}


def difference_db(signal, reference):
    """Return the power of the difference relative to the reference, after the best gain, over what both have [dB]."""
    length = min(len(signal), len(reference))
    signal, reference = signal[:length], reference[:length]
    scaled = signal * np.dot(signal, reference) / np.dot(signal, signal)
    return 10 * np.log10(np.mean((scaled - reference) ** 2) / np.mean(reference**2))


def memory(speech, rirs, noises, work):
    """Return the peak memory of runs in processes of their own [MiB]: of more and more copies of a few utterances, and
    of one job of many, which knows of as many utterances as LibriSpeech has, once and ten times."""
    many = work / "many"
    data = read_data_dir(speech)
    known = [(flac_entry(data.recordings[key].text), soundfile.info(data.recordings[key].text).frames)
             for key in data.utterances]
    pieces = {f"{n // 25:04d}-{n:06d}": known[n % len(known)] for n in range(LIBRISPEECH_UTTERANCES)}
    write_data_dir(many, pieces, (OutUtterance(key, key[:4], key, 0, frames, text="X")
                                  for key, (_, frames) in pieces.items()), segmented=False)
    runs = {f"{copies * len(known)}_utterances": (speech, copies, "1/1") for copies in (10, 40, 160)}
    runs |= {f"one_of_{jobs}_jobs_of_{copies * len(pieces)}_utterances": (many, copies, f"1/{jobs}")
             for copies, jobs in ((1, 1000), (10, 10_000))}
    # not ru_maxrss, which a child has from its parent
    code = ("import sys; from roomeq.augment import augment; "
            "augment(sys.argv[1], sys.argv[2], sys.argv[4], noises=[sys.argv[3]], copies=int(sys.argv[5]), "
            "part=sys.argv[6]); status = dict(line.split(':') for line in open('/proc/self/status')); "
            "print(int(status['VmHWM'].split()[0]) // 1024)")
    return {name: int(subprocess.run(
        [sys.executable, "-c", code, source, rirs, noises, work / f"memory.{name}", str(copies), part], check=True,
        capture_output=True, text=True, env=os.environ | dict(PYTHONPATH=str(PROJECT / "pysrc"))).stdout)
        for name, (source, copies, part) in runs.items()}


if __name__ == "__main__":
    started = time.monotonic()
    status = main()
    print(f"{time.monotonic() - started:.0f} s", file=sys.stderr)
    sys.exit(status)
