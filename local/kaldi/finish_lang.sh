#!/usr/bin/env bash
# Make the lang directory of all systems: pronunciation and silence probabilities estimated with a GMM, and four LMs.
# Usage: local/kaldi/finish_lang.sh [--nj 2] [--dry-run true] <workspace> <set>
# e.g.:  local/kaldi/finish_lang.sh exp/kaldi train.clean
# All systems use the probabilities of the clean speech, whose alignments are the most accurate. The systems therefore
# differ in their acoustic models only.
set -euo pipefail
nj=2            # jobs
dry_run=false   # print the commands
. ./path.sh
. utils/parse_options.sh
. local/kaldi/common.sh
[ $# -eq 2 ] || usage
workspace=$1 gmm=$2/gmm/final
lm=data/local/lm dict=data/local/dict

after lang/nosp lang/lms "$2/gmm/final"
once lang/prons steps/get_prons.sh "data/$2" data/lang_nosp "$gmm"
once lang/pronprobs utils/dict_dir_add_pronprobs.sh --max-normalize true ${dict}_nosp \
  "$gmm"/{pron_counts_nowb,sil_counts_nowb,pron_bigram_counts_nowb}.txt $dict
once lang/lang utils/prepare_lang.sh $dict "<UNK>" data/local/lang_tmp data/lang
once lang/format local/format_lms.sh --src-dir data/lang $lm
for model in tglarge fglarge; do
  once lang/const_arpa_$model utils/build_const_arpa_lm.sh $lm/lm_$model.arpa.gz data/lang data/lang_test_$model
done
