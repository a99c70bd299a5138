#!/usr/bin/env python3
"""Tell whether measured RIRs suffice for the closed loop, which leaves rooms out and scores halves of rooms.

Usage: enough_rooms.py RIR_DIR
e.g.:  python local/enough_rooms.py data/rirs.real.train

Exit status 0 if `roomeq close-loop` takes them; 1 and its one line if not.
"""

import sys
from pathlib import Path

from roomeq.loop.usable import require_enough_rooms


def main(argv: list[str]) -> int:
    """Check the directory; return the exit status."""
    if len(argv) != 1 or argv[0].startswith("-"):
        print(__doc__)
        return 0 if argv[:1] in (["--help"], ["-h"]) else 1
    try:
        require_enough_rooms([Path(argv[0])])
    except (ValueError, OSError) as error:
        print(f"no closed loop: {error}")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
