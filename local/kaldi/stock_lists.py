#!/usr/bin/env python3
"""Write the input of Kaldi's reverberate_data_dir.py, with absolute paths: rir_list and noise_list.

Usage: stock_lists.py RIR_DIR NOISE_DIR OUT_DIR
e.g.:  python local/kaldi/stock_lists.py data/rirs.sim.train data/rirs.real.train exp/kaldi/stock

Ambient noises become isotropic noise of their room, point noises become foreground noise of any room.
"""

import argparse
import shlex
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from roomeq.core.files import write_text
from roomeq.records.rir_dir import read_noises, read_rirs, relocated, write_rirs


def noise_line(directory: Path, row: Mapping[str, Any]) -> str:
    """Return the line of one noise in noise_list."""
    kind = (f"isotropic --bg-fg-type background --room-linkage {row['room_id']}" if row["kind"] == "ambient" else
            "point-source --bg-fg-type foreground")
    pipe = f"sox -D {shlex.quote(str(directory / row['wav']))} -r 16000 -c 1 -b 16 -e signed-integer -t wav - |"
    return f"--noise-id {row['id']} --noise-type {kind} {shlex.quote(pipe)}\n"


def main(argv: list[str] | None = None) -> int:
    """Parse the command line and write the lists; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("rir_dir", "noise_dir", "out_dir"):
        parser.add_argument(name, type=Path, metavar=name.upper())
    args = parser.parse_args(argv)
    try:
        rirs, noises, out = args.rir_dir.absolute(), args.noise_dir.absolute(), args.out_dir.absolute()
        out.mkdir(parents=True, exist_ok=True)
        rows = read_rirs(rirs)
        write_rirs(out, relocated(rows, rirs, out))
        rooms = {row["room_id"] for row in rows}
        write_text(out / "noise_list", "".join(noise_line(noises, row) for row in read_noises(noises)
                                               if row["kind"] != "ambient" or row["room_id"] in rooms))
    except (ValueError, OSError) as error:
        print(f"stock_lists.py: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
