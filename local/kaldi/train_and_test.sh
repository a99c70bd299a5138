#!/usr/bin/env bash
# Train a recogniser on each kind of speech and test it on real far-field speech: stages 8 to 10 of run.sh.
# Usage: local/kaldi/train_and_test.sh [options] <data-dir> <exp-dir>
# e.g.:  KALDI_ROOT=~/kaldi local/kaldi/train_and_test.sh --rows "clean sim.EQ.rvb" data exp
# Makes <exp-dir>/kaldi, the workspace, <exp-dir>/wer and <exp-dir>/report.
set -euo pipefail
stage=8               # first stage to run
stop_stage=10         # last stage to run
nj=2                  # jobs
seed=0                # seed of the TDNN's training
dry_run=false         # print the commands
librispeech=          # directory of LibriSpeech: use its released language models, unless --lm-text is given
lm_text=              # text added to the transcripts of the clean speech to train language models
align_on=clean        # all systems use the alignments of the clean speech; self: of their own set
gmm_passes="mono 300, deltas all 300 3000, lda_mllt all 400 6000, sat all 400 6000"   # --passes of train_gmm.sh
num_leaves=400        # leaves of the TDNN's phonetic decision tree
kinds=real,sim,sim.EQ,sim.loop   # kinds of RIRs that the data were made with
rows=                 # training sets to compare, e.g. "clean sim.rvb"; default: clean speech, and all kinds
speed_perturb=false   # speed-perturb the training sets by 0.9, 1.0 and 1.1
online_cmvn=true      # subtract the mean of the TDNN's features so far
ivectors=false        # add i-vectors to the TDNN's features
use_gpu=false         # train the TDNN on GPUs
chain_opts="--config conf/chain_small.conf"                  # options of train_chain.sh
decode_opts="--beam 11 --max-active 2000 --lattice-beam 6"   # options of decode.sh
. ./path.sh
. utils/parse_options.sh
[ $# -eq 2 ] || usage
data=$1 exp=$2 workspace=$2/kaldi
common=(--nj "$nj" --dry-run "$dry_run")
read -ra chain_opts <<<"$chain_opts"
read -ra decode_opts <<<"$decode_opts"

IFS=, read -ra sets <<<"$kinds"
sets=(clean "${sets[@]/%/.rvb}") # each has a dev set of its own kind, as in the paper; the test set is common
copied=("$data/test.real.rvb")
for x in "${sets[@]}"; do copied+=("$data/train.$x" "$data/dev.$x"); done
for x in $rows; do
  [[ " ${sets[*]} " == *" $x "* ]] || die "--rows: '$x' must be one of: ${sets[*]}"
done
[ -z "$rows" ] || read -ra sets <<<"$rows"
aligned=(train.clean) # sets that a GMM is trained on
[ "$align_on" = clean ] || for x in "${sets[@]}"; do
  [ "$x" = clean ] || aligned+=("train.$x")
done
alignments_of() { if [ "$align_on" = self ]; then echo "train.$1"; else echo train.clean; fi; }
# Print options, with the state of files that they name; roomeq wer compares systems of the same settings only.
settings() { # NAME...
  local name word
  for name; do
    local -n value=$name
    for word in "${value[@]}"; do
      word=${word#--config=}
      if [ -f "$word" ]; then word="${word##*/} $(sha256sum <"$word" | cut -c1-16)"; fi
      echo "$name $word"
    done
  done
}

texts=("$data/train.clean/text" ${lm_text:+"$lm_text"})
[ -z "$librispeech" ] || [ -n "$lm_text" ] || texts=()
of_training=(align_on num_leaves speed_perturb online_cmvn ivectors chain_opts)
# Refuse a later stage with other options than the earlier ones had.
require_same() { # FILE STAGE NAME...
  [ "$dry_run" = false ] || return 0
  require "$1" "stage $2"
  [ "$(settings "${@:3}")" = "$(cat "$1")" ] || die "$1 is of other texts or options ($(
    diff <(settings "${@:3}") "$1" | sed -n 's/^[<>] \([^ ]*\).*/\1/p' | sort -u | paste -sd' ')): start with --stage $2"
}

