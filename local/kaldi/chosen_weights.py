#!/usr/bin/env python3
"""Print the word insertion penalty and LM weight with the fewest errors on a development set.

Usage: chosen_weights.py DECODE_DIR
e.g.:  python local/kaldi/chosen_weights.py exp/kaldi/train.sim.rvb/decode_dev.sim.rvb_tgsmall
"""

import sys
from pathlib import Path

from roomeq.wer.scoring import choose_weights


def main(argv: list[str]) -> int:
    """Print the weights; return the exit status."""
    if len(argv) != 1 or argv[0].startswith("-"):
        print(__doc__)
        return 0 if argv[:1] in (["--help"], ["-h"]) else 1
    try:
        chosen = choose_weights(Path(argv[0]))
    except (ValueError, OSError) as error:
        print(f"chosen_weights.py: {error}", file=sys.stderr)
        return 1
    print(chosen.penalty, chosen.lmwt)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
