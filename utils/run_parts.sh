#!/usr/bin/env bash
# Run a roomeq verb in parts through $cmd, then once more to assemble the output. With the default $cmd, which runs jobs
# on this machine, one process does it all, whose NJ workers share what it has read; LOG_DIR/VERB.log has what they say.
# Usage: utils/run_parts.sh NJ LOG_DIR VERB [ARGUMENT...]
# e.g.:  utils/run_parts.sh 4 exp/log compensate data/rirs.sim.train exp/eq data/rirs.sim.EQ.train
# Nothing is started where the output is up to date. Finished parts are skipped, so a killed run continues where it
# stopped.
set -euo pipefail
. ./path.sh
. ./cmd.sh
. utils/ask.sh
. utils/check_words.sh
. utils/progress.sh
[ $# -ge 3 ] || { sed -n '2,7s/^# //p' "$0" >&2 && exit 1; }
nj=$1 log_dir=$2 verb=$3
shift 3
[[ $nj =~ ^[1-9][0-9]*$ ]] || { echo "${0##*/}: nj='$nj' must be a positive number of jobs" >&2 && exit 1; }
check_words "$log_dir" "$@"
status=0
up_to_date "$verb" "$@" || status=$?
[ "$status" -eq 3 ] || exit "$status" # 3: the output is to be made; 0: it is up to date
cores=$(env -u OMP_NUM_THREADS nproc) # as many jobs as that at once, as in utils/local.sh
workers=$((nj < cores ? nj : cores))
# shellcheck disable=SC2154 # cmd.sh sets it
if [ "$cmd" = utils/local.sh ] && [ "$workers" -gt 1 ]; then
  export ROOMEQ_WORKER_LOG=$log_dir/$verb.log
  { mkdir -p -- "$log_dir" && : >"$ROOMEQ_WORKER_LOG"; } 2>/dev/null || {
    echo "${0##*/}: log $ROOMEQ_WORKER_LOG cannot be written: is the disk full or read-only?" >&2 && exit 1
  }
  roomeq "$verb" --nj "$workers" "$@"
  exit
fi
run_jobs "$log_dir" JOB=1:"$nj" "$log_dir/$verb.JOB.log" roomeq "$verb" --part "JOB/$nj" "$@"
roomeq "$verb" "$@"
