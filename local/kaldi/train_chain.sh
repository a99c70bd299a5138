#!/usr/bin/env bash
# Train a TDNN-F with LF-MMI on one set.
# Usage: local/kaldi/train_chain.sh [options] <workspace> <set> <set-of-alignments>
# e.g.:  local/kaldi/train_chain.sh --use-gpu false --layers 7 --dim 192 exp/kaldi train.sim.rvb train.clean
# The model is <workspace>/<set>/final.mdl. A run that was stopped continues at the last finished iteration.
set -euo pipefail
nj=2                      # jobs that make the examples
use_gpu=true              # train on GPUs; false: on processors
ivectors=true             # add i-vectors to the features
online_cmvn=false         # subtract the mean of the features so far, as mini_librispeech's run_tdnn_1k.sh does
spec_augment=false        # mask bands and spans of time in training (SpecAugment), as run_tdnn_1k.sh does
dropout=0.5               # proportion in the middle of the training; it is 0 at the start and the end
layers=16                 # TDNN-F layers
dim=1536                  # of a layer
bottleneck=160            # of a layer
epochs=4                  # over the data
jobs_initial=3            # networks trained in parallel, at the start
jobs_final=16             # and at the end
lrate_initial=0.00015     # initial learning rate
lrate_final=0.000015      # final learning rate
chunk_width=150,110,100   # frames of an example
minibatch=64,32           # examples per minibatch; smaller sizes for the remainder
frames_per_iter=2500000   # frames per job and iteration
seed=0                    # of the initial weights and of the order of examples
dry_run=false             # print the commands
. ./path.sh
. utils/parse_options.sh
. local/kaldi/common.sh
[ $# -eq 3 ] || usage
workspace=$1 set=$2 ali=$3 ivectors_made=()
[ "$ivectors" = false ] || ivectors_made=("$set/ivectors/train")

# Print the network: LibriSpeech's TDNN-F (splicing -1..1, strides 1, 1, 1, 0, then 3) of the chosen size.
xconfig() { # TARGETS
  local layer stride affine="l2-regularize=0.008 dropout-proportion=0.0 dropout-per-dim=true"
  local prefinal="input=prefinal-l l2-regularize=0.008 big-dim=$dim small-dim=$((dim / 6))"
  [ "$ivectors" = false ] || echo "input dim=100 name=ivector"
  echo "input dim=40 name=input"
  if [ "$spec_augment" = true ]; then # of logarithmic filterbank energies; the statistics of the LDA need them as well
    echo "idct-layer name=idct dim=40 cepstral-lifter=22 affine-transform-file=$set/configs/idct.mat include-in-init=true"
    echo "batchnorm-component name=energies include-in-init=true"
    echo "spec-augment-layer name=masked freq-max-proportion=0.5 time-zeroed-proportion=0.2 time-mask-max-frames=20" \
      "include-in-init=true"
  fi
  echo "fixed-affine-layer name=lda affine-transform-file=$set/configs/lda.mat" \
    "input=Append(-1,0,1$([ "$ivectors" = false ] || echo ",ReplaceIndex(ivector, t, 0)"))"
  echo "relu-batchnorm-dropout-layer name=tdnn1 $affine dropout-per-dim-continuous=true dim=$dim"
  for ((layer = 2; layer <= layers + 1; layer++)); do
    stride=$((layer < 5 ? 1 : layer == 5 ? 0 : 3))
    echo "tdnnf-layer name=tdnnf$layer l2-regularize=0.008 dropout-proportion=0.0 bypass-scale=0.75 dim=$dim" \
      "bottleneck-dim=$bottleneck time-stride=$stride"
  done
  echo "linear-component name=prefinal-l dim=$((dim / 6)) l2-regularize=0.008 orthonormal-constraint=-1.0"
  echo "prefinal-layer name=prefinal-chain $prefinal"
  echo "output-layer name=output include-log-softmax=false dim=$1 l2-regularize=0.002"
  echo "prefinal-layer name=prefinal-xent $prefinal"
  echo "output-layer name=output-xent dim=$1 learning-rate-factor=5.0 l2-regularize=0.002" # 0.5 / xent-regularize
}

after "$set/features/$set.hires.fix" "$ali/align/tree" "${ivectors_made[@]}"
held_out=300 # utterances for validation, as in the stock recipe
if [ "$dry_run" = false ]; then
  utterances=$(wc -l <"$workspace/data/$set.hires/text")
  [ "$utterances" -ge 3000 ] || held_out=$((utterances / 10 + 1))
  mkdir -p "$workspace/$set/configs"
  targets=$(cd "$workspace" && . ./path.sh &&
    tree-info "$ali/align/tree/tree" 2>/dev/null | awk '/num-pdfs/ {print $2}')
  xconfig "$targets" >"$workspace/$set/configs/network.xconfig"
  options=()
  [ "$online_cmvn" = false ] || options=("$workspace/conf/online_cmvn.conf")
  inputs "$workspace/$set/configs/network.xconfig" "${options[@]}" <(echo "$key")
fi
once "$set/nnet/configs" steps/nnet3/xconfig_to_configs.py --xconfig-file "$set/configs/network.xconfig" \
  --config-dir "$set/configs"

cmvn="--norm-means=false --norm-vars=false"
[ "$online_cmvn" = false ] || cmvn="--config=conf/online_cmvn.conf"
train=(steps/nnet3/chain/train.py --cmd "$runner" --use-gpu "$([ "$use_gpu" = true ] && echo wait || echo no)"
  --feat.cmvn-opts="$cmvn"
  --chain.xent-regularize 0.1 --chain.leaky-hmm-coefficient 0.1 --chain.l2-regularize 0.0
  --chain.apply-deriv-weights false --chain.lm-opts="--num-extra-lm-states=2000"
  --egs.opts "--frames-overlap-per-eg 0 --constrained false --online-cmvn $online_cmvn --num-utts-subset $held_out"
  --egs.nj "$(jobs_for "data/$set.hires")"
  --egs.chunk-width "$chunk_width"
  --trainer.dropout-schedule "0,0@0.20,$dropout@0.50,0"
  --trainer.add-option="--optimization.memory-compression-level=2"
  --trainer.srand "$seed" --trainer.num-chunk-per-minibatch "$minibatch" --trainer.frames-per-iter "$frames_per_iter"
  --trainer.num-epochs "$epochs" --trainer.max-param-change 2.0
  --trainer.optimization.num-jobs-initial "$jobs_initial" --trainer.optimization.num-jobs-final "$jobs_final"
  --trainer.optimization.initial-effective-lrate "$lrate_initial"
  --trainer.optimization.final-effective-lrate "$lrate_final"
  --cleanup.remove-egs true --feat-dir "data/$set.hires" --tree-dir "$ali/align/tree" --lat-dir "$ali/align/lats"
  --dir "$set")
[ "$ivectors" = false ] || train+=(--feat.online-ivector-dir "$set/ivectors/$set")
stage=-10
if [ "$dry_run" = false ]; then
  begun=$workspace/$set/begun state=$({ echo "$key" && lasting "${train[@]}"; } | sha256sum)
  if [ "$(cat "$begun" 2>/dev/null)" = "$state" ]; then # the last model may be incomplete: start from the one before
    last=$(find "$workspace/$set" -maxdepth 1 -name '[0-9]*.mdl' -printf '%f\n' | sort -n | tail -n 1)
    last=${last%.mdl}
    [ "${last:-0}" -lt 2 ] || stage=$((last - 1))
    if [ ! -e "$workspace/$set/egs/cegs.1.ark" ]; then # it is removed first, after the last iteration and final.mdl
      if [ -e "$workspace/$set/final.mdl" ]; then stage=1000000; else stage=-10; fi # 1000000: only write the reports
    fi
  else
    take_lock
    rm -rf "$workspace/done/$set/nnet/train" "$workspace/$set"/{egs,*.mdl,online_cmvn,global_cmvn.stats,cmvn_opts}
    echo "$state" >"$begun"
  fi
fi
once "$set/nnet/train" "${train[@]}" --stage "$stage"
once "$set/nnet/source" cp "data/$set/source" "$set/source" # what roomeq wer compares with the set's present state
