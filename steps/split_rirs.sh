#!/usr/bin/env bash
# Split RIRs into disjoint training, development and test sets: <rir-dir>.train, .dev and .test.
# Usage: steps/split_rirs.sh [--split-by rir|room] [--same-rooms 'house_*,lab_*'] [--sizes 773,194,242]
#        [--dev-rirs DIR] [--test-rirs DIR] <rir-dir>
# e.g.:  steps/split_rirs.sh --split-by room data/rirs.real
set -euo pipefail
split_by=rir          # rir or room; room: no room is in two sets
same_rooms=           # patterns: rooms that match one pattern count as one room; only with --split-by room
sizes=773,194,242     # RIRs per set; proportions where there are fewer
dev_rirs=             # RIR directory to develop on, instead of a part of <rir-dir>
test_rirs=            # RIR directory to test on, instead of a part of <rir-dir>
seed=0                # seed of all random numbers
. ./path.sh
. utils/ask.sh
. utils/parse_options.sh
[ $# -eq 1 ] || usage
require "$1/rirs.jsonl" steps/characterise_rirs.sh
run_verb split-rirs --split-by "$split_by" --same-rooms "$same_rooms" --sizes "$sizes" --seed "$seed" \
  ${dev_rirs:+--dev-rirs "$dev_rirs"} ${test_rirs:+--test-rirs "$test_rirs"} "$1" "$1"
