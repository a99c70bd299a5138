#!/usr/bin/env bash
# Make far-field speech with Kaldi's own reverberate_data_dir.py, from our RIRs and noises, for comparison.
# Usage: local/kaldi/reverberate.sh [options] <workspace> <rir-dir> <noise-dir> <clean-set> <set>
# e.g.:  local/kaldi/reverberate.sh exp/kaldi data/rirs.sim.train data/rirs.real.train train.clean train.sim.stock.rvb
# Some versions of Kaldi's script import a module that Python 3.12 has removed, and end with ImportError.
set -euo pipefail
nj=2                    # jobs
snrs=25:20:15:10:5      # SNRs that the noises take in turn [dB]
seed=0                  # seed of all random numbers
dry_run=false           # print the commands
. ./path.sh
. utils/parse_options.sh
. local/kaldi/common.sh
[ $# -eq 5 ] || usage
workspace=$1 lists=stock/$5
inputs "$2/rirs.jsonl" "$workspace/data/$4/source"
rirs=$(realpath -m "$2") noises=$(realpath -m "$3")
once "$5/lists" python "$PWD/local/kaldi/stock_lists.py" "$rirs" "$noises" "$lists"
once "$5/reverberate" python steps/data/reverberate_data_dir.py --rir-set-parameters "1.0, $lists/rir_list" \
  --noise-set-parameters "1.0, $lists/noise_list" --background-snrs "$snrs" --foreground-snrs "$snrs" \
  --random-seed "$seed" --source-sampling-rate 16000 "data/$4" "data/$5"
once "$5/source" cp "data/$4/source" "data/$5/source"
