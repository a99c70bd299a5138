#!/usr/bin/env bash
# Make Kaldi data directories train.clean, dev.clean and test.clean from a speech corpus.
# Usage: steps/prepare_speech.sh [options] <corpus> <data-dir>
# e.g.:  steps/prepare_speech.sh --train-sets train-clean-100,train-clean-360 /corpora/LibriSpeech data
set -euo pipefail
train_sets=train-clean-100   # sets for training, comma-separated: of LibriSpeech, of a CSV (column set), or folders
dev_sets=dev-clean           # sets for development, likewise
test_sets=test-clean         # sets for test, likewise
channel=0                    # channel of files with several that is used, counted from 0
. ./path.sh
. utils/ask.sh
. utils/parse_options.sh
[ $# -eq 2 ] || usage
run_verb prepare-speech --train-sets "$train_sets" --dev-sets "$dev_sets" --test-sets "$test_sets" --channel "$channel" \
  "$1" "$2"
