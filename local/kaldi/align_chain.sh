#!/usr/bin/env bash
# What the network is trained towards: lattices of alternative alignments, and a tree with one state a phone.
# Usage: local/kaldi/align_chain.sh [options] <workspace> <set>
# e.g.:  local/kaldi/align_chain.sh --num-leaves 7000 exp/kaldi train.clean
set -euo pipefail
nj=2                  # jobs
num_leaves=7000       # of the tree
speed_perturb=false   # three speeds
dry_run=false         # print the commands
. ./path.sh
. utils/parse_options.sh
. local/kaldi/common.sh
[ $# -eq 2 ] || usage
workspace=$1 set=$2 data=$2 gmm=$2/gmm/final
[ "$speed_perturb" = false ] || data=$set.sp

after "$set/gmm" "$set/features/$data.fix" lang/const_arpa_fglarge
# the words of bash -c are expanded in there
# shellcheck disable=SC2016
once "$set/chain/lang" bash -c 'rm -rf "$1" && cp -r data/lang "$1" && steps/nnet3/chain/gen_topo.py \
  "$(cat "$1/phones/nonsilence.csl")" "$(cat "$1/phones/silence.csl")" >"$1/topo"' topo "$set/lang_chain"
once "$set/chain/ali" steps/align_fmllr.sh --nj "$nj" --cmd "$runner" "data/$data" data/lang "$gmm" "$set/ali"
once "$set/chain/lats" steps/align_fmllr_lats.sh --nj "$nj" --cmd "$runner" "data/$data" data/lang "$gmm" "$set/lats"
once "$set/chain/tree" steps/nnet3/chain/build_tree.sh --frame-subsampling-factor 3 \
  --context-opts "--context-width=2 --central-position=1" --cmd "$runner" \
  "$num_leaves" "data/$data" "$set/lang_chain" "$set/ali" "$set/tree"
once "$set/chain/graph" utils/mkgraph.sh --self-loop-scale 1.0 --remove-oov data/lang_test_tgsmall "$set/tree" \
  "$set/tree/graph"
