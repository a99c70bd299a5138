#!/usr/bin/env bash
# Try all attacks on the recipe, and print the table of kinds and steps: how many were handled, of how many tried.
# Handled: the same bytes as undisturbed, or exit status 1 and one line that names the cause.
# Usage: tests/nightly/faults/attacks.sh [--examples 1000] [--only damage,power,tests,recipe] --out DIR
# e.g.:  tests/nightly/faults/attacks.sh --out exp/attacks && tests/bench/publish.py faults exp/attacks/attacks.json
# Sections: damage (generated, between two steps), power (losses at any place of a step), tests (those of the gate that
# attack something), recipe (run.sh killed, run twice at once, without disk: see run.sh here; an hour). Finished sections
# are kept.
set -euo pipefail
cd "$(dirname "$0")/../../.."
. ./path.sh
[ $# -gt 0 ] || set -- --help
PYTHONPATH="tests:tests/data:local:$PYTHONPATH" exec python tests/nightly/faults/attacks.py "$@"
