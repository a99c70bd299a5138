#!/usr/bin/env bash
# Run jobs on a Slurm cluster, as one job array. The calling convention is that of Kaldi's run.pl and slurm.pl.
# Usage: utils/slurm.sh [--mem 4G] [--time 2:00:00] [--max-jobs-run 50] [--SBATCH-OPTION VALUE ...] [JOB=1:N]
#          LOG COMMAND [ARGUMENT...]
# e.g.:  export cmd="utils/slurm.sh --mem 4G --time 2:00:00 --partition cpu"
#        utils/slurm.sh --mem 1G JOB=1:4 exp/log/count.JOB.log wc -l data/part.JOB
# Each JOB in LOG and in the arguments is replaced by the job's number. Arguments are passed on unchanged: no shell
# parses them again. Jobs run in this directory with this environment, so both must exist on all nodes. A job that is
# requeued starts its command again; the command is expected to continue its work. Every job that fails, dies or runs
# out of time is named, with its Slurm state and Slurm's reason or the last line of its log. When this script is
# killed, it cancels its jobs.
set -euo pipefail
usage() { sed -n '2,/^set -/{/^# /s/^# //p}' "$0"; }
die() {
  printf '%s: %s\n' "${0##*/}" "$*" >&2
  exit 1
}

first=1 last=1 at_once=''
options=(--requeue)
while [ $# -gt 0 ]; do
  case $1 in
    --help) usage && exit ;;
    --array* | --wait* | --parsable* | --output* | --error* | --open-mode* | --export* | --chdir* | --wrap*)
      die "$1 is set by slurm.sh itself: leave it out" ;;
    --[a-z]*)
      name=${1%%=*}
      if [[ $1 == *=* ]]; then value=${1#*=} && shift; else
        [ $# -gt 1 ] || die "$1 needs a value"
        value=$2 && shift 2
      fi
      case $name in
        --max-jobs-run) at_once=%$value ;;
        --num-threads) options+=("--cpus-per-task=$value") ;;
        *) options+=("$name=$value") ;;
      esac
      ;;
    JOB=*)
      [[ $1 =~ ^JOB=([0-9]+):([0-9]+)$ ]] || die "$1 must be JOB=FIRST:LAST, such as JOB=1:4"
      first=${BASH_REMATCH[1]} last=${BASH_REMATCH[2]}
      shift
      ;;
    *) break ;;
  esac
done
[ $# -ge 2 ] || { usage >&2 && exit 1; }
log=$1
shift
[ "$first" -le "$last" ] || die "JOB=$first:$last: the first must not be above the last"
command -v sbatch >/dev/null || die "no sbatch on this host: submit from another one, or use utils/local.sh"

# jobs write their exit status here, next to the logs, where all nodes can write
for ((job = first; job <= last; job++)); do
  joblog=${log//JOB/$job}
  { mkdir -p "$(dirname "$joblog")" && : >"$joblog"; } 2>/dev/null ||
    die "log $joblog cannot be written: is the disk full or read-only?"
done
ended=$(realpath -- "$(mktemp -d -- "$(dirname "${log//JOB/$first}")/.slurm.XXXXXX")")
name=roomeq${ended##*/.slurm}
waiting=
trap '[ -z "$waiting" ] || env -u ROOMEQ_RUN scancel --quiet --name="$name" --user="$(id -un)" || true; rm -rf -- "$ended"' EXIT
trap 'exit 130' INT
trap 'exit 143' TERM

script() { # print the job script; bash quotes every word
  printf '#!/bin/bash\nlog=%q ended=%q command=(' "$log" "$ended"
  printf '%q ' "$@"
  cat <<'EOF'
)
job=$SLURM_ARRAY_TASK_ID
rm -f -- "$ended/$job"
exec </dev/null >>"${log//JOB/$job}" 2>&1
printf '# Slurm job %s_%s on %s, restarted %s times\n' \
  "$SLURM_ARRAY_JOB_ID" "$job" "$SLURMD_NODENAME" "${SLURM_RESTART_COUNT:-0}"
"${command[@]//JOB/$job}"
status=$?
printf '%s\n' "$status" >"$ended/.$job" && mv -- "$ended/.$job" "$ended/$job"
exit "$status"
EOF
}

# Slurm's own messages (out of time, out of memory) go to the log too; % must be escaped for Slurm's patterns
slurm_log=${log//%/%%}
[[ $slurm_log != *\\* ]] || slurm_log=/dev/null
script "$@" >"$ended/script"
waiting=yes
sbatch --wait --parsable "${options[@]}" --job-name="$name" --array="$first-$last$at_once" --chdir="$PWD" \
  --export=ALL --open-mode=append --output="${slurm_log//JOB/%a}" "$ended/script" \
  >"$ended/id" 2>"$ended/error" </dev/null &
wait $! || true # the status is the highest of all jobs; each job is checked below
id=$(cut -d';' -f1 "$ended/id")
[ -n "$id" ] || { waiting= && die "sbatch refused: $(tail -n 1 "$ended/error")"; }

# sbatch may have lost contact with the controller, and a requeued job has not ended
warned=
while true; do
  if jobs=$(squeue --noheader --jobs="$id" 2>&1); then [ -n "$jobs" ] || break; else
    [[ $jobs != *"Invalid job id"* ]] || break # it ended so long ago that Slurm has no record of it
    [ -n "$warned" ] || printf '%s: Slurm does not answer, trying again: %s\n' "${0##*/}" "$(tail -n 1 <<<"$jobs")" >&2
    warned=yes
  fi
  sleep 3
done
waiting=

last_line() { # LOG STATE: print Slurm's reason if Slurm ended the job, else the last line of the log
  local line last='' reason=''
  while IFS= read -r line || [ -n "$line" ]; do
    last=$line
    case $line in
      '# Slurm job '*) reason= ;; # requeued: the earlier reason no longer counts
      'slurmstepd'*': error: '*) reason=$line ;;
    esac
  done 2>/dev/null <"$1" || true
  [[ $2 == FAILED* ]] || last=${reason:-$last}
  printf '%s\n' "${last:-the log is empty: is the disk full?}"
}

state_of() { # JOB: print its Slurm state; sacct may be absent, and scontrol forgets jobs after some minutes
  { scontrol --oneliner show job "${id}_$1" | sed -n 's/.*JobState=\([A-Z_]*\) Reason=\([^ ]*\).*/\1 (\2)/p' ||
    true; } 2>/dev/null | grep . ||
    { sacct --noheader --parsable2 --allocations --jobs="${id}_$1" --format=State 2>/dev/null || true; } | grep . ||
    echo "state unknown"
}

failed=0
for ((job = first; job <= last; job++)); do
  state=
  for ((tries = 0; tries < 20; tries++)); do # a file written on another node may appear with a delay
    [ ! -s "$ended/$job" ] || break
    state=$(state_of "$job")
    [[ $state == COMPLETED* || $state == *unknown ]] || break
    sleep 0.5
  done
  status=$(cat "$ended/$job" 2>/dev/null) || status=none
  if [ "$status" != 0 ]; then
    state=${state:-$(state_of "$job")}
    [[ $state != TIMEOUT* ]] || status=none # Slurm killed the shell, which may still have written a status
    printf '%s: job %d failed, exit status %s, Slurm says %s: %s (log: %s)\n' "${0##*/}" "$job" "$status" \
      "$state" "$(last_line "${log//JOB/$job}" "$state")" "${log//JOB/$job}" >&2
    failed=1
  fi
done
exit "$failed"
