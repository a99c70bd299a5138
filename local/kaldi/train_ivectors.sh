#!/usr/bin/env bash
# Train an i-vector extractor on one set, and extract the i-vectors of that set and of test sets.
# Usage: local/kaldi/train_ivectors.sh [options] <workspace> <set> <test-set>...
# e.g.:  local/kaldi/train_ivectors.sh --nj 30 exp/kaldi train.sim.rvb dev.real.rvb test.real.rvb
set -euo pipefail
nj=2                  # jobs
online_cmvn=false     # subtract the mean of the features so far, as in train_chain.sh
min_utterances=2000   # for UBM and extractor, at least; of large sets a hundredth and a fifth
dry_run=false         # print the commands
. ./path.sh
. utils/parse_options.sh
. local/kaldi/common.sh
[ $# -ge 3 ] || usage
workspace=$1 set=$2
shift 2
data=data/$set.hires dir=$set/ivectors

after "$set/features/$set.hires.fix"
inputs "$workspace/conf/online_cmvn.conf" <(echo "$key") # which the UBM takes over
if [ "$dry_run" = true ]; then n=132553; else n=$(wc -l <"$workspace/$data/text"); fi # that of LibriSpeech-460
part() { echo $((n < min_utterances ? n : n / $1 < min_utterances ? min_utterances : n / $1)); }
once "$set/ivectors/ubm_data" utils/subset_data_dir.sh "$data" "$(part 100)" "$data.ubm"
once "$set/ivectors/data" utils/subset_data_dir.sh "$data" "$(part 5)" "$data.ivectors"
once "$set/ivectors/pca" steps/online/nnet2/get_pca_transform.sh --cmd "$runner" \
  --splice-opts "--left-context=3 --right-context=3" --max-utts 10000 --subsample 2 "$data.ubm" "$dir/pca"
once "$set/ivectors/ubm" steps/online/nnet2/train_diag_ubm.sh --cmd "$runner" --nj "$(jobs_for "$data.ubm")" --num-frames 700000 \
  --num-threads 2 "$data.ubm" 512 "$dir/pca" "$dir/ubm"
once "$set/ivectors/extractor" steps/online/nnet2/train_ivector_extractor.sh --cmd "$runner" --nj "$(jobs_for "$data.ivectors")" \
  --num-threads 1 --num-processes 1 --online-cmvn-iextractor "$online_cmvn" "$data.ivectors" "$dir/ubm" "$dir/extractor"
once "$set/ivectors/max2" utils/data/modify_speaker_info.sh --utts-per-spk-max 2 "$data" "$data.max2"
once "$set/ivectors/train" steps/online/nnet2/extract_ivectors_online.sh --cmd "$runner" --nj "$(jobs_for "$data.max2")" \
  "$data.max2" "$dir/extractor" "$dir/$set"
for test; do
  after "$set/ivectors/extractor" "$test/features/$test.hires.fix"
  once "$set/ivectors/$test" steps/online/nnet2/extract_ivectors_online.sh --cmd "$runner" \
    --nj "$(jobs_for "data/$test.hires")" \
    "data/$test.hires" "$dir/extractor" "$dir/$test"
done