if at_stage 8 "Kaldi: language, features, GMM"; then
  [ "$dry_run" = true ] || rm -f "$workspace/settings"
  log "language models are trained on: ${texts[*]:-nothing, those of LibriSpeech are used}"
  local/kaldi/make_workspace.sh "${common[@]}" --seed "$seed" "$workspace" "${copied[@]}"
  [ "$dry_run" = true ] || roomeq validate "${copied[@]}" # Kaldi would train on a damaged directory
  [ "$dry_run" = true ] || echo "$seed" >"$workspace/seed" # of which roomeq wer counts the errors
  local/kaldi/make_lang.sh "${common[@]}" "$workspace" "${texts[@]}"
  for x in "${aligned[@]}"; do
    local/kaldi/make_features.sh "${common[@]}" "$workspace" "$x"
    lang=data/lang
    [ "$x" != train.clean ] || lang=data/lang_nosp
    local/kaldi/train_gmm.sh "${common[@]}" --passes "$gmm_passes" "$workspace" "$x" "$lang"
    [ "$x" != train.clean ] || local/kaldi/finish_lang.sh "${common[@]}" "$workspace" "$x"
  done
  [ "$dry_run" = true ] || settings texts gmm_passes >"$workspace/settings"
fi

if at_stage 9 "Kaldi: TDNN with LF-MMI"; then
  require_same "$workspace/settings" 8 texts gmm_passes
  if [ "$dry_run" = false ]; then
    [ "$(cat "$workspace/seed")" = "$seed" ] || die "--seed $seed: $workspace is of seed $(cat "$workspace/seed"): run" \
      "stages 6 to 8 with this seed first, or train with that one"
  fi
  for x in "${aligned[@]}"; do
    [ "$speed_perturb" = false ] ||
      local/kaldi/make_features.sh "${common[@]}" --speed-perturb true "$workspace" "$x"
    local/kaldi/align_chain.sh "${common[@]}" --num-leaves "$num_leaves" --speed-perturb "$speed_perturb" \
      "$workspace" "$x"
  done
  hires=(local/kaldi/make_features.sh "${common[@]}" --hires true --by-utterance "$online_cmvn")
  for x in test.real.rvb "${sets[@]/#/dev.}"; do
    "${hires[@]}" "$workspace" "$x"
  done
  for x in "${sets[@]}"; do
    "${hires[@]}" --train true --speed-perturb "$speed_perturb" "$workspace" "train.$x"
    [ "$ivectors" = false ] ||
      local/kaldi/train_ivectors.sh "${common[@]}" --online-cmvn "$online_cmvn" "$workspace" "train.$x" "dev.$x" \
        test.real.rvb
    local/kaldi/train_chain.sh "${common[@]}" --use-gpu "$use_gpu" --ivectors "$ivectors" \
      --online-cmvn "$online_cmvn" --seed "$seed" "${chain_opts[@]}" "$workspace" "train.$x" "$(alignments_of "$x")"
    [ "$dry_run" = true ] || cp "$workspace/seed" "$workspace/train.$x/seed"
    [ "$dry_run" = true ] || settings texts gmm_passes "${of_training[@]}" >"$workspace/train.$x/trained_with"
  done
fi

if at_stage 10 "Kaldi: decode; word error rates"; then
  require_same "$workspace/settings" 8 texts gmm_passes
  decode=(local/kaldi/decode.sh "${common[@]}" --ivectors "$ivectors" "${decode_opts[@]}")
  for x in "${sets[@]}"; do
    require_same "$workspace/train.$x/trained_with" 9 texts gmm_passes "${of_training[@]}"
    "${decode[@]}" "$workspace" "train.$x" "$(alignments_of "$x")" "dev.$x"
    "${decode[@]}" --tuned-on "dev.$x" "$workspace" "train.$x" "$(alignments_of "$x")" test.real.rvb
    [ "$dry_run" = true ] || { cat "$workspace/train.$x/trained_with" &&
      settings decode_opts; } >"$workspace/train.$x/settings"
  done
  if [ "$dry_run" = false ]; then
    rirs=() # all that a set was made with
    for x in "$data"/rirs.real "$data"/rirs.real.{dev,test} "$data"/rirs.{sim,sim.EQ,sim.loop,sim.free}.dev; do
      [ ! -d "$x" ] || rirs+=(--rirs "$x")
    done
    roomeq wer "${rirs[@]}" --train-rirs "$data/rirs.real.train" "$workspace" "$exp/wer"
    steps/make_report.sh --kinds "$kinds" "$data" "$exp" "$exp/report"
  fi
fi
