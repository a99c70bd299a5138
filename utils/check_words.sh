# shellcheck shell=bash
# check_words LOG WORD...: stop unless $cmd, set by cmd.sh, passes these words to a job unchanged. Sourced.
check_words() {
  local log=$1 word
  shift
  [[ "$log $*" != *JOB* ]] || { echo "${0##*/}: no path or value may hold 'JOB': $*" >&2 && exit 1; }
  # shellcheck disable=SC2154 # cmd.sh sets it
  if [[ $cmd != utils/* ]]; then # Kaldi's runners paste words into a script without quoting them
    for word in "$@"; do
      [[ $word =~ ^[A-Za-z0-9_./,:=+@%^\ -]*$ ]] || {
        echo "${0##*/}: ${cmd%% *} would let a shell read '$word': rename it, or use utils/local.sh or" \
          "utils/slurm.sh" >&2
        exit 1
      }
    done
    [[ $log != *\ * ]] || { echo "${0##*/}: ${cmd%% *} takes no blanks in paths: $log" >&2 && exit 1; }
  fi
}
