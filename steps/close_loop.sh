#!/usr/bin/env bash
# Find the effects that the simulation of measured RIRs lacks, and measure what they improve in held-out rooms.
# Usage: steps/close_loop.sh [options] <measured-rir-dir> <test-rir-dir> <loop-dir>
# e.g.:  steps/close_loop.sh --nj 4 data/rirs.real.train data/rirs.real.dev exp/loop
# Makes ledger.json, the record of all decisions, and model.json for `steps/simulate_rirs.sh --model`. The second
# directory is only scored. The step is one job of $nj processes.
set -euo pipefail
nj=2            # processes; results do not depend on it
max_effects=4   # largest number of effects to add
seed=0          # seed of all random numbers
. ./path.sh
. ./cmd.sh
. utils/ask.sh
. utils/parse_options.sh
. utils/check_words.sh
. utils/progress.sh
[ $# -eq 3 ] || usage
require "$1/rirs.jsonl" steps/split_rirs.sh
require "$2/rirs.jsonl" steps/split_rirs.sh
log=$(dirname "$3")/log/$(basename "$3")/close-loop.log
check_words "$log" "$@"
verb=(close-loop --nj "$nj" --max-effects "$max_effects" --seed "$seed" --test "$2" --out "$3" "$1")
status=0
up_to_date "${verb[@]}" || status=$?
[ "$status" -eq 3 ] || exit "$status"
run_jobs "$(dirname "$log")" --num-threads "$nj" "$log" roomeq "${verb[@]}"
# no line is there if an earlier call was killed when all was done
grep -E '^(base model|final model|test set|unexplained): |^(added|rejected|left out) |: the test set is not scored$' "$log" || true
