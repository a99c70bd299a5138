#!/usr/bin/env bash
# Fit a Gaussian mixture to the sub-band EQs of measured RIRs, and measure those of simulated RIRs for comparison.
# Usage: steps/fit_eq.sh [options] <measured-rir-dir> <simulated-rir-dir> <eq-dir>
# e.g.:  steps/fit_eq.sh data/rirs.real.train data/rirs.sim.train exp/eq
set -euo pipefail
nj=2                 # jobs
num_components=7     # of the mixture
weight_rooms=false   # give every room the same weight
seed=0               # seed of all random numbers
. ./path.sh
. utils/parse_options.sh
[ $# -eq 3 ] || usage
require "$1/rirs.jsonl" steps/split_rirs.sh
require "$2/rirs.jsonl" steps/simulate_rirs.sh
flags=()
[ "$weight_rooms" = false ] || flags=(--weight-rooms)
utils/run_parts.sh "$nj" "$(dirname "$3")/log/$(basename "$3")" fit-eq --num-components "$num_components" \
  "${flags[@]}" --seed "$seed" "$1" "$2" "$3"
