#!/usr/bin/env bash
# Make far-field training data from measured room impulse responses and clean speech: simulate, compensate, augment.
# Usage: ./run.sh [--stage 0] [--stop-stage 7] [--nj 2] [--config conf/mini.conf] [options below]
# e.g.:  ./run.sh                                      # a synthetic corpus; needs no data
#        KALDI_ROOT=~/kaldi ./run.sh --stage 8         # then train and test recognisers on the result
#        ./run.sh --measured RIRS --speech SPEECH      # your own recordings
#        ./run.sh --measured RIRS --test-rirs OTHERS   # test in other rooms
#        ./run.sh --config conf/librispeech.conf --librispeech DIR --reverbdb DIR    # the paper's experiment
# Options are the variables at the top of this file, with - for _. Stages that are up to date are skipped.
set -euo pipefail

stage=0           # first stage to run
stop_stage=       # last stage to run; default: 7, or 10 if --stage is 8 or more
nj=$(env -u OMP_NUM_THREADS nproc)   # parallel jobs; results of stages 0 to 7 do not depend on it
seed=0            # seed of all random numbers, except those of the synthetic corpus
data=data         # where data directories go
exp=exp           # where models, logs and the report go
corpora=corpora   # where the synthetic corpus goes

# stage 0: corpora; a missing corpus is replaced by a synthetic one
librispeech=      # directory of LibriSpeech, as released
reverbdb=         # directory of BUT ReverbDB, as released
speech=           # instead of --librispeech: such a tree, a Kaldi data directory, or a folder, best with manifest.csv
measured=         # instead of --reverbdb: folder of RIRs, CSV file, SOFA file or OpenSLR 28
dev_rirs=         # measured RIRs to develop on, as --measured; default: a part of --measured
test_rirs=        # measured RIRs to test on, as --measured; default: a part of --measured
keep_suspicious=false   # keep measured recordings that are no RIR by their acoustics
noises=           # folder of noise recordings, in addition to those of the measured corpus
train_sets=train-clean-100   # sets for training, comma-separated: of LibriSpeech, of a CSV (column set), or folders
dev_sets=dev-clean           # sets for development, likewise
test_sets=test-clean         # sets for test, likewise
synthetic_utterances=900,150,150   # number of utterances for train, dev, test
synthetic_rooms=9            # number of rooms, 1 to 80
synthetic_positions=6        # number of microphones, and of loudspeakers, per room

# stage 1: measured RIRs
split_by=rir              # rir: split RIRs at random, as in the paper; room: keep all RIRs of a room in one set
same_rooms=               # patterns such as 'house_*,lab_*': rooms that match one pattern count as one room
split_sizes=773,194,242   # number of RIRs for train, dev, test; scaled down if the corpus has fewer

# stages 2-4: simulation, equalisation, compensation
t60_range=0.2,2.0         # range of T60 of RIRs in measured rooms [s]; measured: the range of their recordings
rooms=                    # simulate in so many randomly drawn rooms, and a tenth of it for dev, not in measured ones
free_rooms=0              # make a further training set, sim.free: RIRs of so many drawn rooms, not of measured ones
room_types=               # what they are drawn from: TOML file, or names in conf/room_types.toml; default: all of these
num_rays=10000            # rays per source, for each distinct set of scattering coefficients over the bands
order=200                 # reflections of a ray on average, up to 3 s; more where the decay needs it
num_components=7          # number of Gaussians in the mixture
weight_rooms=false        # give every room the same weight in the mixture
match_rooms=true          # draw each EQ with the mixture weights of its room; false: with those of all rooms
taps=511                  # length of the compensation filters [samples], odd

# stage 5: the closed loop
max_effects=4             # largest number of effects to add

# stage 6: augmentation
snr="uniform 5 25"        # SNR of the ambient noise [dB]
point_snr="uniform 5 25"  # SNR of point-source noises [dB]
draw_rooms_equally=false  # draw the room first, then one of its RIRs
packing=recording         # one FLAC per recording, with segments; or: utterance
test_copies=1             # far-field versions of each test utterance, each with its own draw of RIR and noise

# stages 8-10: Kaldi, from KALDI_ROOT or from the Kaldi tree that holds this directory
dry_run=false             # print the Kaldi commands, do not run them
lm_text=                  # text for the language models, besides the transcripts; default: the corpus's own, if any
align_on=clean            # all systems use the alignments of the clean speech; self: of their own set, as in the paper
gmm_passes="mono 300, deltas all 300 3000, lda_mllt all 400 6000, sat all 400 6000"   # --passes of train_gmm.sh
num_leaves=400            # leaves of the TDNN's phonetic decision tree
rows=                     # training sets to compare, e.g. "sim.rvb sim.loop.rvb"; default: all
speed_perturb=false       # speed-perturb the training sets by 0.9, 1.0 and 1.1
online_cmvn=true          # subtract the mean of the TDNN's features so far
ivectors=false            # add i-vectors to the TDNN's features
use_gpu=false             # train the TDNN on GPUs
chain_opts="--config conf/chain_small.conf"           # options of train_chain.sh
decode_opts="--beam 11 --max-active 2000 --lattice-beam 6"   # options of decode.sh

