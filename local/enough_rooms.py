#!/usr/bin/env python3
"""Tell whether measured RIRs suffice for the closed loop, which leaves rooms out and scores halves of rooms.

Usage: enough_rooms.py RIR_DIR
e.g.:  python local/enough_rooms.py data/rirs.real.train

Exit status 0 if there are enough rooms with geometry; 1 and one line if not.
"""

import sys
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from roomeq.loop.selection import MIN_ROOMS
from roomeq.records.geometry import geometry_usability
from roomeq.records.rir_dir import read_rirs
from roomeq.records.schema import RirRow


def rooms_with_geometry(rows: Iterable[RirRow]) -> set[str]:
    """Return the rooms with at least two RIRs whose geometry is known."""
    count = Counter(row["room_id"] for row in rows
                    if not row.get("noise_for") and geometry_usability(row, needs="loop").usable)
    return {room for room, n in count.items() if n > 1}


def main(argv: list[str]) -> int:
    """Check the directory; return the exit status."""
    if len(argv) != 1 or argv[0].startswith("-"):
        print(__doc__)
        return 0 if argv[:1] in (["--help"], ["-h"]) else 1
    try:
        rooms = rooms_with_geometry(read_rirs(Path(argv[0])))
    except (ValueError, OSError) as error:
        print(f"enough_rooms.py: {error}", file=sys.stderr)
        return 1
    if len(rooms) < MIN_ROOMS:
        print(f"{argv[0]}: {len(rooms)} rooms with geometry and two RIRs; the closed loop needs {MIN_ROOMS}: "
              "skipped")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
