#!/usr/bin/env bash
# Make the lexicon and four language models, or fetch LibriSpeech's, and the first lang directory.
# Usage: local/kaldi/make_lang.sh [options] <workspace> <text>...
# e.g.:  local/kaldi/make_lang.sh exp/kaldi corpora/speech/LibriSpeech-LM/lm.txt data/train.clean/text
# Each <text> holds lines of words, or is a Kaldi file named `text`. Without any, LibriSpeech's models are downloaded.
set -euo pipefail
nj=2                    # jobs
lm_url=www.openslr.org/resources/11   # of LibriSpeech's models
dry_run=false           # print the commands
. ./path.sh
. utils/parse_options.sh
. local/kaldi/common.sh
[ $# -ge 1 ] || usage
workspace=$1
shift
lm=data/local/lm dict=data/local/dict_nosp

if [ $# = 0 ]; then
  once lang/lms local/download_lm.sh "$lm_url" $lm
  once lang/dict local/prepare_dict.sh --stage 3 --nj "$nj" $lm $lm $dict
else
  inputs local/make_dict.py local/espeak_worker.py local/kaldi/make_lms.py "$@"
  if [ "$dry_run" = false ]; then
    mkdir -p "$workspace/$lm"
    for text; do
      if [ "${text##*/}" = text ]; then sed 's/^[[:space:]]*[^[:space:]]*[[:space:]]*//' "$text"; else cat "$text"; fi
    done >"$workspace/$lm/text"
  fi
  once lang/dict python "$PWD/local/make_dict.py" --no-ids $lm/text $dict
fi
once lang/nosp utils/prepare_lang.sh $dict "<UNK>" data/local/lang_tmp_nosp data/lang_nosp
[ $# = 0 ] || once lang/lms python "$PWD/local/kaldi/make_lms.py" $lm/text $lm
