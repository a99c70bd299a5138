#!/usr/bin/env bash
# Run jobs as local processes, as many at once as there are cores. The calling convention is that of Kaldi's run.pl.
# Usage: utils/local.sh [--max-jobs-run N] [JOB=1:N] LOG COMMAND [ARGUMENT...]
# e.g.:  utils/local.sh JOB=1:4 exp/log/count.JOB.log wc -l data/part.JOB
# Each JOB in LOG and in the arguments is replaced by the job's number. Every job that fails is named. Options of
# schedulers, such as --mem 4G, are ignored, as run.pl does.
set -euo pipefail
if [ $# -lt 2 ] || [ "$1" = --help ]; then
  sed -n '2,/^[^#]/{/^#/!q;s/^# \{0,1\}//;p}' "$0"
  [ "${1:-}" = --help ]
  exit
fi
first=1 last=1
max_jobs_run=$(env -u OMP_NUM_THREADS nproc)
while [[ ${1:-} == --* ]]; do
  option=${1%%=*} value=${1#*=}
  [[ $1 == *=* ]] || { value=${2:-} && shift; }
  shift || true
  [ "$option" != --max-jobs-run ] || max_jobs_run=$value
done
[[ $max_jobs_run =~ ^[1-9][0-9]{0,3}$ ]] || {
  echo "${0##*/}: --max-jobs-run '$max_jobs_run' must be a number of jobs from 1" >&2 && exit 1
}
[ $# -ge 2 ] || { echo "${0##*/}: LOG and COMMAND are missing; see --help" >&2 && exit 1; }
if [[ $1 =~ ^JOB=([0-9]+):([0-9]+)$ ]]; then
  first=${BASH_REMATCH[1]} last=${BASH_REMATCH[2]}
  shift
fi
log=$1
shift
last_line() { { tail -n 1 -- "$1" 2>/dev/null || true; } | grep . || echo "the log is empty$2"; }
pids=()
trap 'kill "${pids[@]}" 2>/dev/null || true' EXIT
for ((job = first; job <= last; job++)); do
  joblog=${log//JOB/$job}
  ((job - first < max_jobs_run)) || wait -n || true # one that fails is named below
  if ! { mkdir -p "$(dirname "$joblog")" && : >"$joblog"; } 2>/dev/null; then
    printf '%s: log %s cannot be written: is the disk full or read-only?\n' "${0##*/}" "$joblog" >&2
    exit 1
  fi
  "${@//JOB/$job}" </dev/null >"$joblog" 2>&1 &
  pids+=($!)
done
failed=0
for ((job = first; job <= last; job++)); do
  status=0 how=failed ask=': is the disk full?'
  wait "${pids[job - first]}" || status=$?
  [ "$status" -ne 0 ] || continue
  if [ "$status" -gt 128 ] && signal=$(kill -l "$status" 2>/dev/null); then how="failed by SIG$signal" ask=; fi
  [ "$status" -ne 137 ] || how+=' (memory may be short: use a smaller --nj)'
  joblog=${log//JOB/$job}
  printf '%s: job %d %s: %s (log: %s)\n' "${0##*/}" "$job" "$how" "$(last_line "$joblog" "$ask")" "$joblog" >&2
  failed=1
done
trap - EXIT
exit "$failed"
