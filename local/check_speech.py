#!/usr/bin/env python3
"""Check data directories of clean speech as Kaldi does, with their audio, which must be files.

Usage: check_speech.py DATA_DIR...
e.g.:  python local/check_speech.py data/train.clean data/dev.clean

The steps that use them say the same, but only after all RIRs were simulated.
"""

import sys
from pathlib import Path


def main(argv: list[str]) -> int:
    """Check the directories; return the exit status."""
    if not argv or argv[0].startswith("-"):
        print(__doc__)
        return 0 if argv[:1] in (["--help"], ["-h"]) else 1
    from roomeq.kaldi.datadir import read_data_dir
    from roomeq.kaldi.validate import validate_data_dir

    try:
        for directory in map(Path, argv):
            for recording, entry in read_data_dir(directory, pipes=True).recordings.items():
                if entry.kind == "pipe":
                    raise ValueError(f"{directory}/wav.scp: audio of {recording} is a command, '{entry.text} |', and "
                                     "the recipe runs none: write the audio to WAV or FLAC files")
            print(f"{directory}: {validate_data_dir(directory)} utterances, OK")
    except (ValueError, OSError) as error:
        print(f"check_speech.py: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
