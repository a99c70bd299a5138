#!/usr/bin/env bash
# Generate the synthetic corpus: speech synthesised by eSpeak NG, and RIRs of other simulation code (modes below 250 to
# 350 Hz, image sources and noise above) in place of measured ones. It contains no recordings. The directory layouts are
# those of LibriSpeech and BUT ReverbDB.
# Usage: local/make_synthetic_corpus.sh [--nj 2] [--utterances 900,150,150] [--rooms 9] [--positions 6] <corpora-dir>
# e.g.:  local/make_synthetic_corpus.sh corpora
set -euo pipefail
nj=2                     # jobs
utterances=900,150,150   # number of utterances for train, dev, test
rooms=9                  # number of rooms, 1 to 80
positions=6              # number of microphones, and of loudspeakers, per room
seed=0                   # seed of all random numbers
. ./path.sh
. utils/parse_options.sh
[ $# -eq 1 ] || usage
python local/make_synthetic_speech.py --nj "$nj" --utterances "$utterances" --seed "$seed" "$1/speech"
python local/make_synthetic_rirs.py --nj "$nj" --rooms "$rooms" --mics "$positions" --speakers "$positions" \
  --seed "$seed" "$1/reverbdb"
