#!/usr/bin/env python3
"""Make a speech corpus of digit strings from recordings of single digits (Free Spoken Digit Dataset).

Usage: prepare_digits.py [--passes 2,1,7] [--seed 0] [--nj 2] DIGITS OUT_DIR
e.g.:  python local/prepare_digits.py free-spoken-digit-dataset/recordings corpora/digits

DIGITS holds DIGIT_SPEAKER_INDEX.wav or .flac, in folders or not. Of each speaker and digit, recordings 0-14 go to the
test set, 15-19 to dev, the rest to training: no recording is in two sets, but every speaker is in all. A string is
3-7 recordings of one speaker with 0.1-0.3 s between. Writes FLAC files of 16 kHz and manifest.csv. Where the recordings
have 8 kHz, there is nothing but a noise floor above 4 kHz.
"""

import argparse
import re
import sys
from functools import partial
from pathlib import Path

import numpy as np
import soundfile
import soxr

from make_synthetic_speech import recorded
from roomeq.core.audio import write_flac
from roomeq.core.build import Build
from roomeq.core.constants import FS_HZ
from roomeq.core.files import write_text
from roomeq.core.rng import rng_for

NAME = re.compile(r"(\d)_([A-Za-z0-9]+)_(\d{1,4})\.(wav|flac)")
WORDS = "ZERO ONE TWO THREE FOUR FIVE SIX SEVEN EIGHT NINE".split()
FIRST_INDEX = {"test": 0, "dev": 15, "train": 20}
FADE_S = 0.01


def find_recordings(digits):
    """Return the recordings as {(set, speaker): [(digit, path), ...]}, in an order that doesn't depend on folders.

    Raises
    ------
    ValueError
        There are none, or a set would be empty.
    """
    found = {}
    for path in sorted(digits.rglob("*"), key=lambda path: path.name):
        if named := NAME.fullmatch(path.name):
            digit, speaker, index = int(named[1]), named[2], int(named[3])
            role = max((first, role) for role, first in FIRST_INDEX.items() if first <= index)[1]
            found.setdefault((role, speaker), []).append((digit, path))
    for role in FIRST_INDEX:
        if role not in {key[0] for key in found}:
            raise ValueError(f"{digits}: holds no recordings DIGIT_SPEAKER_INDEX.wav or .flac for the {role} set "
                             f"(index from {FIRST_INDEX[role]}): check the path")
    return found


def read_digit(path):
    """Return a recording at `FS_HZ` with unit RMS, faded in and out."""
    samples, fs_hz = soundfile.read(path, dtype="float64", always_2d=True)
    if not samples.size or not samples[:, 0].any():
        raise ValueError(f"{path}: is empty or silent: leave it out")
    speech = soxr.resample(samples[:, 0], fs_hz, FS_HZ, quality="VHQ")
    ramp = np.minimum(np.arange(len(speech)) / (FADE_S * FS_HZ), 1)
    return speech / speech.std() * ramp * ramp[::-1]


def strings(recordings, passes, rng):
    """Return lists of 3 to 7 recordings, each recording in as many as there are passes."""
    made = []
    for _ in range(passes):
        left = [recordings[n] for n in rng.permutation(len(recordings))]
        while left:
            size = int(rng.integers(3, 8))
            made.append(left[:size])
            left = left[size:]
    return made


def make_set(seed, passes, out_dir, name, item):
    """Write the strings of one speaker and set; return the rows of the manifest."""
    (role, speaker), recordings = item
    rows = []
    for number, chosen in enumerate(strings(recordings, passes[role], rng_for(seed, "digit-strings", name))):
        utterance = f"{speaker}-{role}-{number:04d}"
        rng = rng_for(seed, "digit-string", utterance)
        parts = [read_digit(path) for _, path in chosen]
        gaps = [np.zeros(int(rng.uniform(0.1, 0.3) * FS_HZ)) for _ in parts[1:]]
        speech = np.concatenate([part for pair in zip(parts, [*gaps, []], strict=True) for part in pair])
        write_flac(out_dir / role / f"{utterance}.flac", recorded(speech / np.abs(speech).max(), rng))
        rows.append(f"{role}/{utterance}.flac,{utterance},{speaker},{role},{' '.join(WORDS[d] for d, _ in chosen)}\n")
    return rows


def prepare_digits(digits, out_dir, passes, seed, nj=1):
    """Make the corpus.

    Parameters
    ----------
    digits, out_dir : Path
    passes : dict
        How many strings each recording is in, by set.
    seed : int
    nj : int
        Processes; the result does not depend on it.

    Raises
    ------
    ValueError
        `digits` lacks recordings, or `out_dir` holds something else.
    """
    found = find_recordings(digits)
    build = Build(out_dir, step="digits", options=dict(passes=passes, seed=seed), inputs=[digits, Path(__file__)])
    items = {" ".join(key): (key, recordings) for key, recordings in sorted(found.items())}

    def assemble(directory, records):
        rows = [row for record in records for row in record]
        write_text(directory / "manifest.csv", "file,utt_id,speaker,set,transcript\n" + "".join(rows))
        for role in passes:
            mine = [row for row in rows if row.startswith(f"{role}/")]
            print(f"{out_dir}: {role}: {len(mine)} strings, {sum(len(row.split()) for row in mine)} words")

    if not build.done and build.run(items, partial(make_set, seed, passes, build.work), nj=nj):
        build.finish(assemble)


def three_counts(text):
    """Parse ``"2,1,7"``."""
    if not re.fullmatch(r"[1-9]\d?,[1-9]\d?,[1-9]\d?", text):
        raise argparse.ArgumentTypeError(f"{text} must be three counts from 1 to 99, such as 2,1,7")
    return dict(zip(("train", "dev", "test"), map(int, text.split(",")), strict=True))


def main(argv=None):
    """Parse the command line and make the corpus; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("digits", type=Path, metavar="DIGITS")
    parser.add_argument("out_dir", type=Path, metavar="OUT_DIR")
    parser.add_argument("--passes", type=three_counts, default="2,1,7", metavar="TRAIN,DEV,TEST",
                        help="how many strings each recording is in; default 2,1,7")
    parser.add_argument("--seed", type=int, default=0, help="of all random draws; default 0")
    parser.add_argument("--nj", type=int, default=1, help="processes; default 1")
    args = parser.parse_args(argv)
    try:
        prepare_digits(args.digits, args.out_dir, args.passes, args.seed, args.nj)
    except (ValueError, OSError) as error:
        print(f"prepare_digits.py: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
