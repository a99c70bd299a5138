#!/usr/bin/env python3
"""Stop where roomeq fit-eq cannot fit its mixture to measured RIRs: they are fewer than its components, or lack a band.

Usage: enough_rirs.py RIR_DIR NUM_COMPONENTS
e.g.:  python local/enough_rirs.py data/rirs.real.train 7

The fit says the same, but only after all RIRs were simulated.
"""

import sys
from pathlib import Path


def main(argv: list[str]) -> int:
    """Check the directory; return the exit status."""
    if len(argv) != 2 or argv[0].startswith("-") or not argv[1].isdecimal():
        print(__doc__)
        return 0 if argv[:1] in (["--help"], ["-h"]) else 1
    from roomeq.eq.fit import require_enough_rirs

    try:
        require_enough_rirs(Path(argv[0]), int(argv[1]))
    except (ValueError, OSError) as error:
        print(f"enough_rirs.py: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
