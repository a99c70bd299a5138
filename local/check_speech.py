#!/usr/bin/env python3
"""Check data directories of clean speech as Kaldi does, with their audio: files at 16 kHz or more.

Usage: check_speech.py [--for-kaldi] DATA_DIR...
e.g.:  python local/check_speech.py data/train.clean data/dev.clean

With --for-kaldi, only what Kaldi needs beyond that: WAV or FLAC files of 16 bits, mono, at 16 kHz. What uses the
directories says the same, but only after all RIRs were simulated.
"""

import sys
from pathlib import Path


def main(argv: list[str]) -> int:
    """Check the directories; return the exit status."""
    if not argv or argv[0].startswith("-") and argv[0] != "--for-kaldi":
        print(__doc__)
        return 0 if argv[:1] in (["--help"], ["-h"]) else 1
    from roomeq.core.constants import FS_HZ
    from roomeq.kaldi.datadir import read_data_dir
    from roomeq.kaldi.validate import validate_data_dir
    from roomeq.kaldi.wavscp import read_length

    try:
        if argv[0] == "--for-kaldi":
            for directory in map(Path, argv[1:]):
                _check_for_kaldi(directory)
            return 0
        for directory in map(Path, argv):
            recordings = read_data_dir(directory, pipes=True).recordings
            for recording, entry in recordings.items():
                if entry.kind == "pipe":
                    raise ValueError(f"{directory}/wav.scp: audio of {recording} is a command, '{entry.text} |', and "
                                     "the recipe runs none: write the audio to WAV or FLAC files")
            n_utterances = validate_data_dir(directory)
            for recording, entry in recordings.items():
                if (rate_hz := read_length(entry).rate_hz) < FS_HZ:
                    raise ValueError(f"{directory}/wav.scp: audio of {recording}, {entry.text}: sample rate {rate_hz} "
                                     f"Hz must be at least {FS_HZ} Hz: use other recordings")
            print(f"{directory}: {n_utterances} utterances, OK")
    except (ValueError, OSError) as error:
        print(f"check_speech.py: {error}", file=sys.stderr)
        return 1
    return 0


def _check_for_kaldi(directory: Path) -> None:
    from roomeq.core.audio import audio_info
    from roomeq.core.constants import FS_HZ
    from roomeq.kaldi.datadir import read_data_dir
    from roomeq.kaldi.wavscp import entry_for_kaldi

    for recording, entry in read_data_dir(directory).recordings.items():
        try:
            entry_for_kaldi(entry)
        except ValueError as error:
            raise ValueError(f"{directory}/wav.scp: recording {recording}: {error}, or stop with --stop-stage 7"
                             ) from None
        info, is_flac = audio_info(Path(entry.text)), Path(entry.text).suffix.lower() == ".flac"
        if info.format not in (("FLAC",) if is_flac else ("WAV", "WAVEX")):  # corpora have SPHERE files named .wav
            raise ValueError(f"{directory}/wav.scp: {entry.text}: format {info.format} is not that of its name, which "
                             "Kaldi goes by: convert the audio, or stop with --stop-stage 7")
        if (info.samplerate, info.channels, info.subtype) != (FS_HZ, 1, "PCM_16"):
            raise ValueError(f"{directory}/wav.scp: {entry.text}: {info.samplerate} Hz, {info.channels} channels, "
                             f"{info.subtype}: Kaldi's features need 16-bit mono at {FS_HZ} Hz: convert the audio, or "
                             "stop with --stop-stage 7")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
