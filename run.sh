#!/usr/bin/env bash
# From measured room impulse responses and clean speech to far-field training data: simulate, compensate, augment.
# Usage: ./run.sh [--stage 0] [--stop-stage 7] [--nj 2] [--config conf/mini.conf] [options below]
# e.g.:  ./run.sh                                        # a synthetic corpus, needs nothing
#        KALDI_ROOT=~/kaldi ./run.sh --stage 8        # then train and test recognisers on what it made
#        ./run.sh --measured RIRS --speech SPEECH        # your own recordings
#        ./run.sh --config conf/librispeech.conf --librispeech DIR --reverbdb DIR    # the paper's experiment
# Options are the variables at the top of this file, with - for _. Stages that are up to date cost nothing.
set -euo pipefail

stage=0        # first stage to run
stop_stage=    # last stage to run; none: 7, or 10 with --stage 8 or more
nj=$(env -u OMP_NUM_THREADS nproc)   # jobs; results do not depend on it
seed=0         # of every random draw; results depend on nothing else
data=data      # where data directories go
exp=exp        # where models, logs and the report go
corpora=corpora   # where the synthetic corpus goes

# stage 0: corpora; without any, a synthetic corpus is made
librispeech=   # LibriSpeech as released
reverbdb=      # BUT ReverbDB as released
speech=        # or: any LibriSpeech-like tree, Kaldi data directory or folder with manifest.csv
measured=      # or: measured RIRs: folder, CSV or SOFA file
noises=        # folder of noise recordings, beside those of the measured corpus
train_sets=train-clean-100   # of a LibriSpeech tree, comma-separated
dev_sets=dev-clean          # likewise
test_sets=test-clean        # likewise
synthetic_utterances=900,150,150   # for train, dev, test
synthetic_rooms=9                  # 1 to 80
synthetic_positions=6              # microphones and loudspeakers a room

# stage 1: measured RIRs
split_by=rir              # rir, as in the paper, or room: the stricter question
same_rooms=               # patterns, as 'house_*,lab_*': rooms that one of them matches count as one, if split by room
split_sizes=773,194,242   # RIRs for train, dev, test; scaled down where there are fewer

# stages 2-4: simulation, equalisation, compensation
t60_range=0.2,2.0         # of the simulated RIRs [s]; measured: that of the measured rooms
num_rays=20000            # rays a source
order=200                 # reflections
num_components=7          # of the Gaussian mixture
weight_rooms=false        # let rooms count equally in the mixture
match_rooms=true          # draw each RIR's EQ from its room's share of the mixture; false: from all of it
taps=511                  # of the compensation filters

# stage 5: the closed loop
max_effects=4             # that it adds at most

# stage 6: augmentation
snr="uniform 5 25"        # of the ambient noise [dB]
point_snr="uniform 5 25"  # of point noises [dB]
draw_rooms_equally=false  # draw the room first, then one of its RIRs
packing=recording          # one FLAC a recording, with segments; or: utterance

# stages 8-10: Kaldi, at KALDI_ROOT or around this directory
dry_run=false             # print the Kaldi commands only
lm_text=                  # for the language models, beside the transcripts; LibriSpeech and the synthetic corpus have their own
align_on=clean            # alignments of the clean speech for all sets, or of each set itself (self), as in the paper
gmm_passes="mono 300, deltas all 300 3000, lda_mllt all 400 6000, sat all 400 6000"   # kind utterances leaves Gaussians
num_leaves=400            # of the network's tree
rows=                     # of the table, e.g. "sim.rvb sim.loop.rvb"; none: all
stock_rvb=false           # another set: speech that Kaldi's own reverberate_data_dir.py made with our simulated RIRs
speed_perturb=false       # train on three speeds
ivectors=false            # beside the network's features
use_gpu=false             # true: train on GPUs
chain_opts="--layers 7 --dim 192 --bottleneck 32 --epochs 6 --jobs-initial 2 --jobs-final 2 --lrate-initial 0.002 --lrate-final 0.0002 --chunk-width 140,100 --minibatch 32,16,8 --frames-per-iter 150000"   # of train_chain.sh
decode_opts="--beam 11 --max-active 2000 --lattice-beam 6"   # of decode.sh

