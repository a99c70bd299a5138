# shellcheck shell=bash
# Ask whether the output of a roomeq verb is up to date. Sourced.
# All steps of a recipe ask one process, if the recipe has called start_answering; a step by itself starts its own.

# Start the process. It ends when its input does, and the recipe waits for it.
start_answering() {
  local stdout to from pipe
  exec {stdout}>&1
  coproc python -P -m roomeq.answers 3>&1 >&"$stdout"
  # opened anew: bash closes duplicates of a coprocess's descriptors in the scripts that it starts
  exec {to}>"/dev/fd/${COPROC[1]}" {from}<"/dev/fd/${COPROC[0]}" {stdout}>&-
  for pipe in "${COPROC[@]}"; do exec {pipe}>&-; done
  export ROOMEQ_ANSWERS="$to $from"
  # shellcheck disable=SC2064 # the numbers of today
  trap "exec $to>&- && wait $COPROC_PID || true" EXIT
}

# up_to_date VERB [ARGUMENT...]: exit status 0 if the output is up to date, 3 if it is to be made, else an error.
up_to_date() {
  local to from status
  read -r to from <<<"${ROOMEQ_ANSWERS:-}"
  if [ -n "$to" ] && [[ "$*" != *[$'\n\x1f']* ]] && # a process that was killed is done without
    (trap '' PIPE && IFS=$'\x1f' && printf '%s\n' "$*" >&"$to") 2>/dev/null && read -r status <&"$from"; then
    return "$status"
  fi
  roomeq --ask "$@"
}

# run_verb VERB [ARGUMENT...]: run a verb; where its output is up to date, nothing is started.
run_verb() {
  local status=3
  if [ -n "${ROOMEQ_ANSWERS:-}" ]; then
    status=0
    up_to_date "$@" || status=$?
  fi
  [ "$status" -eq 3 ] || return "$status"
  roomeq "$@"
}
