# shellcheck shell=bash disable=SC2154,SC2034 # variables come from and go to the scripts that source it
# Functions shared by the scripts of this folder. Source it after parse_options.sh. The scripts set `nj`, `dry_run` and
# `workspace`, a directory with links to the steps/ and utils/ of stock Kaldi.

# the command that runs Kaldi's jobs: run.pl, or queue.pl or slurm.pl with their options
runner=${kaldi_cmd:-run.pl --max-jobs-run $nj}

# lasting WORD...: print the words of a command on which its result depends, each ended by a null byte: all but the
# values of --nj, --egs.nj, --cmd and --stage.
lasting() {
  local word previous=''
  for word; do
    [[ $previous =~ ^--((egs\.)?nj|cmd|stage)$ ]] || printf '%s\0' "$word"
    previous=$word
  done
}

# once NAME COMMAND...: run a command in the workspace unless it has run before; log to <workspace>/log/NAME.log. It
# runs again when its `lasting` words, its `inputs`, or the words of an earlier command of the same script have changed.
# With --dry-run it is printed. If two runs share a workspace, one waits for the other. If `outputs` holds files of the
# workspace, they are removed before: Kaldi leaves those of an earlier run with more jobs, and reads them.
once() {
  local name=$1 started=$SECONDS
  shift
  if [ "$dry_run" = true ]; then
    printf '%q ' "$@" && echo
    return
  fi
  key=$({ printf '%s\0' "${key:-}" "$name" && lasting "$@"; } | sha256sum | cut -c1-16)
  local mark=$workspace/done/$name log=$workspace/log/$name.log
  [ "$(cat "$mark" 2>/dev/null)" != "$key" ] || return 0
  exec 9>"$workspace/.lock" # commands inherit the lock, so those that outlive a killed run are waited for, too
  flock -w 10 9 || {
    printf '%s kaldi: waiting for a command of another run in %s\n' "$(date +%H:%M:%S)" "$workspace"
    flock 9
  }
  [ "$(cat "$mark" 2>/dev/null)" != "$key" ] || return 0 # the other run has done it
  rm -f "$mark"
  # shellcheck disable=SC2086 # a pattern
  [ -z "${outputs:-}" ] || rm -f "$workspace"/$outputs
  mkdir -p "$(dirname "$log")" "$(dirname "$mark")"
  printf '%s kaldi: %s\n' "$(date +%H:%M:%S)" "$name"
  (cd "$workspace" && . ./path.sh && "$@") >"$log" 2>&1 </dev/null ||
    die "$name failed after $((SECONDS - started)) s: $(grep -v '^ *$' "$log" | tail -n 1) (log: $log)"
  echo "$key" >"$mark.new" && mv "$mark.new" "$mark"
}

# inputs FILE...: declare files that the following commands depend on.
inputs() {
  [ "$dry_run" = false ] || return 0
  local file
  for file; do require "$file" "the stage before"; done
  key=$(cat -- "$@" | sha256sum | cut -c1-16)
}

# after NAME...: declare that the following commands depend on commands of other scripts, by their `once` names.
after() { inputs "${@/#/"$workspace"/done/}"; }
