# shellcheck shell=bash
# Let a script end with everything that it has started, when a signal ends it or one of its parts. Sourced.
#
# The outermost script starts itself again and waits. All descendants carry a mark in their environment, by which they
# are found wherever they are; a part that fails, or is killed, leaves nothing behind either. The exit status is 128 + n
# after signal n.

marked_processes() (
  mark=ROOMEQ_RUN=$ROOMEQ_RUN
  unset ROOMEQ_RUN # the commands here are not meant
  { grep -lsxzF "$mark" /proc/[0-9]*/environ || true; } | grep -o '[0-9]*'
)

end_marked_processes() { # those that do not end within ten seconds are killed
  local tries pids
  for ((tries = 0; tries < 100; tries++)); do
    pids=$(marked_processes) || return 0
    # shellcheck disable=SC2086 # process ids
    ((tries % 10)) || kill $pids 2>/dev/null || true
    sleep 0.1
  done
  # shellcheck disable=SC2086 # process ids
  kill -KILL $pids 2>/dev/null || true
}

end_by_signal() { # NAME NUMBER
  trap '' HUP INT TERM
  printf '%s: ended by SIG%s\n' "${0##*/}" "$1" >&2
  end_marked_processes
  exit $((128 + $2))
}

if [ -z "${ROOMEQ_RUN:-}" ]; then
  ROOMEQ_RUN=$$.$(date +%s%N)
  export ROOMEQ_RUN
  # ends all when this process is killed, which closes the pipe
  exec {ROOMEQ_ALIVE}> >(trap '' HUP INT TERM && { read -r || end_marked_processes; } >/dev/null 2>&1)
  trap 'end_by_signal HUP 1' HUP
  trap 'end_by_signal INT 2' INT
  trap 'end_by_signal TERM 15' TERM
  "$BASH" "$0" "$@" <&0 {ROOMEQ_ALIVE}>&- &
  status=0
  wait "$!" || status=$?
  end_marked_processes
  exit "$status"
fi
