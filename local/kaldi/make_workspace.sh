#!/usr/bin/env bash
# Make a workspace for stock Kaldi scripts: link Kaldi's folders, check Kaldi's tools, copy data directories.
# Usage: local/kaldi/make_workspace.sh [--dry-run true] [--nj 2] [--seed 0] <workspace> <data-dir>...
# e.g.:  KALDI_ROOT=~/kaldi local/kaldi/make_workspace.sh exp/kaldi data/train.clean data/test.real.rvb
set -euo pipefail
nj=2            # jobs at a time, for local processes
dry_run=false   # print the commands
seed=           # seed that far-field speech must have been made with; default: any
. ./path.sh
. ./cmd.sh
. utils/parse_options.sh
. local/kaldi/common.sh
[ $# -ge 2 ] || usage
workspace=$1
shift
require_plain workspace "$workspace"

if [ "$dry_run" = true ]; then
  root=${KALDI_ROOT:-KALDI_ROOT}
  echo "ln -s $root/egs/wsj/s5/{steps,utils} $root/egs/librispeech/s5/{local,conf} $workspace/"
  for data; do echo "local/kaldi/copy_data.py $data $workspace/data/${data##*/}"; done
  exit
fi
root=$(kaldi_root)
mkdir -p "$workspace/data"
if was_moved; then
  log "$workspace was made as $(cat "$workspace/place"), by which Kaldi names its features: commands run again"
  rm -rf "$workspace"/done "$workspace"/data/*/split[0-9]*
fi
realpath "$workspace" >"$workspace/place"
for link in wsj/s5/steps wsj/s5/utils librispeech/s5/local librispeech/s5/conf; do
  ln -sfn "$root/egs/$link" "$workspace/${link##*/}"
done
{
  printf 'export KALDI_ROOT=%q ROOMEQ_DIR=%q LC_ALL=C PYTHONUNBUFFERED=1 OPENBLAS_NUM_THREADS=1\n' "$root" "$PWD"
  cat <<'EOF'
PATH=$PWD/utils:$PWD:$KALDI_ROOT/tools/openfst/bin:$PATH
for folder in "$KALDI_ROOT"/src/*bin; do PATH=$folder:$PATH; done
export PATH=$PWD/bin:$ROOMEQ_DIR/.venv/bin:$PATH # ahead of Kaldi's tools, which may link to another Python
EOF
} >"$workspace/path.sh"
printf 'export train_cmd=%q decode_cmd=%q\n' "$runner" "$runner" >"$workspace/cmd.sh"

local/kaldi/check_kaldi.sh "$workspace"

for data; do
  require "$data/wav.scp" "stages 0-6"
  local/kaldi/copy_data.py ${seed:+--seed "$seed"} "$data" "$workspace/data/${data##*/}"
done
