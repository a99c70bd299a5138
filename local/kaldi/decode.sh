#!/usr/bin/env bash
# Decode one set with one system, with four language models and online, and score it.
# Usage: local/kaldi/decode.sh [options] <workspace> <set> <set-of-alignments> <test-set>
# e.g.:  local/kaldi/decode.sh --tuned-on dev.sim.rvb exp/kaldi train.sim.rvb train.clean test.real.rvb
# Results are <workspace>/<set>/decode_<test-set>_{tgsmall,tgmed,tglarge,fglarge,online}/scoring_kaldi.
set -euo pipefail
nj=2            # jobs
ivectors=true   # add i-vectors to the features
beam=15         # beam of the search
max_active=7000   # largest number of active states
lattice_beam=8    # beam of the lattices that the larger models rescore
tuned_on=       # development set whose best weights are used; none: try all weights
dry_run=false   # print the commands
. ./path.sh
. utils/parse_options.sh
. local/kaldi/common.sh
[ $# -eq 4 ] || usage
[ "$max_active" -ge 200 ] || die "--max-active $max_active must be at least 200, the minimum of Kaldi"
workspace=$1 set=$2 ali=$3 test=$4
graph=$ali/align/tree/graph out=$set/decode_$test data=data/$test.hires small=data/lang_test_tgsmall
search=(--acwt 1.0 --post-decode-acwt 10.0 --beam "$beam" --max-active "$max_active" --lattice-beam "$lattice_beam")
ivectors_made=() with_ivectors=() extractor=()
if [ "$ivectors" = true ]; then
  ivectors_made=("$set/ivectors/$test")
  with_ivectors=(--online-ivector-dir "$set/ivectors/$test")
  extractor=("$set/ivectors/extractor")
fi

# Score with all language model weights and insertion penalties, or with those that were best on `tuned_on`; then
# bootstrap the best result.
score() { # COLUMN
  local penalty=0.0,0.5,1.0 lowest=1 highest=17
  if [ -n "$tuned_on" ] && [ "$dry_run" = false ]; then
    read -r penalty lowest < <(local/kaldi/chosen_weights.py "$workspace/$set/decode_${tuned_on}_$1")
    highest=$lowest
  fi
  once "$out/$1.score" steps/scoring/score_kaldi_wer.sh --cmd "$runner" --word-ins-penalty "$penalty" \
    --min-lmwt "$lowest" --max-lmwt "$highest" "$data" "$graph" "${out}_$1"
  # shellcheck disable=SC2016 # the inner bash expands the variables
  once "$out/$1.bootci" bash -c 'cd "$1/scoring_kaldi" && compute-wer-bootci --mode=present ark:test_filt.txt \
    "ark:penalty_$(cat wer_details/wip)/$(cat wer_details/lmwt).txt" >../bootci' bootci "${out}_$1"
}

after "$set/nnet/train" "$ali/align/graph" "$test/features/$test.hires.fix" "${ivectors_made[@]}"
jobs=$(jobs_for "$data")
outputs="${out}_tgsmall/lat.*.gz" once "$out/tgsmall" steps/nnet3/decode.sh "${search[@]}" \
  --skip-scoring true --nj "$jobs" --cmd "$runner" "${with_ivectors[@]}" "$graph" "$data" "${out}_tgsmall"
score tgsmall
outputs="${out}_tgmed/lat.*.gz" once "$out/tgmed" steps/lmrescore.sh --skip-scoring true --cmd "$runner" \
  --self-loop-scale 1.0 $small data/lang_test_tgmed "$data" "${out}"_{tgsmall,tgmed}
score tgmed
for model in tglarge fglarge; do
  outputs="${out}_$model/lat.*.gz" once "$out/$model" steps/lmrescore_const_arpa.sh --skip-scoring true \
    --cmd "$runner" $small data/lang_test_$model "$data" "${out}_tgsmall" "${out}_$model"
  score $model
done
inputs "$workspace"/conf/{mfcc_hires,online_cmvn}.conf <(echo "$key")
once "$out/online_config" steps/online/nnet3/prepare_online_decoding.sh --mfcc-config conf/mfcc_hires.conf \
  "$ali/align/lang" "${extractor[@]}" "$set" "$set/online"
outputs="$set/online/decode_$test/lat.*.gz" once "$out/online" steps/online/nnet3/decode.sh \
  "${search[@]}" --skip-scoring true --nj "$jobs" --cmd "$runner" "$graph" "$data" "$set/online/decode_$test"
once "$out/link" ln -sfn "online/decode_$test" "${out}_online"
score online
for column in tgsmall tgmed tglarge fglarge online; do # what roomeq wer compares with the set's present state
  once "$out/$column.source" cp "data/$test/source" "${out}_$column/source"
done
