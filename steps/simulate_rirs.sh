#!/usr/bin/env bash
# Simulate one RIR per measured RIR, with the same room, source and microphone, and with random materials.
# Usage: steps/simulate_rirs.sh [options] <measured-rir-dir> <rir-dir>
# e.g.:  steps/simulate_rirs.sh --nj 4 data/rirs.real.train data/rirs.sim.train
set -euo pipefail
nj=2               # jobs
t60_range=0.2,2.0  # range of T60 [s]; measured: the range of the measured rooms
num_rays=20000     # rays per source
order=200          # least number of reflections per ray
model=             # effects to add, from steps/close_loop.sh: exp/loop/model.json
seed=0             # seed of all random numbers
. ./path.sh
. utils/parse_options.sh
[ $# -eq 2 ] || usage
require "$1/rirs.jsonl" steps/split_rirs.sh
more=()
[ -z "$model" ] || { require "$model" steps/close_loop.sh && more=(--model "$model"); }
utils/run_parts.sh "$nj" "$(dirname "$2")/log/$(basename "$2")" simulate --t60-range "$t60_range" \
  --num-rays "$num_rays" --order "$order" "${more[@]}" --seed "$seed" "$1" "$2"
