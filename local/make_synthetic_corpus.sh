#!/usr/bin/env bash
# Generate the synthetic corpus: sentences spoken by eSpeak NG, and "measured" RIRs by a wave-acoustics generator.
# Nothing in it is recorded. The layouts are those of LibriSpeech and BUT ReverbDB.
# Usage: local/make_synthetic_corpus.sh [--nj 2] [--utterances 900,150,150] [--rooms 9] [--positions 6] <corpora-dir>
# e.g.:  local/make_synthetic_corpus.sh corpora
set -euo pipefail
nj=2                     # jobs
utterances=900,150,150   # for train, dev, test
rooms=9                  # 1 to 80
positions=6              # microphones and loudspeakers per room
seed=0                   # of every random draw
. ./path.sh
. utils/parse_options.sh
[ $# -eq 1 ] || usage
python local/make_synthetic_speech.py --nj "$nj" --utterances "$utterances" --seed "$seed" "$1/speech"
python local/make_synthetic_rirs.py --nj "$nj" --rooms "$rooms" --mics "$positions" --speakers "$positions" \
  --seed "$seed" "$1/reverbdb"
