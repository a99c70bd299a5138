#!/usr/bin/env bash
# How the error depends on the reverberation of the training RIRs, without the rooms of the test set: the recognisers of
# tests/bench/wer.sh, and one more, are tested in drawn rooms of any reverberation time.
# Usage: KALDI_ROOT=DIR tests/bench/wer_by_reverberation.sh [--seeds "0 1 2 3 4"] <out-dir of wer.sh>
# e.g.:  KALDI_ROOT=~/kaldi tests/bench/wer_by_reverberation.sh --point-snr "uniform 0 15" exp/bench_wer
# The one more, train.sim.t60.rvb, is trained on RIRs that are simulated as those of train.sim.rvb, but each with the
# T20 of the measured RIR. The clean test speech is reverberated with RIRs of drawn rooms, others for each seed, and
# with noises of dev. The table is <out-dir>/by_reverberation/wer. May be stopped at any time; the same call goes on.
set -euo pipefail
seeds="0 1 2 3 4"          # of the recognisers
rooms=200                  # drawn rooms for each seed, at most 1000
t60_range=0.2,2.0          # their T60 at 1 kHz [s]
# as the recognisers were trained and tested with:
snr="uniform 5 25"         # SNR of the ambient noise [dB]
point_snr="uniform 5 25"   # SNR of point-source noises [dB]
draw_rooms_equally=true    # draw the room first, then one of its RIRs
online_cmvn=true           # subtract the mean of the features so far
chain_opts="--config conf/chain_small.conf"                  # options of train_chain.sh
decode_opts="--beam 11 --max-active 2000 --lattice-beam 6"   # options of decode.sh
nj=2                       # jobs
. ./path.sh
. utils/parse_options.sh
[ $# -eq 1 ] || usage
[[ $seeds =~ ^[0-9]+(\ [0-9]+)*$ ]] || die "--seeds '$seeds' must be whole numbers with blanks between"
out=$(realpath -m "$1") test=test.real.rvb added=sim.t60.rvb
read -ra decode_opts <<<"$decode_opts"
read -ra chain_opts <<<"$chain_opts"

add_set() { # CLEAN RIRS NOISES NAME [OPTION...]: make far-field speech, and its features in the workspace
  steps/augment_data.sh --nj "$nj" --snr "$snr" --point-snr "$point_snr" --seed "$seed" --noises "$3" \
    --draw-rooms-equally "$draw_rooms_equally" "$1" "$2" "$data/$4"
  local/kaldi/copy_data.py --seed "$seed" "$data/$4" "$workspace/data/$4"
  local/kaldi/make_features.sh --nj "$nj" --hires true --by-utterance "$online_cmvn" "${@:5}" "$workspace" "$4"
}
decode() { # ROW SET [OPTION...]
  local/kaldi/decode.sh --nj "$nj" --ivectors false "${decode_opts[@]}" "${@:3}" "$workspace" "$1" train.clean "$2"
}
rirs=() done=()
for seed in $seeds; do
  trained=$out/seed$seed/exp/kaldi data=$out/by_reverberation/seed$seed workspace=$out/by_reverberation/seed$seed/kaldi
  require "$trained/settings" "tests/bench/wer.sh with this seed"
  if [ ! -d "$workspace" ]; then # all but what was made of the other test set
    rm -rf "$workspace.new"
    mkdir -p "$data"
    cp -a "$trained" "$workspace.new"
    (cd "$workspace.new" && rm -rf -- {data,done}/"$test"* {,done/}train.*/{,online/}decode_"$test"*)
    mv "$workspace.new" "$workspace"
  fi
  for x in train dev; do
    [ -d "$data/measured.$x" ] || tests/bench/real/with_measured_t60.py "$out/data/rirs.real.$x" "$data/measured.$x"
    steps/simulate_rirs.sh --nj "$nj" --seed "$seed" "$data/measured.$x" "$data/rirs.sim.t60.$x"
    add_set "$out/data/$x.clean" "$data/rirs.sim.t60.$x" "$out/data/rirs.real.$x" "$x.$added" \
      --train "$([ "$x" = dev ] && echo false || echo true)"
  done
  local/kaldi/train_chain.sh --nj "$nj" --use-gpu false --ivectors false --online-cmvn "$online_cmvn" --seed "$seed" \
    "${chain_opts[@]}" "$workspace" "train.$added" train.clean
  cp "$workspace"/train.sim.rvb/{seed,settings} "$workspace/train.$added"
  decode "train.$added" "dev.$added"

  steps/simulate_rirs.sh --nj "$nj" --rooms "$((first = 1000 * seed + 1001))-$((first + rooms - 1))" \
    --t60-range "$t60_range" --seed "$seed" "$data/rirs" # no two seeds, and no training set, have a room in common
  add_set "$out/data/test.clean" "$data/rirs" "$out/data/rirs.real.dev" "$test"
  for row in "$workspace"/train.*; do
    row=${row##*/}
    decode "$row" "$test" --tuned-on "dev.${row#train.}"
  done
  for x in "$out"/data/rirs.real.dev "$out/seed$seed"/data/rirs.{sim,sim.EQ,sim.loop,sim.free}.dev \
    "$data"/rirs{,.sim.t60.dev}; do
    [ ! -d "$x" ] || rirs+=(--rirs "$x")
  done
  done+=("$workspace")
  roomeq wer "${rirs[@]}" --train-rirs "$out/data/rirs.real.train" "${done[@]}" "$out/by_reverberation/wer"
done
