#!/usr/bin/env bash
# Give every simulated RIR a sub-band EQ drawn from the measured distribution.
# Usage: steps/compensate_rirs.sh [options] <simulated-rir-dir> <eq-dir> <rir-dir>
# e.g.:  steps/compensate_rirs.sh --nj 4 data/rirs.sim.train exp/eq data/rirs.sim.EQ.train
set -euo pipefail
nj=2       # jobs
taps=511   # of the filters
seed=0   # of every random draw
. ./path.sh
. utils/parse_options.sh
[ $# -eq 3 ] || usage
require "$1/rirs.jsonl" steps/simulate_rirs.sh
require "$2/gmm.json" steps/fit_eq.sh
utils/run_parts.sh "$nj" "$(dirname "$3")/log/$(basename "$3")" compensate --taps "$taps" --seed "$seed" \
  "$1" "$2" "$3"
