#!/usr/bin/env bash
# Make the training targets of the network: lattices of alternative alignments, and a tree with one state per phone.
# Usage: local/kaldi/align_chain.sh [options] <workspace> <set>
# e.g.:  local/kaldi/align_chain.sh --num-leaves 7000 exp/kaldi train.clean
set -euo pipefail
nj=2                  # jobs
num_leaves=7000       # leaves of the tree
speed_perturb=false   # use the data of three speeds
dry_run=false         # print the commands
. ./path.sh
. utils/parse_options.sh
. local/kaldi/common.sh
[ $# -eq 2 ] || usage
workspace=$1 set=$2 data=$2 gmm=$2/gmm/final
[ "$speed_perturb" = false ] || data=$set.sp

after "$set/gmm/final" "$set/features/$data.fix" lang/const_arpa_fglarge
jobs=$(jobs_for "data/$data")
# the inner bash expands the variables
# shellcheck disable=SC2016
once "$set/align/lang" bash -c \
  'rm -rf "$1" && mkdir -p "${1%/*}" && cp -r data/lang "$1" && steps/nnet3/chain/gen_topo.py \
  "$(cat "$1/phones/nonsilence.csl")" "$(cat "$1/phones/silence.csl")" >"$1/topo"' topo "$set/align/lang"
once "$set/align/ali" steps/align_fmllr.sh --nj "$jobs" --cmd "$runner" "data/$data" data/lang "$gmm" "$set/align/ali"
once "$set/align/lats" steps/align_fmllr_lats.sh --nj "$jobs" --cmd "$runner" "data/$data" data/lang "$gmm" \
  "$set/align/lats"
once "$set/align/tree" steps/nnet3/chain/build_tree.sh --frame-subsampling-factor 3 \
  --context-opts "--context-width=2 --central-position=1" --cmd "$runner" \
  "$num_leaves" "data/$data" "$set/align/lang" "$set/align/ali" "$set/align/tree"
once "$set/align/graph" utils/mkgraph.sh --self-loop-scale 1.0 --remove-oov data/lang_test_tgsmall "$set/align/tree" \
  "$set/align/tree/graph"
