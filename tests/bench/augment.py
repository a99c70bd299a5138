#!/usr/bin/env python3
"""Measure augmentation: times real time on one core, reading and writing FLAC included, and memory.

Usage: tests/bench/augment.py [--speech ../shared/data/speech] [--measured ../shared/data/measured]
                              [--noise ../shared/data/noise] [--min-s 10] [--copies 10] [--rounds 3]

Where KALDI_ROOT is set, `flac -d | wav-reverberate | flac` does the same work (reverberation and one ambient noise)
on the same utterances, in turns with ours, and the audio of both is compared without noise.
Prints one JSON object. CPU seconds of the process and its children count, so a busy machine disturbs less.
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
from pathlib import Path

import numpy as np
import soundfile
from scipy.signal import fftconvolve

PROJECT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(PROJECT / "pysrc"))

from roomeq.augment import augment  # noqa: E402
from roomeq.corpora import read_measured, read_noises  # noqa: E402
from roomeq.datadir import read_data_dir, read_utterance  # noqa: E402
from roomeq.datawrite import OutUtterance, write_data_dir  # noqa: E402
from roomeq.rirs import load_rir, read_rirs, write_rirs  # noqa: E402
from roomeq.rirs import read_noises as noise_rows  # noqa: E402
from roomeq.wavscp import flac_entry  # noqa: E402

FS = 16000


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
        print(json.dumps(measure(given, Path(folder)), indent=1))


def measure(given, work):
    speech, rirs, noises = work / "speech", work / "rirs", work / "noises"
    total_s = make_speech_dir(given.speech, speech, given.min_s)
    read_measured(given.measured, rirs)
    read_noises(given.noise, noises)
    result = dict(utterances=len(read_data_dir(speech).utterances), speech_s=round(total_s, 1), copies=given.copies)
    ours, point, kaldi = [], [], []
    for n in range(given.rounds):
        for name, prob, rates in (("ambient", 0.0, ours), ("point", 0.5, point)):
            before = cpu_s()
            augment(speech, rirs, work / f"{name}{n}", seed=n, noises=[noises], copies=given.copies,
                    point_noise_prob=prob)
            rates.append(given.copies * total_s / (cpu_s() - before))
        if kaldi_binary():
            kaldi.append(total_s / reverberate_with_kaldi(speech, rirs, noises, work / f"ambient{n}", given.copies))
    result.update(times_real_time=dict(reverberation_and_ambient_noise=summary(ours),
                                       and_point_noise_for_half=summary(point)))
    if kaldi:
        result["times_real_time"]["wav_reverberate_and_ambient_noise"] = summary(kaldi)
        result["ratio_to_wav_reverberate"] = round(statistics.median(ours) / statistics.median(kaldi), 2)
        result["difference_to_float64_db"] = compare_with_kaldi(speech, rirs, work)
    result["peak_memory_mib"] = memory(speech, rirs, noises, work)
    return result


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


def kaldi_binary():
    path = Path(os.environ.get("KALDI_ROOT", "/nonexistent")) / "src/featbin/wav-reverberate"
    return path if path.is_file() else None


def pcm_wav(path, samples):
    """Write a 16-bit WAV at full scale: `wav-reverberate` reads nothing else."""
    if not path.exists():
        soundfile.write(path, 0.9 * samples / np.abs(samples).max(), FS, subtype="PCM_16")
    return path


def reverberate_with_kaldi(speech, rirs, noises, ours, copies):
    """Do what the first copy of our directory did, with Kaldi; return CPU seconds."""
    responses = {row["id"]: row for row in read_rirs(rirs)}
    sounds = {row["id"]: row for row in noise_rows(noises)}
    data, out = read_data_dir(speech), ours.with_suffix(".kaldi")
    out.mkdir()
    rows = [row for row in map(json.loads, open(ours / "augment.jsonl"))
            if copies == 1 or row["id"].endswith("-rvb1")]
    for row in rows:
        pcm_wav(out / f"{row['rir']}.wav", load_rir(rirs, responses[row["rir"]]))
        noise = row["noises"][0]["id"]
        pcm_wav(out / f"{noise}.wav", soundfile.read(noises / sounds[noise]["wav"])[0])
    before = cpu_s()
    for row in rows:
        noise = row["noises"][0]
        run_kaldi(data.recordings[row["clean"]].text, out / f"{row['rir']}.wav", out / f"{row['clean']}.flac",
                  f"--duration={row['n_samples'] / FS:.7f}", f"--additive-signals={out / noise['id']}.wav",
                  f"--snrs={noise['snr_db']}", "--start-times=0")
    return cpu_s() - before


def run_kaldi(source, rir, out, *options):
    with subprocess.Popen(["flac", "-c", "-d", "-s", source], stdout=subprocess.PIPE) as decode:
        with subprocess.Popen([kaldi_binary(), "--shift-output=true", f"--impulse-response={rir}", *options, "-", "-"],
                              stdin=decode.stdout, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as reverberate:
            if Path(out).suffix == ".flac":
                subprocess.run(["flac", "-s", "-f", "-o", out, "-"], stdin=reverberate.stdout, check=True)
            else:
                Path(out).write_bytes(reverberate.stdout.read())


def compare_with_kaldi(speech, rirs, work):
    """Return how far ours and Kaldi's are from a convolution in float64, and from each other [dB], at equal levels.

    Kaldi advances by the largest peak, so RIRs are taken whose direct sound that is, at the 16 bits it reads.
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
    by_id, found = {row["id"]: row for row in rows}, dict(ours=[], wav_reverberate=[], between=[])
    for row in map(json.loads, open(work / "plain/augment.jsonl")):
        h = load_rir(some, by_id[row["rir"]])
        run_kaldi(clean.recordings[row["clean"]].text, some / by_id[row["rir"]]["wav"], work / "kaldi.wav")
        kaldi = soundfile.read(work / "kaldi.wav")[0][:row["n_samples"]]
        if np.abs(h).argmax() != row["shift"] or np.abs(kaldi).max() > 0.999:
            continue  # aligned elsewhere, or clipped by Kaldi
        dry = soundfile.read(clean.recordings[row["clean"]].text)[0]
        exact = fftconvolve(dry, h)[row["shift"]:row["shift"] + len(kaldi)]
        ours = read_utterance(result, result.utterances[row["id"]]).astype(float)[:len(kaldi)]
        for name, signal, reference in (("ours", ours, exact), ("wav_reverberate", kaldi, exact),
                                        ("between", ours, kaldi)):
            scaled = signal * np.dot(signal, reference) / np.dot(signal, signal)
            found[name].append(10 * np.log10(np.mean((scaled - reference) ** 2) / np.mean(reference**2)))
    return {name: dict(median=round(statistics.median(values), 1), worst=round(max(values), 1))
            for name, values in found.items()}


def memory(speech, rirs, noises, work):
    """Return the peak memory of runs of 1 and 16 copies, each in a process of its own [MiB]."""
    code = ("import sys, resource; from roomeq.augment import augment; "
            "augment(sys.argv[1], sys.argv[2], sys.argv[4], noises=[sys.argv[3]], copies=int(sys.argv[5])); "
            "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024)")
    return {f"copies_{copies}": int(subprocess.run(
        [sys.executable, "-c", code, speech, rirs, noises, work / f"memory{copies}", str(copies)], check=True,
        capture_output=True, text=True, env=os.environ | dict(PYTHONPATH=str(PROJECT / "pysrc"))).stdout)
        for copies in (1, 16)}


if __name__ == "__main__":
    started = time.monotonic()
    main()
    print(f"{time.monotonic() - started:.0f} s", file=sys.stderr)
