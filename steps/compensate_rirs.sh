#!/usr/bin/env bash
# Filter every simulated RIR so that its sub-band EQ is one drawn from the fitted mixture.
# Usage: steps/compensate_rirs.sh [options] <simulated-rir-dir> <eq-dir> <rir-dir>
# e.g.:  steps/compensate_rirs.sh --nj 4 data/rirs.sim.train exp/eq data/rirs.sim.EQ.train
set -euo pipefail
nj=2               # jobs
taps=511           # length of the filters, odd
match_rooms=true   # draw each EQ with the component weights of the measured RIRs of its room
seed=0             # seed of all random numbers
. ./path.sh
. utils/parse_options.sh
[ $# -eq 3 ] || usage
require "$1/rirs.jsonl" steps/simulate_rirs.sh
require "$2/gmm.json" steps/fit_eq.sh
flag=--match-rooms
[ "$match_rooms" = true ] || flag=--no-match-rooms
utils/run_parts.sh "$nj" "$(dirname "$3")/log/$(basename "$3")" compensate --taps "$taps" "$flag" --seed "$seed" \
  "$1" "$2" "$3"
