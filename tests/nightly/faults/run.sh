#!/usr/bin/env bash
# Break the recipe on purpose: kill it at random moments, run it twice at once, fill the disk, forbid writing.
# After each, the run is started again, and must end with the bytes of an undisturbed run, or refuse in one line.
# Usage: tests/nightly/faults/run.sh [--kills 30] [--pairs 6] [--disks 6] [--seed 0] [--nj 2] --out DIR
# e.g.:  tests/nightly/faults/run.sh --out /tmp/faults
# DIR/table.md is the result. A bench that was stopped goes on where it was. Full and read-only disks need root.
set -euo pipefail
cd "$(dirname "$0")/../../.."
. ./path.sh
[ $# -gt 0 ] || set -- --help
PYTHONPATH="tests:tests/data:$PYTHONPATH" exec python tests/nightly/faults/runs.py "$@"
