#!/usr/bin/env bash
# Run a roomeq verb in parts through $cmd, then once more to put its output in place.
# Usage: utils/run_parts.sh NJ LOG_DIR VERB [ARGUMENT...]
# e.g.:  utils/run_parts.sh 4 exp/log compensate data/rirs.sim.train exp/eq data/rirs.sim.EQ.train
# Parts that are done already cost nothing, so a killed run goes on where it stopped.
set -euo pipefail
. ./path.sh
. ./cmd.sh
[ $# -ge 3 ] || { sed -n '2,5s/^# //p' "$0" >&2 && exit 1; }
nj=$1 log_dir=$2 verb=$3
shift 3
[[ $nj =~ ^[1-9][0-9]*$ ]] || { echo "${0##*/}: nj='$nj' must be a positive number of jobs" >&2 && exit 1; }
[[ "$log_dir $*" != *JOB* ]] || { echo "${0##*/}: no path or value may hold 'JOB': $*" >&2 && exit 1; }
if [[ $cmd != utils/* ]]; then # stock runners paste words without blanks into a script, and logs into commands
  for word in "$@"; do
    [[ $word =~ ^[A-Za-z0-9_./,:=+@%^\ -]*$ ]] || {
      echo "${0##*/}: ${cmd%% *} would let a shell read '$word': rename it, or use utils/local.sh or utils/slurm.sh" >&2
      exit 1
    }
  done
  [[ $log_dir != *\ * ]] || { echo "${0##*/}: ${cmd%% *} takes no blanks in paths: $log_dir" >&2 && exit 1; }
fi
# $cmd may hold options ("queue.pl --mem 2G"): split on purpose
# shellcheck disable=SC2086
$cmd JOB=1:"$nj" "$log_dir/$verb.JOB.log" roomeq "$verb" --part "JOB/$nj" "$@"
roomeq "$verb" "$@"
