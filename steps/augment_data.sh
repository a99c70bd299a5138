#!/usr/bin/env bash
# Make far-field speech: clean speech * RIR + point-source noises * their RIRs + ambient noise (*: convolution).
# The output is sample-aligned with the clean speech.
# Usage: steps/augment_data.sh [options] <clean-data-dir> <rir-dir> <data-dir>
# e.g.:  steps/augment_data.sh --nj 4 data/train.clean data/rirs.sim.train data/train.sim.rvb
set -euo pipefail
nj=2                       # jobs
noises=                    # directory with a noises.jsonl, in addition to the noises of <rir-dir>
snr="uniform 5 25"         # SNR of the ambient noise [dB]; also "normal 15 5", "list 20,15", none
point_snr="uniform 5 25"   # SNR of point-source noises [dB]
draw_rooms_equally=false   # draw the room first, then one of its RIRs; false: every RIR is equally likely
packing=recording          # one FLAC per recording, with segments; or: utterance
copies=1                   # far-field versions of each utterance
seed=0                     # seed of all random numbers
. ./path.sh
. utils/parse_options.sh
[ $# -eq 3 ] || usage
require "$1/wav.scp" steps/prepare_speech.sh
require "$2/rirs.jsonl" "the step that makes $2"
flags=()
[ "$draw_rooms_equally" = false ] || flags=(--draw-rooms-equally)
utils/run_parts.sh "$nj" "$(dirname "$3")/log/$(basename "$3")" augment ${noises:+--noises "$noises"} \
  --snr "$snr" --point-snr "$point_snr" --packing "$packing" --copies "$copies" --seed "$seed" \
  "${flags[@]}" "$1" "$2" "$3"
