#!/usr/bin/env python3
"""Tell whether measured RIRs suffice for the closed loop, which leaves rooms out and scores halves of rooms.

Usage: enough_rooms.py RIR_DIR OUT_DIR NJ
e.g.:  python local/enough_rooms.py data/rirs.real.train exp/rooms 2

All recordings are read for it. OUT_DIR/usable.json says what was found; it is made again when RIRs, meshes or code
change. There is a file OUT_DIR/enough if `roomeq close-loop` takes the RIRs; if not, its one line is printed.
"""

import sys
from pathlib import Path

from roomeq.core.build import Build
from roomeq.core.files import read_json, write_json, write_text
from roomeq.records.rir_dir import mesh_files

USABLE_FILE, ENOUGH_FILE = "usable.json", "enough"


def why_not(rir_dir: Path, out: Path, nj: int) -> str | None:
    """Return why the RIRs of a directory are too few, or None; the answer is kept in `out`. `nj` processes find it.

    Raises
    ------
    ValueError
        An RIR directory is invalid, or `out` was not made by this function.
    """
    build = Build(out, step="enough-rooms", options={}, inputs=[
        rir_dir, *(mesh for mesh in mesh_files(rir_dir) if mesh.exists()), Path(__file__)])

    def assemble(directory: Path, _: list[None]) -> None:
        from roomeq.loop.usable import too_few_rooms, usable_rirs  # takes longer than all the rest

        usable = usable_rirs([rir_dir], nj)
        problem = too_few_rooms(usable)
        write_json(directory / USABLE_FILE, dict(rirs=len(usable.rirs), scored_rooms=usable.n_scored,
                                                 left_out=[entry._asdict() for entry in usable.left_out],
                                                 problem=problem))
        if problem is None:
            write_text(directory / ENOUGH_FILE, "")

    if not build.done and build.run({}, lambda *_: None):
        build.finish(assemble)
    return read_json(out / USABLE_FILE)["problem"]


def main(argv: list[str]) -> int:
    """Check the directory; return the exit status."""
    if len(argv) != 3 or argv[0].startswith("-") or not argv[2].isdigit():
        print(__doc__)
        return 0 if argv[:1] in (["--help"], ["-h"]) else 1
    rir_dir, out = map(Path, argv[:2])
    try:
        problem = why_not(rir_dir, out, int(argv[2]))
    except (ValueError, OSError) as error:
        print(f"enough_rooms.py: {error}", file=sys.stderr)
        return 1
    if problem:
        print(f"no closed loop: {rir_dir}: {problem}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
