# shellcheck shell=bash disable=SC2154,SC2034 # variables come from and go to the scripts that source it
# Functions shared by the scripts of this folder. Source it after parse_options.sh. The scripts set `nj`, `dry_run` and
# `workspace`, a directory with links to the steps/ and utils/ of stock Kaldi.

outputs='' key='' earlier='' # of `once`; none of the environment

# the command that runs Kaldi's jobs: run.pl, or queue.pl or slurm.pl with their options
runner=${kaldi_cmd:-run.pl --max-jobs-run $nj}

# kaldi_root: print Kaldi's top directory: KALDI_ROOT, or the Kaldi tree that holds this directory.
kaldi_root() {
  local root=${KALDI_ROOT:-} folder
  if [ -z "$root" ] && [[ $PWD == */egs/librispeech/* ]]; then root=${PWD%/egs/librispeech/*}; fi
  [ -n "$root" ] ||
    die "KALDI_ROOT is not set: set it to Kaldi's top directory, or put this directory into Kaldi's egs/librispeech"
  for folder in egs/wsj/s5/steps egs/wsj/s5/utils egs/librispeech/s5/local egs/librispeech/s5/conf src; do
    [ -d "$root/$folder" ] || die "KALDI_ROOT '$root' has no $folder: is it Kaldi's top directory?"
  done
  realpath "$root"
}

# require_plain NAME PATH: stop if stock scripts cannot work below a path.
require_plain() {
  local path
  path=$(realpath -m "$2")
  [[ $path != *[[:space:]\*\?\[]* ]] ||
    die "$1 '$2': Kaldi's scripts take no blanks and no *, ? or [ in its path ($path): choose another"
}

# jobs_for DATA: print the number of jobs for a data directory of the workspace: stock scripts refuse more than it has
# speakers.
jobs_for() {
  local speakers=$nj
  [ "$dry_run" = true ] || speakers=$(wc -l <"$workspace/$1/spk2utt")
  echo $((speakers < nj ? speakers : nj))
}

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
# runs again when its `lasting` words, its `inputs`, or the words of an earlier command of the same script have changed,
# when an earlier one has run since, or when a file or directory of the workspace that its words name is gone. With
# --dry-run it is printed. If two runs share a workspace, one waits for the other. If `outputs` holds files or a directory
# of the workspace, they are removed before: Kaldi leaves those of an earlier run with more jobs and reads them, or
# refuses a directory that is there.
once() {
  local name=$1 started=$SECONDS
  shift
  if [ "$dry_run" = true ]; then
    printf '%q ' "$@" && echo
    return
  fi
  key=$({ printf '%s\0' "${key:-}" "$name" && lasting "$@"; } | sha256sum | cut -c1-16)
  local mark=$workspace/done/$name log=$workspace/log/$name.log
  ! is_done "$mark" || return 0
  ! was_moved ||
    die "$workspace was made as $(cat "$workspace/place"), by which Kaldi names its features: start with --stage 8"
  take_lock
  ! is_done "$mark" || return 0 # another run has done it
  rm -f "$mark"
  # shellcheck disable=SC2086 # a pattern
  [ -z "${outputs:-}" ] || rm -rf "${workspace:?}"/$outputs
  mkdir -p "$(dirname "$log")" "$(dirname "$mark")"
  printf '%s kaldi: %s\n' "$(date +%H:%M:%S)" "$name"
  (cd "$workspace" && . ./path.sh && "$@") >"$log" 2>&1 </dev/null ||
    die "$name failed after $((SECONDS - started)) s: $(grep -v '^ *$' "$log" | tail -n 1) (log: $log)"
  { printf '%s\n' "$key" "$(date +%s%N).$$" "${earlier:-}" && named "${@:2}"; } >"$mark.new" && mv "$mark.new" "$mark"
  is_done "$mark"
}

# was_moved: tell whether the workspace has been moved or copied. Features, and configurations of online decoding, hold its
# path: commands would read those of the workspace that is there now.
was_moved() {
  [ -f "$workspace/place" ] && [ "$(cat "$workspace/place")" != "$(realpath "$workspace")" ]
}

# named WORD...: print those words of a command that are paths of the workspace.
named() {
  local word
  for word; do
    [[ -z $word || $word == /* || ! -e $workspace/$word ]] || printf '%s\n' "$word"
  done
}

# is_done MARK: tell whether a command's mark is that of its key, and of the earlier command as that ran last. If so, this
# command is the earlier one of the next. What it named must still be there, as it may have been deleted to save space.
is_done() {
  local lines=() path
  [ ! -f "$1" ] || mapfile -t lines <"$1"
  [ "${lines[0]:-}" = "$key" ] && [ "${lines[2]:-}" = "${earlier:-}" ] || return 1
  for path in "${lines[@]:3}"; do
    [ -e "$workspace/$path" ] || return 1
  done
  earlier=${lines[1]:-}
}

# take_lock: wait until no command of another run works in the workspace. Commands inherit the lock, so that those which
# outlive a killed run are waited for, too.
take_lock() {
  local status=0
  exec 9>"$workspace/.lock"
  flock -w 10 -E 9 9 || status=$?
  [ "$status" -ne 9 ] || {
    printf '%s kaldi: waiting for a command of another run in %s\n' "$(date +%H:%M:%S)" "$workspace"
    status=0
    flock 9 || status=$?
  }
  [ "$status" -eq 0 ] || printf '%s: no locks here: let one run at a time work there\n' "$workspace" >&2
}

# inputs FILE...: declare files that the following commands depend on, instead of those declared before; <(echo "$key")
# stands for these and for the commands so far.
inputs() {
  [ "$dry_run" = false ] || return 0
  local file
  for file; do require "$file" "the stage before"; done
  key=$(cat -- "$@" | sha256sum | cut -c1-16)
}

# after NAME...: declare that the following commands depend on commands of other scripts, by their `once` names.
after() {
  [ "$dry_run" = false ] || return 0
  local name
  for name; do require "$workspace/done/$name" "the stage before"; done
  key=$(head -qn 1 -- "${@/#/"$workspace"/done/}" | sha256sum | cut -c1-16)
}
