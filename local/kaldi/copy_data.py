#!/usr/bin/env python3
"""Copy a data directory without its audio into a Kaldi workspace, where Kaldi adds files.

Usage: copy_data.py [--seed N] DATA_DIR COPY
e.g.:  python local/kaldi/copy_data.py data/train.sim.rvb exp/kaldi/data/train.sim.rvb

Paths become absolute. Files added by Kaldi stay unless the source has changed or moved; the file `source` records its
state. Where they are removed, so are the marks of the commands that made them. The file `content` holds the hash of a
source that a step made; it goes to wer.json, which then says what it is of.
"""

import argparse
import hashlib
import os
import shutil
import sys
from pathlib import Path

from roomeq.core.digests import digest
from roomeq.core.files import sync, write_bytes, write_text
from roomeq.core.stamps import read_stamp
from roomeq.kaldi.datadir import read_data_dir
from roomeq.kaldi.wavscp import entry_for_kaldi
from roomeq.wer.workspace import CONTENT_FILE

COPIED = ("segments", "text", "utt2spk", "spk2utt", "spk2gender", "utt2dur", "reco2dur", "utt2lang", "utt2uniq",
          "utt2rir", "utt2snr")


def copy_data(source: Path, copy: Path, seed: int | None = None) -> None:
    """Copy the files of `source` unless `copy` has them already.

    Raises
    ------
    ValueError
        `source` is not a valid data directory, has recordings that are not FLAC or WAV files, or was made with another
        seed.
    """
    stamp = read_stamp(source) if seed is not None else None
    made_with = stamp.options.get("seed", seed) if stamp else seed
    if made_with != seed:
        raise ValueError(f"{source}: was made with seed {made_with}, and would count as one of seed {seed}: run stages "
                         f"2 to 7 with that seed in another --data, or give --seed {made_with}")
    files = [file for name in ("wav.scp", *COPIED, ".done") if (file := source / name).is_file()]
    state = hashlib.sha256(b"\0".join([os.fsencode(os.path.realpath(source)), *(file.read_bytes() for file in files)]))
    if (copy / "source").is_file() and (copy / "source").read_text() == f"{state.hexdigest()}\n":
        _write_content(source, copy)
        return
    recordings = read_data_dir(source, pipes=True).recordings
    lines = []
    for recording, entry in recordings.items():
        try:
            lines.append(f"{recording} {entry_for_kaldi(entry)}\n")
        except ValueError as error:
            raise ValueError(f"{source}/wav.scp: recording {recording}: {error}") from None
    shutil.rmtree(copy.parent.parent / "done" / copy.name / "features", ignore_errors=True)
    shutil.rmtree(copy, ignore_errors=True)
    copy.mkdir(parents=True)
    for name in COPIED:
        if (source / name).is_file():
            write_bytes(copy / name, (source / name).read_bytes())
    write_text(copy / "wav.scp", "".join(lines))
    sync(copy)  # the files are on the disk before the one that says so
    _write_content(source, copy)
    write_text(copy / "source", f"{state.hexdigest()}\n")


def _write_content(source: Path, copy: Path) -> None:
    if not (copy / CONTENT_FILE).is_file() and read_stamp(source):
        write_text(copy / CONTENT_FILE, f"{digest(source)}\n")


def main(argv: list[str] | None = None) -> int:
    """Parse the command line and copy; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, help="seed that far-field speech must have been made with")
    parser.add_argument("source", type=Path, metavar="DATA_DIR")
    parser.add_argument("copy", type=Path, metavar="COPY")
    args = parser.parse_args(argv)
    try:
        copy_data(args.source, args.copy, args.seed)
    except (ValueError, OSError) as error:
        print(f"copy_data.py: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
