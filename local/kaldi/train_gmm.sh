#!/usr/bin/env bash
# Train a GMM system on one set in passes, as Kaldi's LibriSpeech recipe does.
# Each pass after the first uses alignments made with the model of the previous pass.
# Usage: local/kaldi/train_gmm.sh [options] <workspace> <set> <lang>
# e.g.:  local/kaldi/train_gmm.sh --passes "mono 500, deltas all 500 5000" exp/kaldi train.clean data/lang_nosp
# <workspace>/<set>/gmm/final is a link to the model of the last pass.
set -euo pipefail
nj=2   # jobs
# of each pass: kind (mono, deltas, lda_mllt, sat), number of utterances or all, and unless mono leaves, Gaussians
passes="mono 2000, deltas 5000 2000 10000, lda_mllt 10000 2500 15000, sat 10000 2500 15000, sat all 5000 100000"
dry_run=false   # print the commands
. ./path.sh
. utils/parse_options.sh
. local/kaldi/common.sh
[ $# -eq 3 ] || usage
workspace=$1 set=$2 lang=$3
boost=(--boost-silence 1.25)

after "$set/features/$set.fix" "lang/$([ "$lang" = data/lang ] && echo const_arpa_fglarge || echo nosp)"
IFS=, read -ra pass_list <<<"$passes"
number=0 previous=''
for pass in "${pass_list[@]}"; do
  read -r kind utterances leaves gaussians <<<"$pass"
  number=$((number + 1))
  dir=$set/gmm/$number.$kind data=data/$set
  if [ "$utterances" != all ] &&
    { [ "$dry_run" = true ] || [ "$utterances" -lt "$(wc -l <"$workspace/$data/text")" ]; }; then
    shortest=() && [ "$kind" != mono ] || shortest=(--shortest)
    once "$set/gmm/$number.subset" utils/subset_data_dir.sh "${shortest[@]}" "$data" "$utterances" "$data.$utterances"
    data=$data.$utterances
  fi
  if [ -n "$previous" ]; then
    align=$([[ $previous == *.sat ]] && echo align_fmllr || echo align_si)
    once "$set/gmm/$number.align" "steps/$align.sh" --nj "$(jobs_for "$data")" --cmd "$runner" "$data" "$lang" \
      "$previous" "$dir.ali"
  fi
  case $kind in
    mono)
      once "$set/gmm/$number.mono" steps/train_mono.sh "${boost[@]}" --nj "$(jobs_for "$data")" --cmd "$runner" "$data" \
        "$lang" "$dir"
      ;;
    deltas) train=(steps/train_deltas.sh "${boost[@]}") ;;
    lda_mllt) train=(steps/train_lda_mllt.sh --splice-opts "--left-context=3 --right-context=3") ;;
    sat) train=(steps/train_sat.sh) ;;
    *) die "--passes: '$kind' must be mono, deltas, lda_mllt or sat" ;;
  esac
  [ "$kind" = mono ] ||
    once "$set/gmm/$number.$kind" "${train[@]}" --cmd "$runner" "$leaves" "$gaussians" "$data" "$lang" "$dir.ali" "$dir"
  previous=$dir
done
once "$set/gmm/final" ln -sfn "${previous##*/}" "$set/gmm/final"
