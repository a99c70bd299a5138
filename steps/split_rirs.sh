#!/usr/bin/env bash
# Split RIRs into disjoint training, development and test sets: <rir-dir>.train, .dev and .test.
# Usage: steps/split_rirs.sh [--split-by rir|room] [--same-rooms 'house_*,lab_*'] [--sizes 773,194,242] <rir-dir>
# e.g.:  steps/split_rirs.sh --split-by room data/rirs.real
set -euo pipefail
split_by=rir          # or room: no room is in two sets
same_rooms=           # patterns: rooms that one of them matches count as one; only by room
sizes=773,194,242     # proportions, where there are fewer RIRs
seed=0   # of every random draw
. ./path.sh
. utils/parse_options.sh
[ $# -eq 1 ] || usage
require "$1/rirs.jsonl" steps/characterise_rirs.sh
roomeq split-rirs --split-by "$split_by" --same-rooms "$same_rooms" --sizes "$sizes" --seed "$seed" "$1" "$1"
