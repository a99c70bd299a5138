#!/usr/bin/env python3
"""Make a speech corpus of digit strings from recordings of single digits (Free Spoken Digit Dataset).

Usage: prepare_digits.py [--passes 2,5,7] [--seed 0] [--nj 2] DIGITS OUT_DIR
e.g.:  python local/prepare_digits.py free-spoken-digit-dataset/recordings corpora/digits

DIGITS holds DIGIT_SPEAKER_INDEX.wav or .flac, in any folders. Of each speaker and digit, recordings 0-14 go to the test
set, 15-19 to dev, the rest to training: no recording is in two sets, but every speaker is in all sets. A string is 3-7
recordings of one speaker, the last one of a pass maybe fewer, with gaps of 0.1-0.3 s. Writes FLAC files of 16 kHz and
manifest.csv. Of recordings at 8 kHz, the band above 4 kHz holds a noise floor only.

Each recording of dev is in five strings, 1,500 words in all. The weights of the language models are chosen on dev: of
300 words, a dozen errors would choose them, and word error rates on test would differ by a tenth by chance.
"""

import argparse
import re
import sys
from functools import partial
from pathlib import Path

import numpy as np
import soundfile
import soxr

import make_synthetic_speech
from roomeq.core.arrays import FloatArray
from roomeq.core.audio import write_flac
from roomeq.core.build import Build
from roomeq.core.constants import FS_HZ
from roomeq.core.files import write_text
from roomeq.core.rng import rng_for

NAME = re.compile(r"(\d)_([A-Za-z0-9]+)_(\d{1,4})\.(wav|flac)")
WORDS = "ZERO ONE TWO THREE FOUR FIVE SIX SEVEN EIGHT NINE".split()
FIRST_INDEX = {"test": 0, "dev": 15, "train": 20}
FADE_S = 0.01


Recording = tuple[int, Path]
"""Digit and file."""


def find_recordings(digits: Path) -> dict[tuple[str, str], list[Recording]]:
    """Return the recordings by set and speaker, in an order that does not depend on folders.

    Raises
    ------
    ValueError
        There are no recordings, or a set would be empty.
    """
    recordings: dict[tuple[str, str], list[Recording]] = {}
    for path in sorted(digits.rglob("*"), key=lambda path: path.name):
        if named := NAME.fullmatch(path.name):
            digit, speaker, index = int(named[1]), named[2], int(named[3])
            role = max((first, role) for role, first in FIRST_INDEX.items() if first <= index)[1]
            recordings.setdefault((role, speaker), []).append((digit, path))
    for role in FIRST_INDEX:
        if role not in {key[0] for key in recordings}:
            raise ValueError(f"{digits}: holds no recordings DIGIT_SPEAKER_INDEX.wav or .flac for the {role} set "
                             f"(index from {FIRST_INDEX[role]}): check the path")
    return recordings


def read_digit(path: Path) -> FloatArray:
    """Return a recording at `FS_HZ` with unit RMS, faded in and out.

    Raises
    ------
    ValueError
        The recording is empty or silent.
    """
    samples, fs_hz = soundfile.read(path, dtype="float64", always_2d=True)
    if not samples.size or not samples[:, 0].any():
        raise ValueError(f"{path}: is empty or silent: leave it out")
    speech = soxr.resample(samples[:, 0], fs_hz, FS_HZ, quality="VHQ")
    ramp = np.minimum(np.arange(len(speech)) / (FADE_S * FS_HZ), 1)
    return speech / speech.std() * ramp * ramp[::-1]


def draw_strings(recordings: list[Recording], passes: int, rng: np.random.Generator) -> list[list[Recording]]:
    """Return lists of 3 to 7 recordings, the last of a pass maybe fewer; each recording is in as many as passes."""
    strings = []
    for _ in range(passes):
        left = [recordings[n] for n in rng.permutation(len(recordings))]
        while left:
            size = int(rng.integers(3, 8))
            strings.append(left[:size])
            left = left[size:]
    return strings


def make_set(seed: int, passes: dict[str, int], out_dir: Path, name: str,
             item: tuple[tuple[str, str], list[Recording]]) -> list[str]:
    """Write the strings of one speaker and set; return the rows of the manifest."""
    (role, speaker), recordings = item
    rows = []
    for number, chosen in enumerate(draw_strings(recordings, passes[role], rng_for(seed, "digit-strings", name))):
        utterance = f"{speaker}-{role}-{number:04d}"
        rng = rng_for(seed, "digit-string", utterance)
        parts = [read_digit(path) for _, path in chosen]
        gaps = [np.zeros(int(rng.uniform(0.1, 0.3) * FS_HZ)) for _ in parts[1:]] + [np.zeros(0)]
        speech = np.concatenate([part for pair in zip(parts, gaps, strict=True) for part in pair])
        recorded = make_synthetic_speech.recorded(speech / np.abs(speech).max(), rng)
        write_flac(out_dir / role / f"{utterance}.flac", recorded)
        rows.append(f"{role}/{utterance}.flac,{utterance},{speaker},{role},{' '.join(WORDS[d] for d, _ in chosen)}\n")
    return rows


def prepare_digits(digits: Path, out_dir: Path, passes: dict[str, int], seed: int, nj: int = 1) -> None:
    """Make the corpus.

    Parameters
    ----------
    digits
        Folder of recordings.
    out_dir
        Directory to make.
    passes
        Number of strings that each recording is in, by set.
    seed
    nj
        Number of processes; the result does not depend on it.

    Raises
    ------
    ValueError
        `digits` lacks recordings, or `out_dir` exists and was not made by this function.
    """
    build = Build(out_dir, step="digits", options=dict(passes=passes, seed=seed), inputs=[
        digits, Path(__file__), Path(make_synthetic_speech.__file__)])
    items = {" ".join(key): (key, recordings) for key, recordings in sorted(find_recordings(digits).items())}

    def assemble(directory: Path, records: list[list[str]]) -> None:
        rows = [row for record in records for row in record]
        write_text(directory / "manifest.csv", "file,utt_id,speaker,set,transcript\n" + "".join(rows))
        for role in passes:
            of_set = [row for row in rows if row.startswith(f"{role}/")]
            print(f"{out_dir}: {role}: {len(of_set)} strings, {sum(len(row.split()) for row in of_set)} words")

    if not build.done and build.run(items, partial(make_set, seed, passes, build.work), nj=nj):
        build.finish(assemble)


def three_counts(text: str) -> dict[str, int]:
    """Parse ``"2,5,7"``."""
    if not re.fullmatch(r"[1-9]\d?,[1-9]\d?,[1-9]\d?", text):
        raise argparse.ArgumentTypeError(f"{text} must be three counts from 1 to 99, such as 2,5,7")
    return dict(zip(("train", "dev", "test"), map(int, text.split(",")), strict=True))


def main(argv: list[str] | None = None) -> int:
    """Parse the command line and make the corpus; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("digits", type=Path, metavar="DIGITS")
    parser.add_argument("out_dir", type=Path, metavar="OUT_DIR")
    parser.add_argument("--passes", type=three_counts, default="2,5,7", metavar="TRAIN,DEV,TEST",
                        help="strings that each recording is in; default 2,5,7")
    parser.add_argument("--seed", type=int, default=0, help="seed of all random numbers; default 0")
    parser.add_argument("--nj", type=int, default=1, help="number of processes; default 1")
    args = parser.parse_args(argv)
    try:
        prepare_digits(args.digits, args.out_dir, args.passes, args.seed, args.nj)
    except (ValueError, OSError) as error:
        print(f"prepare_digits.py: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
