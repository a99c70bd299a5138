#!/usr/bin/env bash
# Give every simulated RIR a sub-band EQ drawn from the measured distribution.
# Usage: steps/compensate_rirs.sh [options] <simulated-rir-dir> <eq-dir> <rir-dir>
# e.g.:  steps/compensate_rirs.sh --nj 4 data/rirs.sim.train exp/eq data/rirs.sim.EQ.train
set -euo pipefail
nj=2               # jobs
taps=511           # of the filters
match_rooms=true   # choose the mixture's components as the measured RIRs of the same room do
seed=0             # of every random draw
. ./path.sh
. utils/parse_options.sh
[ $# -eq 3 ] || usage
require "$1/rirs.jsonl" steps/simulate_rirs.sh
require "$2/gmm.json" steps/fit_eq.sh
flag=--match-rooms
[ "$match_rooms" = true ] || flag=--no-match-rooms
utils/run_parts.sh "$nj" "$(dirname "$3")/log/$(basename "$3")" compensate --taps "$taps" "$flag" --seed "$seed" \
  "$1" "$2" "$3"