[ -f path.sh ] || { echo "run.sh: call it from the directory that holds run.sh, not from $PWD" >&2 && exit 1; }
. ./path.sh
. utils/parse_options.sh
[ $# -eq 0 ] || die "'$1' is no option: options begin with --; see --help"
[ -n "$stop_stage" ] || stop_stage=$((stage < 8 ? 7 : 10))
. local/check_options.sh
. utils/one_run.sh
[ "$dry_run" = true ] || one_run "$data" "$exp"
local/install.sh
. utils/ask.sh && start_answering

if at_stage 0 "read speech and measured RIRs"; then
  [ -n "$librispeech$speech" ] || log "no --speech or --librispeech: synthetic speech is used"
  [ -n "$reverbdb$measured" ] || log "no --measured or --reverbdb: synthetic RIRs are used"
  if [ -z "$librispeech$speech" ] || [ -z "$reverbdb$measured" ]; then
    local/make_synthetic_corpus.sh --nj "$nj" --utterances "$synthetic_utterances" --rooms "$synthetic_rooms" \
      --positions "$synthetic_positions" "$corpora"
  fi
  [ -n "$noises$librispeech$speech" ] || noises=$corpora/speech/point_noises
  steps/prepare_speech.sh --train-sets "$train_sets" --dev-sets "$dev_sets" --test-sets "$test_sets" \
    "${librispeech:-${speech:-$corpora/speech}}" "$data"
  steps/read_measured.sh --noises "$noises" --keep-suspicious "$keep_suspicious" \
    "${reverbdb:-${measured:-$corpora/reverbdb}}" "$data/measured"
  [ -z "$dev_rirs" ] || steps/read_measured.sh --keep-suspicious "$keep_suspicious" "$dev_rirs" "$data/measured.dev"
  [ -z "$test_rirs" ] || steps/read_measured.sh --keep-suspicious "$keep_suspicious" "$test_rirs" "$data/measured.test"
fi

if [[ $stage -le 6 && ( $stage -eq 0 || $stop_stage -ge 6 ) ]]; then # before hours of simulation
  unchecked=() # clean speech of which no far-field speech was made yet
  for x in train dev test; do
    [[ ! -f $data/$x.clean/wav.scp || -f $data/$x.clean/.done && $data/$x.real.rvb/.done -nt $data/$x.clean/.done ]] ||
      unchecked+=("$data/$x.clean")
  done
  [ ${#unchecked[@]} -eq 0 ] || local/check_speech.py "${unchecked[@]}"
fi
if [[ $stage -le 8 && $stop_stage -ge 8 && $dry_run = false ]]; then
  for x in train dev test; do
    [ -f "$data/$x.clean/wav.scp" ] || continue
    [ -f "$data/$x.clean/text" ] || die "$data/$x.clean: no text: recognisers need transcripts: give speech with" \
      "transcripts, or stop with --stop-stage 7"
    [ "$x" = test ] || local/check_speech.py --for-kaldi "$data/$x.clean" # the test set is far-field speech
  done
fi

if at_stage 1 "characterise and split the measured RIRs"; then
  steps/characterise_rirs.sh --nj "$nj" "$data/measured" "$data/rirs.real"
  for x in ${dev_rirs:+dev} ${test_rirs:+test}; do
    steps/characterise_rirs.sh --nj "$nj" "$data/measured.$x" "$data/rirs.$x"
  done
  steps/split_rirs.sh --split-by "$split_by" --same-rooms "$same_rooms" --sizes "$split_sizes" --seed "$seed" \
    ${dev_rirs:+--dev-rirs "$data/rirs.dev"} ${test_rirs:+--test-rirs "$data/rirs.test"} "$data/rirs.real"
fi

simulate() { # NAME ROOMS [OPTION...]: make data/rirs.NAME.train and data/rirs.NAME.dev, in drawn ROOMS if there are any
  local name=$1 rooms=$2 x
  local step=(steps/simulate_rirs.sh --nj "$nj" --num-rays "$num_rays" --order "$order" --seed "$seed" "${@:3}")
  if [ -n "$rooms" ]; then # T60 as the room types say
    step+=(--room-types "$room_types")
    "${step[@]}" --rooms "$rooms" "$data/rirs.$name.train"
    "${step[@]}" --rooms "$((rooms + 1))-$((rooms + (rooms + 9) / 10))" "$data/rirs.$name.dev"
  else
    for x in train dev; do
      "${step[@]}" --t60-range "$t60_range" "$data/rirs.real.$x" "$data/rirs.$name.$x"
    done
  fi
}
if at_stage 2 "simulate RIRs"; then
  if [ "$stop_stage" -ge 3 ]; then # of which stage 3 makes the mixture
    require "$data/rirs.real.train/rirs.jsonl" steps/split_rirs.sh
    local/enough_rirs.py "$data/rirs.real.train" "$num_components"
  fi
  simulate sim "$rooms"
  [ "$free_rooms" = 0 ] || simulate sim.free "$free_rooms"
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

if at_stage 5 "close the loop: find the effects that the simulation lacks, and simulate with them"; then
  require "$data/rirs.real.train/rirs.jsonl" steps/split_rirs.sh
  local/enough_rooms.py "$data/rirs.real.train" "$exp/rooms" "$nj"
  if [ -f "$exp/rooms/enough" ]; then
    steps/close_loop.sh --nj "$nj" --max-effects "$max_effects" --seed "$seed" \
      "$data/rirs.real.train" "$data/rirs.real.dev" "$exp/loop"
    simulate sim.loop "$rooms" --model "$exp/loop/model.json" --draw-devices true
  fi
fi

[ "$stop_stage" -ge 6 ] || exit 0
kinds=(real sim sim.EQ) # of RIRs; $data may hold others of an earlier run
[ "$dry_run" = true ] || [ ! -d "$data/rirs.real.train" ] ||
  local/enough_rooms.py "$data/rirs.real.train" "$exp/rooms" "$nj" >/dev/null
if [ "$dry_run" = true ] || [ -f "$exp/rooms/enough" ]; then kinds+=(sim.loop); fi
[ "$free_rooms" = 0 ] || kinds+=(sim.free)
kind_list=$(IFS=, && echo "${kinds[*]}")
if [ "$dry_run" = false ] && [ "$stage" -ge 2 ]; then # what skipped stages made may be of another split or seed
  [ "$stage" -gt 6 ] && origin=(--speech) || origin=(--seed "$seed")
  local/check_origin.py "${origin[@]}" --kinds "$kind_list" "$data" "$exp"
fi

if at_stage 6 "make far-field speech"; then
  for rirs in "${kinds[@]/%/.train}" "${kinds[@]/%/.dev}" real.test; do
    x=${rirs##*.}
    [ "$x" = test ] && copies=$test_copies || copies=1
    steps/augment_data.sh --nj "$nj" --snr "$snr" --point-snr "$point_snr" --packing "$packing" --copies "$copies" \
      --draw-rooms-equally "$draw_rooms_equally" --seed "$seed" --noises "$data/rirs.real.$x" \
      "$data/$x.clean" "$data/rirs.$rirs" "$data/$x.${rirs%.*}.rvb"
  done
fi

if at_stage 7 "make the report"; then
  steps/make_report.sh --kinds "$kind_list" "$data" "$exp" "$exp/report"
fi

if [ "$stop_stage" -ge 8 ]; then
  of_corpus=$(realpath -m "$corpora")/speech/
  of_corpus=${of_corpus//\'/\'\"\'\"\'} # as wav.scp quotes it
  if [ -z "$lm_text$librispeech$speech" ] && { [ "$dry_run" = true ] ||
    grep -qF -- "$of_corpus" "$data/train.clean/wav.scp"; }; then
    lm_text=$corpora/speech/LibriSpeech-LM/lm.txt
  fi
  local/kaldi/train_and_test.sh --stage "$stage" --stop-stage "$stop_stage" --nj "$nj" --seed "$seed" \
    --dry-run "$dry_run" --librispeech "$librispeech" --lm-text "$lm_text" --align-on "$align_on" \
    --gmm-passes "$gmm_passes" --num-leaves "$num_leaves" --kinds "$kind_list" --rows "$rows" \
    --speed-perturb "$speed_perturb" --online-cmvn "$online_cmvn" --ivectors "$ivectors" --use-gpu "$use_gpu" \
    --chain-opts "$chain_opts" --decode-opts "$decode_opts" "$data" "$exp"
fi
[ "$dry_run" = false ] || exit 0

for kind in "${kinds[@]}"; do
  for x in "$data"/{train,dev,test}."$kind.rvb"; do
    [ ! -d "$x" ] || log "data directory: $(realpath "$x")"
  done
done
[ ! -f "$exp/report/index.html" ] || log "report: $(realpath "$exp")/report/index.html"
