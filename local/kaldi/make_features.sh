#!/usr/bin/env bash
# Make the features of one set: MFCCs for the GMM, or high-resolution MFCCs for the network.
# Usage: local/kaldi/make_features.sh [options] <workspace> <set>
# e.g.:  local/kaldi/make_features.sh --hires true --train true exp/kaldi train.sim.rvb
# Makes data/<set>, data/<set>.sp or, with --hires, data/<set>.hires; existing features are kept.
set -euo pipefail
nj=2                  # jobs
hires=false           # high-resolution features
train=false           # vary the level, as Kaldi's recipes do for training sets
by_utterance=false    # with --hires: each utterance is a speaker of its own, so that CMVN does not mix rooms
speed_perturb=false   # perturb the speed: 0.9, 1.0 and 1.1
dry_run=false         # print the commands
. ./path.sh
. utils/parse_options.sh
. local/kaldi/common.sh
[ $# -eq 2 ] || usage
workspace=$1 set=$2 made=$2 config=conf/mfcc.conf

inputs "$workspace/data/$set/source"
if [ "$speed_perturb" = true ]; then
  outputs=data/$set.sp once "$set/features/speed" utils/data/perturb_data_dir_speed_3way.sh "data/$set" "data/$set.sp"
  made=$set.sp
  # perturb_data_dir_speed.sh rounds the times of segments to 10 ms, and not the lengths of recordings without segments
  # shellcheck disable=SC2016 # the fields are those of awk
  exact='NR == FNR { start[$1] = $3; end[$1] = $4; next }
    match($1, /^sp(0\.9|1\.1)-/) { speed = substr($1, 3, 3); id = substr($1, 7)
      $3 = sprintf("%.5f", start[id] / speed); $4 = sprintf("%.5f", end[id] / speed) }
    { print }'
  # shellcheck disable=SC2016 # the arguments are those of bash
  rewrite='awk "$0" "$1/segments" "$2/segments" >"$2/exact" && mv "$2/exact" "$2/segments"'
  [ ! -f "$workspace/data/$set/segments" ] ||
    once "$set/features/segments" bash -c "$rewrite" "$exact" "data/$set" "data/$set.sp"
fi
if [ "$hires" = true ]; then
  copy=(utils/copy_data_dir.sh)
  [ "$by_utterance" = false ] || copy=(utils/data/modify_speaker_info.sh --utts-per-spk-max 1)
  outputs=data/$set.hires once "$set/features/copy" "${copy[@]}" "data/$made" "data/$set.hires"
  [ "$by_utterance" = false ] || [ "$speed_perturb" = false ] || # modify_speaker_info.sh leaves it out
    once "$set/features/utt2uniq" cp "data/$made/utt2uniq" "data/$set.hires/"
  made=$set.hires config=conf/mfcc_hires.conf
  [ "$train" = false ] || once "$set/features/volume" utils/data/perturb_data_dir_volume.sh "data/$made"
fi
inputs "$workspace/$config" <(echo "$key") # not before: commands above are shared by both kinds of features
once "$set/features/$made" steps/make_mfcc.sh --nj "$(jobs_for "data/$made")" --cmd "$runner" --mfcc-config $config "data/$made"
once "$set/features/$made.cmvn" steps/compute_cmvn_stats.sh "data/$made"
once "$set/features/$made.fix" utils/fix_data_dir.sh "data/$made"
