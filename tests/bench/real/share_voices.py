#!/usr/bin/env python3
"""Divide generated speech anew, with every voice in all sets, for word error rates in real rooms.

Usage: tests/bench/real/share_voices.py SPEECH_DIR
e.g.:  local/make_synthetic_speech.py --nj 2 --utterances 2200,400,1200 corpora/shared_voices
       tests/bench/real/share_voices.py corpora/shared_voices

SPEECH_DIR is what local/make_synthetic_speech.py has written. Writes SPEECH_DIR/manifest.csv for --speech of run.sh:
the sets have as many utterances as before, but each has utterances of every voice. Rooms are compared here. With new
voices in the test set, most errors in dry rooms are those of voices that are unlike all voices of training.
"""

import argparse
import csv
import sys
from pathlib import Path

SETS = {"train": "train-clean-100", "dev": "dev-clean", "test": "test-clean"}


def transcripts(speech: Path, subset: str) -> dict[str, tuple[str, str]]:
    """Return file, relative to `speech`, and transcript of each utterance of a subset."""
    found = {}
    for path in sorted((speech / "LibriSpeech" / subset).glob("*/*/*.trans.txt")):
        for line in path.read_text().splitlines():
            utterance, text = line.split(maxsplit=1)
            found[utterance] = (str((path.parent / f"{utterance}.flac").relative_to(speech)), text)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("speech", type=Path, metavar="SPEECH_DIR")
    speech = parser.parse_args().speech
    by_set = {role: transcripts(speech, subset) for role, subset in SETS.items()}
    if not all(by_set.values()):
        sys.exit(f"{speech}: lacks LibriSpeech/*/*/*/*.trans.txt of a set: run local/make_synthetic_speech.py first")
    total = sum(map(len, by_set.values()))
    bounds = {"train": len(by_set["train"]) / total, "dev": 1 - len(by_set["test"]) / total, "test": 1.0}
    of_voice: dict[str, list[str]] = {}
    utterances = {utterance: found for one in by_set.values() for utterance, found in one.items()}
    for utterance in utterances:  # sentences were drawn independently: their order means nothing
        of_voice.setdefault(utterance.split("-")[0], []).append(utterance)
    counts = dict.fromkeys(SETS, 0)
    with (speech / "manifest.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("file", "utt_id", "speaker", "set", "transcript"))
        for voice, spoken in of_voice.items():
            for number, utterance in enumerate(spoken):
                role = next(role for role, bound in bounds.items() if (number + 0.5) / len(spoken) < bound)
                counts[role] += 1
                writer.writerow((utterances[utterance][0], utterance, voice, role, utterances[utterance][1]))
    print(f"{speech}: {len(of_voice)} voices; " + ", ".join(f"{role} {count}" for role, count in counts.items()))


if __name__ == "__main__":
    main()
