"""Make one set of rooms: python -m testbed source_response --strength 2 --seed 1 --out exp/rooms."""

import argparse
import json
from pathlib import Path

from testbed import BASES, KINDS, make_room_set


def main():
    parser = argparse.ArgumentParser(prog="testbed", description=__doc__)
    parser.add_argument("kind", help=f"clean, {', '.join(KINDS)}, or some of them joined by +")
    parser.add_argument("--strength", type=float, default=2.0, help="mean change of the cells touched [JND]")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--base", default=BASES[0], help=f"simulator of all but the effect: {' or '.join(BASES)}")
    parser.add_argument("--out", type=Path, required=True, help="folder for fit/, test/ and truth.json")
    parser.add_argument("--cache", type=Path, help="folder that keeps traced rooms for other sets of the seed")
    args = parser.parse_args()
    try:
        truth = make_room_set(args.kind, args.strength, args.seed, args.out, cache=args.cache, base=args.base)
    except ValueError as error:
        raise SystemExit(f"testbed: {error}") from None
    print(json.dumps(dict(kind=args.kind, base=args.base, achieved_jnd=truth["achieved_jnd"])))


if __name__ == "__main__":
    main()
