#!/usr/bin/env bash
# Simulate one RIR per measured RIR, with the same room, source and microphone, and with random materials; or, with
# --rooms, RIRs of rooms that are drawn at random.
# Usage: steps/simulate_rirs.sh [options] [<measured-rir-dir>] <rir-dir>
# e.g.:  steps/simulate_rirs.sh --nj 4 data/rirs.real.train data/rirs.sim.train
#        steps/simulate_rirs.sh --nj 4 --rooms 1000 data/rirs.drawn.train
set -euo pipefail
nj=2               # jobs
rooms=             # instead of <measured-rir-dir>: number of rooms to draw, or the first and the last, as 1001-1100
room_types=        # what they are drawn from: a TOML file, or names in conf/room_types.toml; default: all of these
fs=16000           # sample rate [Hz]; the following steps take 16000 only
t60_range=         # range of T60 [s]; measured: that of the measured rooms; default: 0.2,2.0, or as the room types say
num_rays=10000     # rays per source, for each distinct set of scattering coefficients over the bands
order=200          # reflections of a ray on average, up to 3 s; more where the decay needs it
model=             # effects to add, from steps/close_loop.sh: exp/loop/model.json
draw_devices=false # with --model: draw loudspeakers and microphones anew, and where they face if no row states it
seed=0             # seed of all random numbers
. ./path.sh
. utils/parse_options.sh
if [ -n "$rooms" ]; then [ $# -eq 1 ] || usage; else [ $# -eq 2 ] || usage; fi
[ -n "$rooms" ] || require "$1/rirs.jsonl" steps/split_rirs.sh
more=()
[ -z "$model" ] || { require "$model" steps/close_loop.sh && more+=(--model "$model"); }
[ "$draw_devices" = false ] || more+=(--draw-devices)
[ -z "$rooms" ] || more+=(--rooms "$rooms")
[ -z "$room_types" ] || more+=(--room-types "$room_types")
[ -z "$t60_range" ] || more+=(--t60-range "$t60_range")
out=${*: -1}
utils/run_parts.sh "$nj" "$(dirname "$out")/log/$(basename "$out")" simulate --fs "$fs" --num-rays "$num_rays" \
  --order "$order" "${more[@]}" --seed "$seed" "$@"
