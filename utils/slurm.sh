#!/usr/bin/env bash
# Run jobs on a Slurm cluster, as one job array: the calling convention of Kaldi's run.pl and slurm.pl.
# Usage: utils/slurm.sh [--mem 4G] [--time 2:00:00] [--max-jobs-run 50] [--SBATCH-OPTION VALUE ...] [JOB=1:N]
#          LOG COMMAND [ARGUMENT...]
# e.g.:  export cmd="utils/slurm.sh --mem 4G --time 2:00:00 --partition cpu"
#        utils/slurm.sh --mem 1G JOB=1:4 exp/log/count.JOB.log wc -l data/part.JOB
# Each JOB in LOG and in the arguments becomes the job's number. Arguments reach the command as they are: no shell
# reads them again. Jobs see this directory and environment, so both must be there on all nodes. A job that is
# requeued starts its command again, which is to go on where it was. Every job that fails, dies or runs out of
# time is named, with its Slurm state and Slurm's reason or the last line of its log. Killed itself, it cancels its jobs.
set -euo pipefail
usage() { sed -n '2,/^set -/{/^# /s/^# //p}' "$0"; }
die() {
  printf '%s: %s\n' "${0##*/}" "$*" >&2
  exit 1
}

first=1 last=1 at_once=''
options=(--job-name=roomeq --requeue)
while [ $# -gt 0 ]; do
  case $1 in
    --help) usage && exit ;;
    --array* | --wait* | --parsable* | --output* | --error* | --open-mode* | --export* | --chdir* | --wrap*)
      die "$1 is for slurm.sh itself to set" ;;
    --max-jobs-run | --num-threads | --[a-z]*)
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
command -v sbatch >/dev/null || die "no sbatch here: is this a host that jobs are submitted from? (utils/local.sh needs none)"

# where jobs say how they ended: beside the logs, which all nodes see
for ((job = first; job <= last; job++)); do
  joblog=${log//JOB/$job}
  { mkdir -p "$(dirname "$joblog")" && : >"$joblog"; } 2>/dev/null ||
    die "log $joblog cannot be written: is the disk full or read-only?"
done
ended=$(realpath -- "$(mktemp -d -- "$(dirname "${log//JOB/$first}")/.slurm.XXXXXX")")
name=roomeq${ended##*/.slurm}
waiting=
trap '[ -z "$waiting" ] || scancel --quiet --name="$name" --user="$(id -un)" || true; rm -rf -- "$ended"' EXIT
trap 'exit 130' INT
trap 'exit 143' TERM

script() { # the job: bash itself quotes every word of it
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

# what Slurm itself says of a job (out of time, out of memory) goes to its log too; % is its sign for patterns
slurm_log=${log//%/%%}
[[ $slurm_log != *\\* ]] || slurm_log=/dev/null
script "$@" >"$ended/script"
waiting=yes
sbatch --wait --parsable "${options[@]}" --job-name="$name" --array="$first-$last$at_once" --chdir="$PWD" \
  --export=ALL --open-mode=append --output="${slurm_log//JOB/%a}" "$ended/script" \
  >"$ended/id" 2>"$ended/said" </dev/null &
wait $! || true # its status is the highest of all jobs: each is looked at below
id=$(cut -d';' -f1 "$ended/id")
[ -n "$id" ] || { waiting= && die "sbatch refused: $(tail -n 1 "$ended/said")"; }

# sbatch may have lost the controller, and a requeued job is not at its end
said=
while true; do
  if jobs=$(squeue --noheader --jobs="$id" 2>&1); then [ -n "$jobs" ] || break; else
    [[ $jobs != *"Invalid job id"* ]] || break # so long at its end that Slurm has forgotten it
    [ -n "$said" ] || printf '%s: Slurm does not answer, asking on: %s\n' "${0##*/}" "$(tail -n 1 <<<"$jobs")" >&2
    said=yes
  fi
  sleep 3
done
waiting=

last_words() { # LOG STATE: Slurm's own reason if it ended the job, else the last line
  local line last='' why=''
  while IFS= read -r line || [ -n "$line" ]; do
    last=$line
    case $line in
      '# Slurm job '*) why= ;; # it was requeued: what ended it before is past
      'slurmstepd'*': error: '*) why=$line ;; # it may name its node
    esac
  done 2>/dev/null <"$1" || true
  [[ $2 == FAILED* ]] || last=${why:-$last}
  printf '%s\n' "${last:-it left no word: is the disk full?}"
}

state_of() { # JOB: Slurm's word on it; sacct may be absent, and scontrol forgets after some minutes
  { scontrol --oneliner show job "${id}_$1" | sed -n 's/.*JobState=\([A-Z_]*\) Reason=\([^ ]*\).*/\1 (\2)/p' ||
    true; } 2>/dev/null | grep . ||
    { sacct --noheader --parsable2 --allocations --jobs="${id}_$1" --format=State 2>/dev/null || true; } | grep . ||
    echo "state unknown"
}

failed=0
for ((job = first; job <= last; job++)); do
  state=
  for ((tries = 0; tries < 20; tries++)); do # another node's file takes a moment to show
    [ ! -s "$ended/$job" ] || break
    state=$(state_of "$job")
    [[ $state == COMPLETED* || $state == *unknown ]] || break
    sleep 0.5
  done
  status=$(cat "$ended/$job" 2>/dev/null) || status=none
  if [ "$status" != 0 ]; then
    state=${state:-$(state_of "$job")}
    [[ $state != TIMEOUT* ]] || status=none # what the shell noted in its last moment is Slurm's doing
    printf '%s: job %d failed, exit status %s, Slurm says %s: %s (log: %s)\n' "${0##*/}" "$job" "$status" \
      "$state" "$(last_words "${log//JOB/$job}" "$state")" "${log//JOB/$job}" >&2
    failed=1
  fi
done
exit "$failed"
