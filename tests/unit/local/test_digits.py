"""Strings of single digit recordings: their content, and that no recording is in two sets."""

import csv
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import soundfile

import prepare_digits

LOCAL = Path(__file__).parents[3] / "local"

FS_HZ = 8000


def run(*args):
    command = [sys.executable, str(LOCAL / "prepare_digits.py"), *map(str, args)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def digits(tmp_path_factory):
    """Recordings of two speakers; each is a tone whose frequency identifies the recording."""
    where = tmp_path_factory.mktemp("digits")
    for speaker in ("ann", "bob"):
        for digit in range(2):
            for index in (0, 3, 14, 15, 17, 20, 49):
                path = where / f"{digit}_{speaker}_{index}.wav"
                tone = np.sin(2 * np.pi * (500 + 10 * index) * np.arange(2400) / FS_HZ)
                soundfile.write(path, 0.1 * tone, FS_HZ)
    return where


@pytest.fixture(scope="module")
def corpus(digits, tmp_path_factory):
    out_dir = tmp_path_factory.mktemp("corpus") / "strings"
    done = run("--passes", "2,1,3", digits, out_dir)
    assert done.returncode == 0, done.stderr
    return out_dir


def rows(corpus):
    with open(corpus / "manifest.csv", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def test_each_set_has_every_digit_as_often_as_passes(corpus):
    words = {role: Counter() for role in ("train", "dev", "test")}
    for row in rows(corpus):
        words[row["set"]].update((row["speaker"], word) for word in row["transcript"].split())
    for role, times in (("train", 2 * 2), ("dev", 2 * 1), ("test", 3 * 3)):
        assert words[role] == {(speaker, word): times for speaker in ("ann", "bob") for word in ("ZERO", "ONE")}


def test_strings_are_16_khz_audio_with_a_noise_floor(corpus):
    for row in rows(corpus):
        samples, fs_hz = soundfile.read(corpus / row["file"])
        n_words = len(row["transcript"].split())
        assert fs_hz == 16000 and 1 <= n_words <= 7
        assert len(samples) / fs_hz > 0.3 * n_words + 0.1 * (n_words - 1) + 0.3
        quiet = samples[:16 * 120].reshape(-1, 160).std(axis=1)
        assert np.all(quiet > 10 ** (-75 / 20)) and 0.2 < np.abs(samples).max() < 1


def test_no_recording_is_in_two_sets(digits):
    recordings = prepare_digits.find_recordings(digits)
    indices = {role: {int(path.stem.split("_")[2]) for key, of_speaker in recordings.items() if key[0] == role
                      for _, path in of_speaker} for role in ("train", "dev", "test")}
    assert indices == {"train": {20, 49}, "dev": {15, 17}, "test": {0, 3, 14}}


def test_two_jobs_give_the_same_bytes(digits, corpus, tmp_path):
    assert run("--passes", "2,1,3", "--nj", "2", digits, tmp_path / "again").returncode == 0
    for path in corpus.rglob("*"):
        if path.is_file() and path.name != ".done":
            assert path.read_bytes() == (tmp_path / "again" / path.relative_to(corpus)).read_bytes()


def test_wrong_inputs_are_one_line(tmp_path, digits):
    (tmp_path / "empty").mkdir()
    done = run(tmp_path / "empty", tmp_path / "out")
    assert done.returncode == 1 and "holds no recordings DIGIT_SPEAKER_INDEX" in done.stderr
    assert done.stderr.count("\n") == 1
    done = run("--passes", "0,1,1", digits, tmp_path / "out")
    assert done.returncode == 2 and "0,1,1 must be three counts" in done.stderr
