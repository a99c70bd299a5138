#!/usr/bin/env bash
# Word error rates over several seeds: rooms, speech and their split stay, all that is drawn later is drawn again.
# Usage: KALDI_ROOT=DIR tests/bench/wer.sh [--seeds "0 1 2 3 4"] <out-dir> [-- options of run.sh]
# e.g.:  KALDI_ROOT=~/kaldi tests/bench/wer.sh exp/bench_wer -- --config conf/mini.conf
# May be stopped at any time; the same call goes on. The table of all seeds that are done is <out-dir>/wer.
set -euo pipefail
seeds="0 1 2 3 4"   # as many runs
. ./path.sh
. utils/parse_options.sh
[ $# -ge 1 ] || usage
[[ $seeds =~ ^[0-9]+(\ [0-9]+)*$ ]] || die "--seeds '$seeds' must be whole numbers with blanks between"
out=$(realpath -m "$1")
shift
[ "${1:-}" != -- ] || shift
./run.sh "$@" --data "$out/data" --exp "$out/exp" --corpora "$out/corpora" --stop-stage 1
done=()
for seed in $seeds; do
  where=$out/seed$seed
  mkdir -p "$where/data"
  for shared in "$out"/data/{measured,rirs.real,rirs.real.train,rirs.real.dev,rirs.real.test} "$out"/data/*.clean; do
    ln -sfn "$shared" "$where/data/${shared##*/}"
  done
  ./run.sh "$@" --seed "$seed" --data "$where/data" --exp "$where/exp" --corpora "$out/corpora" --stage 2 --stop-stage 7
  workspace=$where/exp/kaldi
  if [ ${#done[@]} -gt 0 ] && [ ! -e "$workspace" ]; then # no seed changes these; stages repeat what is out of date
    mkdir -p "$workspace"
    (cd "${done[0]}" && cp -a --parents data/lang* data/local {,done/}train.clean/{gmm,align} done/lang "$workspace")
  fi
  ./run.sh "$@" --seed "$seed" --data "$where/data" --exp "$where/exp" --corpora "$out/corpora" --stage 8
  done+=("$workspace")
  roomeq wer --rirs "$out/data/rirs.real" "${done[@]}" "$out/wer"
done
