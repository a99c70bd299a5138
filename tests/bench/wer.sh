#!/usr/bin/env bash
# Word error rates over several seeds: rooms, speech and their split stay, all that is drawn later is drawn again.
# Usage: KALDI_ROOT=DIR tests/bench/wer.sh [--seeds "0 1 2 3 4"] [--rows-without-cmvn "sim.rvb sim.EQ.rvb"]
#        [--counted DIR] <out-dir> [-- options of run.sh]
# e.g.:  KALDI_ROOT=~/kaldi tests/bench/wer.sh exp/bench_wer -- --config conf/mini.conf
# May be stopped at any time; the same call goes on. The tables of all seeds that are done are <out-dir>/wer and
# <out-dir>/wer.without_cmvn. Seeds of another machine are added with --counted docs/results/counts/PAGE, where
# tests/bench/publish.py has put their errors.
set -euo pipefail
seeds="0 1 2 3 4"    # as many runs
rows_without_cmvn=   # training sets to train a second recogniser on, whose features are not normalised
counted=             # directory with the errors of further seeds: wer.jsonl, wer.without_cmvn.jsonl
. ./path.sh
. utils/parse_options.sh
[ $# -ge 1 ] || usage
[[ $seeds =~ ^[0-9]+(\ [0-9]+)*$ ]] || die "--seeds '$seeds' must be whole numbers with blanks between"
out=$(realpath -m "$1")
shift
[ "${1:-}" != -- ] || shift
[ -z "$counted" ] || require "$counted/wer.jsonl" tests/bench/publish.py
./run.sh "$@" --data "$out/data" --exp "$out/exp" --corpora "$out/corpora" --stop-stage 1

first='' # workspace that has been trained in
done=() done_without_cmvn=()
train() { # WORKSPACE OPTION...: stages 8 to 10
  local workspace=$1
  if [ -n "$first" ] && [ ! -e "$workspace" ]; then # no seed changes these; stages repeat what is out of date
    mkdir -p "$workspace"
    (cd "$first" && cp -a --parents data/lang* data/local {,done/}train.clean/{gmm,align} done/lang "$workspace")
  fi
  ./run.sh "${options[@]}" --exp "${workspace%/kaldi}" --stage 8 "${@:2}"
  first=${first:-$workspace}
}
table() { # NAME WORKSPACE...: word error rates of all seeds so far
  local also=()
  [ ! -f "$counted/$1.jsonl" ] || also=(--counted "$counted/$1.jsonl")
  roomeq wer "${rirs[@]}" "${also[@]}" "${@:2}" "$out/$1"
}
rirs=(--train-rirs "$out/data/rirs.real.train")
for x in "$out"/data/rirs.real{,.dev,.test}; do
  [ ! -d "$x" ] || rirs+=(--rirs "$x")
done
for seed in $seeds; do
  where=$out/seed$seed
  mkdir -p "$where/data"
  for shared in "$out"/data/{*.clean,measured*,rirs.*}; do
    ln -sfn "$shared" "$where/data/${shared##*/}"
  done
  options=("$@" --seed "$seed" --data "$where/data" --corpora "$out/corpora")
  ./run.sh "${options[@]}" --exp "$where/exp" --stage 2 --stop-stage 7
  for row in $rows_without_cmvn; do
    [ -d "$where/data/train.$row" ] || die "--rows-without-cmvn: $where/data has no train.$row"
  done
  for x in "$where"/data/rirs.{sim,sim.EQ,sim.loop,sim.free}.dev; do
    [ ! -d "$x" ] || rirs+=(--rirs "$x")
  done
  train "$where/exp/kaldi"
  done+=("$where/exp/kaldi")
  table wer "${done[@]}"
  [ -n "$rows_without_cmvn" ] || continue
  mkdir -p "$where/exp.without_cmvn"
  for x in eq loop; do
    ln -sfn "$where/exp/$x" "$where/exp.without_cmvn/$x"
  done
  train "$where/exp.without_cmvn/kaldi" --online-cmvn false --rows "$rows_without_cmvn"
  done_without_cmvn+=("$where/exp.without_cmvn/kaldi")
  table wer.without_cmvn "${done_without_cmvn[@]}"
done