[ -f path.sh ] || { echo "run.sh: call it from the directory that holds run.sh, not from $PWD" >&2 && exit 1; }
. ./path.sh
. utils/parse_options.sh
[ $# -eq 0 ] || usage
log() { printf '%s run.sh: %s\n' "$(date +%H:%M:%S)" "$*"; }
at_stage() { [ "$stage" -le "$1" ] && [ "$stop_stage" -ge "$1" ] && log "stage $1: $2"; }

[[ $split_by =~ ^(rir|room)$ ]] || die "--split-by '$split_by' must be rir or room"
[[ $split_sizes =~ ^[0-9]+,[0-9]+,[0-9]+$ ]] || die "--split-sizes '$split_sizes' must be three counts, as 773,194,242"
[[ $t60_range =~ ^([0-9.]+,[0-9.]+|measured)$ ]] ||
  die "--t60-range '$t60_range' must be two times, as 0.2,2.0, or measured"
[[ $packing =~ ^(recording|utterance)$ ]] || die "--packing '$packing' must be recording or utterance"
[ $((taps % 2)) = 1 ] || die "--taps '$taps' must be odd"
number='[-+]?[0-9]*\.?[0-9]+'
for name in snr point_snr; do # the tools check the rest: this spares the stages before them
  [[ ${!name} =~ ^(none|$number|((uniform|normal)\ +${number}[\ ,]+|list\ +(${number}[\ ,]+)*)$number)$ ]] ||
    die "--${name/_/-} '${!name}' must be 'uniform LOW HIGH', 'normal MEAN SD', 'list A,B,...', a number or none"
done
[ -n "$stop_stage" ] || stop_stage=$((stage < 8 ? 7 : 10))
[[ $stop_stage =~ ^([0-9]|10)$ ]] || die "--stop-stage '$stop_stage' must be a whole number up to 10"
[[ $align_on =~ ^(clean|self)$ ]] || die "--align-on '$align_on' must be clean or self"
[ "$dry_run" = false ] || [ "$stage" -ge 8 ] || die "--dry-run prints what Kaldi is asked to do: add --stage 8"
local/install.sh

if at_stage 0 "speech and measured RIRs"; then
  if [ -z "$librispeech$speech" ] || [ -z "$reverbdb$measured" ]; then
    [ -n "$librispeech$speech" ] || log "no --speech or --librispeech given: synthetic speech is used"
    [ -n "$reverbdb$measured" ] || log "no --measured or --reverbdb given: synthetic RIRs are used"
    local/make_synthetic_corpus.sh --nj "$nj" --utterances "$synthetic_utterances" --rooms "$synthetic_rooms" \
      --positions "$synthetic_positions" "$corpora"
  fi
  steps/prepare_speech.sh --train-sets "$train_sets" --dev-sets "$dev_sets" --test-sets "$test_sets" \
    "${librispeech:-${speech:-$corpora/speech}}" "$data"
  if [ -z "$noises$librispeech$speech" ]; then noises=$corpora/speech/point_noises; fi
  steps/read_measured.sh --noises "$noises" "${reverbdb:-${measured:-$corpora/reverbdb}}" "$data/measured"
fi

if at_stage 1 "measure them, leave out repeats and uncommon spaces, split"; then
  steps/characterise_rirs.sh --nj "$nj" "$data/measured" "$data/rirs.real"
  steps/split_rirs.sh --split-by "$split_by" --same-rooms "$same_rooms" --sizes "$split_sizes" --seed "$seed" \
    "$data/rirs.real"
fi

if at_stage 2 "simulate one RIR per measured one"; then
  for x in train dev; do
    steps/simulate_rirs.sh --nj "$nj" --t60-range "$t60_range" --num-rays "$num_rays" --order "$order" \
      --seed "$seed" "$data/rirs.real.$x" "$data/rirs.sim.$x"
  done
fi

if at_stage 3 "fit the distribution of measured sub-band EQs"; then
  steps/fit_eq.sh --nj "$nj" --num-components "$num_components" --weight-rooms "$weight_rooms" --seed "$seed" \
    "$data/rirs.real.train" "$data/rirs.sim.train" "$exp/eq"
fi

if at_stage 4 "compensate the simulated RIRs"; then
  for x in train dev; do
    steps/compensate_rirs.sh --nj "$nj" --match-rooms "$match_rooms" --taps "$taps" --seed "$seed" \
      "$data/rirs.sim.$x" "$exp/eq" "$data/rirs.sim.EQ.$x"
  done
fi

alignments() { if [ "$align_on" = self ]; then echo "train.$1"; else echo train.clean; fi; } # that a set is trained on
enough_rooms() { # else it says so
  require "$data/rirs.real.train/rirs.jsonl" steps/split_rirs.sh
  local/enough_rooms.py "$data/rirs.real.train"
}
if at_stage 5 "close the loop: find what the simulation lacks, and simulate with it" && enough_rooms; then
  steps/close_loop.sh --nj "$nj" --max-effects "$max_effects" --seed "$seed" \
    "$data/rirs.real.train" "$data/rirs.real.dev" "$exp/loop"
  for x in train dev; do
    steps/simulate_rirs.sh --nj "$nj" --t60-range "$t60_range" --num-rays "$num_rays" --order "$order" \
      --model "$exp/loop/model.json" --seed "$seed" "$data/rirs.real.$x" "$data/rirs.sim.loop.$x"
  done
fi

if at_stage 6 "far-field speech"; then
  kinds=(real sim sim.EQ)
  if enough_rooms >/dev/null; then kinds+=(sim.loop); fi
  for rirs in "${kinds[@]/%/.train}" "${kinds[@]/%/.dev}" real.test; do
    x=${rirs##*.}
    steps/augment_data.sh --nj "$nj" --snr "$snr" --point-snr "$point_snr" --packing "$packing" \
      --draw-rooms-equally "$draw_rooms_equally" --seed "$seed" --noises "$data/rirs.real.$x" \
      "$data/$x.clean" "$data/rirs.$rirs" "$data/$x.${rirs%.*}.rvb"
  done
fi

if at_stage 7 "report"; then
  steps/make_report.sh "$data" "$exp" "$exp/report"
fi

if [ "$stop_stage" -ge 8 ]; then
  kaldi=(--nj "$nj" --dry-run "$dry_run")
  sets=(clean real.rvb sim.rvb sim.EQ.rvb) # each developed on its own kind, as in the paper; one test for all
  if [ "$dry_run" = true ] || enough_rooms >/dev/null; then sets+=(sim.loop.rvb); fi
  made=("$data/test.real.rvb" "${sets[@]/#/$data/train.}" "${sets[@]/#/$data/dev.}")
  [ "$stock_rvb" = false ] || sets+=(sim.stock.rvb)
  for x in $rows; do
    [[ " ${sets[*]} " == *" $x "* ]] || die "--rows: '$x' must be one of: ${sets[*]}"
  done
  [ -z "$rows" ] || read -ra sets <<<"$rows"
  aligned=(train.clean)
  [ "$align_on" = clean ] || for x in "${sets[@]}"; do
    [ "$x" = clean ] || aligned+=("train.$x")
  done
fi

if at_stage 8 "Kaldi: language, features, GMM"; then
  texts=("$data/train.clean/text")
  if [ -n "$lm_text" ]; then
    texts+=("$lm_text")
  elif [ -n "$librispeech" ]; then
    texts=()
  elif [ -z "$speech" ]; then
    texts+=("$corpora/speech/LibriSpeech-LM/lm.txt")
  fi
  local/kaldi/make_workspace.sh "${kaldi[@]}" "$exp/kaldi" "${made[@]}"
  [ "$stock_rvb" = false ] || for x in train dev; do
    local/kaldi/reverberate.sh "${kaldi[@]}" --seed "$seed" "$exp/kaldi" "$data/rirs.sim.$x" "$data/rirs.real.$x" \
      "$x.clean" "$x.sim.stock.rvb"
  done
  local/kaldi/make_lang.sh "${kaldi[@]}" "$exp/kaldi" "${texts[@]}"
  for x in "${aligned[@]}"; do
    local/kaldi/make_features.sh "${kaldi[@]}" "$exp/kaldi" "$x"
    lang=data/lang_nosp
    [ "$x" = train.clean ] || lang=data/lang
    local/kaldi/train_gmm.sh "${kaldi[@]}" --passes "$gmm_passes" "$exp/kaldi" "$x" "$lang"
    [ "$x" != train.clean ] || local/kaldi/finish_lang.sh "${kaldi[@]}" "$exp/kaldi" "$x"
  done
fi

if at_stage 9 "Kaldi: TDNN with LF-MMI"; then
  for x in "${aligned[@]}"; do
    [ "$speed_perturb" = false ] ||
      local/kaldi/make_features.sh "${kaldi[@]}" --speed-perturb true "$exp/kaldi" "$x"
    local/kaldi/align_chain.sh "${kaldi[@]}" --num-leaves "$num_leaves" --speed-perturb "$speed_perturb" "$exp/kaldi" "$x"
  done
  for x in test.real.rvb "${sets[@]/#/dev.}"; do
    local/kaldi/make_features.sh "${kaldi[@]}" --hires true "$exp/kaldi" "$x"
  done
  for x in "${sets[@]}"; do
    local/kaldi/make_features.sh "${kaldi[@]}" --hires true --train true --speed-perturb "$speed_perturb" \
      "$exp/kaldi" "train.$x"
    [ "$ivectors" = false ] ||
      local/kaldi/train_ivectors.sh "${kaldi[@]}" "$exp/kaldi" "train.$x" "dev.$x" test.real.rvb
    # options and their values: split on purpose
    # shellcheck disable=SC2086
    local/kaldi/train_chain.sh "${kaldi[@]}" --use-gpu "$use_gpu" --ivectors "$ivectors" --seed "$seed" $chain_opts \
      "$exp/kaldi" "train.$x" "$(alignments "$x")"
  done
fi

if at_stage 10 "Kaldi: recognise; word error rates"; then
  for x in "${sets[@]}"; do
    decode=(local/kaldi/decode.sh "${kaldi[@]}" --ivectors "$ivectors")
    # shellcheck disable=SC2206 # as above
    decode+=($decode_opts)
    "${decode[@]}" "$exp/kaldi" "train.$x" "$(alignments "$x")" "dev.$x"
    "${decode[@]}" --tuned-on "dev.$x" "$exp/kaldi" "train.$x" "$(alignments "$x")" test.real.rvb
  done
  if [ "$dry_run" = false ]; then
    roomeq wer --rirs "$data/rirs.real" "$exp/kaldi" "$exp/wer"
    steps/make_report.sh "$data" "$exp" "$exp/report"
  fi
fi
[ "$dry_run" = false ] || exit 0

for x in "$data"/*.rvb; do
  [ ! -d "$x" ] || log "data directory: $(realpath "$x")"
done
[ ! -f "$exp/report/index.html" ] || log "report: $(realpath "$exp")/report/index.html"
